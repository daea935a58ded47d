//! Offsets between the joints and their drives: what `moveoff` is to do, whatever LinuxCNC does meanwhile.
//!
//! `moveoff` limits speed and acceleration in the servo thread, so that its input may step. This module
//! decides the goal of each joint:
//!
//! | LinuxCNC | the offset of a joint |
//! |---|---|
//! | on, all joints homed | base + offset of the axis, command + offset within the joint's limits |
//! | off, emergency stop, drive fault, homing, not homed | held: the drive stands, and the planner follows its feedback |
//! | a joint is homed again while an offset acts | held, and from then on the base, see below |
//!
//! A home switch is found with the offset that acts, and LinuxCNC's new reference (`joint.N.motor-offset`) contains it:
//! to find the same places as before, it has to stay, and new offsets are added to it. So the base is the offset that
//! acted when `motor-offset` changed. A joint that is homed without an offset has a base of 0. The drive is never
//! further from the planner's machine than the offset of the axis; both are counted without the base. The reference that a base
//! belongs to is kept at a pin, so that a component that is loaded again sees a homing that it missed.
//!
//! `moveoff` computes as `limit3` does, and has a fault (2.9, read and measured): from rest, with an input that stands
//! above its output, it goes down by acceleration · period² in every other cycle, away from its goal and beyond
//! `offset-max`, which limits the input alone. An input that changes is followed. So a goal that stands and is not reached
//! changes by a nanometre at every step, towards the base.

use core::time::Duration;

/// `moveoff` has this many joints.
pub const MAX_JOINTS: usize = 9;
/// An offset is applied when it is within this of its goal, in nanometres.
const APPLIED_TOLERANCE_NM: f64 = 20.0;
/// `motor-offset` has changed if it differs by this, in nanometres.
const CHANGE_TOLERANCE_NM: f64 = 1e-3;
/// An offset moves if it does so by this, in nanometres.
const MOTION_THRESHOLD_NM: f64 = 1.0;
/// An offset that is not at its goal and has not moved for this time is not taken.
const STALL_TIMEOUT: Duration = Duration::from_secs(1);
/// By how much a goal changes that is above the offset, in nanometres: a tenth of the wire's resolution.
const DITHER_AMPLITUDE_NM: f64 = 1.0;

/// Settings of a joint that gets an offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSettings {
    /// LinuxCNC's number.
    pub number: usize,
    /// Index of its axis: X, Y, Z.
    pub axis: usize,
    /// Least and largest position of the drive, in nanometres; infinite where none is stated.
    pub limits_nm: [f64; 2],
    /// Fastest change of the offset, in mm/s.
    pub mm_per_s: f64,
    /// Acceleration of the offset, in mm/s².
    pub mm_per_s2: f64,
}

/// Values of LinuxCNC's pins for a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointReading {
    /// The offset that acts, in nanometres: `moveoff.offset-current`.
    pub now_nm: f64,
    /// Commanded position, in nanometres: `joint.N.pos-cmd`.
    pub command_nm: f64,
    /// LinuxCNC's reference, in nanometres: `joint.N.motor-offset`.
    pub reference_nm: f64,
    /// True while the joint is homed.
    pub homing: bool,
}

impl JointReading {
    /// Returns what is known of a joint whose wires are not connected yet: its pins say 0, and the first real value
    /// would count as a change.
    #[must_use]
    pub fn unconnected() -> Self {
        let unknown = f64::NAN;
        Self { now_nm: unknown, command_nm: unknown, reference_nm: unknown, homing: true }
    }
}

/// Goal and limits of a joint's offset for `moveoff`, in nanometres.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointGoal {
    /// Goal of the offset.
    pub offset_nm: f64,
    /// The offset may be from here …
    pub min_nm: f64,
    /// … to here.
    pub max_nm: f64,
    /// The reference of LinuxCNC that all of this is counted from: kept for the component after this one, which sees by it
    /// that the joint was homed meanwhile. NaN: not known.
    pub reference_nm: f64,
}

