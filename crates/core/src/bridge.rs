//! One tick of the bridge: a millisecond of samples in, one offset out.
//!
//! ```text
//! codes ─► health ─► filter ─► sensor ─┐
//! temperatures ─► heat ────────────────┼► elongation ─► along the tool ─┐
//!                  └─► thermal ─┐      (the first source that is fresh) │
//! Position ─► place ─► screw ───┼► errors of the axes ─────────────────┴► minus the reference
//!                  └─► guides ──┘                                         ─► limits ─► offset
//! Control ────────────────────────────────► engaged? held? ──────────────────┘
//! ```
//!
//! What the offset follows is decided in one place ([`Bridge::tick`]). An input is what the
//! calibration needs: the sensor or another source of the elongation, temperatures, the positions of
//! those axes that something depends on, the angles of the axes that turn the tool.
//!
//! | the CNC | the inputs | offset | quality |
//! |---|---|---|---|
//! | engages | all fresh | −(error − reference), at the slew limit | live |
//! | engages | the sensor is lost, another source is configured | the same | temperature or warm-up model |
//! | engages, or was lost while engaged | any is lost | as it is, for `hold_ms` | hold |
//! | the same, after `hold_ms` | | to 0, at the slew limit | ramping out |
//! | does not engage, or is not referenced | | to 0, at the slew limit | ramping out |
//! | any of these, offset arrived at 0 | sensor and temperatures believable | 0 | off |
//! | any of these, offset arrived at 0 | faulty or missing | none | fault |
//!
//! Lost and returned is no jump: every way back goes through the slew limit, and so does the way
//! from one source of the elongation to another.

use crate::{
    calibration::{Calibration, Source},
    cnc::{Command, Control, Flags, LinearAxis, Output, Quality, Rotary, Spindle},
    filter::{CODES_PER_TICK, Filter},
    geometry::Place,
    health::{Health, Noise},
    heat::{self, CHANNELS, Channel, Heat, RawTemperatures},
    lag::STEP_MS,
    limits::{Applied, Met},
    term::{Effect, Target, Turning},
    tool::Direction,
    units::{Code, Fine, Millis, Nanometres, Rpm, Temperature},
};

/// Without samples for so long the converter counts as stopped, and a reading as stale.
pub const SAMPLES_TIMEOUT_MS: u32 = 20;
/// Without a temperature for so long its channel counts as bad.
pub const TEMPERATURE_TIMEOUT_MS: u32 = 1_000;

/// What the bridge knows of the machine.
#[derive(Clone, Debug)]
pub struct Bridge<'a> {
    calibration: Calibration<'a>,
    needs: Needs,
}

/// The inputs without which the calibration cannot be followed.
#[derive(Clone, Copy, Debug, Default)]
struct Needs {
    position: [bool; 3],
    rotary: bool,
    /// The spindle's speed and load, from the CNC.
    turning: bool,
    /// Temperatures of the axes and of terms; that of the spindle is one source among others.
    temperature: [bool; CHANNELS],
    /// There are terms of the elongation.
    terms: bool,
}

/// What one tick brings.
#[derive(Clone, Copy, Debug, Default)]
pub struct Input<'a> {
    /// A millisecond of conversions; `None` where none came.
    pub codes: Option<&'a [Code; CODES_PER_TICK]>,
    /// The spindle speed as the board knows it; a fresh one from the CNC wins.
    pub speed: Option<Rpm>,
    /// What the temperature channels deliver; `None` where nothing new came.
    pub temperatures: Option<&'a RawTemperatures>,
}

/// What the bridge remembers from tick to tick.
#[derive(Clone, Debug, Default)]
pub struct State {
    now: Millis,
    health: Health,
    filter: Filter,
    control: Heard<Control>,
    spindle: Heard<Spindle>,
    rotary: Heard<Rotary>,
    place: Place,
    position_age: [Age; 3],
    /// Whether the CNC was ever heard: silence is a loss only after that.
    cnc_known: bool,
    codes_age: Age,
    /// By the sensor.
    elongation: Option<Nanometres>,
    elongation_age: Age,
    believable: bool,
    raw: RawTemperatures,
    raw_age: Age,
    channels: [Channel; CHANNELS],
    heat: Heat,
    /// Milliseconds of the present step of the heat.
    phase_ms: u32,
    reference: Reference,
    /// How long ago the offset was last live; `None` if it is not to be held.
    live_age: Option<Age>,
    applied: Applied,
}

