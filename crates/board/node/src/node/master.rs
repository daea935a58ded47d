//! Who commands the bridge, and what it waits for before it gives an offset.
//!
//! **The engage sequence.** After every start, whatever its reason, the offset that the CNC still
//! applies is not known here. So nothing is available until `Engage` was received as 0 in three
//! accepted `Control` frames, one after the other, and then as 1: a CNC raises it only when the
//! offset that it applies is 0.
//!
//! **One master.** The line on which `Control` was last accepted is the master's, until it has been
//! silent for the link timeout. Commands from any other line are ignored meanwhile, and
//! reported. On the same line a second master shows in the counters: each time the two change over, one frame is
//! repeated or out of sequence. A sound link has none of these and a CNC that restarts has one, so
//! three within 2.4 s are a second master. Neither is believed then, as if both were silent. After the stranger's
//! last frame the master is the sender whose next two counters follow on, with none out of sequence for a quarter of
//! the link timeout: a sender that is there interrupts any other one sooner. Without such a sender the doubt ends
//! after 2.4 to 3.2 s.
//!
//! **Edges** of `Zero` and `Confirm` count once the bit was 0 after three accepted frames in a row and
//! then 1 in three more: two masters that disagree on a bit make no edge of it, and neither does a
//! single frame of a stranger that has guessed the counter. A `Zero` that was shorter is refused, and
//! reported.
//!
//! **Whether a CNC is there.** A tool says `Service` itself where no CNC sends. No operator at the machine has seen
//! such a change, so the board has to distinguish the two ([`Master::is_cnc`]).

use trueup_canopen::dictionary::Authority;
use trueup_core::cnc::Control;

/// A wire on which the bridge is spoken to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interface {
    /// The CAN bus.
    Can,
    /// SLCAN on the serial line.
    Serial,
    /// Modbus on the RS-485 line.
    Modbus,
}

/// This many accepted frames in a row make the engage sequence, and an edge believable.
const STEADY: u8 = 3;
/// The weight of a frame out of sequence, and the sum that is a second master: three frames.
const WEIGHT: u8 = 4;
const SECOND_MASTER: u8 = 3 * WEIGHT;
/// The sum goes down by one in this time: 2.4 s for three frames.
const LEAK_MS: u32 = 200;
/// Frames that have to follow on after one out of sequence, for its sender to be the master.
const FOLLOWING: u8 = 2;
/// And none may come out of sequence for this share of the link timeout. A CNC sends more often: else one lost frame
/// or two would be its silence.
const QUIET_SHARE: u32 = 4;
/// Time for which another line is reported after its last command.
const TOLD_MS: u32 = LEAK_MS * SECOND_MASTER as u32;

/// A bit of `Control` whose edge means something.
#[derive(Clone, Copy, Debug, Default)]
struct Edge {
    /// It was 0 in a frame of a master that is steady.
    is_armed: bool,
    /// Frames in a row with it set, up to [`STEADY`].
    run: u8,
}

/// The outcome of an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Asked {
    No,
    Yes,
    /// It was taken back, or a frame was refused, before it could be believed.
    TooShort,
}

impl Edge {
    fn receive(&mut self, bit: bool, is_steady: bool) -> Asked {
        let was_begun = (1..STEADY).contains(&self.run);
        if !bit {
            *self = Self { is_armed: is_steady, run: 0 };
            return if was_begun { Asked::TooShort } else { Asked::No };
        }
        if !self.is_armed || self.run == STEADY {
            return Asked::No;
        }
        self.run = self.run.saturating_add(1);
        if self.run == STEADY { Asked::Yes } else { Asked::No }
    }

    /// A frame was refused. Whether that has cut it short.
    fn cut(&mut self) -> bool {
        let was_begun = (1..STEADY).contains(&self.run);
        *self = Self::default();
        was_begun
    }
}

/// The master's `Control`, and whether it is one.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Master {
    /// Where the last `Control` was accepted; `None`: none was, or it is too long ago.
    line: Option<Interface>,
    silent_ms: u32,
    last: Control,
    zero: Edge,
    confirm: Edge,
    /// A `Zero` was cut short, and that is not reported yet.
    zero_was_cut: bool,
    /// Frames accepted since the last one that was refused, up to [`STEADY`].
    steady: u8,
    /// Of these, in a row and at the end, with `Engage` 0.
    released: u8,
    /// The engage sequence is complete.
    is_started: bool,
    /// Frames out of sequence, weighed.
    strange: u8,
    leak_ms: u32,
    /// Since the last of them.
    quiet_ms: u32,
    /// Two share the line, and neither is believed.
    is_doubtful: bool,
    /// Time for which another line is still reported.
    other_line_ms: u32,
    /// It has engaged since it began to speak.
    has_engaged: bool,
    /// A master has been silent, or another sender went on in its place.
    was_interrupted: bool,
}

