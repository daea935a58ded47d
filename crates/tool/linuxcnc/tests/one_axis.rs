//! One axis against LinuxCNC's planner: whatever happens, no step is larger than the slew limit
//! allows, and what was asked for is reached in the end.
//!
//! [`Motion`] is one axis of LinuxCNC's motion controller as far as external offsets go, after
//! `axis.c`, `control.c` and `simple_tp.c` of 2.9. The real one is tried in `host-tests`.

use std::time::Duration;

use proptest::prelude::*;
use trueup_linuxcnc::offset_follower::{AxisReading, OffsetFollower, RateLimits};

const CYCLE_S: f64 = 1e-3;

/// Lengths in nanometres.
#[derive(Clone, Debug)]
struct Motion {
    on: bool,
    homed: bool,
    /// Coordinated or teleop mode; in joint mode the offset stands.
    moves: bool,
    /// Where the axis is sent, and the axis' soft limit.
    position: f64,
    limit: f64,
    request: f64,
    offset: f64,
    speed: f64,
    counts_before: i32,
    top_speed: f64,
    acceleration: f64,
}

impl Motion {
    fn new(top_speed: f64, acceleration: f64, counts: i32) -> Self {
        Self {
            on: true,
            homed: true,
            moves: true,
            position: 0.0,
            limit: 1e12,
            request: 0.0,
            offset: 0.0,
            speed: 0.0,
            counts_before: counts,
            top_speed,
            acceleration,
        }
    }

    fn switch(&mut self, on: bool) {
        if on && !self.on {
            // The joint stays where it is: its position is now all command.
            self.position += self.offset;
            (self.request, self.offset, self.speed) = (0.0, 0.0, 0.0);
        }
        self.on = on;
    }

    /// Returns one servo cycle; by how much the joint has stepped beyond its command.
    fn cycle(&mut self, counts: i32, command: f64) -> f64 {
        let joint = self.position + self.offset;
        let moved = command - self.position;
        self.position = command;
        if self.on && self.moves {
            self.plan();
            if self.position + self.offset >= self.limit && self.offset != 0.0 {
                self.offset = self.limit - self.position;
                self.speed = 0.0;
            }
        }
        let change = counts.wrapping_sub(self.counts_before);
        self.counts_before = counts;
        if self.on && self.homed {
            self.request += f64::from(change);
        }
        ((self.position + self.offset - joint).abs() - moved.abs()).max(0.0)
    }

    fn plan(&mut self) {
        let gain = self.acceleration * CYCLE_S;
        let way = self.request - self.offset;
        let rests = way.abs() <= gain * CYCLE_S * 1e-3;
        let expected = (2.0 * self.acceleration * way.abs() + gain * gain).sqrt() - gain;
        let expected = if rests { 0.0 } else { expected.copysign(way) };
        let expected = expected.clamp(-self.top_speed, self.top_speed);
        self.speed += (expected - self.speed).clamp(-gain, gain);
        self.offset += self.speed * CYCLE_S;
    }

    fn reading(&self) -> AxisReading {
        AxisReading { request_nm: self.request, eoffset_nm: self.offset }
    }
}

/// The axis and the component, each in its own time.
struct Both {
    motion: Motion,
    follower: OffsetFollower,
    counts: i32,
    pace: RateLimits,
    us: u64,
    /// The servo thread gets no time.
    stands: bool,
}

impl Both {
    fn new(pace: RateLimits, motion: Motion) -> Self {
        let counts = motion.counts_before;
        Self { motion, follower: OffsetFollower::default(), counts, pace, us: 0, stands: false }
    }

    /// One turn of the component's loop.
    fn turn(&mut self, goal: Option<i32>) {
        let now = Duration::from_micros(self.us);
        let ready = self.motion.on && self.motion.homed;
        let step = self.follower.step(now, ready, goal, self.motion.reading(), &self.pace);
        assert!(!step.not_taken || self.stands, "every step was taken");
        self.counts = self.counts.wrapping_add(step.counts);
    }