/// The error that counts as none: what `Zero` has taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reference {
    /// Of the tool: it turns with it.
    pub elongation: Nanometres,
    /// Of X, Y and Z.
    pub axes: [Fine; 3],
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

/// The errors of one moment, before the reference.
#[derive(Clone, Copy, Debug, Default)]
struct Now {
    elongation: Nanometres,
    axes: [Fine; 3],
    clamped: bool,
    outside: bool,
}

/// Which inputs are there.
#[derive(Clone, Copy, Debug, Default)]
struct Fresh {
    /// The source of the elongation that is used; `None`: there is one, but none is fresh.
    source: Option<Option<Source>>,
    /// The temperatures of the axes.
    temperatures: bool,
    /// The positions and angles that the CNC sends.
    place: bool,
}

impl Fresh {
    fn all(self) -> bool {
        self.source.is_some() && self.temperatures && self.place
    }
}

impl State {
    /// The time of the last tick.
    #[must_use]
    pub fn now(&self) -> Millis {
        self.now
    }

    /// The newest elongation by the sensor, before reference and limits.
    #[must_use]
    pub fn elongation(&self) -> Option<Nanometres> {
        self.elongation
    }

    /// The temperature of a channel, where one is connected and believable.
    #[must_use]
    pub fn temperature(&self, channel: u8) -> Option<Temperature> {
        self.channels.get(usize::from(channel)).and_then(Channel::temperature)
    }

    /// The error that counts as none.
    #[must_use]
    pub fn reference(&self) -> Reference {
        self.reference
    }

    /// Takes up a reference that was stored.
    pub fn set_reference(&mut self, reference: Reference) {
        self.reference = reference;
    }

    /// The noise of the raw codes since the last call.
    pub fn take_noise(&mut self) -> Noise {
        self.health.take_noise()
    }
}

impl<'a> Bridge<'a> {
    /// A bridge for this machine.
    #[must_use]
    pub fn new(calibration: Calibration<'a>) -> Self {
        Self { calibration, needs: Needs::of(&calibration) }
    }

