//! One tick of the bridge: a millisecond of samples in, one offset out.
//!
//! ```text
//! codes ─► health ─► filter ─► elongation ─► along the tool ─► minus the reference ─► limits ─► offset
//!                                                                                      ▲
//! Control, Spindle ────────────────────────────────────────────────► engaged? held? ───┘
//! ```
//!
//! What the offset follows is decided in one place ([`Bridge::tick`]):
//!
//! | the CNC | the sensor | offset | quality |
//! |---|---|---|---|
//! | engages | fresh | −(error − reference), at the slew limit | live |
//! | engages, or was lost while engaged | either is lost | as it is, for `hold_ms` | hold |
//! | the same, after `hold_ms` | | to 0, at the slew limit | ramping out |
//! | does not engage, or is not referenced | | to 0, at the slew limit | ramping out |
//! | any of these, offset arrived at 0 | believable | 0 | off |
//! | any of these, offset arrived at 0 | faulty or missing | none | fault |
//!
//! Lost and returned is no jump: every way back goes through the slew limit.

use crate::{
    calibration::Calibration,
    cnc::{Command, Control, Flags, Output, Quality, Spindle},
    filter::{CODES_PER_TICK, Filter},
    health::{Health, Noise},
    limits::{Applied, Met},
    units::{Code, Millis, Nanometres, Rpm},
};

/// Without samples for so long the converter counts as stopped, and a reading as stale.
pub const SAMPLES_TIMEOUT_MS: u32 = 20;

/// What the bridge knows of the machine.
#[derive(Clone, Debug)]
pub struct Bridge {
    calibration: Calibration,
}

/// What one tick brings.
#[derive(Clone, Copy, Debug)]
pub struct Input<'a> {
    /// A millisecond of conversions; `None` where none came.
    pub codes: Option<&'a [Code; CODES_PER_TICK]>,
    /// The spindle speed as the board knows it; a fresh one from the CNC wins.
    pub speed: Option<Rpm>,
}

/// What the bridge remembers from tick to tick.
#[derive(Clone, Debug, Default)]
pub struct State {
    now: Millis,
    health: Health,
    filter: Filter,
    control: Heard<Control>,
    spindle: Heard<Spindle>,
    /// Whether the CNC was ever heard: silence is a loss only after that.
    cnc_known: bool,
    codes_age: Age,
    elongation: Option<Nanometres>,
    elongation_age: Age,
    believable: bool,
    reference: Nanometres,
    /// How long ago the offset was last live; `None` if it is not to be held.
    live_age: Option<Age>,
    applied: Applied,
}

/// Milliseconds since something happened; stays at its largest value, where it also begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Age(u32);

impl Default for Age {
    fn default() -> Self {
        Self(u32::MAX)
    }
}

impl Age {
    fn grow(&mut self, elapsed_ms: u32) {
        self.0 = self.0.saturating_add(elapsed_ms);
    }
}

/// The last message of a kind, with its age, until it is too old.
#[derive(Clone, Copy, Debug)]
struct Heard<T>(Option<(T, Age)>);

impl<T> Default for Heard<T> {
    fn default() -> Self {
        Self(None)
    }
}

impl<T: Copy> Heard<T> {
    fn value(&self) -> Option<T> {
        self.0.map(|(value, _)| value)
    }

    fn hear(&mut self, value: T) {
        self.0 = Some((value, Age(0)));
    }

    fn grow(&mut self, elapsed_ms: u32, timeout_ms: u32) {
        if let Some((_, age)) = &mut self.0 {
            age.grow(elapsed_ms);
            if age.0 > timeout_ms {
                self.0 = None;
            }
        }
    }
}

/// Where the offset is to go.
enum Course {
    Follow,
    Hold,
    RampOut,
}

impl State {
    /// The time of the last tick.
    #[must_use]
    pub fn now(&self) -> Millis {
        self.now
    }

    /// The newest elongation, before reference and limits.
    #[must_use]
    pub fn elongation(&self) -> Option<Nanometres> {
        self.elongation
    }

