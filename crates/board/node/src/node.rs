//! The bridge as it stands on the bus: frames in, samples in, frames out.
//!
//! This is the whole of what a board does between its converter and its wires, without any
//! hardware, so the host can run the same thing.
//!
//! The tick makes offsets and nothing else. The rest of a CANopen node's messages, the heartbeat,
//! emergencies, the status, answers to SDO requests, is [`Node::next_service_frame`], which a board calls from a task that
//! a tick interrupts.

use trueup_canopen::{
    emergency::{EmergencyProducer, Fault, Faults},
    heartbeat::HeartbeatConsumer,
    sdo,
};
use trueup_core::{
    bridge::{self, Bridge, TickInput},
    cnc::{CncMessage, Control, OffsetFlags, OffsetQuality, Output},
    sensor_health::NoiseStatistics,
    supply_monitor::SupplyMonitor,
    units::TimestampMs,
};
use trueup_link::{
    e2e,
    frame::Frame,
    frames::{self, NmtState},
    layout::{
        CONTROL_ID, HEARTBEAT_PERIOD_MS, MIN_SERVICE_FRAME_INTERVAL_MS, NMT_ID, SDO_REQUEST_ID,
        STATUS_PERIOD_MS,
    },
    receiver::{CncReceiver, ReceiveError},
    status::{self, FrameRejectReason, Status},
};
use trueup_store::{
    calibration::calibration_crc,
    calibration_load::{LoadBuffer, LoadOutcome, LoadSlot},
    write_log::{WriteKind, machine_identity_crc},
};

use crate::{
    configuration::NodeConfiguration, display_values::DisplayValues, reset_info::ResetInfo,
};

mod confirmation;
mod faults;
pub mod firmware_update;
mod learned_changes;
mod master;
mod nmt;
mod object_access;
mod reference_status;
mod registers;
mod restart;
mod service_switch;
mod status_items;
mod supply;
mod write_journal;

use firmware_update::FirmwareUpdate;
pub use master::Interface;
use master::Master;
use reference_status::OfferedReference;
pub use reference_status::ZeroOutcome;
use registers::RegisterExchange;
use service_switch::SwitchDebouncer;
use write_journal::WriteJournal;

/// The frames of one tick: both halves of a cycle's offsets.
pub type OffsetFrames = [Frame; 2];

/// The bridge, its memory, and its end of the link.
#[derive(Debug)]
pub struct Node<'a> {
    /// `None` without a valid calibration: nothing can be computed then.
    bridge: Option<Bridge<'a>>,
    state: bridge::BridgeState,
    receiver: CncReceiver,
    now: TimestampMs,
    /// The same by a clock that does not count samples.
    clock: TimestampMs,
    until_forgiven_ms: u32,
    blocks: u32,
    counter: u8,
    heartbeat: HeartbeatSchedule,
    consumer: HeartbeatConsumer,
    /// When [`Node::next_service_frame`] last ran.
    serviced: TimestampMs,
    /// The flags of all ticks since then.
    flags_since: OffsetFlags,
    server: sdo::SdoServer,
    answer: Option<Frame>,
    emergencies: EmergencyProducer,
    /// Of the board, which stay until it says otherwise.
    board_faults: Faults,
    /// Questions that are open to the operator: nothing is available until they are answered.
    questions: Faults,
    /// The last question that was answered, for the board to keep.
    confirmed: Option<Fault>,
    master: Master,
    /// Of the RS-485 line.
    registers: RegisterExchange,
    /// The blob of the running calibration.
    blob: &'a [u8],
    /// Its machine and board, as [`machine_identity_crc`] has them.
    identity: u32,
    slot: LoadSlot<'a>,
    /// CRC of the calibration that is stored for the next start; 0: none was loaded.
    new_crc: u32,
    /// A master has requested to drop it.
    drops_new: bool,
    firmware: FirmwareUpdate,
    /// Who has written.
    log: WriteJournal,
    noise: NoiseStatistics,
    status: StatusSchedule,
    last_refused: FrameRejectReason,
    board: BoardInfo,
    restart: bool,
    degraded: bool,
    last: Output,
    zero: Option<ZeroOutcome>,
    /// The reference that is offered, and where the one comes from that is in force.
    offer: OfferedReference,
    /// A `Zero` was refused since [`Node::next_service_frame`] last ran.
    zero_refused: bool,
    /// So was a learned change, and `Control` was not received without one since.
    learned_refused: bool,
    supply: SupplyMonitor,
    switch: SwitchDebouncer,
}