    /// What it knows of the machine.
    #[must_use]
    pub fn calibration(&self) -> &Calibration<'a> {
        &self.calibration
    }

    /// Takes a valid message of the CNC. It counts from now on, that is from the last tick.
    pub fn hear(&self, state: &mut State, command: Command) {
        match command {
            Command::Control(control) => {
                // An edge needs a known `Control` before it: a CNC that starts with the bit
                // already set has asked for nothing.
                let was = state.control.value();
                if control.zero && was.is_some_and(|was| !was.zero) {
                    self.zero(state);
                }
                state.control.hear(control);
                state.cnc_known = true;
            }
            Command::Spindle(spindle) => state.spindle.hear(spindle),
            Command::Rotary(rotary) => state.rotary.hear(rotary),
            Command::Position(heard) => {
                let number = heard.axis as usize;
                if let (Some(position), Some(travel), Some(age), Some(axis)) = (
                    state.place.position.get_mut(number),
                    state.place.travel.get_mut(number),
                    state.position_age.get_mut(number),
                    self.calibration.axes.get(number),
                ) {
                    *position = heard.position;
                    *age = Age(0);
                    travel.update(&axis.travel, heard.position, heard.direction as i8);
                }
            }
        }
    }

    /// The present error becomes the reference, if it is known.
    fn zero(&self, state: &mut State) {
        let fresh = self.fresh(state);
        if fresh.all() {
            let now = self.error(state, fresh);
            state.reference = Reference { elongation: now.elongation, axes: now.axes };
        }
    }

    /// One tick: `now` is the time at its end.
    pub fn tick(&self, state: &mut State, now: Millis, input: Input<'_>) -> Output {
        let limits = &self.calibration.limits;
        let elapsed_ms = now.since(state.now);
        state.now = now;
        state.grow_older(elapsed_ms, limits.link_timeout_ms);

        let speed = state.spindle.value().map(|spindle| spindle.speed).or(input.speed);
        if let Some(codes) = input.codes {
            self.sense(state, codes, speed);
        }
        if let Some(raw) = input.temperatures {
            state.raw = *raw;
            state.raw_age = Age(0);
        }
        self.heat_up(state, elapsed_ms, speed);

        let fresh = self.fresh(state);
        let course = state.course(fresh.all(), limits.hold_ms);
        let mut told = Now::default();
        let met = match course {
            Course::Follow => {
                told = self.error(state, fresh);
                let (target, clamped) = self.target(state, &told);
                told.clamped |= clamped;
                state.applied.step(limits, target, elapsed_ms)
            }
            // What is applied is held; it does not travel on to where it was going.
            Course::Hold => Met::default(),
            Course::RampOut => state.applied.step(limits, [Nanometres::ZERO; 3], elapsed_ms),
        };

        let uses_sensor = self.calibration.spindle.chain.contains(&Some(Source::Sensor));
        let missing = uses_sensor && state.codes_age.0 > SAMPLES_TIMEOUT_MS;
        let unbelievable = (uses_sensor && !missing && !state.believable)
            || self
                .needs
                .temperature
                .iter()
                .zip(&state.channels)
                .any(|(n, it)| *n && it.is_faulty());
        let faulty = self.is_faulty(state);
        let quality = match course {
            Course::Follow => self.quality(fresh),
            Course::Hold => Quality::Hold,
            Course::RampOut if !state.applied.is_zero() => Quality::RampingOut,
            Course::RampOut if faulty => Quality::Fault,
            Course::RampOut => Quality::Off,
        };
        let lost = state.control.value().is_none() || !fresh.place;
        let flags = Flags::NONE
            .with_if(met.clamp || told.clamped, Flags::CLAMPED)
            .with_if(met.slew, Flags::SLEWING)
            .with_if(unbelievable, Flags::SENSOR_FAULT)
            .with_if(missing, Flags::SAMPLES_MISSING)
            .with_if(state.cnc_known && lost, Flags::CNC_LOST)
            .with_if(speed.is_none(), Flags::SPEED_UNKNOWN)
            .with_if(told.outside, Flags::OUTSIDE_TABLE);
        Output {
            offset: (quality != Quality::Fault).then(|| state.applied.offset()),
            quality,
            flags,
            age_ms: u8::try_from(self.age(state, fresh).0).unwrap_or(u8::MAX),
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
                    state.elongation = Some(self.calibration.spindle.sensor.elongation(reading));
                    state.elongation_age = Age(0);
                }
            }
        }
    }

    /// Every 100 ms each temperature is read once, and then each part of the heat is stepped once:
    /// one of them a millisecond.
    fn heat_up(&self, state: &mut State, elapsed_ms: u32, speed: Option<Rpm>) {
        for _ in 0..elapsed_ms.min(STEP_MS) {
            state.phase_ms =
                if state.phase_ms >= STEP_MS { 1 } else { state.phase_ms.saturating_add(1) };
            let phase = usize::try_from(state.phase_ms).unwrap_or_default().saturating_sub(1);
            if phase < CHANNELS {
                if let (Some(channel), Some(Some(thermometer)), Some(raw)) = (
                    state.channels.get_mut(phase),
                    self.calibration.thermometers.get(phase),
                    state.raw.get(phase),
                ) {
                    let fresh = state.raw_age.0 <= TEMPERATURE_TIMEOUT_MS;
                    channel.hear(fresh.then(|| thermometer.read(*raw).ok()).flatten());
                }
            } else if phase < CHANNELS.saturating_add(heat::ITEMS) {
                let temperatures = state.temperatures();
                let item = phase.saturating_sub(CHANNELS);
                state.heat.step_item(&self.calibration, item, &temperatures, speed);
            }
        }
    }

    /// Which inputs are there.
    fn fresh(&self, state: &State) -> Fresh {
        let spindle = &self.calibration.spindle;
        let is_fresh = |source: &Source| match source {
            Source::Sensor => state.sensor_is_fresh(),
            Source::Temperature => {
                let channel = spindle.temperature.map(|temperature| temperature.channel);
                channel.is_some_and(|channel| state.temperature(channel).is_some())
            }
            Source::Warmup => spindle.warmup.is_some(),
        };
        let mut configured = spindle.chain.iter().flatten().peekable();
        let source = match configured.peek() {
            None => Some(None),
            Some(_) => configured.copied().find(is_fresh).map(Some),
        };
        let timeout_ms = self.calibration.limits.link_timeout_ms;
        let positions = self.needs.position.iter().zip(&state.position_age);
        Fresh {
            source,
            temperatures: self
                .needs
                .temperature
                .iter()
                .zip(&state.channels)
                .all(|(needed, channel)| !needed || channel.temperature().is_some())
                && state.heat.knows(&self.calibration),
            place: positions
                .fold(true, |fresh, (needed, age)| fresh && (!needed || age.0 <= timeout_ms))
                && (!self.needs.rotary || state.rotary.value().is_some())
                && (!self.needs.turning || state.spindle.value().is_some()),
        }
    }

    /// Whether an input of the board itself is broken for which there is no other. What has only
    /// not come yet is not broken.
    fn is_faulty(&self, state: &State) -> bool {
        let spindle = &self.calibration.spindle;
        let is_broken =
            |channel: u8| state.channels.get(usize::from(channel)).is_none_or(Channel::is_faulty);
        let mut sources = spindle.chain.iter().flatten().peekable();
        let has_source = sources.peek().is_some();
        let all_broken = sources.all(|source| match source {
            Source::Sensor => state.codes_age.0 > SAMPLES_TIMEOUT_MS || !state.believable,
            Source::Temperature => spindle.temperature.is_none_or(|it| is_broken(it.channel)),
            Source::Warmup => spindle.warmup.is_none(),
        });
        let temperatures = self.needs.temperature.iter().zip(&state.channels);
        (has_source && all_broken)
            || temperatures.fold(false, |any, (needed, it)| any || (*needed && it.is_faulty()))
    }

    /// The errors of this moment.
    fn error(&self, state: &State, fresh: Fresh) -> Now {
        let mut elongation = match fresh.source.flatten() {
            Some(Source::Sensor) => state.elongation.unwrap_or_default(),
            Some(Source::Temperature) => state.heat.by_temperature(),
            Some(Source::Warmup) => state.heat.by_running_time(),
            None => Nanometres::ZERO,
        };
        // The terms were fitted to the first source.
        if self.needs.terms && fresh.source == Some(self.calibration.spindle.chain[0]) {
            let spindle = state.spindle.value();
            let turning = Turning {
                speed: spindle.map(|spindle| spindle.speed),
                load: spindle.map_or(0, |spindle| i32::from(spindle.load_n).saturating_mul(256)),
            };
            let terms = state.heat.terms();
            elongation = self.calibration.with_terms(elongation.fine(), terms, turning).rounded();
        }
        let errors = self.calibration.errors(&state.heat, &state.place);
        let mut now =
            Now { elongation, axes: [Fine::ZERO; 3], clamped: false, outside: errors.outside };
        for ((sum, error), max) in
            now.axes.iter_mut().zip(&errors.axes).zip(self.calibration.limits.max)
        {
            let (held, clamped) = error.sum(max.fine());
            *sum = held;
            now.clamped |= clamped;
        }
        now
    }

    /// The offset that undoes the error since the reference; and whether a part was held at its
    /// limit.
    fn target(&self, state: &State, now: &Now) -> ([Nanometres; 3], bool) {
        let since =
            i64::from(now.elongation.0).saturating_sub(i64::from(state.reference.elongation.0));
        let along = self.direction(state).fine_error(Nanometres::saturating(since));
        let mut target = [Nanometres::ZERO; 3];
        let mut clamped = false;
        for ((((target, along), sum), reference), max) in target
            .iter_mut()
            .zip(along)
            .zip(now.axes)
            .zip(state.reference.axes)
            .zip(self.calibration.limits.max)
        {
            let largest = max.fine().0.max(0);
            let held = along.0.clamp(largest.saturating_neg(), largest);
            clamped |= held != along.0;
            let error = Fine(held).plus(sum).plus(Fine(reference.0.saturating_neg()));
            *target = error.rounded().opposite();
        }
        (target, clamped)
    }

    /// The tool direction at the present angles.
    fn direction(&self, state: &State) -> Direction {
        let kinematics = &self.calibration.kinematics;
        match state.rotary.value() {
            Some(rotary) if self.needs.rotary => kinematics.direction(rotary.angles),
            _ => kinematics.zero,
        }
    }

    /// The quality of an offset that is followed: how far down the chain its source stands.
    fn quality(&self, fresh: Fresh) -> Quality {
        let first = self.calibration.spindle.chain.iter().flatten().next().copied();
        match fresh.source.flatten() {
            source if source == first => Quality::Live,
            Some(Source::Temperature) => Quality::TemperatureModel,
            Some(Source::Warmup) => Quality::WarmUpModel,
            _ => Quality::Live,
        }
    }

    /// The age of the newest sample that the offset rests on.
    fn age(&self, state: &State, fresh: Fresh) -> Age {
        match fresh.source {
            Some(Some(Source::Sensor)) | None => state.elongation_age,
            Some(Some(Source::Temperature)) => state.raw_age,
            Some(Some(Source::Warmup)) | Some(None) => Age(0),
        }
    }
}