    /// Returns a servo cycle with this many turns in it.
    fn cycle(&mut self, turns: u32, goal: Option<i32>) -> f64 {
        for _ in 0..turns {
            self.us += 1_000 / u64::from(turns.max(1));
            self.turn(goal);
        }
        if turns == 0 {
            self.us += 1_000;
        }
        let command = self.motion.position;
        self.motion.cycle(self.counts, command)
    }
}

fn pace(slew_um_per_s: f64, acceleration_mm_per_s2: f64) -> RateLimits {
    RateLimits {
        slew_nm_per_s: slew_um_per_s * 1e3,
        cycle_s: CYCLE_S,
        acceleration_nm_per_s2: acceleration_mm_per_s2 * 1e6,
        planner_keeps_slew: false,
    }
}

/// Events of a stretch of cycles.
#[derive(Clone, Debug)]
enum Event {
    Goal(Option<i32>),
    Switch(bool),
    Home(bool),
    Mode(bool),
}

fn events() -> impl Strategy<Value = Vec<(Event, Vec<u32>)>> {
    let event = prop_oneof![
        3 => (-60_000..60_000_i32).prop_map(|goal| Event::Goal(Some(goal))),
        1 => Just(Event::Goal(None)),
        1 => any::<bool>().prop_map(Event::Switch),
        1 => any::<bool>().prop_map(Event::Home),
        1 => any::<bool>().prop_map(Event::Mode),
    ];
    // Turns of the loop in each cycle: hurried, regular, and stalled.
    let turns = prop::collection::vec(prop_oneof![6 => 1..4_u32, 2 => Just(0_u32)], 1..300);
    prop::collection::vec((event, turns), 1..12)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    /// `top`: what `OFFSET_AV_RATIO` permits, in slew limits. With 1, LinuxCNC itself keeps the
    /// limit, with more the component alone does.
    #[test]
    fn no_step_is_larger_than_the_slew_limit_allows_and_the_goal_is_reached(
        events in events(),
        counts in prop_oneof![any::<i32>(), Just(i32::MAX), Just(i32::MIN)],
        slew in prop_oneof![Just(20.0), Just(500.0), Just(1000.0)],
        acceleration in prop_oneof![Just(5.0), Just(50.0), Just(500.0)],
        top in prop_oneof![Just(1.0), Just(40.0)],
    ) {
        let pace = RateLimits { planner_keeps_slew: top <= 1.0, ..pace(slew, acceleration) };
        let motion = Motion::new(slew * 1e3 * top, acceleration * 1e6, counts);
        let mut both = Both::new(pace, motion);
        let most = pace.max_step_counts();
        let mut goal = Some(0);
        for (event, turns) in &events {
            match *event {
                Event::Goal(new) => goal = new,
                Event::Switch(on) => both.motion.switch(on),
                Event::Home(homed) => both.motion.homed = homed,
                Event::Mode(moves) => both.motion.moves = moves,
            }
            for &turns in turns {
                let step = both.cycle(turns, goal);
                prop_assert!(step <= most + 1e-3, "{step} of {most} nm");
            }
        }
        both.motion.switch(true);
        both.motion.homed = true;
        both.motion.moves = true;
        // A whole turn round at the limit, and then some for the planner to settle.
        let cycles = (130_000.0 / pace.max_step_counts()) as u32 * 3 + 1_500;
        for _ in 0..cycles {
            let step = both.cycle(2, Some(31_234));
            prop_assert!(step <= most + 1e-3, "{step} of {most} nm");
        }
        let off = (both.motion.offset - 31_234.0).abs();
        prop_assert!(off <= 2.0, "{off} nm off: {:?}", both.motion);
    }
}