    /// The noise of the raw codes since the last call.
    pub fn take_noise(&mut self) -> Noise {
        self.health.take_noise()
    }
}

impl Bridge {
    /// A bridge for this machine.
    #[must_use]
    pub const fn new(calibration: Calibration) -> Self {
        Self { calibration }
    }

    /// Takes a valid message of the CNC. It counts from now on, that is from the last tick.
    pub fn hear(&self, state: &mut State, command: Command) {
        match command {
            Command::Control(control) => {
                // The edge of `Zero` needs a `Control` before it: a CNC that starts with the bit
                // already set has asked for nothing.
                let was = state.control.value();
                if control.zero && was.is_some_and(|was| !was.zero) && state.sensor_is_fresh() {
                    state.reference = state.elongation.unwrap_or(state.reference);
                }
                state.control.hear(control);
                state.cnc_known = true;
            }
            Command::Spindle(spindle) => state.spindle.hear(spindle),
        }
    }

    /// One tick: `now` is the time at its end.
    pub fn tick(&self, state: &mut State, now: Millis, input: Input) -> Output {
        let limits = &self.calibration.limits;
        let elapsed_ms = now.since(state.now);
        state.now = now;
        state.grow_older(elapsed_ms, limits.link_timeout_ms);

        let speed = state.spindle.value().map(|spindle| spindle.speed).or(input.speed);
        if let Some(codes) = input.codes {
            self.sense(state, codes, speed);
        }

        let course = state.course(limits.hold_ms);
        let met = match course {
            Course::Follow => state.applied.step(limits, self.target(state), elapsed_ms),
            // What is applied is held; it does not travel on to where it was going.
            Course::Hold => Met::default(),
            Course::RampOut => state.applied.step(limits, [Nanometres::ZERO; 3], elapsed_ms),
        };

        let missing = state.codes_age.0 > SAMPLES_TIMEOUT_MS;
        let faulty = missing || !state.believable;
        let quality = match course {
            Course::Follow => Quality::Live,
            Course::Hold => Quality::Hold,
            Course::RampOut if !state.applied.is_zero() => Quality::RampingOut,
            Course::RampOut if faulty => Quality::Fault,
            Course::RampOut => Quality::Off,
        };
        let flags = Flags::NONE
            .with_if(met.clamp, Flags::CLAMPED)
            .with_if(met.slew, Flags::SLEWING)
            .with_if(!missing && !state.believable, Flags::SENSOR_FAULT)
            .with_if(missing, Flags::SAMPLES_MISSING)
            .with_if(state.cnc_known && state.control.value().is_none(), Flags::CNC_LOST)
            .with_if(speed.is_none(), Flags::SPEED_UNKNOWN);
        Output {
            offset: (quality != Quality::Fault).then(|| state.applied.offset()),
            quality,
            flags,
            age_ms: u8::try_from(state.elongation_age.0).unwrap_or(u8::MAX),
        }
    }

    /// Codes to elongation.
    fn sense(&self, state: &mut State, codes: &[Code; CODES_PER_TICK], speed: Option<Rpm>) {
        state.codes_age = Age(0);
        let clean = state.health.check(codes);
        state.believable = clean.is_some();
        match clean {
            None => state.filter.clear(),
            Some(clean) => {
                if let Some(reading) = state.filter.tick(&clean, speed) {
                    state.elongation = Some(self.calibration.sensor.elongation(reading));
                    state.elongation_age = Age(0);
                }
            }
        }
    }

    /// The offset that undoes the error: minus the elongation since the reference, along the tool.
    fn target(&self, state: &State) -> [Nanometres; 3] {
        let elongation = state.elongation.unwrap_or(state.reference);
        let since_reference = i64::from(elongation.0).saturating_sub(i64::from(state.reference.0));
        let error = self.calibration.tool_direction.error(Nanometres::saturating(since_reference));
        error.map(Nanometres::opposite)
    }
}