impl Needs {
    fn of(calibration: &Calibration<'_>) -> Self {
        let terms = || calibration.terms.iter().flatten();
        let has_elongation = calibration.spindle.chain.iter().any(Option::is_some)
            || terms().any(|term| term.target == Target::Elongation);
        let mut needs = Self {
            rotary: calibration.kinematics.axes.iter().any(Option::is_some) && has_elongation,
            terms: terms().any(|term| term.target == Target::Elongation),
            turning: terms().any(|it| matches!(it.effect, Effect::Speed(_) | Effect::Load(_))),
            ..Self::default()
        };
        let mut position = |axis: LinearAxis| {
            if let Some(needed) = needs.position.get_mut(axis as usize) {
                *needed = true;
            }
        };
        let all = [LinearAxis::X, LinearAxis::Y, LinearAxis::Z];
        for (axis, name) in calibration.axes.iter().zip(all) {
            let moves = axis.thermal.is_some_and(|thermal| thermal.law.depends_on_position());
            if moves || axis.pitch.is_some() || axis.dual.is_some() || axis.backlash != Fine::ZERO {
                position(name);
            }
            if let Some(dual) = &axis.dual {
                position(dual.across);
            }
        }
        for (((_, over), curve), gradient) in crate::calibration::CROSSED
            .into_iter()
            .zip(&calibration.straightness)
            .zip(&calibration.squareness)
        {
            if !curve.is_empty() || gradient.0 != 0 {
                position(over);
            }
        }
        for term in terms() {
            match (term.effect, term.target) {
                (Effect::Position { axis, .. } | Effect::Curve { axis, .. }, _)
                | (
                    Effect::Reversed { .. } | Effect::Table(_) | Effect::Wave { .. },
                    Target::Axis(axis),
                ) => position(axis),
                _ => {}
            }
        }
        let of_axes = calibration.axes.iter().flat_map(|axis| axis.thermal).map(|it| it.channel);
        let of_terms = terms().filter_map(|term| match term.effect {
            Effect::Heat { channel, .. } => Some(channel),
            _ => None,
        });
        for channel in of_axes.chain(of_terms) {
            if let Some(needed) = needs.temperature.get_mut(usize::from(channel)) {
                *needed = true;
            }
        }
        needs
    }
}