/// When the next heartbeat is due.
#[derive(Debug)]
struct HeartbeatSchedule {
    since_ms: u32,
    period_ms: u16,
    /// The boot-up message was sent, which comes in the place of the first heartbeat.
    has_booted: bool,
}

/// When the next status frame is due, and what it is about.
#[derive(Debug, Default)]
struct StatusSchedule {
    until_ms: u32,
    /// Its place in the order of items.
    item: u8,
    counter: u8,
    /// The slopes of X, Y and Z that were last sent, in 0.1 µm/m.
    slopes: [i16; 3],
}

/// What the board says of itself.
#[derive(Debug)]
struct BoardInfo {
    start: ResetInfo,
    /// As CANopen's identity object has it.
    serial_number: u32,
    /// As the object has it; 0: it is not known.
    commit: u32,
    /// Bytes of the stack that were never used.
    free_stack: u16,
}

impl<'a> Node<'a> {
    /// Returns a node that has just been switched on.
    #[must_use]
    pub fn new(configuration: NodeConfiguration<'a>) -> Self {
        let NodeConfiguration {
            calibration,
            blob,
            buffer,
            is_degraded,
            faults,
            questions,
            start,
            serial_number,
            commit,
            writes,
        } = configuration;
        let bridge = calibration.map(Bridge::new);
        let names = bridge.as_ref().map(|bridge| bridge.calibration().names).unwrap_or_default();
        let mut state = bridge
            .as_ref()
            .map_or_else(bridge::BridgeState::without_calibration, Bridge::initial_state);
        // The engage sequence is not complete.
        state.set_inhibited(true);
        Self {
            identity: machine_identity_crc(&names),
            bridge,
            state,
            receiver: CncReceiver::default(),
            now: TimestampMs::default(),
            clock: TimestampMs::default(),
            until_forgiven_ms: 0,
            blocks: 0,
            counter: 0,
            heartbeat: HeartbeatSchedule {
                since_ms: 0,
                period_ms: default_heartbeat_period_ms(),
                has_booted: false,
            },
            consumer: HeartbeatConsumer::default(),
            serviced: TimestampMs::default(),
            flags_since: OffsetFlags::NONE,
            server: sdo::SdoServer::default(),
            answer: None,
            emergencies: EmergencyProducer::default(),
            board_faults: faults,
            questions,
            confirmed: None,
            master: Master::default(),
            registers: RegisterExchange::default(),
            blob,
            slot: buffer.map_or(LoadSlot::None, LoadSlot::new),
            new_crc: 0,
            drops_new: false,
            firmware: FirmwareUpdate::default(),
            log: WriteJournal::from_stored(writes),
            noise: NoiseStatistics::default(),
            status: StatusSchedule::default(),
            last_refused: FrameRejectReason::None,
            board: BoardInfo { start, serial_number, commit, free_stack: u16::MAX },
            restart: false,
            degraded: is_degraded,
            last: Output::default(),
            zero: None,
            offer: OfferedReference::default(),
            zero_refused: false,
            learned_refused: false,
            supply: SupplyMonitor::default(),
            switch: SwitchDebouncer::default(),
        }
    }

