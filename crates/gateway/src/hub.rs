//! Both blocks of registers between the bridge and a PLC; time is an argument.
//!
//! | the bridge | the input block |
//! |---|---|
//! | a valid pair of offset frames | what they say, the counter one further |
//! | no new pair | stands, counter and all |
//! | none for [`STALE`] | "not available", quality 6; the counter goes on, since the gateway lives |
//!
//! A block is made whole and replaced whole, so whoever asks for it gets one moment's.

use std::time::Duration;

use trueup_client::status::Board;
use trueup_core::cnc::{Control, Output, Quality};
use trueup_link::{
    frame::Frame,
    layout::STATUS_ID,
    receiver::{Counters, OffsetReceiver},
    slcan::Event,
    status::StateBits,
};
use trueup_modbus::{
    cnc::{self, Checker, Cnc, Refused},
    input::{self, Input},
    server::Busy,
    table::HOLDING_LEN,
};

use crate::cnc::Speaker;

/// Without a valid pair for so long the bridge counts as silent: as in `trueup linuxcnc`, a hundred
/// cycles, and less than the 256 ms after which a counter of CAN comes round.
pub const STALE: Duration = Duration::from_millis(100);
/// Each item of `Status` comes every 1.1 s; three missed, and it counts as unknown.
const STATUS_LASTS: Duration = Duration::from_millis(3_400);
/// A master that has sent no valid block for so long no longer keeps others out: the link timeout
/// after which the bridge counts its CNC as lost, by default.
pub const MASTER_LASTS: Duration = Duration::from_millis(500);
/// How long a second master is told of.
const TOLD: Duration = Duration::from_secs(2);

/// Who sends holding blocks: a connection.
pub type Master = u64;

/// What stands between the bridge and the PLC.
pub struct Hub {
    offsets: OffsetReceiver,
    malformed_lines: u32,
    last: Option<(Duration, Output)>,
    is_new: bool,
    board: Board,
    status_heard: Option<Duration>,
    input: Input,
    registers: input::Registers,
    master: Option<(Master, Duration)>,
    checker: Checker,
    holding: cnc::Registers,
    speaker: Speaker,
    control: Option<(Duration, Control)>,
    second_master: Option<Duration>,
}

/// What came of a holding block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// It is used.
    Used,
    /// It is not, and why.
    Refused(Refused),
}

impl Default for Hub {
    fn default() -> Self {
        Self::new()
    }
}

impl Hub {
    /// Nothing heard from anyone.
    #[must_use]
    pub fn new() -> Self {
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
            registers: input.encode(),
            input,
            master: None,
            checker: Checker::default(),
            holding: [0; HOLDING_LEN],
            speaker: Speaker::default(),
            control: None,
            second_master: None,
        }
    }

    /// Takes what came over the bridge's line. What must not be used is counted.
    pub fn hear(&mut self, now: Duration, event: &Event) {
        match event {
            Event::Frame(frame) if frame.id() == STATUS_ID => {
                let refused = self.board.refused();
                self.board.hear(frame);
                if self.board.refused() == refused {
                    self.status_heard = Some(now);
                }
            }
            Event::Frame(frame) => {
                if let Ok(Some(output)) = self.offsets.accept(frame) {
                    self.last = Some((now, output));
                    self.is_new = true;
                }
            }
            Event::Malformed(_) => self.malformed_lines = self.malformed_lines.saturating_add(1),
            Event::Accepted | Event::Refused | Event::Other(_) => {}
        }
    }

    /// Makes the input block anew, if there is anything new to say.
    pub fn refresh(&mut self, now: Duration) {
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
    }

    /// The newest valid pair, unless it is stale.
    fn fresh(&self, now: Duration) -> Option<&Output> {
        let (heard, output) = self.last.as_ref()?;
        (now.saturating_sub(*heard) <= STALE).then_some(output)
    }

    fn age_ms(&self, now: Duration) -> u16 {
        let Some((heard, output)) = self.last else { return u16::MAX };
        let waited = u16::try_from(now.saturating_sub(heard).as_millis()).unwrap_or(u16::MAX);
        waited.saturating_add(output.age_ms.into())
    }

    /// The input block.
    #[must_use]
    pub fn input(&self) -> input::Registers {
        self.registers
    }

    /// What it says.
    #[must_use]
    pub fn said(&self) -> &Input {
        &self.input
    }

    /// Whether the bridge is heard.
    #[must_use]
    pub fn hears_bridge(&self, now: Duration) -> bool {
        self.fresh(now).is_some()
    }

    /// What has arrived from the bridge, in frames.
    #[must_use]
    pub fn counters(&self) -> Counters {
        let counters = self.offsets.counters();
        Counters { malformed: counters.malformed.saturating_add(self.malformed_lines), ..counters }
    }

    /// The holding block that was last used.
    #[must_use]
    pub fn holding(&self) -> cnc::Registers {
        self.holding
    }

    /// What the PLC last said, while that is not older than [`MASTER_LASTS`].
    #[must_use]
    pub fn control(&self, now: Duration) -> Option<Control> {
        let (at, control) = self.control?;
        (now.saturating_sub(at) <= MASTER_LASTS).then_some(control)
    }

    /// Takes a holding block from a master. One that is refused is counted, and told in the input
    /// block.
    ///
    /// # Errors
    /// Another master sends.
    pub fn take(
        &mut self,
        now: Duration,
        master: Master,
        block: &cnc::Registers,
    ) -> Result<Taken, Busy> {
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
        match self.checker.accept(block) {
            Ok(said) => {
                self.master = Some((master, now));
                self.holding = *block;
                self.use_block(now, said);
                Ok(Taken::Used)
            }
            Err(refused) => {
                self.input.last_refused = refused as u16;
                self.input.refused = self.input.refused.saturating_add(1);
                Ok(Taken::Refused(refused))
            }
        }
    }

    fn use_block(&mut self, now: Duration, said: Cnc) {
        self.control = Some((now, said.control));
        self.speaker.say(now, &said);
    }

    /// A master has gone: another need not wait.
    pub fn leave(&mut self, master: Master) {
        if self.master.is_some_and(|(it, _)| it == master) {
            self.master = None;
        }
    }

    /// The frames that are due for the bridge.
    pub fn frames(&mut self) -> Vec<Frame> {
        self.speaker.take()
    }
}

#[cfg(test)]
mod tests;