impl State {
    fn grow_older(&mut self, elapsed_ms: u32, link_timeout_ms: u32) {
        self.control.grow(elapsed_ms, link_timeout_ms);
        self.spindle.grow(elapsed_ms, link_timeout_ms);
        self.rotary.grow(elapsed_ms, link_timeout_ms);
        for age in &mut self.position_age {
            age.grow(elapsed_ms);
        }
        self.codes_age.grow(elapsed_ms);
        self.elongation_age.grow(elapsed_ms);
        self.raw_age.grow(elapsed_ms);
        if let Some(age) = &mut self.live_age {
            age.grow(elapsed_ms);
        }
    }

    fn sensor_is_fresh(&self) -> bool {
        self.elongation.is_some() && self.believable && self.elongation_age.0 <= SAMPLES_TIMEOUT_MS
    }

    fn temperatures(&self) -> [Option<Temperature>; CHANNELS] {
        self.channels.map(|channel| channel.temperature())
    }

    /// Decides where the offset goes, and remembers when it was last live.
    fn course(&mut self, fresh: bool, hold_ms: u32) -> Course {
        let control = self.control.value();
        if control.is_some_and(|control| !(control.engage && control.referenced)) {
            self.live_age = None;
        } else if control.is_some() && fresh {
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
        calibration::AxisThermal,
        cnc::{AxisPosition, Heading},
        kinematics::{self, Kinematics},
        lag::Share,
        limits::Limits,
        sensor::{SensorLaw, Slope},
        thermal::Law,
        thermometer::{Raw, Thermometer},
        units::{MicroDegrees, Position, Reading},
    };

    /// A machine with nothing but limits.
    fn plain() -> Calibration<'static> {
        Calibration {
            thermometers: [None; CHANNELS],
            spindle: Default::default(),
            kinematics: Kinematics { zero: Direction::DOWN, axes: [None; 2] },
            axes: Default::default(),
            straightness: Default::default(),
            squareness: Default::default(),
            terms: [None; crate::term::MOST],
            limits: Limits {
                max: [Nanometres(200_000), Nanometres(200_000), Nanometres(500_000)],
                slew_nm_per_s: 1_000_000,
                link_timeout_ms: 500,
                hold_ms: 2_000,
            },
        }
    }

