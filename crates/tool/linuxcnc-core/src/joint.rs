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
//! further from the planner's machine than the offset of the axis; both are counted without the base.
//!
//! `moveoff` computes as `limit3` does, and has a fault (2.9, read and measured): from rest, with an input that stands
//! above its output, it goes down by acceleration · period² in every other cycle, away from its goal and beyond
//! `offset-max`, which limits the input alone. An input that changes is followed. So a goal that stands and is not reached
//! changes by a nanometre at every step, towards the base.

use core::time::Duration;

/// `moveoff` has this many joints.
pub const MAX_JOINTS: usize = 9;
/// An offset is applied when it is within this of its goal, in nanometres.
const APPLIED_WITHIN_NM: f64 = 20.0;
/// `motor-offset` has changed if it differs by this, in nanometres.
const SAME_NM: f64 = 1e-3;
/// An offset moves if it does so by this, in nanometres.
const MOVED_NM: f64 = 1.0;
/// An offset that is not at its goal and has not moved for so long is not taken.
const LOST_AFTER: Duration = Duration::from_secs(1);
/// By how much a goal changes that is above the offset, in nanometres: a tenth of the wire's resolution.
const KICK_NM: f64 = 1.0;

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
    pub fn not_wired() -> Self {
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
}

/// Offsets that act on the axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Applied {
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

impl Applied {
    /// Nothing acts, and nothing is to.
    pub const NOTHING: Self =
        Self { nm: [0.0; 3], at_zero: true, arrived: true, limited: false, not_taken: false };
}

/// A joint between two steps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct State {
    base_nm: f64,
    offset_nm: f64,
    /// `motor-offset` at the step before; `None` before the first one.
    reference_nm: Option<f64>,
    /// The offset follows the bridge: the machine was ready at the step before.
    follows: bool,
    /// Where the offset stands off its goal or goes away from it, and since when.
    stands: Option<(f64, Duration)>,
    /// The goal of the step before, and whether it was changed by [`KICK_NM`].
    given: (f64, bool),
}

/// The offsets of all joints.
#[derive(Clone, Copy, Debug, Default)]
pub struct JointOffsets {
    states: [State; MAX_JOINTS],
}

/// Inputs of a step that all joints share.
#[derive(Clone, Copy, Debug)]
pub struct Step {
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
            *state = State { base_nm, offset_nm: left.offset_nm, ..State::default() };
        }
    }

    /// Computes the goal of each joint.
    pub fn step(
        &mut self,
        step: &Step,
        joints: &[Option<JointSettings>; MAX_JOINTS],
        readings: &[JointReading; MAX_JOINTS],
    ) -> ([JointGoal; MAX_JOINTS], Applied) {
        let mut goals = [JointGoal::default(); MAX_JOINTS];
        let mut applied = Applied::NOTHING;
        for (index, (joint, reading)) in joints.iter().zip(readings).enumerate() {
            let Some(joint) = joint else { continue };
            let Some(state) = self.states.get_mut(index) else { continue };
            // There is no other axis, and the servo thread checks no index.
            let axis = joint.axis.min(2);
            state.follow_reference(reading);
            state.hold(step.ready && !reading.homing, reading);
            if let (true, Some(goal)) = (state.follows, step.goal_nm) {
                let goal = f64::from(goal[axis]);
                let allowed = within_limits(goal, joint, reading);
                applied.limited |= (allowed - goal).abs() > APPLIED_WITHIN_NM;
                state.offset_nm = state.base_nm + allowed;
            }
            let max = f64::from(step.max_nm[axis].max(0));
            goals[index] = JointGoal {
                offset_nm: state.offset_nm + state.kick(reading),
                min_nm: state.base_nm - max,
                max_nm: state.base_nm + max,
            };
            let acts = reading.now_nm - state.base_nm;
            if acts.abs() > applied.nm[axis].abs() {
                applied.nm[axis] = acts;
            }
            applied.at_zero &= acts.abs() <= APPLIED_WITHIN_NM;
            applied.arrived &= (reading.now_nm - state.offset_nm).abs() <= APPLIED_WITHIN_NM;
            applied.not_taken |= state.is_lost(step.now, reading);
        }
        applied.arrived &= !applied.limited;
        (goals, applied)
    }
}