/// The outcome of a `Control` frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ControlEvent {
    /// The command that the bridge follows: `Zero` is set where its edge is believed, and in this frame alone.
    pub control: Control,
    /// `Zero` was asked for, believed or not.
    pub zero: bool,
    /// `Confirm` was asked for.
    pub confirm: bool,
}

impl Master {
    /// Returns true if the commands of a CNC are accepted from this line.
    pub(crate) fn admits(&self, line: Interface) -> bool {
        self.line.is_none_or(|his| his == line)
    }

    /// Records a CNC's frame on a line that is not the master's. A damaged frame is noise and does not count.
    pub(crate) fn receive_other(&mut self) {
        self.other_line_ms = TOLD_MS;
    }

    /// Takes an accepted `Control`; `None`: it is not believed.
    pub fn take(&mut self, line: Interface, control: Control) -> Option<ControlEvent> {
        self.line = Some(line);
        self.silent_ms = 0;
        self.steady = self.steady.saturating_add(1).min(STEADY);
        let is_steady = self.steady >= STEADY;
        let asked = self.zero.receive(control.zero, is_steady);
        let confirm = self.confirm.receive(control.confirm, is_steady) == Asked::Yes;
        let was_cut = core::mem::take(&mut self.zero_was_cut);
        let zero = was_cut || asked != Asked::No;
        self.last = control;
        if control.engage {
            self.has_engaged = true;
            self.is_started |= self.released >= STEADY && !self.is_doubtful;
            self.released = 0;
        } else {
            self.released = self.released.saturating_add(1).min(STEADY);
        }
        let control = Control { zero: asked == Asked::Yes, confirm: false, ..control };
        (!self.is_doubtful).then_some(ControlEvent { control, zero, confirm })
    }

    /// A `Control` that was refused; `is_sound`: it was whole, but not in sequence.
    pub fn refuse(&mut self, is_sound: bool) {
        self.steady = 0;
        self.released = 0;
        self.zero_was_cut |= self.zero.cut();
        self.confirm.cut();
        if is_sound {
            self.quiet_ms = 0;
            // It may be another sender.
            (self.has_engaged, self.was_interrupted) = (false, true);
            // Up to one weight more than a second master has, so that the doubt lasts for a while after the last of them.
            self.strange = self.strange.saturating_add(WEIGHT).min(SECOND_MASTER + WEIGHT);
            self.is_doubtful |= self.strange >= SECOND_MASTER;
        }
    }

    /// Time passes.
    pub fn tick(&mut self, elapsed_ms: u32, link_timeout_ms: u32) {
        self.silent_ms = self.silent_ms.saturating_add(elapsed_ms);
        if self.silent_ms > link_timeout_ms {
            self.was_interrupted |= self.line.is_some();
            (self.line, self.steady, self.released) = (None, 0, 0);
            self.has_engaged = false;
        }
        self.leak_ms = self.leak_ms.saturating_add(elapsed_ms);
        if self.leak_ms >= LEAK_MS {
            self.leak_ms = 0;
            self.strange = self.strange.saturating_sub(1);
        }
        self.quiet_ms = self.quiet_ms.saturating_add(elapsed_ms);
        if self.steady >= FOLLOWING && self.quiet_ms > link_timeout_ms / QUIET_SHARE {
            self.strange = if self.is_doubtful { 0 } else { self.strange };
        }
        self.is_doubtful &= self.strange > 0;
        self.other_line_ms = self.other_line_ms.saturating_sub(elapsed_ms);
    }

    /// Returns whether the engage sequence is complete.
    pub(crate) const fn is_started(&self) -> bool {
        self.is_started
    }

    /// Returns whether more than one sends `Control`.
    pub const fn is_second(&self) -> bool {
        self.is_doubtful || self.other_line_ms > 0
    }

    /// Returns whether the master is the CNC: it has engaged since it began to speak, or it speaks since the start of
    /// the board without a gap, and its axes are referenced. A tool that sends `Control` for want of a CNC has no axes.
    /// One that comes after a silence may be anybody.
    pub(crate) fn is_cnc(&self) -> bool {
        let from_the_start = !self.was_interrupted && self.last.referenced;
        self.line.is_some() && (self.has_engaged || from_the_start)
    }

    /// Who may write, as the dictionary has it.
    pub fn authority(&self) -> Authority {
        if self.line.is_none() {
            Authority::NoMaster
        } else if self.last.service && !self.last.engage && !self.is_doubtful {
            Authority::Service
        } else {
            Authority::NoService
        }
    }
}

#[cfg(test)]
mod tests;
