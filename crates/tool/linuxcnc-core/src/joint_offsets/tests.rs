//! Goals of joints, tried on machines that follow at once, in part, or not.

use super::*;

const JOINT: JointSettings =
    JointSettings { number: 0, axis: 2, limits_nm: [-50e6, 50e6], mm_per_s: 1.2, mm_per_s2: 200.0 };

/// A joint whose `moveoff` is at its goal at once.
struct World {
    offsets: JointOffsets,
    reading: JointReading,
    applied: AppliedOffsets,
    goal: JointGoal,
    ms: u64,
    /// `moveoff` covers this share of the way to its goal in a step.
    share: f64,
}

impl World {
    fn new() -> Self {
        let (offsets, goal) = (JointOffsets::default(), JointGoal::default());
        let reading = JointReading::default();
        Self { offsets, reading, applied: AppliedOffsets::ZERO, goal, ms: 0, share: 1.0 }
    }

    fn step(&mut self, ready: bool, z_nm: Option<i32>) -> f64 {
        let (mut joints, mut readings) =
            ([None; MAX_JOINTS], [JointReading::default(); MAX_JOINTS]);
        (joints[3], readings[3]) = (Some(JOINT), self.reading);
        self.ms += 1;
        let now = Duration::from_millis(self.ms);
        let goal_nm = z_nm.map(|z| [7, 8, z]);
        let step = StepInputs { now, ready, goal_nm, max_nm: [0, 0, 100_000] };
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
    let left =
        JointGoal { offset_nm: 80_000.0, min_nm: -60_000.0, max_nm: 140_000.0, reference_nm: -5e6 };
    world.offsets.resume(3, left);
    // Its pins are connected one after the other.
    world.reading = JointReading::unconnected();
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
fn a_component_that_starts_with_the_machine_off_moves_nothing() {
    let mut world = World::new();
    let left = JointGoal { offset_nm: 80_000.0, ..JointGoal::default() };
    world.offsets.resume(3, left);
    // moveoff was stopped half way.
    world.reading = JointReading { now_nm: 40_000.0, ..JointReading::default() };
    assert_eq!(world.step(false, Some(80_000)), 40_000.0);
    assert_eq!(world.step(true, None), 40_000.0, "the bridge has sent nothing");
    assert_eq!(world.step(true, Some(80_000)), 80_000.0);
}

#[test]
fn a_joint_that_was_homed_while_no_component_was_there_has_its_base() {
    let mut world = World::new();
    world.reading.reference_nm = -5e6;
    world.step(true, Some(40_000));
    world.step(true, Some(40_000));
    assert_eq!(world.goal.reference_nm, -5e6);
    // The next one finds another reference: it contains the 40 um that moveoff holds.
    let left = world.goal;
    world.offsets = JointOffsets::default();
    world.offsets.resume(3, left);
    let there = world.reading;
    world.reading = JointReading::unconnected();
    world.step(true, Some(40_000));
    assert_eq!(world.goal.reference_nm, -5e6, "kept until the wires are there");
    world.reading = JointReading { reference_nm: -5.04e6, ..there };
    assert_eq!(world.step(true, Some(40_000)), 80_000.0);
    assert_eq!((world.goal.min_nm, world.goal.max_nm), (-60_000.0, 140_000.0));
    assert_eq!(world.goal.reference_nm, -5.04e6);
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
            (moveoff.now_nm - f64::from(goal)).abs() <= 2.0 * DITHER_AMPLITUDE_NM,
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