    /// 1024 nm a code exactly, zero at code 1000, 1 µm in a millisecond.
    fn calibration() -> Calibration<'static> {
        let mut calibration = plain();
        calibration.spindle.chain[0] = Some(Source::Sensor);
        calibration.spindle.sensor =
            SensorLaw { k0: Nanometres(0), zero: Reading(1000 << 10), slope: Slope(1 << 28) };
        calibration
    }
    const ENGAGED: Control = Control { engage: true, referenced: true, zero: false };

    /// A bridge with the hand that feeds it.
    struct Rig {
        bridge: Bridge<'static>,
        state: State,
        now: Millis,
        last: Output,
    }

    impl Rig {
        fn new(calibration: Calibration<'static>) -> Self {
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
            let input =
                Input { codes: codes.as_ref(), speed: Some(Rpm(24_000)), temperatures: None };
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
        let mut rig = Rig::new(calibration());
        // 50 codes are 51.2 µm of growth: the tool tip is too low, the offset goes up.
        let output = rig.run_engaged(200, 1050);
        assert_eq!(output.quality, Quality::Live);
        assert_eq!(output.offset, Some([Nanometres(0), Nanometres(0), Nanometres(51_200)]));
        assert_eq!(output.flags, Flags::NONE);
        assert_eq!(output.age_ms, 0);
    }

    #[test]
    fn nothing_is_engaged_before_the_first_control() {
        let mut rig = Rig::new(calibration());
        let output = rig.run(5_000, 1050);
        assert_eq!((output.quality, output.offset), (Quality::Off, Some([Nanometres(0); 3])));
        assert!(!output.flags.contains(Flags::CNC_LOST), "what was never there is not lost");
    }

    #[test]
    fn it_takes_both_engage_and_referenced() {
        for (engage, referenced) in [(true, false), (false, true), (false, false)] {
            let mut rig = Rig::new(calibration());
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
        let mut rig = Rig::new(calibration());
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
        let mut rig = Rig::new(calibration());
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
        let mut rig = Rig::new(calibration());
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
        let mut rig = Rig::new(calibration());
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
        let mut rig = Rig::new(calibration());
        let output = rig.tick(None);
        assert_eq!((output.quality, output.offset), (Quality::Fault, None));
        assert_eq!((output.flags, output.age_ms), (Flags::SAMPLES_MISSING, 255));
    }

    #[test]
    fn zero_takes_the_present_growth_as_reference_by_a_ramp() {
        let mut rig = Rig::new(calibration());
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
        let mut rig = Rig::new(calibration());
        rig.run(100, 1050);
        rig.control(Control { zero: true, ..ENGAGED });
        rig.run(100, 1050);
        assert_eq!(rig.z_nm(), 51_200);
    }

    #[test]
    fn the_clamp_is_told() {
        let mut rig = Rig::new(calibration());
        let output = rig.run_engaged(900, 1900);
        assert_eq!(rig.z_nm(), 500_000);
        assert!(output.flags.contains(Flags::CLAMPED));
    }

    #[test]
    fn without_a_speed_the_window_is_200_ms_and_it_says_so() {
        let mut rig = Rig::new(calibration());
        for ms in 0..450_u16 {
            let codes = core::array::from_fn(|n| Code(1000 + (n % 2) as u16 + ms % 2));
            let input = Input { codes: Some(&codes), ..Input::default() };
            let output = rig.bridge.tick(&mut rig.state, Millis(u32::from(ms) + 1), input);
            assert!(output.flags.contains(Flags::SPEED_UNKNOWN));
            assert_eq!(rig.state.elongation().is_some(), ms >= 399, "at {ms} ms");
        }
    }

    #[test]
    fn the_speed_of_the_cnc_wins_while_it_is_fresh() {
        let mut rig = Rig::new(calibration());
        let spindle = Spindle { speed: Rpm(60_000), load_n: 0 };
        rig.bridge.hear(&mut rig.state, Command::Spindle(spindle));
        for ms in 1..=3 {
            let codes = core::array::from_fn(|n| Code(1000 + (n % 2) as u16));
            rig.bridge.tick(
                &mut rig.state,
                Millis(ms),
                Input { codes: Some(&codes), ..Input::default() },
            );
        }
        // Two windows of 5 samples are full after 2 ms; two of 200 ms would not be.
        assert!(rig.state.elongation().is_some());
    }

    /// 100 µm/m per kelvin above 20 °C at X, seen by a chain of 1 count a kelvin on channel 3.
    const LAW: [[u8; 20]; 1] = [piece_bytes()];

    const fn piece_bytes() -> [u8; 20] {
        // 1e-3 nm per position unit and kelvin, Q36, 1.024 K, Q4: 1 125 899 906.8.
        let words = [20 * 4_096_000, 0, 0, 0, 1_125_899_907_i32];
        let mut bytes = [0; 20];
        let mut n = 0;
        while n < 20 {
            bytes[n] = words[n / 4].to_le_bytes()[n % 4];
            n += 1;
        }
        bytes
    }

    fn expanding() -> Calibration<'static> {
        let mut calibration = plain();
        // One count a kelvin: 16 000 units per 1/256 count.
        calibration.thermometers[3] =
            Some(Thermometer::Linear { zero: 0, slope: 16_000, shift: 0 });
        let law = Law { pieces: &LAW };
        calibration.axes[0].thermal = Some(AxisThermal {
            channel: 3,
            share: Share::ALL,
            falling: Share::ALL,
            origin: Position(0),
            law,
        });
        calibration
    }

    fn warm(rig: &mut Rig, ms: u32, kelvin: Option<i32>, x_mm: i32) -> Output {
        for _ in 0..ms {
            rig.control(ENGAGED);
            rig.bridge.hear(
                &mut rig.state,
                Command::Position(AxisPosition {
                    axis: LinearAxis::X,
                    position: Position(x_mm * Position::PER_MILLIMETRE),
                    direction: Heading::Positive,
                }),
            );
            let mut raw = [Raw::NONE; CHANNELS];
            raw[3] = kelvin.map_or(Raw::NONE, |kelvin| Raw(kelvin * 256));
            rig.now = rig.now.after(1);
            let input = Input { temperatures: Some(&raw), speed: Some(Rpm(0)), codes: None };
            rig.last = rig.bridge.tick(&mut rig.state, rig.now, input);
        }
        rig.last
    }

    #[test]
    fn an_axis_that_has_grown_is_taken_back_along_itself() {
        let mut rig = Rig::new(expanding());
        // 1 K and 1 m: +100 µm of error, so the offset is −100 µm; and it needs no sensor.
        let output = warm(&mut rig, 300, Some(21), 1_000);
        assert_eq!(output.offset, Some([Nanometres(-100_000), Nanometres(0), Nanometres(0)]));
        assert_eq!((output.quality, output.flags), (Quality::Live, Flags::NONE));
        // On the other side of the origin the error turns round.
        let output = warm(&mut rig, 300, Some(21), -1_000);
        assert_eq!(output.offset, Some([Nanometres(100_000), Nanometres(0), Nanometres(0)]));
    }

    #[test]
    fn a_part_beyond_its_limit_is_held_and_told() {
        let mut rig = Rig::new(expanding());
        let output = warm(&mut rig, 500, Some(24), 1_000);
        assert_eq!(output.offset, Some([Nanometres(-200_000), Nanometres(0), Nanometres(0)]));
        assert!(output.flags.contains(Flags::CLAMPED));
    }

    #[test]
    fn a_broken_thermometer_holds_then_ramps_out_then_is_not_available() {
        let mut rig = Rig::new(expanding());
        warm(&mut rig, 300, Some(21), 1_000);
        // A spark of 300 ms is nothing; the fourth bad reading is a fault.
        let output = warm(&mut rig, 299, None, 1_000);
        assert_eq!((output.quality, output.flags), (Quality::Live, Flags::NONE));
        let output = warm(&mut rig, 200, None, 1_000);
        assert_eq!(output.quality, Quality::Hold);
        assert!(output.flags.contains(Flags::SENSOR_FAULT));
        assert_eq!(output.offset.unwrap()[0], Nanometres(-100_000));
        let output = warm(&mut rig, 2_500, None, 1_000);
        assert_eq!((output.quality, output.offset), (Quality::Fault, None));
        let output = warm(&mut rig, 500, Some(21), 1_000);
        assert_eq!(output.quality, Quality::Live);
    }

    #[test]
    fn without_the_position_that_it_needs_it_does_not_follow_and_says_that_the_cnc_is_lost() {
        let mut rig = Rig::new(expanding());
        warm(&mut rig, 300, Some(21), 1_000);
        for _ in 0..501 {
            rig.control(ENGAGED);
            rig.tick(None);
        }
        assert_eq!(rig.last.quality, Quality::Hold);
        assert!(rig.last.flags.contains(Flags::CNC_LOST));
    }

    #[test]
    fn zero_takes_all_of_the_present_error() {
        let mut rig = Rig::new(expanding());
        warm(&mut rig, 300, Some(21), 1_000);
        rig.control(Control { zero: true, ..ENGAGED });
        let output = warm(&mut rig, 300, Some(21), 1_000);
        assert_eq!(output.offset, Some([Nanometres(0); 3]));
        // 200 µm at 2 m, of which 100 count as none.
        let output = warm(&mut rig, 300, Some(21), 2_000);
        assert_eq!(output.offset, Some([Nanometres(-100_000), Nanometres(0), Nanometres(0)]));
        let reference = rig.state.reference();
        assert_eq!(reference.axes, [Fine(25_600_000), Fine(0), Fine(0)]);
    }

    #[test]
    fn a_tilted_head_takes_growth_to_both_axes() {
        let mut machine = calibration();
        machine.kinematics.axes = [Some(kinematics::Axis::A), None];
        let mut rig = Rig::new(machine);
        // Without an angle nobody knows where the tool points.
        assert_eq!(rig.run_engaged(200, 1050).quality, Quality::Off);
        for _ in 0..300 {
            let angles = [MicroDegrees(30_000_000), MicroDegrees(0)];
            rig.bridge.hear(&mut rig.state, Command::Rotary(Rotary { angles }));
            rig.run_engaged(1, 1100);
        }
        // 102.4 µm along (0, 0.5, −0.866): error (0, 51.2, −88.681), offset its opposite.
        let expected = [Nanometres(0), Nanometres(-51_200), Nanometres(88_681)];
        assert_eq!(rig.last.offset, Some(expected));
    }

    #[test]
    fn a_lost_sensor_is_followed_by_the_next_source_without_a_jump() {
        let mut machine = calibration();
        machine.spindle.chain[1] = Some(Source::Warmup);
        machine.spindle.warmup = Some(crate::calibration::Warmup {
            law: crate::warmup::Warmup {
                lag_ms: 0,
                max: Nanometres(30_000).fine(),
                share_heat: Share::ALL,
                share_cool: Share::ALL,
                full: 1 << crate::warmup::Warmup::FULL_FRACTION_BITS,
            },
            power: Default::default(),
        });
        let mut rig = Rig::new(machine);
        rig.run_engaged(200, 1050);
        assert_eq!((rig.last.quality, rig.z_nm()), (Quality::Live, 51_200));
        let mut before = 51_200;
        for _ in 0..100 {
            rig.control(ENGAGED);
            rig.tick(Some([Code(0); CODES_PER_TICK]));
            assert!((rig.z_nm() - before).abs() <= 1_000);
            before = rig.z_nm();
        }
        assert_eq!((rig.last.quality, rig.z_nm()), (Quality::WarmUpModel, 30_000));
        assert!(rig.last.flags.contains(Flags::SENSOR_FAULT));
    }
}