impl State {
    fn grow_older(&mut self, elapsed_ms: u32, link_timeout_ms: u32) {
        self.control.grow(elapsed_ms, link_timeout_ms);
        self.spindle.grow(elapsed_ms, link_timeout_ms);
        self.codes_age.grow(elapsed_ms);
        self.elongation_age.grow(elapsed_ms);
        if let Some(age) = &mut self.live_age {
            age.grow(elapsed_ms);
        }
    }

    fn sensor_is_fresh(&self) -> bool {
        self.elongation.is_some() && self.believable && self.elongation_age.0 <= SAMPLES_TIMEOUT_MS
    }

    /// Decides where the offset goes, and remembers when it was last live.
    fn course(&mut self, hold_ms: u32) -> Course {
        let control = self.control.value();
        if control.is_some_and(|control| !(control.engage && control.referenced)) {
            self.live_age = None;
        } else if control.is_some() && self.sensor_is_fresh() {
            self.live_age = Some(Age(0));
            return Course::Follow;
        } else if self.live_age.is_some_and(|age| age.0 <= hold_ms) {
            return Course::Hold;
        }
        Course::RampOut
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        limits::Limits,
        sensor::{SensorLaw, Slope},
        tool::Direction,
        units::Reading,
    };

    /// 1024 nm a code exactly, zero at code 1000, 1 µm in a millisecond.
    const CALIBRATION: Calibration = Calibration {
        sensor: SensorLaw { k0: Nanometres(0), zero: Reading(1000 << 10), slope: Slope(1 << 28) },
        tool_direction: Direction::DOWN,
        limits: Limits {
            max: [Nanometres(200_000), Nanometres(200_000), Nanometres(500_000)],
            slew_nm_per_s: 1_000_000,
            link_timeout_ms: 500,
            hold_ms: 2_000,
        },
    };
    const ENGAGED: Control = Control { engage: true, referenced: true, zero: false };

    /// A bridge with the hand that feeds it.
    struct Rig {
        bridge: Bridge,
        state: State,
        now: Millis,
        last: Output,
    }

    impl Rig {
        fn new(calibration: Calibration) -> Self {
            Self {
                bridge: Bridge::new(calibration),
                state: State::default(),
                now: Millis(0),
                last: Output::default(),
            }
        }

        fn control(&mut self, control: Control) {
            self.bridge.hear(&mut self.state, Command::Control(control));
        }

        fn tick(&mut self, codes: Option<[Code; CODES_PER_TICK]>) -> Output {
            self.now = self.now.after(1);
            let input = Input { codes: codes.as_ref(), speed: Some(Rpm(24_000)) };
            self.last = self.bridge.tick(&mut self.state, self.now, input);
            self.last
        }

        /// Codes that are alive but average to `code`.
        fn run(&mut self, ms: u32, code: u16) -> Output {
            for _ in 0..ms {
                let codes = core::array::from_fn(|n| match n % 4 {
                    0 => Code(code - 1),
                    2 => Code(code + 1),
                    _ => Code(code),
                });
                self.tick(Some(codes));
            }
            self.last
        }

        /// The same, with a `Control` every 20 ms.
        fn run_engaged(&mut self, ms: u32, code: u16) -> Output {
            for n in 0..ms {
                if n % 20 == 0 {
                    self.control(ENGAGED);
                }
                self.run(1, code);
            }
            self.last
        }

        fn z_nm(&self) -> i32 {
            self.last.offset.expect("available")[2].0
        }
    }

    #[test]
    fn a_spindle_that_grows_is_lifted() {
        let mut rig = Rig::new(CALIBRATION);
        // 50 codes are 51.2 µm of growth: the tool tip is too low, the offset goes up.
        let output = rig.run_engaged(200, 1050);
        assert_eq!(output.quality, Quality::Live);
        assert_eq!(output.offset, Some([Nanometres(0), Nanometres(0), Nanometres(51_200)]));
        assert_eq!(output.flags, Flags::NONE);
        assert_eq!(output.age_ms, 0);
    }

    #[test]
    fn nothing_is_engaged_before_the_first_control() {
        let mut rig = Rig::new(CALIBRATION);
        let output = rig.run(5_000, 1050);
        assert_eq!((output.quality, output.offset), (Quality::Off, Some([Nanometres(0); 3])));
        assert!(!output.flags.contains(Flags::CNC_LOST), "what was never there is not lost");
    }

