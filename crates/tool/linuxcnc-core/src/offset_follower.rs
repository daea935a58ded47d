//! One axis: brings LinuxCNC's external offset to a target, whatever LinuxCNC does meanwhile.
//!
//! A count is a nanometre. Let r be `eoffset-request` and c `eoffset`, both in counts, g the goal,
//! d = v·T the slew limit's share of a servo cycle T. One step is
//!
//! ```text
//! r' = r + clamp(g − r, −d, d)         then kept within c ± lead, and counts ← counts + (r' − r)
//! lead = v²/(2a) + d, where LinuxCNC keeps the limit as well + (what c has come since the step before, at most d)
//! ```
//!
//! Three things make it safe:
//! * **One step a servo cycle.** After a step nothing is written until `eoffset-request` shows it:
//!   then a servo cycle has taken it, and the next step falls into a later one. So a delayed or a
//!   hurried loop never puts two steps into one cycle, without any clock in common. A step that is
//!   not shown for long is taken back before another is tried: a servo thread that comes late, on a
//!   starved computer, finds one step at most, however long it stood.
//! * **The state is LinuxCNC's own.** r is read, never remembered. Where it has changed by
//!   something else (machine on, another writer), the next step begins there.
//! * **No wind-up.** LinuxCNC's planner (`simple_tp.c`) requests the speed
//!   u = −aT + √(2a·e + a²T²) at the distance e = r − c, with a its acceleration. u = v at
//!   e = v²/(2a) + vT, which is `max_lead_counts`: an offset that could not move for a while (joint mode, soft
//!   limit) cannot hurry afterwards. The rest is what the planner covers in the cycle that
//!   `eoffset` does not show yet, taken from the cycle that it shows. A planner that stops in that very cycle
//!   would hurry by it afterwards; so it is given only where `OFFSET_AV_RATIO` has LinuxCNC itself keep the limit.
//!   Where it has not, an offset follows at 1/(1 + 2aT/v) of the limit at least, never below half of it.

use core::time::Duration;

use crate::rounding::{floor, trunc};

/// A step that `eoffset-request` does not show after so long is taken back.
const STEP_TIMEOUT: Duration = Duration::from_secs(1);
/// After a change that was not ours, the pins are left to settle for this time, which is many servo
/// cycles.
const SETTLE_TIME: Duration = Duration::from_millis(50);
/// This many of them one after the other: the pins are not connected as they should be, or LinuxCNC
/// stands.
const LOST_STEP_LIMIT: u8 = 3;
/// An axis that the planner does not move for this time is reported as stuck.
const STUCK_TIMEOUT: Duration = Duration::from_millis(500);
/// Two readings of `eoffset-request` are the same within this, in counts.
const READING_TOLERANCE_COUNTS: f64 = 0.25;
/// A request is a whole number of counts within this.
const COUNT_TOLERANCE: f64 = 1e-3;

/// How fast an offset may change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateLimits {
    /// The slew limit, in nanometres a second.
    pub slew_nm_per_s: f64,
    /// The servo cycle, in seconds.
    pub cycle_s: f64,
    /// The acceleration of LinuxCNC's planner for this offset, in nanometres a second²; infinite
    /// where it is not known, which costs speed, not safety.
    pub acceleration_nm_per_s2: f64,
    /// LinuxCNC itself lets this offset change no faster than the slew limit (`OFFSET_AV_RATIO`).
    pub planner_keeps_slew: bool,
}

impl RateLimits {
    /// Returns the largest step, d: whole counts, at least one. So below 1 µm/s (at a servo cycle of 1 ms)
    /// the bridge's own slew limit is the one that counts.
    #[must_use]
    pub fn max_step_counts(&self) -> f64 {
        floor(self.slew_nm_per_s * self.cycle_s + COUNT_TOLERANCE).max(1.0)
    }

    /// Returns how far the request may run ahead of an offset that stands.
    #[must_use]
    pub(crate) fn max_lead_counts(&self) -> f64 {
        let slew = self.slew_nm_per_s;
        slew * slew / (2.0 * self.acceleration_nm_per_s2) + self.max_step_counts()
    }
}

/// Values of the pins of an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisReading {
    /// `axis.L.eoffset-request`, in nanometres.
    pub request_nm: f64,
    /// `axis.L.eoffset`, in nanometres.
    pub eoffset_nm: f64,
}

