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
//! such a change, so the board has to distinguish the two ([`Master::is_master_cnc`]).

use trueup_canopen::dictionary::WriteAuthority;
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
const MIN_CONSECUTIVE_FRAMES: u8 = 3;
/// The weight of a frame out of sequence, and the sum that is a second master: three frames.
const OUT_OF_SEQUENCE_WEIGHT: u8 = 4;
const SECOND_MASTER_THRESHOLD: u8 = 3 * OUT_OF_SEQUENCE_WEIGHT;
/// The sum goes down by one in this time: 2.4 s for three frames.
const LEAK_PERIOD_MS: u32 = 200;
/// Frames that have to follow on after one out of sequence, for its sender to be the master.
const MIN_SEQUENTIAL_FRAMES: u8 = 2;
/// And none may come out of sequence for this share of the link timeout. A CNC sends more often: else one lost frame
/// or two would be its silence.
const QUIET_TIMEOUT_DIVISOR: u32 = 4;
/// Time for which another line is reported after its last command.
const OTHER_INTERFACE_REPORT_MS: u32 = LEAK_PERIOD_MS * SECOND_MASTER_THRESHOLD as u32;

/// A bit of `Control` whose edge means something.
#[derive(Clone, Copy, Debug, Default)]
struct EdgeDetector {
    /// It was 0 in a frame of a master that is steady.
    is_armed: bool,
    /// Frames in a row with it set, up to [`MIN_CONSECUTIVE_FRAMES`].
    run: u8,
}

/// The outcome of an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum EdgeOutcome {
    No,
    Yes,
    /// It was taken back, or a frame was refused, before it could be believed.
    TooShort,
}

impl EdgeDetector {
    fn receive(&mut self, bit: bool, is_steady: bool) -> EdgeOutcome {
        let was_begun = (1..MIN_CONSECUTIVE_FRAMES).contains(&self.run);
        if !bit {
            *self = Self { is_armed: is_steady, run: 0 };
            return if was_begun { EdgeOutcome::TooShort } else { EdgeOutcome::No };
        }
        if !self.is_armed || self.run == MIN_CONSECUTIVE_FRAMES {
            return EdgeOutcome::No;
        }
        self.run = self.run.saturating_add(1);
        if self.run == MIN_CONSECUTIVE_FRAMES { EdgeOutcome::Yes } else { EdgeOutcome::No }
    }

    /// A frame was refused. Whether that has cut it short.
    fn abort(&mut self) -> bool {
        let was_begun = (1..MIN_CONSECUTIVE_FRAMES).contains(&self.run);
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
    zero: EdgeDetector,
    confirm: EdgeDetector,
    /// A `Zero` was cut short, and that is not reported yet.
    zero_was_cut: bool,
    /// Frames accepted since the last one that was refused, up to [`MIN_CONSECUTIVE_FRAMES`].
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
    /// `Zero` was requested, believed or not.
    pub zero: bool,
    /// `Confirm` was requested.
    pub confirm: bool,
}

impl Master {
    /// Returns true if the commands of a CNC are accepted from this line.
    pub(crate) fn accepts_interface(&self, line: Interface) -> bool {
        self.line.is_none_or(|his| his == line)
    }

    /// Records a CNC's frame on a line that is not the master's. A damaged frame is noise and does not count.
    pub(crate) fn record_frame_on_other_interface(&mut self) {
        self.other_line_ms = OTHER_INTERFACE_REPORT_MS;
    }

    /// Takes an accepted `Control`; `None`: it is not believed.
    pub(crate) fn accept_control(
        &mut self,
        line: Interface,
        control: Control,
    ) -> Option<ControlEvent> {
        self.line = Some(line);
        self.silent_ms = 0;
        self.steady = self.steady.saturating_add(1).min(MIN_CONSECUTIVE_FRAMES);
        let is_steady = self.steady >= MIN_CONSECUTIVE_FRAMES;
        let requested = self.zero.receive(control.zero, is_steady);
        let confirm = self.confirm.receive(control.confirm, is_steady) == EdgeOutcome::Yes;
        let was_cut = core::mem::take(&mut self.zero_was_cut);
        let zero = was_cut || requested != EdgeOutcome::No;
        self.last = control;
        if control.engage {
            self.has_engaged = true;
            self.is_started |= self.released >= MIN_CONSECUTIVE_FRAMES && !self.is_doubtful;
            self.released = 0;
        } else {
            self.released = self.released.saturating_add(1).min(MIN_CONSECUTIVE_FRAMES);
        }
        let control = Control { zero: requested == EdgeOutcome::Yes, confirm: false, ..control };
        (!self.is_doubtful).then_some(ControlEvent { control, zero, confirm })
    }

    /// A `Control` that was refused; `is_sound`: it was whole, but not in sequence.
    pub(crate) fn reject_control(&mut self, is_sound: bool) {
        self.steady = 0;
        self.released = 0;
        self.zero_was_cut |= self.zero.abort();
        self.confirm.abort();
        if is_sound {
            self.quiet_ms = 0;
            // It may be another sender.
            (self.has_engaged, self.was_interrupted) = (false, true);
            // Up to one weight more than a second master has, so that the doubt lasts for a while after the last of them.
            self.strange = self
                .strange
                .saturating_add(OUT_OF_SEQUENCE_WEIGHT)
                .min(SECOND_MASTER_THRESHOLD + OUT_OF_SEQUENCE_WEIGHT);
            self.is_doubtful |= self.strange >= SECOND_MASTER_THRESHOLD;
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
        if self.leak_ms >= LEAK_PERIOD_MS {
            self.leak_ms = 0;
            self.strange = self.strange.saturating_sub(1);
        }
        self.quiet_ms = self.quiet_ms.saturating_add(elapsed_ms);
        if self.steady >= MIN_SEQUENTIAL_FRAMES
            && self.quiet_ms > link_timeout_ms / QUIET_TIMEOUT_DIVISOR
        {
            self.strange = if self.is_doubtful { 0 } else { self.strange };
        }
        self.is_doubtful &= self.strange > 0;
        self.other_line_ms = self.other_line_ms.saturating_sub(elapsed_ms);
    }

    /// Returns whether the engage sequence is complete.
    pub(crate) const fn is_engage_sequence_complete(&self) -> bool {
        self.is_started
    }

    /// Returns whether more than one sends `Control`.
    pub(crate) const fn has_second_sender(&self) -> bool {
        self.is_doubtful || self.other_line_ms > 0
    }

    /// Returns whether the master is the CNC: it has engaged since it began to speak, or it speaks since the start of
    /// the board without a gap, and its axes are referenced. A tool that sends `Control` for want of a CNC has no axes.
    /// One that comes after a silence may be anybody.
    pub(crate) fn is_master_cnc(&self) -> bool {
        let from_the_start = !self.was_interrupted && self.last.referenced;
        self.line.is_some() && (self.has_engaged || from_the_start)
    }

    /// Who may write, as the dictionary has it.
    pub(crate) fn write_authority(&self) -> WriteAuthority {
        if self.line.is_none() {
            WriteAuthority::NoMaster
        } else if self.last.service && !self.last.engage && !self.is_doubtful {
            WriteAuthority::Service
        } else {
            WriteAuthority::NoService
        }
    }
}

#[cfg(test)]
mod tests;