    #[test]
    fn it_takes_both_engage_and_referenced() {
        for (engage, referenced) in [(true, false), (false, true), (false, false)] {
            let mut rig = Rig::new(CALIBRATION);
            for _ in 0..20 {
                rig.control(Control { engage, referenced, zero: false });
                rig.run(20, 1050);
            }
            assert_eq!(rig.last.quality, Quality::Off);
            assert_eq!(rig.z_nm(), 0);
        }
    }

    #[test]
    fn engaging_and_disengaging_ramp_at_the_slew_limit_and_say_so() {
        let mut rig = Rig::new(CALIBRATION);
        rig.run(100, 1050);
        let mut before = 0;
        for ms in 1..=52 {
            rig.run_engaged(1, 1050);
            assert!((rig.z_nm() - before).abs() <= 1_000, "at {ms} ms");
            assert_eq!(rig.last.flags.contains(Flags::SLEWING), ms < 52);
            before = rig.z_nm();
        }
        assert_eq!(before, 51_200);
        rig.control(Control { engage: false, ..ENGAGED });
        for left in (0..=51).rev() {
            rig.run(1, 1050);
            assert_eq!(
                rig.last.quality,
                if left > 0 || rig.z_nm() > 0 { Quality::RampingOut } else { Quality::Off }
            );
        }
        assert_eq!((rig.z_nm(), rig.last.quality), (0, Quality::Off));
    }

    #[test]
    fn a_silent_cnc_is_lost_after_500_ms_held_for_2_s_and_ramped_out() {
        let mut rig = Rig::new(CALIBRATION);
        rig.run_engaged(200, 1050);
        rig.control(ENGAGED);
        rig.run(500, 1050);
        assert_eq!(rig.last.quality, Quality::Live);
        rig.run(1, 1050);
        assert_eq!(rig.last.quality, Quality::Hold);
        assert!(rig.last.flags.contains(Flags::CNC_LOST));
        // While it is held the spindle may grow as it likes.
        rig.run(1_999, 1090);
        assert_eq!((rig.last.quality, rig.z_nm()), (Quality::Hold, 51_200));
        rig.run(1, 1090);
        assert_eq!((rig.last.quality, rig.z_nm()), (Quality::RampingOut, 50_200));
        rig.run(60, 1090);
        assert_eq!((rig.last.quality, rig.z_nm()), (Quality::Off, 0));
        assert!(rig.last.flags.contains(Flags::CNC_LOST));
        // It comes back: no jump.
        rig.run_engaged(1, 1090);
        assert_eq!((rig.last.quality, rig.z_nm()), (Quality::Live, 1_000));
        assert!(!rig.last.flags.contains(Flags::CNC_LOST));
    }

    #[test]
    fn a_broken_wire_holds_then_ramps_out_then_is_not_available() {
        let mut rig = Rig::new(CALIBRATION);
        rig.run_engaged(200, 1050);
        for ms in 1..=2_100_u32 {
            if ms % 20 == 0 {
                rig.control(ENGAGED);
            }
            let before = rig.last.offset.map_or(0, |offset| offset[2].0);
            rig.tick(Some([Code(0); CODES_PER_TICK]));
            let after = rig.last.offset.map_or(0, |offset| offset[2].0);
            assert!((after - before).abs() <= 1_000, "a jump at {ms} ms");
            assert!(rig.last.flags.contains(Flags::SENSOR_FAULT));
            if ms <= 2_000 {
                assert_eq!((rig.last.quality, after), (Quality::Hold, 51_200), "at {ms} ms");
            }
        }
        assert_eq!((rig.last.quality, rig.last.offset), (Quality::Fault, None));
        assert_eq!(rig.last.age_ms, 255);
        // The wire is mended: 10 ms of good codes and a full filter later it ramps in again.
        rig.run_engaged(13, 1050);
        assert_ne!(rig.last.quality, Quality::Live);
        rig.run_engaged(1, 1050);
        assert_eq!((rig.last.quality, rig.z_nm()), (Quality::Live, 1_000));
        rig.run_engaged(60, 1050);
        assert_eq!(rig.z_nm(), 51_200);
    }