/// Offsets that act on the axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AppliedOffsets {
    /// Offset of X, Y and Z without the bases, in nanometres; of an axis with two joints the larger one.
    pub nm: [f64; 3],
    /// True if no offset acts.
    pub at_zero: bool,
    /// True if every joint is at its goal and no joint stands back.
    pub arrived: bool,
    /// True if a joint stands back from its limit.
    pub limited: bool,
    /// True if `moveoff` does not bring a joint towards its goal.
    pub not_taken: bool,
}

impl AppliedOffsets {
    /// Nothing acts, and nothing is to.
    pub(crate) const ZERO: Self =
        Self { nm: [0.0; 3], at_zero: true, arrived: true, limited: false, not_taken: false };
}

/// A joint between two steps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct JointState {
    base_nm: f64,
    offset_nm: f64,
    /// `motor-offset` at the step before; `None` before the first one.
    reference_nm: Option<f64>,
    /// The offset follows the bridge: the machine was ready at the step before.
    follows: bool,
    /// Where the offset stands off its goal or goes away from it, and since when.
    stands: Option<(f64, Duration)>,
    /// The goal of the step before, and whether it was changed by [`DITHER_AMPLITUDE_NM`].
    given: (f64, bool),
    /// The goal is that of a component before this one, and its wires have no value yet.
    is_left: bool,
}

/// The offsets of all joints.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct JointOffsets {
    states: [JointState; MAX_JOINTS],
}

/// Inputs of a step that all joints share.
#[derive(Clone, Copy, Debug)]
pub struct StepInputs {
    /// The time.
    pub now: Duration,
    /// The machine is on and all joints are homed.
    pub ready: bool,
    /// Offsets of X, Y and Z, in nanometres; `None`: as before.
    pub goal_nm: Option<[i32; 3]>,
    /// Largest offset of X, Y and Z, in nanometres.
    pub max_nm: [i32; 3],
}

impl JointOffsets {
    /// Goes on from what a component before this one has left at the pins of `moveoff`.
    pub fn resume(&mut self, joint: usize, left: JointGoal) {
        let base_nm = f64::midpoint(left.min_nm, left.max_nm);
        if let Some(state) = self.states.get_mut(joint) {
            let reference_nm =
                Some(left.reference_nm).filter(|reference_nm| reference_nm.is_finite());
            *state = JointState {
                base_nm,
                offset_nm: left.offset_nm,
                reference_nm,
                is_left: true,
                ..JointState::default()
            };
        }
    }

    /// Computes the goal of each joint.
    pub fn step(
        &mut self,
        step: &StepInputs,
        joints: &[Option<JointSettings>; MAX_JOINTS],
        readings: &[JointReading; MAX_JOINTS],
    ) -> ([JointGoal; MAX_JOINTS], AppliedOffsets) {
        let mut goals = [JointGoal::default(); MAX_JOINTS];
        let mut applied = AppliedOffsets::ZERO;
        for (index, (joint, reading)) in joints.iter().zip(readings).enumerate() {
            let Some(joint) = joint else { continue };
            let Some(state) = self.states.get_mut(index) else { continue };
            // There is no other axis, and the servo thread checks no index.
            let axis = joint.axis.min(2);
            state.adopt_current_offset(reading);
            state.update_base_offset(reading);
            state.hold_unless_following(step.ready && !reading.homing, reading);
            if let (true, Some(goal)) = (state.follows, step.goal_nm) {
                let goal = f64::from(goal[axis]);
                let allowed = clamp_to_limits(goal, joint, reading);
                applied.limited |= (allowed - goal).abs() > APPLIED_TOLERANCE_NM;
                state.offset_nm = state.base_nm + allowed;
            }
            let max = f64::from(step.max_nm[axis].max(0));
            goals[index] = JointGoal {
                offset_nm: state.offset_nm + state.next_dither_nm(reading),
                min_nm: state.base_nm - max,
                max_nm: state.base_nm + max,
                reference_nm: state.reference_nm.unwrap_or(f64::NAN),
            };
            let acts = reading.now_nm - state.base_nm;
            if acts.abs() > applied.nm[axis].abs() {
                applied.nm[axis] = acts;
            }
            applied.at_zero &= acts.abs() <= APPLIED_TOLERANCE_NM;
            applied.arrived &= (reading.now_nm - state.offset_nm).abs() <= APPLIED_TOLERANCE_NM;
            applied.not_taken |= state.detect_stall(step.now, reading);
        }
        applied.arrived &= !applied.limited;
        (goals, applied)
    }
}

