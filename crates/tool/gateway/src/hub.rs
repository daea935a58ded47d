//! Both blocks of registers between the bridge and a PLC; time is an argument.
//!
//! | the bridge | the input block |
//! |---|---|
//! | a valid pair of offset frames | what they say, the counter one further |
//! | no new pair | stands, counter and all |
//! | none for `STALE` | "not available", quality 6; the counter goes on, since the gateway lives |
//!
//! | the PLC | the bridge |
//! |---|---|
//! | a block in step | its frames |
//! | the first block after `MASTER_LASTS` of silence, and those on its heels | nothing: it may be of a stalled line |
//! | `Engage` while the bridge runs on another calibration than the pinned one | `Engage` and `Zero` 0 |
//!
//! A block is made whole and replaced whole, so a reader gets one moment's.

use std::time::Duration;

use trueup_client::{pinned::Pinned, status::Board};
use trueup_core::cnc::{Control, Output, Quality};
use trueup_link::{
    frame::Frame,
    layout::STATUS_ID,
    receiver::{Counters, OffsetReceiver},
    slcan::Event,
    status::{Item, StateBits, decode},
};
use trueup_modbus::{
    cnc::{self, Checker, Cnc, Refused},
    input::{self, Input},
    server::Busy,
    slopes,
    table::WHOLE_HOLDING_LEN,
};

use crate::cnc::CncTransmitter;

/// Without a valid pair for so long the bridge counts as silent: as in `trueup linuxcnc`, a hundred
/// cycles, and less than the 256 ms after which a counter of CAN comes round.
pub(crate) const STALE: Duration = Duration::from_millis(100);
/// Each item of `Status` comes every 1.1 s; three missed, and it counts as unknown.
const STATUS_LASTS: Duration = Duration::from_millis(3_400);
/// With slopes each item comes every 1.5 s; three missed.
const SLOPES_LAST: Duration = Duration::from_millis(4_600);
/// A master that has sent no valid block for so long no longer keeps others out: the link timeout
/// after which the bridge counts its CNC as lost, by default.
pub(crate) const MASTER_LASTS: Duration = Duration::from_millis(500);
/// How long a second master is reported of.
const TOLD: Duration = Duration::from_secs(2);

/// Blocks that come so soon after one that may be old have waited with it: a line that goes on delivers them at once.
const ON_ITS_HEELS: Duration = Duration::from_millis(30);
/// `LastRefused` of a block that may be old: it came after a silence.
pub(crate) const MAY_BE_OLD: u16 = 5;
/// `LastRefused` of `Engage` to a bridge that runs on another calibration than the pinned one.
pub(crate) const OTHER_CALIBRATION: u16 = 6;
/// Without a valid pair for so long the bridge may have been exchanged: as long as a bridge holds by default.
const GONE: Duration = Duration::from_secs(2);

/// Reported where slopes are expected and none come.
const NO_SLOPES: &str = "warning: the bridge sends no slopes, so nothing is handed over: its calibration has no \
                         [axis.*.thermal] of mode \"position\" or \"both\", or its firmware is older. Take --mode offsets";

/// Who sends holding blocks: a connection.
pub type Master = u64;

/// Exchange of blocks between the bridge and the PLC.
pub struct Hub {
    offsets: OffsetReceiver,
    malformed_lines: u32,
    last: Option<(Duration, Output)>,
    is_new: bool,
    board: Board,
    status_heard: Option<Duration>,
    pinned: Pinned,
    /// When the bridge last was not available, or gone: what it ran on before does not count.
    was_away: Option<Duration>,
    calibration_heard: Option<Duration>,
    /// When the slope of each axis was last sent.
    slopes_heard: [Option<Duration>; 3],
    /// Since when slopes are expected, and whether it was reported that none come.
    expects_slopes: Option<(Duration, bool)>,
    news: Vec<String>,
    stalls: u32,
    input: Input,
    registers: input::Registers,
    with_slopes: [u16; slopes::LEN],
    master: Option<(Master, Duration)>,
    checker: Checker,
    holding: cnc::Registers,
    speaker: CncTransmitter,
    control: Option<(Duration, Control)>,
    /// The last whole block of the master, or its connection.
    arrived: Option<(Master, Duration)>,
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
    Used,
    /// It is not, and why.
    Refused(Refused),
    /// It is not, because it may have waited in a line that stalled.
    MayBeOld,
}

impl Hub {
    /// Nothing received from anyone. Only a bridge that runs on the pinned calibration is engaged.
    #[must_use]
    pub fn new(pinned: Pinned) -> Self {
        let input = Input {
            output: Output { quality: Quality::Fault, ..Output::default() },
            age_ms: u16::MAX,
            ..Input::default()
        };
        Self {
            offsets: OffsetReceiver::new(),
            malformed_lines: 0,
            last: None,
            is_new: false,
            board: Board::default(),
            status_heard: None,
            pinned,
            was_away: None,
            calibration_heard: None,
            slopes_heard: [None; 3],
            expects_slopes: None,
            news: Vec::new(),
            stalls: 0,
            registers: input.encode(),
            with_slopes: slopes::encode(&input, None),
            input,
            master: None,
            checker: Checker::default(),
            holding: [0; WHOLE_HOLDING_LEN],
            speaker: CncTransmitter::default(),
            control: None,
            arrived: None,
            pace: None,
            doubted_until: Duration::ZERO,
            second_master: None,
        }
    }