    #[test]
    fn missing_samples_are_flagged_held_and_end_in_not_available() {
        let mut rig = Rig::new(CALIBRATION);
        rig.run_engaged(200, 1050);
        let mut hold_ends = 0;
        for ms in 1..=2_200_u32 {
            rig.control(ENGAGED);
            rig.tick(None);
            assert_eq!(rig.last.flags.contains(Flags::SAMPLES_MISSING), ms > SAMPLES_TIMEOUT_MS);
            if rig.last.quality == Quality::Hold {
                hold_ends = ms;
            }
        }
        assert_eq!(hold_ends, SAMPLES_TIMEOUT_MS + 2_000);
        assert_eq!((rig.last.quality, rig.last.offset), (Quality::Fault, None));
    }

    #[test]
    fn a_board_without_samples_is_not_available_from_the_first_tick() {
        let mut rig = Rig::new(CALIBRATION);
        let output = rig.tick(None);
        assert_eq!((output.quality, output.offset), (Quality::Fault, None));
        assert_eq!((output.flags, output.age_ms), (Flags::SAMPLES_MISSING, 255));
    }

    #[test]
    fn zero_takes_the_present_growth_as_reference_by_a_ramp() {
        let mut rig = Rig::new(CALIBRATION);
        rig.run_engaged(200, 1050);
        rig.control(Control { zero: true, ..ENGAGED });
        rig.run(1, 1050);
        assert_eq!(rig.z_nm(), 50_200, "one step at the slew limit");
        rig.run(60, 1050);
        assert_eq!(rig.z_nm(), 0);
        // 10 codes more are 10.24 µm since the reference; the bit that stays set does nothing.
        rig.control(Control { zero: true, ..ENGAGED });
        rig.run(60, 1060);
        assert_eq!(rig.z_nm(), 10_240);
    }

    #[test]
    fn a_cnc_that_starts_with_zero_set_has_asked_for_nothing() {
        let mut rig = Rig::new(CALIBRATION);
        rig.run(100, 1050);
        rig.control(Control { zero: true, ..ENGAGED });
        rig.run(100, 1050);
        assert_eq!(rig.z_nm(), 51_200);
    }

    #[test]
    fn the_clamp_is_told() {
        let mut rig = Rig::new(CALIBRATION);
        let output = rig.run_engaged(900, 1900);
        assert_eq!(rig.z_nm(), 500_000);
        assert!(output.flags.contains(Flags::CLAMPED));
    }

    #[test]
    fn without_a_speed_the_window_is_200_ms_and_it_says_so() {
        let mut rig = Rig::new(CALIBRATION);
        for ms in 0..450_u16 {
            let codes = core::array::from_fn(|n| Code(1000 + (n % 2) as u16 + ms % 2));
            let input = Input { codes: Some(&codes), speed: None };
            let output = rig.bridge.tick(&mut rig.state, Millis(u32::from(ms) + 1), input);
            assert!(output.flags.contains(Flags::SPEED_UNKNOWN));
            assert_eq!(rig.state.elongation().is_some(), ms >= 399, "at {ms} ms");
        }
    }

    #[test]
    fn the_speed_of_the_cnc_wins_while_it_is_fresh() {
        let mut rig = Rig::new(CALIBRATION);
        let spindle = Spindle { speed: Rpm(60_000), load_n: 0 };
        rig.bridge.hear(&mut rig.state, Command::Spindle(spindle));
        for ms in 1..=3 {
            let codes = core::array::from_fn(|n| Code(1000 + (n % 2) as u16));
            rig.bridge.tick(&mut rig.state, Millis(ms), Input { codes: Some(&codes), speed: None });
        }
        // Two windows of 5 samples are full after 2 ms; two of 200 ms would not be.
        assert!(rig.state.elongation().is_some());
    }
}
