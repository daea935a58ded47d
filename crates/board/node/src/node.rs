//! The bridge as it stands on the bus: frames in, samples in, frames out.
//!
//! This is the whole of what a board does between its converter and its wires, without any
//! hardware, so the host can run the same thing.
//!
//! The tick makes offsets and nothing else. The rest of a CANopen node's messages, the heartbeat,
//! emergencies, the status, answers to SDO requests, is [`Node::service`], which a board calls from a task that
//! a tick interrupts.

use trueup_canopen::{
    emergency::{Emergencies, Fault, Faults},
    heartbeat::Consumer,
    sdo,
};
use trueup_core::{
    bridge::{self, Bridge, Input},
    calibration::Calibration,
    cnc::{Command, Control, Flags, Output, Quality},
    health::Noise,
    supply::Supply,
    units::Millis,
};
use trueup_link::{
    e2e,
    frame::Frame,
    frames::{self, State},
    layout::{
        CONTROL_ID, HEARTBEAT_PERIOD_MS, NMT_ID, SDO_REQUEST_ID, SERVICE_PERIOD_MS,
        STATUS_PERIOD_MS,
    },
    receiver::{Receiver, Refused},
    status::{self, Reason, Status},
};
use trueup_store::{
    calibration::identity,
    load::{Load, Outcome, Slot},
    writes::WriteKind,
};

use crate::{shown::ShownValues, start::Start};

mod faults;
pub mod firmware;
mod learned;
mod master;
mod network;
mod objects;
mod questions;
mod registers;
mod restart;
mod slopes;
mod standing;
mod supply;
mod switch;
mod writes;

use firmware::Firmware;
pub use master::Interface;
use master::Master;
use registers::Registers;
use standing::Offer;
pub use standing::Zero;
use switch::ServiceSwitch;
use writes::Log;

/// The frames of one tick: both halves of a cycle's offsets.
pub type Frames = [Frame; 2];

/// The bridge, its memory, and its end of the link.
#[derive(Debug)]
pub struct Node<'a> {
    /// `None` without a valid calibration: nothing can be computed then.
    bridge: Option<Bridge<'a>>,
    state: bridge::State,
    receiver: Receiver,
    now: Millis,
    /// The same by a clock that does not count samples.
    clock: Millis,
    until_forgiven_ms: u32,
    blocks: u32,
    counter: u8,
    since_heartbeat_ms: u32,
    heartbeat_period_ms: u16,
    /// The boot-up message was sent, which comes in the place of the first heartbeat.
    has_booted: bool,
    consumer: Consumer,
    /// When [`Node::service`] last ran.
    serviced: Millis,
    /// The flags of all ticks since then.
    flags_since: Flags,
    server: sdo::Server,
    answer: Option<Frame>,
    emergencies: Emergencies,
    /// Of the board, which stay until it says otherwise.
    board_faults: Faults,
    /// Questions that are open to the operator: nothing is available until they are answered.
    questions: Faults,
    /// The last question that was answered, for the board to keep.
    confirmed: Option<Fault>,
    master: Master,
    /// Of the RS-485 line.
    registers: Registers,
    /// The blob of the running calibration.
    blob: &'a [u8],
    slot: Slot<'a>,
    /// CRC of the calibration that is stored for the next start; 0: none was loaded.
    new_crc: u32,
    /// A master has asked to drop it.
    drops_new: bool,
    firmware: Firmware,
    /// Who has written.
    log: Log,
    noise: Noise,
    until_status_ms: u32,
    /// Which of the order of items the next status frame is about, and its counter.
    status_item: u8,
    /// The slopes of X, Y and Z that were last sent, in 0.1 µm/m.
    slopes: [i16; 3],
    status_counter: u8,
    last_refused: Reason,
    start: Start,
    /// As CANopen's identity object has it.
    serial_number: u32,
    /// As the object has it; 0: it is not known.
    commit: u32,
    free_stack: u16,
    restart: bool,
    degraded: bool,
    last: Output,
    zero: Option<Zero>,
    /// The reference that is offered, and where the one comes from that is in force.
    offer: Offer,
    /// A `Zero` was refused since [`Node::service`] last ran.
    zero_refused: bool,
    /// So was a learned change, and `Control` was not received without one since.
    learned_refused: bool,
    supply: Supply,
    switch: ServiceSwitch,
}