impl State {
    /// Takes the offset that acts as the base when LinuxCNC has taken a new reference with it.
    fn follow_reference(&mut self, reading: &JointReading) {
        if !reading.reference_nm.is_finite() || !reading.now_nm.is_finite() {
            return;
        }
        let before = self.reference_nm.replace(reading.reference_nm);
        if before.is_some_and(|before| (before - reading.reference_nm).abs() > SAME_NM) {
            self.base_nm = reading.now_nm;
            self.offset_nm = reading.now_nm;
        }
    }

    /// Keeps the offset that acts when the machine is no longer ready, on whatever way it is to its goal.
    fn hold(&mut self, follows: bool, reading: &JointReading) {
        if self.follows && !follows && reading.now_nm.is_finite() {
            self.offset_nm = reading.now_nm;
        }
        self.follows = follows;
    }

    /// Returns by how much the goal is changed now, in nanometres: in every other step, while it stands above the offset.
    fn kick(&mut self, reading: &JointReading) -> f64 {
        let (before_nm, was_kicked) = self.given;
        let stands = (self.offset_nm - before_nm).abs() <= SAME_NM;
        let is_kicked = stands && !was_kicked && self.offset_nm - reading.now_nm > SAME_NM;
        self.given = (self.offset_nm, is_kicked);
        match (is_kicked, self.offset_nm > self.base_nm) {
            (false, _) => 0.0,
            (true, true) => -KICK_NM,
            (true, false) => KICK_NM,
        }
    }

    /// Returns whether `moveoff` leaves the offset where it is, off its goal, or moves it away from there.
    fn is_lost(&mut self, now: Duration, reading: &JointReading) -> bool {
        let is_off = (reading.now_nm - self.offset_nm).abs() > APPLIED_WITHIN_NM;
        if !self.follows || !is_off {
            self.stands = None;
            return false;
        }
        let (at_nm, since) = *self.stands.get_or_insert((reading.now_nm, now));
        let towards = (self.offset_nm - at_nm).signum();
        if (reading.now_nm - at_nm) * towards > MOVED_NM {
            self.stands = Some((reading.now_nm, now));
            return false;
        }
        now.saturating_sub(since) >= LOST_AFTER
    }
}

