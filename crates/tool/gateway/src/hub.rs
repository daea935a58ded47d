//! Both blocks of registers between the bridge and a PLC; time is an argument.
//!
//! | the bridge | the input block |
//! |---|---|
//! | a valid pair of offset frames | what they say, the counter one further |
//! | no new pair | stands, counter and all |
//! | none for `OFFSETS_STALE_TIMEOUT` | "not available", quality 6; the counter goes on, since the gateway lives |
//!
//! | the PLC | the bridge |
//! |---|---|
//! | a block in step | its frames |
//! | the first block after `MASTER_TIMEOUT` of silence, and those on its heels | nothing: it may be of a stalled line |
//! | `Engage` while the bridge runs on another calibration than the pinned one | `Engage` and `Zero` 0 |
//!
//! A block is made whole and replaced whole, so a reader gets one moment's.

use std::time::Duration;

use trueup_client::{pinned_calibration::PinnedCalibration, status::BoardStatus};
use trueup_core::cnc::{Control, OffsetQuality, Output};
use trueup_link::{
    frame::Frame,
    layout::STATUS_ID,
    receiver::{FrameCounters, OffsetReceiver},
    slcan::AdapterMessage,
    status::{StateBits, StatusItem, decode},
};
use trueup_modbus::{
    holding_block::{self, BlockRejectReason, CncData, HoldingBlockChecker},
    input_block::{self, InputBlock},
    input_block_with_slopes,
    register_map::WHOLE_HOLDING_LEN,
    server::RegistersBusy,
};

use crate::cnc::CncTransmitter;

/// After this time without a valid pair the bridge counts as silent: as in `trueup linuxcnc`, a hundred
/// cycles, and less than the 256 ms after which a counter of CAN comes round.
pub(crate) const OFFSETS_STALE_TIMEOUT: Duration = Duration::from_millis(100);
/// Each item of `Status` comes every 1.1 s; three missed, and it counts as unknown.
const STATUS_TIMEOUT: Duration = Duration::from_millis(3_400);
/// With slopes each item comes every 1.5 s; three missed.
const SLOPES_TIMEOUT: Duration = Duration::from_millis(4_600);
/// After this time without a valid block a master no longer keeps others out: the link timeout
/// after which the bridge counts its CNC as lost, by default.
pub(crate) const MASTER_TIMEOUT: Duration = Duration::from_millis(500);
/// How long a second master is reported of.
const SECOND_MASTER_HOLD_TIME: Duration = Duration::from_secs(2);

/// Blocks that come so soon after one that may be old have waited with it: a line that goes on delivers them at once.
const BACKLOG_WINDOW: Duration = Duration::from_millis(30);
/// `LastRefused` of a block that may be old: it came after a silence.
pub(crate) const REJECT_REASON_STALE: u16 = 5;
/// `LastRefused` of `Engage` to a bridge that runs on another calibration than the pinned one.
pub(crate) const REJECT_REASON_CALIBRATION: u16 = 6;
/// After this time without a valid pair the bridge may have been exchanged: as long as a bridge holds by default.
const BRIDGE_LOSS_TIMEOUT: Duration = Duration::from_secs(2);

/// Reported where slopes are expected and none come.
const NO_SLOPES_WARNING: &str = "warning: the bridge sends no slopes, so nothing is handed \
    over. Its calibration has no [axis.*.thermal] of mode \"position\" or \"both\", or its \
    firmware is older. Take --mode offsets";

/// Who sends holding blocks: a connection.
pub type MasterId = u64;

/// Exchange of blocks between the bridge and the PLC.
pub struct Hub {
    offsets: OffsetReceiver,
    malformed_lines: u32,
    last: Option<(Duration, Output)>,
    is_new: bool,
    board: BoardStatus,
    status_received: Option<Duration>,
    pinned: PinnedCalibration,
    /// When the bridge last was not available, or gone: what it ran on before does not count.
    was_away: Option<Duration>,
    calibration_received: Option<Duration>,
    /// When the slope of each axis was last sent.
    slopes_received: [Option<Duration>; 3],
    /// Since when slopes are expected, and whether it was reported that none come.
    expects_slopes: Option<(Duration, bool)>,
    news: Vec<String>,
    stalls: u32,
    input: InputBlock,
    registers: input_block::InputRegisters,
    with_slopes: [u16; input_block_with_slopes::INPUT_WITH_SLOPES_LEN],
    master: Option<(MasterId, Duration)>,
    checker: HoldingBlockChecker,
    holding: holding_block::HoldingRegisters,
    transmitter: CncTransmitter,
    control: Option<(Duration, Control)>,
    /// The last whole block of the master, or its connection.
    arrived: Option<(MasterId, Duration)>,
    /// How long it had not come before that.
    pace: Option<Duration>,
    /// Blocks before this time may be old.
    doubted_until: Duration,
    second_master: Option<Duration>,
}