impl<'a> Node<'a> {
    /// Returns a node that has just been switched on. `degraded` marks every frame of a board that runs on a fall-back.
    #[must_use]
    pub fn new(calibration: Option<Calibration<'a>>, degraded: bool) -> Self {
        let mut node = Self {
            bridge: calibration.map(Bridge::new),
            state: bridge::State::default(),
            receiver: Receiver::default(),
            now: Millis::default(),
            clock: Millis::default(),
            until_forgiven_ms: 0,
            blocks: 0,
            counter: 0,
            since_heartbeat_ms: 0,
            heartbeat_period_ms: default_heartbeat_ms(),
            has_booted: false,
            consumer: Consumer::default(),
            serviced: Millis::default(),
            flags_since: Flags::NONE,
            server: sdo::Server::default(),
            answer: None,
            emergencies: Emergencies::default(),
            board_faults: Faults::default(),
            questions: Faults::default(),
            confirmed: None,
            master: Master::default(),
            registers: Registers::default(),
            blob: &[],
            slot: Slot::None,
            new_crc: 0,
            drops_new: false,
            firmware: Firmware::default(),
            log: Log::default(),
            noise: Noise::default(),
            until_status_ms: 0,
            status_item: 0,
            slopes: [0; 3],
            status_counter: 0,
            last_refused: Reason::None,
            start: Start::default(),
            serial_number: 1,
            commit: 0,
            free_stack: u16::MAX,
            restart: false,
            degraded,
            last: Output::default(),
            zero: None,
            offer: Offer::default(),
            zero_refused: false,
            learned_refused: false,
            supply: Supply::default(),
            switch: ServiceSwitch::default(),
        };
        node.inhibit();
        node
    }

    /// Lets a CANopen master read the blob of the running calibration.
    pub fn set_blob(&mut self, blob: &'a [u8]) {
        self.blob = blob;
    }