impl JointState {
    /// Stands where `moveoff` stands when it is known for the first time: it was stopped on its way to the goal that was left,
    /// and the machine may be off now.
    fn adopt_current_offset(&mut self, reading: &JointReading) {
        if self.is_left && reading.now_nm.is_finite() {
            self.offset_nm = reading.now_nm;
            self.is_left = false;
        }
    }

    /// Takes the offset that acts as the base when LinuxCNC has taken a new reference with it.
    fn update_base_offset(&mut self, reading: &JointReading) {
        if !reading.reference_nm.is_finite() || !reading.now_nm.is_finite() {
            return;
        }
        let before = self.reference_nm.replace(reading.reference_nm);
        if before.is_some_and(|before| (before - reading.reference_nm).abs() > CHANGE_TOLERANCE_NM)
        {
            self.base_nm = reading.now_nm;
            self.offset_nm = reading.now_nm;
        }
    }

    /// Keeps the offset that acts when the machine is no longer ready, on whatever way it is to its goal.
    fn hold_unless_following(&mut self, follows: bool, reading: &JointReading) {
        if self.follows && !follows && reading.now_nm.is_finite() {
            self.offset_nm = reading.now_nm;
        }
        self.follows = follows;
    }

    /// Returns by how much the goal is changed now, in nanometres: in every other step, while it stands above the offset.
    fn next_dither_nm(&mut self, reading: &JointReading) -> f64 {
        let (before_nm, was_kicked) = self.given;
        let stands = (self.offset_nm - before_nm).abs() <= CHANGE_TOLERANCE_NM;
        let is_kicked =
            stands && !was_kicked && self.offset_nm - reading.now_nm > CHANGE_TOLERANCE_NM;
        self.given = (self.offset_nm, is_kicked);
        match (is_kicked, self.offset_nm > self.base_nm) {
            (false, _) => 0.0,
            (true, true) => -DITHER_AMPLITUDE_NM,
            (true, false) => DITHER_AMPLITUDE_NM,
        }
    }

    /// Returns whether `moveoff` leaves the offset where it is, off its goal, or moves it away from there.
    fn detect_stall(&mut self, now: Duration, reading: &JointReading) -> bool {
        let is_off = (reading.now_nm - self.offset_nm).abs() > APPLIED_TOLERANCE_NM;
        if !self.follows || !is_off {
            self.stands = None;
            return false;
        }
        let (at_nm, since) = *self.stands.get_or_insert((reading.now_nm, now));
        let towards = (self.offset_nm - at_nm).signum();
        if (reading.now_nm - at_nm) * towards > MOTION_THRESHOLD_NM {
            self.stands = Some((reading.now_nm, now));
            return false;
        }
        now.saturating_sub(since) >= STALL_TIMEOUT
    }
}

/// Returns the offset with which the drive stays within the joint's limits; a command beyond them is LinuxCNC's affair.
fn clamp_to_limits(goal_nm: f64, joint: &JointSettings, reading: &JointReading) -> f64 {
    if !reading.command_nm.is_finite() {
        return goal_nm;
    }
    let [low, high] = joint.limits_nm.map(|limit| limit - reading.command_nm);
    // Not `clamp`, which panics where the limits are none.
    goal_nm.max(low.min(0.0)).min(high.max(0.0))
}

#[cfg(test)]
mod tests;