/// Returns the offset with which the drive stays within the joint's limits; a command beyond them is LinuxCNC's affair.
fn within_limits(goal_nm: f64, joint: &JointSettings, reading: &JointReading) -> f64 {
    if !reading.command_nm.is_finite() {
        return goal_nm;
    }
    let [low, high] = joint.limits_nm.map(|limit| limit - reading.command_nm);
    // Not `clamp`, which panics where the limits are none.
    goal_nm.max(low.min(0.0)).min(high.max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    const JOINT: JointSettings = JointSettings {
        number: 0,
        axis: 2,
        limits_nm: [-50e6, 50e6],
        mm_per_s: 1.2,
        mm_per_s2: 200.0,
    };

    /// A joint whose `moveoff` is at its goal at once.
    struct World {
        offsets: JointOffsets,
        reading: JointReading,
        applied: Applied,
        goal: JointGoal,
        ms: u64,
        /// `moveoff` covers this share of the way to its goal in a step.
        share: f64,
    }

    impl World {
        fn new() -> Self {
            let (offsets, goal) = (JointOffsets::default(), JointGoal::default());
            let reading = JointReading::default();
            Self { offsets, reading, applied: Applied::NOTHING, goal, ms: 0, share: 1.0 }
        }

        fn step(&mut self, ready: bool, z_nm: Option<i32>) -> f64 {
            let (mut joints, mut readings) =
                ([None; MAX_JOINTS], [JointReading::default(); MAX_JOINTS]);
            (joints[3], readings[3]) = (Some(JOINT), self.reading);
            self.ms += 1;
            let now = Duration::from_millis(self.ms);
            let goal_nm = z_nm.map(|z| [7, 8, z]);
            let step = Step { now, ready, goal_nm, max_nm: [0, 0, 100_000] };
            let (goals, applied) = self.offsets.step(&step, &joints, &readings);
            (self.goal, self.applied) = (goals[3], applied);
            self.reading.now_nm += self.share * (goals[3].offset_nm - self.reading.now_nm);
            goals[3].offset_nm
        }
    }

    #[test]
    fn an_offset_is_held_while_the_machine_is_off_or_the_bridge_silent() {
        let mut world = World::new();
        assert_eq!(world.step(true, Some(40_000)), 40_000.0);
        assert_eq!(world.step(true, Some(40_000)), 40_000.0);
        assert!(world.applied.arrived && world.applied.nm == [0.0, 0.0, 40_000.0]);
        assert_eq!(world.step(false, Some(0)), 40_000.0);
        assert_eq!(world.step(true, None), 40_000.0);
        world.reading.homing = true;
        assert_eq!(world.step(true, Some(0)), 40_000.0);
        world.reading.homing = false;
        assert_eq!(world.step(true, Some(-1_000)), -1_000.0);
    }

    #[test]
    fn the_offset_that_acted_at_homing_stays_under_those_that_follow() {
        let mut world = World::new();
        world.step(true, Some(40_000));
        world.step(true, Some(40_000));
        // The switch is found 40 um later by the feedback without the offset.
        world.reading.reference_nm -= 40_000.0;
        world.step(false, Some(40_000));
        assert!(world.applied.at_zero, "counted from the new reference nothing acts");
        assert_eq!(world.step(true, Some(40_000)), 80_000.0);
        assert_eq!((world.goal.min_nm, world.goal.max_nm), (-60_000.0, 140_000.0));
        world.step(true, Some(40_000));
        assert_eq!(world.applied.nm[2], 40_000.0);
        // The drive is where it was at the first homing: base + reference are the same.
        assert_eq!(world.goal.offset_nm + world.reading.reference_nm, 40_000.0);
    }

    #[test]
    fn the_drive_stays_within_the_joints_limits() {
        let mut world = World::new();
        for (command_nm, goal, allowed) in [
            (49_990e3, 40_000, 10_000.0),
            (-50e6, -40_000, 0.0),
            (-50e6, 40_000, 40_000.0),
            // Beyond the limit already: LinuxCNC has to bring it back, and no offset hurries it.
            (50_001e3, 40_000, 0.0),
            (50_001e3, -40_000, -40_000.0),
        ] {
            world.reading.command_nm = command_nm;
            assert_eq!(world.step(true, Some(goal)), allowed, "{command_nm}");
            assert_eq!(world.applied.limited, allowed != f64::from(goal));
        }
    }

    #[test]
    fn a_component_that_starts_again_goes_on_where_moveoff_stands() {
        let mut world = World::new();
        let left = JointGoal { offset_nm: 80_000.0, min_nm: -60_000.0, max_nm: 140_000.0 };
        world.offsets.resume(3, left);
        // Its pins are connected one after the other.
        world.reading = JointReading::not_wired();
        assert_eq!(world.step(true, Some(0)), 80_000.0);
        assert!(!world.applied.at_zero && !world.applied.arrived, "nobody knows what acts");
        world.reading =
            JointReading { now_nm: 80_000.0, reference_nm: -5e6, ..JointReading::default() };
        assert_eq!(world.step(true, None), 80_000.0);
        assert_eq!((world.goal.min_nm, world.goal.max_nm), (-60_000.0, 140_000.0));
        assert_eq!(world.applied.nm[2], 40_000.0);
        assert_eq!(world.step(true, Some(0)), 40_000.0);
    }

    #[test]
    fn held_is_the_offset_that_acts_and_not_its_goal() {
        for is_homing in [false, true] {
            let mut world = World::new();
            world.share = 0.25;
            world.step(true, Some(40_000));
            world.reading.homing = is_homing;
            // A quarter of the way acts.
            assert_eq!(world.step(is_homing, Some(40_000)), 10_000.0, "{is_homing}");
            assert_eq!(world.step(is_homing, Some(40_000)), 10_000.0, "{is_homing}");
            world.reading.homing = false;
            assert_eq!(world.step(true, Some(40_000)), 40_000.0, "{is_homing}");
        }
    }

    /// `moveoff` at rest, with an acceleration of 200 nm a cycle², as LinuxCNC 2.9 computes.
    struct Limiter {
        goal_nm: f64,
        now_nm: f64,
        speed: f64,
    }

    impl Limiter {
        fn step(&mut self, goal_nm: f64) {
            const STEP: f64 = 200.0;
            let stands = self.goal_nm.to_bits() == goal_nm.to_bits();
            let to_go = goal_nm - self.now_nm;
            self.goal_nm = goal_nm;
            self.speed = if stands && to_go > STEP && self.speed <= 0.0 {
                // The fault: down, and to rest again.
                if self.speed == 0.0 { -STEP } else { 0.0 }
            } else {
                to_go.clamp(self.speed - STEP, self.speed + STEP).clamp(-1_200.0, 1_200.0)
            };
            self.now_nm += self.speed;
        }
    }

    #[test]
    fn moveoff_reaches_a_goal_above_it_from_rest_also_while_the_offset_is_held() {
        for (goal, ready) in [(40_000, true), (-30_000, true), (100_000, true), (-30_000, false)] {
            let mut world = World::new();
            world.reading.now_nm = -30_000.0;
            world.step(true, Some(goal));
            let at = if ready { -99_000.0 } else { -30_000.0 };
            world.reading.now_nm = at;
            world.step(ready, Some(goal));
            // It has overshot, and is at rest below.
            let mut moveoff = Limiter { goal_nm: f64::from(goal), now_nm: -99_000.0, speed: 0.0 };
            let mut least = 0.0_f64;
            for _ in 0..2_000 {
                world.share = 0.0;
                world.reading.now_nm = moveoff.now_nm;
                let goal_nm = world.step(ready, Some(goal));
                moveoff.step(goal_nm);
                least = least.min(moveoff.now_nm);
            }
            assert!(
                (moveoff.now_nm - f64::from(goal)).abs() <= 2.0 * KICK_NM,
                "{goal} {}",
                moveoff.now_nm
            );
            assert!(least >= -99_400.0, "it went the wrong way: {least} nm");
        }
    }

    #[test]
    fn an_offset_that_goes_away_from_its_goal_is_not_taken() {
        let mut world = World::new();
        world.share = 0.0;
        let steps = (0..3_000).find(|_| {
            world.step(true, Some(40_000));
            world.reading.now_nm -= 100.0;
            world.applied.not_taken
        });
        assert_eq!(steps, Some(1_000));
    }

    #[test]
    fn an_offset_that_moveoff_does_not_move_is_not_taken() {
        let mut world = World::new();
        world.share = 0.0;
        let steps = (0..3_000).find(|_| {
            world.step(true, Some(40_000));
            world.applied.not_taken
        });
        assert_eq!(steps, Some(1_000));
        world.step(false, Some(40_000));
        assert!(!world.applied.not_taken, "held is no way to go");
        // Slow is not lost.
        let mut world = World::new();
        world.share = 1e-4;
        assert!((0..5_000).all(|_| {
            world.step(true, Some(40_000));
            !world.applied.not_taken
        }));
        world.share = 1.0;
        for _ in 0..3_000 {
            world.step(true, Some(40_000));
        }
        assert!(world.applied.arrived && !world.applied.not_taken);
    }
}