    /// Returns the blob of the running calibration; empty without one.
    #[must_use]
    pub fn blob(&self) -> &'a [u8] {
        self.blob
    }

    /// Lets a CANopen master load a calibration through this buffer; without one the answer
    /// is that nothing can be stored.
    pub fn set_buffer(&mut self, buffer: &'a mut [u8]) {
        self.slot = Slot::new(buffer);
    }

    /// Notes what is wrong with the board.
    pub fn set_fault(&mut self, fault: Fault) {
        self.board_faults = self.board_faults.with_if(true, fault);
    }

    /// Notes whether this is wrong with the board now: for what may go again.
    pub fn set_fault_if(&mut self, is_there: bool, fault: Fault) {
        self.board_faults = self.board_faults.without(fault).with_if(is_there, fault);
    }

    /// Notes where the last start stopped, and how often the board has started.
    pub fn note_start(&mut self, start: Start) {
        self.start = start;
    }

    /// Notes from which commit of the source the image was built: the first 32 bits of its hash; 0: not known.
    pub fn note_commit(&mut self, commit: u32) {
        self.commit = commit;
    }

    /// Notes how many bytes of the stack were never used.
    pub fn note_free_stack(&mut self, bytes: u16) {
        self.free_stack = bytes;
    }

    /// Returns a calibration that has come whole, once: it is to be looked at, stored, and given back.
    pub fn take_load(&mut self) -> Option<Load<'a>> {
        self.slot.take()
    }

    /// Gives it back, and lets the master know what came of it.
    pub fn end_load(&mut self, load: Load<'a>, outcome: Outcome) {
        let outcome = self.slot.give_back(load, outcome).map_err(objects::abort);
        if let (Ok(()), Some(stored)) = (outcome, self.slot.stored()) {
            self.new_crc = identity(stored);
            self.log_load(self.new_crc);
        }
        self.answer = self.server.end(outcome).or(self.answer);
    }

    /// Takes a frame from a line. Gives the command it carried, `None` if it is not for this node, or
    /// not from the master.
    ///
    /// # Errors
    /// A frame for this node that is damaged, repeated or out of order; it is counted and has no
    /// effect.
    // A function of its own in the image, where a test follows its calls (host-tests, no_panic).
    #[inline(never)]
    pub fn receive(&mut self, line: Interface, frame: &Frame) -> Result<Option<Command>, Refused> {
        if frame.id() == SDO_REQUEST_ID {
            self.log.speaks(line);
            // Taken out, because what it reads and writes is the rest of this node.
            let mut server = self.server;
            self.answer = server.receive(frame, self).or(self.answer);
            self.server = server;
            return Ok(None);
        }
        if frame.id() == NMT_ID {
            self.network_command(frame);
            return Ok(None);
        }
        self.consumer.receive(frame);
        if Receiver::is_from_cnc(frame.id()) && !self.master.admits(line) {
            if e2e::is_whole(frame) {
                self.master.receive_other();
            }
            return Ok(None);
        }
        let heard = self.receiver.accept(frame);
        if let Err(refused) = &heard {
            self.last_refused = refused.reason();
            if frame.id() == CONTROL_ID {
                self.master.refuse(refused.is_sound());
            }
        }
        let command = heard?;
        match (command, &self.bridge) {
            (Some(Command::Control(control)), _) => self.receive_control(line, control),
            (Some(value), Some(bridge)) => bridge.receive_value(&mut self.state, value),
            _ => {}
        }
        Ok(command)
    }

    fn receive_control(&mut self, line: Interface, control: Control) {
        let Some(received) = self.master.take(line, control) else { return };
        if received.confirm {
            self.confirm(line);
        }
        self.inhibit();
        self.receive_learned(received.control.learned);
        let Some(bridge) = &self.bridge else { return };
        let before = self.state.reference();
        bridge.receive_control(&mut self.state, received.control);
        let now = self.state.reference();
        let zeroed = self.state.take_zeroed();
        if now != before || zeroed && self.offer.is_open() {
            self.zero = Some(Zero::Taken(now));
            self.end_offer(now, WriteKind::Zeroed, Some(line));
        } else if received.zero && self.zero.is_none() {
            self.zero = Some(Zero::Unchanged);
            self.zero_refused = true;
        }
    }

    /// Runs one tick, which ends `elapsed_ms` after the last one. Returns the frames to send.
    // A function of its own in the image, where a test follows its calls (host-tests, no_panic).
    #[inline(never)]
    pub fn tick(&mut self, elapsed_ms: u32, input: Input<'_>) -> Frames {
        self.now = self.now.after(elapsed_ms);
        if input.codes.is_some() {
            self.blocks = self.blocks.wrapping_add(1);
        }
        let mut output = match &self.bridge {
            Some(bridge) => bridge.tick(&mut self.state, self.now, input),
            None => Output { quality: Quality::Fault, age_ms: u8::MAX, ..Output::default() },
        };
        output.flags = output.flags.with_if(self.degraded, Flags::BOARD_DEGRADED);
        self.last = output;

        self.flags_since = self.flags_since.with(output.flags);
        let counter = self.counter;
        self.counter = counter.wrapping_add(1);
        [frames::offset_xy(&output, counter), frames::offset_z(&output, counter)]
    }

    /// Returns whether it is time for [`Node::service`].
    #[must_use]
    pub fn service_is_due(&self) -> bool {
        self.now.since(self.serviced) >= SERVICE_PERIOD_MS
    }

    /// Returns what there is to say besides the offsets: the heartbeat, an emergency, the status, or the
    /// answer to an SDO request, in this order, one frame at most. On the bus they share a place, so there are
    /// [`SERVICE_PERIOD_MS`] from one to the next, however often this is called.
    // A function of its own in the image, where a test follows its calls (host-tests, no_panic).
    #[inline(never)]
    pub fn service(&mut self) -> Option<Frame> {
        if !self.service_is_due() {
            return None;
        }
        let elapsed_ms = self.now.since(self.serviced);
        self.serviced = self.now;
        let output = self.last;
        // A fault of a single tick is not overlooked.
        let flags = core::mem::take(&mut self.flags_since);
        self.consumer.tick(elapsed_ms);
        let link_timeout_ms =
            self.bridge.as_ref().map_or(u32::MAX, |it| it.calibration().limits.link_timeout_ms);
        self.master.tick(elapsed_ms, link_timeout_ms);
        self.questions = self
            .questions
            .without(Fault::HeatUnknown)
            .with_if(self.state.heat_is_unknown(), Fault::HeatUnknown);
        let seen = self.faults(&Output { flags, ..output });
        self.zero_refused = false;
        let now = self.faults(&output);
        self.emergencies.update(elapsed_ms, seen);
        // Taken out, because what it asks for room is the rest of this node.
        let mut server = self.server;
        self.answer = server.proceed(self).or_else(|| server.tick(elapsed_ms)).or(self.answer);
        self.server = server;
        self.since_heartbeat_ms = self.since_heartbeat_ms.saturating_add(elapsed_ms);
        self.until_status_ms = self.until_status_ms.saturating_sub(elapsed_ms);
        self.heartbeat(&output)
            .or_else(|| self.emergencies.next(now, &output))
            .or_else(|| self.status())
            .or_else(|| self.answer.take())
    }

    /// Returns the heartbeat, if it is due. One that had to wait does not put off those after it.
    fn heartbeat(&mut self, output: &Output) -> Option<Frame> {
        let period_ms = u32::from(self.heartbeat_period_ms);
        let has_booted = core::mem::replace(&mut self.has_booted, true);
        if has_booted && (period_ms == 0 || self.since_heartbeat_ms < period_ms) {
            return None;
        }
        let late_ms = self.since_heartbeat_ms.checked_rem(period_ms);
        self.since_heartbeat_ms = if has_booted { late_ms.unwrap_or(0) } else { 0 };
        Some(frames::heartbeat(match output.quality {
            _ if !has_booted => State::BootUp,
            Quality::Fault => State::Stopped,
            _ => State::Operational,
        }))
    }

    /// Returns the status, if it is due: each time about the next item. One that had to wait puts off those after it.
    fn status(&mut self) -> Option<Frame> {
        if self.until_status_ms > 0 {
            return None;
        }
        self.until_status_ms = STATUS_PERIOD_MS;
        let counter = self.status_counter;
        self.status_counter = counter.wrapping_add(1);
        let status = Status { last_refused: self.last_refused, item: self.next_item() };
        Some(status::encode(&status, counter))
    }

    /// Returns the time of the last tick.
    #[must_use]
    pub fn now(&self) -> Millis {
        self.now
    }

    /// Blocks of samples taken so far; wraps.
    #[must_use]
    pub fn blocks(&self) -> u32 {
        self.blocks
    }

    /// Returns what the last tick gave.
    #[must_use]
    pub fn last(&self) -> &Output {
        &self.last
    }

    /// Returns what was received and refused so far.
    #[must_use]
    pub fn receiver(&self) -> &Receiver {
        &self.receiver
    }

    /// Returns the live values for the log, and begins to measure the noise of the raw codes anew.
    pub fn take_shown(&mut self) -> ShownValues {
        self.noise = self.state.take_noise();
        ShownValues::new(self.last.offset, self.state.elongation(), self.noise)
    }
}

fn default_heartbeat_ms() -> u16 {
    u16::try_from(HEARTBEAT_PERIOD_MS).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod example;
#[cfg(test)]
mod tests;
#[cfg(test)]
pub(crate) use example::tests_calibration;
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