    /// Takes an event of the bridge's line. Frames and lines that must not be used are counted.
    pub fn receive(&mut self, now: Duration, event: &Event) {
        match event {
            Event::Frame(frame) if frame.id() == STATUS_ID => {
                let refused = self.board.refused();
                self.board.receive(frame);
                if self.board.refused() == refused {
                    self.status_heard = Some(now);
                    match decode(frame).map(|status| status.item) {
                        Ok(Item::Calibration(_)) => self.calibration_heard = Some(now),
                        Ok(Item::Slope { axis, .. }) => {
                            if let Some(heard) = self.slopes_heard.get_mut(usize::from(axis)) {
                                *heard = Some(now);
                            }
                        }
                        _ => {}
                    }
                }
            }
            Event::Frame(frame) => {
                if let Ok(Some(output)) = self.offsets.accept(frame) {
                    let is_available = output.quality != Quality::Fault;
                    let was_available =
                        self.last.is_some_and(|(_, last)| last.quality != Quality::Fault);
                    if was_available && !is_available {
                        self.was_away = Some(now);
                    }
                    self.last = Some((now, output));
                    self.is_new = true;
                }
            }
            Event::Malformed(_) => self.malformed_lines = self.malformed_lines.saturating_add(1),
            Event::Accepted | Event::Refused | Event::Other(_) => {}
        }
    }

    /// Takes note that the line delivers frames that are too old to be used.
    pub fn stalled(&mut self) {
        self.stalls = self.stalls.saturating_add(1);
    }

    /// Returns how often the line has stalled.
    #[must_use]
    pub(crate) fn stalls(&self) -> u32 {
        self.stalls
    }

    /// Returns the messages about the bridge's calibration since the last call.
    pub fn news(&mut self) -> Vec<String> {
        std::mem::take(&mut self.news)
    }

    /// Returns what may be engaged.
    #[must_use]
    pub fn pinned(&self) -> &Pinned {
        &self.pinned
    }

    /// Looks on what calibration the bridge runs now, as far as it has said so since it was last away.
    fn check_calibration(&mut self, now: Duration) {
        if self.last.is_some_and(|(heard, _)| now.saturating_sub(heard) > GONE) {
            self.was_away = Some(now);
        }
        let is_known = self.calibration_heard.is_some_and(|heard| {
            now.saturating_sub(heard) <= STATUS_LASTS && self.was_away.is_none_or(|at| heard > at)
        });
        let running = self.board.calibration.filter(|_| is_known);
        self.news.extend(self.pinned.runs_on(running));
    }

    /// Makes the input block anew, if there is anything new to say.
    pub fn refresh(&mut self, now: Duration) {
        self.check_calibration(now);
        let fresh = self.fresh(now).copied();
        if !self.is_new && fresh.is_some() {
            return;
        }
        self.is_new = false;
        let silent = Output { quality: Quality::Fault, ..Output::default() };
        self.input.counter = self.input.counter.wrapping_add(1);
        self.input.output = fresh.unwrap_or(silent);
        // "Not available" and "fault" go together, whichever of them the bridge has said.
        if self.input.output.offset.is_none() || self.input.output.quality == Quality::Fault {
            (self.input.output.offset, self.input.output.quality) = (None, Quality::Fault);
        }
        self.input.age_ms = self.age_ms(now);
        let knows = self.status_heard.is_some_and(|at| now.saturating_sub(at) <= STATUS_LASTS);
        let second = self.second_master.is_some_and(|at| now.saturating_sub(at) <= TOLD);
        let state = if knows { self.board.state } else { StateBits::default() };
        self.input.state = state.with_if(second, StateBits::SECOND_MASTER).0;
        self.input.calibration = self.board.calibration.filter(|_| knows).unwrap_or(0);
        self.input.elongation = self.board.elongation.filter(|_| knows);
        self.input.centi_c = self.board.centi_c.map(|it| it.filter(|_| knows));
        self.registers = self.input.encode();
        let slopes = self.slopes(now);
        self.with_slopes = slopes::encode(&self.input, slopes);
    }