/// Result of a holding block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockOutcome {
    /// It is used.
    Accepted,
    /// It is not, and why.
    Rejected(BlockRejectReason),
    /// It is not, because it may have waited in a line that stalled.
    MayBeOld,
}

impl Hub {
    /// Nothing received from anyone. Only a bridge that runs on the pinned calibration is engaged.
    #[must_use]
    pub fn new(pinned: PinnedCalibration) -> Self {
        let input = InputBlock {
            output: Output { quality: OffsetQuality::Fault, ..Output::default() },
            age_ms: u16::MAX,
            ..InputBlock::default()
        };
        Self {
            offsets: OffsetReceiver::new(),
            malformed_lines: 0,
            last: None,
            is_new: false,
            board: BoardStatus::default(),
            status_received: None,
            pinned,
            was_away: None,
            calibration_received: None,
            slopes_received: [None; 3],
            expects_slopes: None,
            news: Vec::new(),
            stalls: 0,
            registers: input.encode(),
            with_slopes: input_block_with_slopes::encode(&input, None),
            input,
            master: None,
            checker: HoldingBlockChecker::default(),
            holding: [0; WHOLE_HOLDING_LEN],
            transmitter: CncTransmitter::default(),
            control: None,
            arrived: None,
            pace: None,
            doubted_until: Duration::ZERO,
            second_master: None,
        }
    }

    /// Takes an event of the bridge's line. Frames and lines that must not be used are counted.
    pub fn receive(&mut self, now: Duration, event: &AdapterMessage) {
        match event {
            AdapterMessage::Frame(frame) if frame.id() == STATUS_ID => {
                let refused = self.board.rejected_status_frame_count();
                self.board.receive(frame);
                if self.board.rejected_status_frame_count() == refused {
                    self.status_received = Some(now);
                    match decode(frame).map(|status| status.item) {
                        Ok(StatusItem::Calibration(_)) => self.calibration_received = Some(now),
                        Ok(StatusItem::Slope { axis, .. }) => {
                            if let Some(received) = self.slopes_received.get_mut(usize::from(axis))
                            {
                                *received = Some(now);
                            }
                        }
                        _ => {}
                    }
                }
            }
            AdapterMessage::Frame(frame) => {
                if let Ok(Some(output)) = self.offsets.accept(frame) {
                    let is_available = output.quality != OffsetQuality::Fault;
                    let was_available =
                        self.last.is_some_and(|(_, last)| last.quality != OffsetQuality::Fault);
                    if was_available && !is_available {
                        self.was_away = Some(now);
                    }
                    self.last = Some((now, output));
                    self.is_new = true;
                }
            }
            AdapterMessage::Malformed(_) => {
                self.malformed_lines = self.malformed_lines.saturating_add(1)
            }
            AdapterMessage::Accepted | AdapterMessage::Rejected | AdapterMessage::Other(_) => {}
        }
    }

    /// Takes note that the line delivers frames that are too old to be used.
    pub(crate) fn count_stall(&mut self) {
        self.stalls = self.stalls.saturating_add(1);
    }

    /// Returns how often the line has stalled.
    #[must_use]
    pub(crate) fn stall_count(&self) -> u32 {
        self.stalls
    }

    /// Returns the messages about the bridge's calibration since the last call.
    pub fn take_messages(&mut self) -> Vec<String> {
        std::mem::take(&mut self.news)
    }

    /// Returns what may be engaged.
    #[must_use]
    pub fn pinned_calibration(&self) -> &PinnedCalibration {
        &self.pinned
    }

    /// Looks on what calibration the bridge runs now, as far as it has reported it since it was last away.
    fn check_calibration(&mut self, now: Duration) {
        if self.last.is_some_and(|(received, _)| now.saturating_sub(received) > BRIDGE_LOSS_TIMEOUT)
        {
            self.was_away = Some(now);
        }
        let is_known = self.calibration_received.is_some_and(|received| {
            now.saturating_sub(received) <= STATUS_TIMEOUT
                && self.was_away.is_none_or(|at| received > at)
        });
        let running = self.board.calibration.filter(|_| is_known);
        self.news.extend(self.pinned.update_running_crc(running));
    }