#[test]
fn the_pace_is_kept_at_two_turns_a_cycle_and_the_counts_wrap_unnoticed() {
    let pace = pace(500.0, 50.0);
    let motion = Motion::new(20e6, 50e6, i32::MAX - 9_999);
    let mut both = Both::new(pace, motion);
    let mut cycles = 0;
    while (both.motion.offset - 40_000.0).abs() > 1.0 {
        assert!(both.cycle(2, Some(40_000)) <= pace.max_step_counts() + 1e-3);
        cycles += 1;
        assert!(cycles < 300, "{:?}", both.motion);
    }
    // 40 µm at 500 µm/s are 80 cycles, 50 are waited at first.
    println!("40 um in {cycles} servo cycles; the counts went on to {}", both.counts);
    assert!(both.counts < 0 && cycles < 160);
}

#[test]
fn an_offset_that_the_soft_limit_has_held_back_does_not_hurry_afterwards() {
    let pace = pace(500.0, 50.0);
    let mut both = Both::new(pace, Motion::new(20e6, 50e6, 0));
    for _ in 0..400 {
        both.cycle(2, Some(40_000));
    }
    both.motion.limit = 1e6;
    let mut largest = 0.0_f64;
    let mut command = 0.0;
    for cycle in 0..2_000 {
        command = if cycle < 500 {
            (command + 10_000.0_f64).min(990_000.0)
        } else {
            (command - 10_000.0).max(500_000.0)
        };
        both.us += 500;
        both.turn(Some(40_000));
        both.us += 500;
        both.turn(Some(40_000));
        let step = both.motion.cycle(both.counts, command);
        assert!(both.motion.position + both.motion.offset <= 1e6 + 1e-3, "beyond the limit");
        largest = largest.max(step);
    }
    println!("the largest step is {largest:.1} of {} nm", pace.max_step_counts());
    assert!(largest <= pace.max_step_counts() + 1e-3, "{largest} nm");
    assert!((both.motion.offset - 40_000.0).abs() < 2.0, "{:?}", both.motion);
}

#[test]
fn a_servo_thread_that_stood_for_seconds_finds_one_step_and_is_followed_again() {
    let pace = pace(500.0, 50.0);
    // It wakes at every phase of what the component does meanwhile.
    for stood_ms in (0..6_000).step_by(37) {
        let mut both = Both::new(pace, Motion::new(20e6, 50e6, 0));
        for _ in 0..90 {
            both.cycle(2, Some(40_000));
        }
        both.stands = true;
        for ms in 0..stood_ms {
            both.us += 1_000;
            // Meanwhile the goal goes on.
            both.turn(Some(40_000 + ms));
        }
        let mut cycles = 0;
        while (both.motion.offset - 31_000.0).abs() > 1.0 {
            let before = both.motion.request;
            both.cycle(2, Some(31_000));
            let requested = (both.motion.request - before).abs();
            assert!(
                requested <= pace.max_step_counts() + 1e-3,
                "{requested} nm at once after {stood_ms} ms"
            );
            cycles += 1;
            // It is left alone for a little after a step was taken back.
            both.stands = cycles < 60;
            assert!(cycles < 2_000, "after {stood_ms} ms {:?}", both.motion);
        }
    }
}

#[test]
fn a_component_whose_pins_are_not_connected_reports_it_and_is_never_more_than_a_step_off() {
    let pace = pace(500.0, 50.0);
    let mut follower = OffsetFollower::default();
    let (mut written, mut tries, mut not_taken) = (0_i32, 0, false);
    for ms in 0..20_000 {
        let now = Duration::from_millis(ms);
        let step = follower.step(now, true, Some(40_000), AxisReading::default(), &pace);
        written += step.counts;
        tries += i32::from(step.counts != 0);
        not_taken = step.not_taken;
        assert!(written.abs() <= 500, "{written} counts");
    }
    assert!(not_taken && tries > 20, "it goes on trying: {tries}");
    // They are connected: the next step is taken.
    let mut both = Both::new(pace, Motion::new(20e6, 50e6, written));
    (both.follower, both.us, both.stands) = (follower, 20_000_000, true);
    for _ in 0..1_200 {
        both.cycle(2, Some(40_000));
    }
    both.stands = false;
    for _ in 0..200 {
        both.cycle(2, Some(40_000));
    }
    assert!((both.motion.offset - 40_000.0).abs() < 2.0, "{:?}", both.motion);
}