    /// Returns K₀ and slope of each axis, if all are fresh and of the bridge that is there now.
    fn slopes(&mut self, now: Duration) -> Option<[slopes::Part; 3]> {
        let is_fresh = |heard: &Option<Duration>| {
            heard.is_some_and(|heard| {
                now.saturating_sub(heard) <= SLOPES_LAST
                    && self.was_away.is_none_or(|at| heard > at)
            })
        };
        let are_fresh = self.slopes_heard.iter().all(is_fresh);
        if let Some((since, is_reported)) = &mut self.expects_slopes {
            if are_fresh || self.input.output.offset.is_none() {
                (*since, *is_reported) = (now, false);
            } else if !*is_reported && now.saturating_sub(*since) > SLOPES_LAST {
                *is_reported = true;
                self.news.push(NO_SLOPES.into());
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
    pub(crate) fn input_with_slopes(&self) -> [u16; slopes::LEN] {
        self.with_slopes
    }

    /// Returns the newest valid pair, unless it is stale.
    fn fresh(&self, now: Duration) -> Option<&Output> {
        let (heard, output) = self.last.as_ref()?;
        (now.saturating_sub(*heard) <= STALE).then_some(output)
    }

    fn age_ms(&self, now: Duration) -> u16 {
        let Some((heard, output)) = self.last else { return u16::MAX };
        let waited = u16::try_from(now.saturating_sub(heard).as_millis()).unwrap_or(u16::MAX);
        waited.saturating_add(output.age_ms.into())
    }

    /// Returns the input block.
    #[must_use]
    pub fn input(&self) -> input::Registers {
        self.registers
    }

    /// Returns what it says.
    #[must_use]
    pub fn said(&self) -> &Input {
        &self.input
    }

    /// Returns whether the bridge is received.
    #[must_use]
    pub fn receives_bridge(&self, now: Duration) -> bool {
        self.fresh(now).is_some()
    }

    /// Returns what has arrived from the bridge, in frames.
    #[must_use]
    pub fn counters(&self) -> Counters {
        let counters = self.offsets.counters();
        Counters { malformed: counters.malformed.saturating_add(self.malformed_lines), ..counters }
    }

    /// Returns the holding block that was last used.
    #[must_use]
    pub fn holding(&self) -> cnc::Registers {
        self.holding
    }

    /// Returns what the PLC last said, while that is not older than `MASTER_LASTS`.
    #[must_use]
    pub fn control(&self, now: Duration) -> Option<Control> {
        let (at, control) = self.control?;
        (now.saturating_sub(at) <= MASTER_LASTS).then_some(control)
    }

    /// Takes a holding block from a master. One that is refused is counted, and reported in the input
    /// block.
    ///
    /// # Errors
    /// Another master sends.
    pub fn take(
        &mut self,
        now: Duration,
        master: Master,
        block: &cnc::Registers,
    ) -> Result<BlockOutcome, Busy> {
        match self.master {
            Some((other, at)) if other != master => {
                if now.saturating_sub(at) <= MASTER_LASTS {
                    self.second_master = Some(now);
                    return Err(Busy);
                }
                self.checker = Checker::default();
            }
            Some(_) => {}
            None => self.checker = Checker::default(),
        }
        let checked = self.checker.accept(block);
        match checked {
            Ok(_) if self.may_be_old(now, master) => {
                self.master = Some((master, now));
                self.refuse(MAY_BE_OLD);
                Ok(BlockOutcome::MayBeOld)
            }
            Ok(said) => {
                self.master = Some((master, now));
                self.holding = *block;
                self.use_block(now, said);
                Ok(BlockOutcome::Used)
            }
            Err(refused) => {
                self.refuse(refused as u16);
                Ok(BlockOutcome::Refused(refused))
            }
        }
    }

    fn refuse(&mut self, why: u16) {
        self.input.last_refused = why;
        self.input.refused = self.input.refused.saturating_add(1);
    }

    /// A master has connected: what it sends has not waited for longer than since now.
    pub fn join(&mut self, now: Duration, master: Master) {
        if self.master.is_none() {
            (self.arrived, self.pace, self.doubted_until) =
                (Some((master, now)), None, Duration::ZERO);
        }
    }

    /// Returns whether a whole block may have waited in the line since the one before it. A slow PLC has a slow pace.
    fn may_be_old(&mut self, now: Duration, master: Master) -> bool {
        let before = self.arrived.replace((master, now));
        let Some((_, at)) = before.filter(|(of, _)| *of == master) else {
            (self.pace, self.doubted_until) = (None, Duration::ZERO);
            return false;
        };
        let waited = now.saturating_sub(at);
        let pace = self.pace.replace(waited);
        if waited > MASTER_LASTS && pace.is_none_or(|pace| waited > 2 * pace) {
            self.doubted_until = now + ON_ITS_HEELS;
        }
        now < self.doubted_until
    }

    fn use_block(&mut self, now: Duration, mut said: Cnc) {
        // A bridge that has yet to say what it runs on is no matter for the PLC.
        if said.control.engage && self.pinned.refuses() {
            self.refuse(OTHER_CALIBRATION);
        }
        said.control.engage &= self.pinned.lets_engage();
        said.control.zero &= self.pinned.lets_engage();
        self.control = Some((now, said.control));
        self.speaker.transmit(now, &said);
    }

    /// A master has gone: another need not wait.
    pub fn leave(&mut self, master: Master) {
        if self.master.is_some_and(|(it, _)| it == master) {
            self.master = None;
        }
    }

    /// Returns the frames that are due for the bridge.
    pub fn frames(&mut self) -> Vec<Frame> {
        self.speaker.take()
    }
}

#[cfg(test)]
mod tests;