    /// Makes the input block anew, if there is anything new to say.
    pub fn refresh_input_block(&mut self, now: Duration) {
        self.check_calibration(now);
        let fresh = self.fresh_output(now).copied();
        if !self.is_new && fresh.is_some() {
            return;
        }
        self.is_new = false;
        let silent = Output { quality: OffsetQuality::Fault, ..Output::default() };
        self.input.counter = self.input.counter.wrapping_add(1);
        self.input.output = fresh.unwrap_or(silent);
        // "Not available" and "fault" go together, whichever of them the bridge has sent.
        if self.input.output.offset.is_none() || self.input.output.quality == OffsetQuality::Fault {
            (self.input.output.offset, self.input.output.quality) = (None, OffsetQuality::Fault);
        }
        self.input.age_ms = self.output_age_ms(now);
        let knows = self.status_received.is_some_and(|at| now.saturating_sub(at) <= STATUS_TIMEOUT);
        let second =
            self.second_master.is_some_and(|at| now.saturating_sub(at) <= SECOND_MASTER_HOLD_TIME);
        let state = if knows { self.board.state } else { StateBits::default() };
        self.input.state = state.with_if(second, StateBits::SECOND_MASTER).0;
        self.input.calibration = self.board.calibration.filter(|_| knows).unwrap_or(0);
        self.input.elongation = self.board.elongation.filter(|_| knows);
        self.input.centi_c = self.board.centi_c.map(|centi_c| centi_c.filter(|_| knows));
        self.registers = self.input.encode();
        let slopes = self.fresh_slopes(now);
        self.with_slopes = input_block_with_slopes::encode(&self.input, slopes);
    }

    /// Returns K₀ and slope of each axis, if all are fresh and of the bridge that is there now.
    fn fresh_slopes(
        &mut self,
        now: Duration,
    ) -> Option<[input_block_with_slopes::LinearCoefficients; 3]> {
        let is_fresh = |received: &Option<Duration>| {
            received.is_some_and(|received| {
                now.saturating_sub(received) <= SLOPES_TIMEOUT
                    && self.was_away.is_none_or(|at| received > at)
            })
        };
        let are_fresh = self.slopes_received.iter().all(is_fresh);
        if let Some((since, is_reported)) = &mut self.expects_slopes {
            if are_fresh || self.input.output.offset.is_none() {
                (*since, *is_reported) = (now, false);
            } else if !*is_reported && now.saturating_sub(*since) > SLOPES_TIMEOUT {
                *is_reported = true;
                self.news.push(NO_SLOPES_WARNING.into());
            }
        }
        let [Some(x), Some(y), Some(z)] = self.board.slopes else { return None };
        are_fresh.then_some([x, y, z])
    }

    /// Reports from now on if the bridge sends no slopes.
    pub(crate) fn expect_slopes(&mut self, now: Duration) {
        self.expects_slopes = Some((now, false));
    }

    /// Returns the input block with slopes.
    #[must_use]
    pub(crate) fn input_registers_with_slopes(
        &self,
    ) -> [u16; input_block_with_slopes::INPUT_WITH_SLOPES_LEN] {
        self.with_slopes
    }

    /// Returns the newest valid pair, unless it is stale.
    fn fresh_output(&self, now: Duration) -> Option<&Output> {
        let (received, output) = self.last.as_ref()?;
        (now.saturating_sub(*received) <= OFFSETS_STALE_TIMEOUT).then_some(output)
    }

    fn output_age_ms(&self, now: Duration) -> u16 {
        let Some((received, output)) = self.last else { return u16::MAX };
        let waited = u16::try_from(now.saturating_sub(received).as_millis()).unwrap_or(u16::MAX);
        waited.saturating_add(output.age_ms.into())
    }

    /// Returns the input block.
    #[must_use]
    pub fn input_registers(&self) -> input_block::InputRegisters {
        self.registers
    }

    /// Returns what it says.
    #[must_use]
    pub(crate) fn current_input_block(&self) -> &InputBlock {
        &self.input
    }