/// A step that was written.
#[derive(Clone, Copy, Debug)]
struct PendingStep {
    before: f64,
    counts: i32,
    written: Duration,
}

/// The result of one call.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepResult {
    /// To be added to the counts, with wrapping; 0: leave the pin alone.
    pub counts: i32,
    /// LinuxCNC has not moved the offset for a while although it should.
    pub stuck: bool,
    /// Steps are not taken, one after the other. It goes on trying, by one step and back.
    pub not_taken: bool,
}

/// Brings the external offset of one axis to its target, step by step.
#[derive(Debug, Default)]
pub struct OffsetFollower {
    pending: Option<PendingStep>,
    /// Nothing is written before.
    settled: Duration,
    was_ready: bool,
    lost: u8,
    /// `eoffset` at the step before.
    offset_before: f64,
    /// Since when the lead keeps it from its goal.
    held_since: Option<Duration>,
}

impl OffsetFollower {
    /// Returns the next step towards `goal_nm`, or, without one, towards where the request stands. `ready`:
    /// the machine is on and all joints are homed.
    pub fn step(
        &mut self,
        now: Duration,
        ready: bool,
        goal_nm: Option<i32>,
        reading: AxisReading,
        pace: &RateLimits,
    ) -> StepResult {
        let stuck = self.held_since.is_some_and(|since| now.saturating_sub(since) > STUCK_TIMEOUT);
        let result = StepResult { counts: 0, stuck, not_taken: self.lost >= LOST_STEP_LIMIT };
        if !ready || !reading.request_nm.is_finite() || !reading.eoffset_nm.is_finite() {
            *self = Self { offset_before: reading.eoffset_nm, ..Self::default() };
            return StepResult::default();
        }
        if !self.was_ready {
            self.was_ready = true;
            self.settled = now.saturating_add(SETTLE_TIME);
        }
        if let Some(pending) = self.pending {
            let change = reading.request_nm - pending.before;
            if (change - f64::from(pending.counts)).abs() < READING_TOLERANCE_COUNTS {
                self.lost = 0;
            } else if change.abs() >= READING_TOLERANCE_COUNTS {
                self.settled = now.saturating_add(SETTLE_TIME);
            } else if now.saturating_sub(pending.written) >= STEP_TIMEOUT {
                self.lost = self.lost.saturating_add(1);
                self.settled = now.saturating_add(SETTLE_TIME);
                self.pending = None;
                return StepResult { counts: -pending.counts, ..result };
            } else {
                return result;
            }
            self.pending = None;
        }
        if now < self.settled {
            return result;
        }
        let counts = self.compute_step_counts(now, goal_nm, reading, pace);
        if counts != 0 {
            self.pending = Some(PendingStep { before: reading.request_nm, counts, written: now });
        }
        StepResult { counts, ..result }
    }

    /// Returns the step, in counts.
    #[allow(clippy::cast_possible_truncation, reason = "held to the range of an i32 before")]
    fn compute_step_counts(
        &mut self,
        now: Duration,
        goal_nm: Option<i32>,
        reading: AxisReading,
        pace: &RateLimits,
    ) -> i32 {
        let AxisReading { request_nm: request, eoffset_nm: offset } = reading;
        let goal = goal_nm.map_or(request, f64::from);
        let requested = saturate(goal - request, -pace.max_step_counts(), pace.max_step_counts());
        let moved = (offset - self.offset_before) * requested.signum();
        let covers = if pace.planner_keeps_slew {
            saturate(moved, 0.0, pace.max_step_counts())
        } else {
            0.0
        };
        let lead = pace.max_lead_counts() + covers;
        let next = saturate(request + requested, offset - lead, offset + lead);
        if (next - (request + requested)).abs() < READING_TOLERANCE_COUNTS {
            self.held_since = None;
        } else {
            self.held_since.get_or_insert(now);
        }
        // Towards zero; what LinuxCNC has added up is whole but for the noise of its arithmetic.
        let exact = next - request;
        let whole = trunc(exact + COUNT_TOLERANCE.copysign(exact));
        let whole = saturate(whole, f64::from(i32::MIN), f64::from(i32::MAX)) as i32;
        if whole != 0 {
            self.offset_before = offset;
        }
        whole
    }
}

/// Holds a value between two others; unlike `clamp` it does not panic where they are not in order.
fn saturate(value: f64, low: f64, high: f64) -> f64 {
    value.max(low).min(high)
}