    /// Returns the blob of the running calibration; empty without one.
    #[must_use]
    pub fn calibration_blob(&self) -> &'a [u8] {
        self.blob
    }

    /// Notes what is wrong with the board.
    pub fn set_fault(&mut self, fault: Fault) {
        self.board_faults = self.board_faults.with_fault_if(true, fault);
    }

    /// Notes whether this is wrong with the board now: for what may go again.
    pub fn set_or_clear_fault(&mut self, is_there: bool, fault: Fault) {
        self.board_faults = self.board_faults.without_fault(fault).with_fault_if(is_there, fault);
    }

    /// Notes how many bytes of the stack were never used.
    pub fn set_free_stack_bytes(&mut self, bytes: u16) {
        self.board.free_stack = bytes;
    }

    /// Returns a calibration that has come whole, once: it is to be looked at, stored, and given back.
    pub fn take_received_calibration(&mut self) -> Option<LoadBuffer<'a>> {
        self.slot.take_load()
    }

    /// Gives it back, and lets the master know what came of it.
    pub fn finish_load(&mut self, load: LoadBuffer<'a>, outcome: LoadOutcome) {
        let outcome = self.slot.finish_load(load, outcome).map_err(object_access::load_abort_code);
        if let (Ok(()), Some(stored)) = (outcome, self.slot.stored_blob()) {
            self.new_crc = calibration_crc(stored);
            self.log_calibration_load(self.new_crc);
        }
        self.answer = self.server.finish_download(outcome).or(self.answer);
    }

    /// Takes a frame from a line. Gives the command it carried, `None` if it is not for this node, or
    /// not from the master.
    ///
    /// # Errors
    /// A frame for this node that is damaged, repeated or out of order; it is counted and has no
    /// effect.
    // A function of its own in the image, where a test follows its calls (host-tests, no_panic).
    #[inline(never)]
    pub fn receive(
        &mut self,
        line: Interface,
        frame: &Frame,
    ) -> Result<Option<CncMessage>, ReceiveError> {
        if frame.id() == SDO_REQUEST_ID {
            self.log.set_request_interface(line);
            // Taken out, because what it reads and writes is the rest of this node.
            let mut server = self.server;
            self.answer = server.receive(frame, self).or(self.answer);
            self.server = server;
            return Ok(None);
        }
        if frame.id() == NMT_ID {
            self.handle_nmt_command(frame);
            return Ok(None);
        }
        self.consumer.receive(frame);
        if CncReceiver::is_cnc_frame_id(frame.id()) && !self.master.accepts_interface(line) {
            if e2e::has_valid_crc(frame) {
                self.master.record_frame_on_other_interface();
            }
            return Ok(None);
        }
        let received = self.receiver.accept(frame);
        if let Err(refused) = &received {
            self.last_refused = refused.reject_reason();
            if frame.id() == CONTROL_ID {
                self.master.reject_control(refused.is_sequence_error());
            }
        }
        let command = received?;
        match (command, &self.bridge) {
            (Some(CncMessage::Control(control)), _) => self.receive_control(line, control),
            (Some(value), Some(bridge)) => bridge.receive_command(&mut self.state, value),
            _ => {}
        }
        Ok(command)
    }

    fn receive_control(&mut self, line: Interface, control: Control) {
        let Some(received) = self.master.accept_control(line, control) else { return };
        if received.confirm {
            self.confirm(line);
        }
        self.update_inhibition();
        self.apply_learned_change(received.control.learned);
        let Some(bridge) = &self.bridge else { return };
        let before = self.state.reference();
        bridge.receive_control(&mut self.state, received.control);
        let now = self.state.reference();
        let zeroed = self.state.take_zero_event();
        if now != before || zeroed && self.offer.has_offered_reference() {
            self.zero = Some(ZeroOutcome::Taken(now));
            self.end_reference_offer(now, WriteKind::Zeroed, Some(line));
        } else if received.zero && self.zero.is_none() {
            self.zero = Some(ZeroOutcome::Unchanged);
            self.zero_refused = true;
        }
    }

    /// Runs one tick, which ends `elapsed_ms` after the last one. Returns the frames to send.
    // A function of its own in the image, where a test follows its calls (host-tests, no_panic).
    #[inline(never)]
    pub fn tick(&mut self, elapsed_ms: u32, input: TickInput<'_>) -> OffsetFrames {
        self.now = self.now.wrapping_add_ms(elapsed_ms);
        if input.codes.is_some() {
            self.blocks = self.blocks.wrapping_add(1);
        }
        let mut output = match &self.bridge {
            Some(bridge) => bridge.tick(&mut self.state, self.now, input),
            None => Output { quality: OffsetQuality::Fault, age_ms: u8::MAX, ..Output::default() },
        };
        output.flags = output.flags.with_if(self.degraded, OffsetFlags::BOARD_DEGRADED);
        self.last = output;

        self.flags_since = self.flags_since.union(output.flags);
        let counter = self.counter;
        self.counter = counter.wrapping_add(1);
        [frames::encode_offset_xy(&output, counter), frames::encode_offset_z(&output, counter)]
    }

    /// Returns whether it is time for [`Node::next_service_frame`].
    #[must_use]
    pub fn is_service_frame_due(&self) -> bool {
        self.now.duration_ms_since(self.serviced) >= MIN_SERVICE_FRAME_INTERVAL_MS
    }

    /// Returns what there is to say besides the offsets: the heartbeat, an emergency, the status, or the
    /// answer to an SDO request, in this order, one frame at most. On the bus they share a place, so there are
    /// [`MIN_SERVICE_FRAME_INTERVAL_MS`] from one to the next, however often this is called.
    // A function of its own in the image, where a test follows its calls (host-tests, no_panic).
    #[inline(never)]
    pub fn next_service_frame(&mut self) -> Option<Frame> {
        if !self.is_service_frame_due() {
            return None;
        }
        let elapsed_ms = self.now.duration_ms_since(self.serviced);
        self.serviced = self.now;
        let output = self.last;
        // A fault of a single tick is not overlooked.
        let flags = core::mem::take(&mut self.flags_since);
        self.consumer.advance_time(elapsed_ms);
        let link_timeout_ms = self
            .bridge
            .as_ref()
            .map_or(u32::MAX, |bridge| bridge.calibration().limits.link_timeout_ms);
        self.master.tick(elapsed_ms, link_timeout_ms);
        self.questions = self
            .questions
            .without_fault(Fault::HeatUnknown)
            .with_fault_if(self.state.is_thermal_state_unknown(), Fault::HeatUnknown);
        let seen = self.faults(&Output { flags, ..output });
        self.zero_refused = false;
        let now = self.faults(&output);
        self.emergencies.update(elapsed_ms, seen);
        // Taken out, because what it asks for room is the rest of this node.
        let mut server = self.server;
        self.answer = server.resume_block(self).or_else(|| server.tick(elapsed_ms)).or(self.answer);
        self.server = server;
        self.heartbeat.since_ms = self.heartbeat.since_ms.saturating_add(elapsed_ms);
        self.status.until_ms = self.status.until_ms.saturating_sub(elapsed_ms);
        self.poll_heartbeat(&output)
            .or_else(|| self.emergencies.next_frame(now, &output))
            .or_else(|| self.poll_status())
            .or_else(|| self.answer.take())
    }

    /// Returns the heartbeat, if it is due. One that had to wait does not put off those after it.
    fn poll_heartbeat(&mut self, output: &Output) -> Option<Frame> {
        let period_ms = u32::from(self.heartbeat.period_ms);
        let has_booted = core::mem::replace(&mut self.heartbeat.has_booted, true);
        if has_booted && (period_ms == 0 || self.heartbeat.since_ms < period_ms) {
            return None;
        }
        let late_ms = self.heartbeat.since_ms.checked_rem(period_ms);
        self.heartbeat.since_ms = if has_booted { late_ms.unwrap_or(0) } else { 0 };
        Some(frames::encode_heartbeat(match output.quality {
            _ if !has_booted => NmtState::BootUp,
            OffsetQuality::Fault => NmtState::Stopped,
            _ => NmtState::Operational,
        }))
    }

    /// Returns the status, if it is due: each time about the next item. One that had to wait puts off those after it.
    fn poll_status(&mut self) -> Option<Frame> {
        if self.status.until_ms > 0 {
            return None;
        }
        self.status.until_ms = STATUS_PERIOD_MS;
        let counter = self.status.counter;
        self.status.counter = counter.wrapping_add(1);
        let status = Status { last_refused: self.last_refused, item: self.next_status_item() };
        Some(status::encode(&status, counter))
    }

    /// Returns the time of the last tick.
    #[must_use]
    pub fn now(&self) -> TimestampMs {
        self.now
    }

    /// Blocks of samples taken so far; wraps.
    #[must_use]
    pub fn sample_block_count(&self) -> u32 {
        self.blocks
    }

    /// Returns what the last tick gave.
    #[must_use]
    pub fn last_output(&self) -> &Output {
        &self.last
    }

    /// Returns what was received and refused so far.
    #[must_use]
    pub fn receiver(&self) -> &CncReceiver {
        &self.receiver
    }

    /// Returns the live values for the log, and begins to measure the noise of the raw codes anew.
    pub fn take_display_values(&mut self) -> DisplayValues {
        self.noise = self.state.take_noise_statistics();
        DisplayValues::new(self.last.offset, self.state.elongation(), self.noise)
    }
}

fn default_heartbeat_period_ms() -> u16 {
    u16::try_from(HEARTBEAT_PERIOD_MS).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod example;
#[cfg(test)]
mod tests;
#[cfg(test)]
pub(crate) use example::sensor_only_calibration;
#[cfg(test)]
mod conditions_tests;
#[cfg(test)]
mod firmware_tests;
#[cfg(test)]
mod learned_tests;
#[cfg(test)]
mod register_tests;
#[cfg(test)]
mod restart_tests;
#[cfg(test)]
mod slopes_tests;
#[cfg(test)]
mod standing_tests;
#[cfg(test)]
mod tick_tests;
#[cfg(test)]
mod write_tests;