    /// Returns whether the bridge is received.
    #[must_use]
    pub fn has_fresh_output(&self, now: Duration) -> bool {
        self.fresh_output(now).is_some()
    }

    /// Returns what has arrived from the bridge, in frames.
    #[must_use]
    pub fn counters(&self) -> FrameCounters {
        let counters = self.offsets.counters();
        FrameCounters {
            malformed: counters.malformed.saturating_add(self.malformed_lines),
            ..counters
        }
    }

    /// Returns the holding block that was last used.
    #[must_use]
    pub fn holding_registers(&self) -> holding_block::HoldingRegisters {
        self.holding
    }

    /// Returns the last values of the PLC, while that is not older than `MASTER_TIMEOUT`.
    #[must_use]
    pub(crate) fn fresh_control(&self, now: Duration) -> Option<Control> {
        let (at, control) = self.control?;
        (now.saturating_sub(at) <= MASTER_TIMEOUT).then_some(control)
    }

    /// Takes a holding block from a master. One that is refused is counted, and reported in the input
    /// block.
    ///
    /// # Errors
    /// Another master sends.
    pub fn accept_block(
        &mut self,
        now: Duration,
        master: MasterId,
        block: &holding_block::HoldingRegisters,
    ) -> Result<BlockOutcome, RegistersBusy> {
        match self.master {
            Some((other, at)) if other != master => {
                if now.saturating_sub(at) <= MASTER_TIMEOUT {
                    self.second_master = Some(now);
                    return Err(RegistersBusy);
                }
                self.checker = HoldingBlockChecker::default();
            }
            Some(_) => {}
            None => self.checker = HoldingBlockChecker::default(),
        }
        let checked = self.checker.accept(block);
        match checked {
            Ok(_) if self.detect_stale_block(now, master) => {
                self.master = Some((master, now));
                self.record_refusal(REJECT_REASON_STALE);
                Ok(BlockOutcome::MayBeOld)
            }
            Ok(cnc_data) => {
                self.master = Some((master, now));
                self.holding = *block;
                self.apply_cnc_data(now, cnc_data);
                Ok(BlockOutcome::Accepted)
            }
            Err(refused) => {
                self.record_refusal(refused as u16);
                Ok(BlockOutcome::Rejected(refused))
            }
        }
    }

    fn record_refusal(&mut self, why: u16) {
        self.input.last_refused = why;
        self.input.refused = self.input.refused.saturating_add(1);
    }

    /// A master has connected: what it sends has not waited for longer than since now.
    pub(crate) fn register_master(&mut self, now: Duration, master: MasterId) {
        if self.master.is_none() {
            (self.arrived, self.pace, self.doubted_until) =
                (Some((master, now)), None, Duration::ZERO);
        }
    }

    /// Returns whether a whole block may have waited in the line since the one before it. A slow PLC has a slow pace.
    fn detect_stale_block(&mut self, now: Duration, master: MasterId) -> bool {
        let before = self.arrived.replace((master, now));
        let Some((_, at)) = before.filter(|(of, _)| *of == master) else {
            (self.pace, self.doubted_until) = (None, Duration::ZERO);
            return false;
        };
        let waited = now.saturating_sub(at);
        let pace = self.pace.replace(waited);
        if waited > MASTER_TIMEOUT && pace.is_none_or(|pace| waited > 2 * pace) {
            self.doubted_until = now + BACKLOG_WINDOW;
        }
        now < self.doubted_until
    }

    fn apply_cnc_data(&mut self, now: Duration, mut cnc_data: CncData) {
        // A bridge that has yet to say what it runs on is no matter for the PLC.
        if cnc_data.control.engage && self.pinned.is_engage_refused() {
            self.record_refusal(REJECT_REASON_CALIBRATION);
        }
        cnc_data.control.engage &= self.pinned.is_engage_allowed();
        cnc_data.control.zero &= self.pinned.is_engage_allowed();
        self.control = Some((now, cnc_data.control));
        self.transmitter.queue_frames(now, &cnc_data);
    }

    /// A master has gone: another need not wait.
    pub fn unregister_master(&mut self, master: MasterId) {
        if self.master.is_some_and(|(current, _)| current == master) {
            self.master = None;
        }
    }

    /// Returns the frames that are due for the bridge.
    pub fn take_due_frames(&mut self) -> Vec<Frame> {
        self.transmitter.take_frames()
    }
}

#[cfg(test)]
mod tests;
