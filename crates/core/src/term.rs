//! What a diagnosis has added to the machine's model: up to [`MAX_TERMS`] terms, in their order.
//!
//! A term of the elongation gives p a new value; one of an axis adds to its error:
//!
//! ```text
//! gain        p + m·p                    heat      + m·(lag_τ(T) − T_ref)
//! curvature   p + m·(p²/2²⁴)             time      + m·(1 − e^(−t/τ))
//! saturation  min(p, limit)              speed     + m·n²
//! position    + gradient·P               load      + m·F
//! reversed    + β·(w + gradient·P)       wave      + a·sin(2π·P/L + φ)
//! ```
//!
//! and a table or a curve of the position. Each also adds a constant. β is the fraction of the approach
//! in the negative direction ([`travel`](crate::travel)). m is a number with its own binary point
//! ([`Scaled`]), so that a coefficient of any size keeps 30 bits. Heat and time are stepped every
//! 100 ms with the rest of the heat; the others are computed where they are needed.
//!
//! Everything is 1/256 nm. Measured worst error against `f64`, from the largest to the smallest
//! coefficients: half of that unit for each product, and 0.004 nm for a wave of 100 µm.

use crate::{
    angle::sine_cosine,
    calibration::Calibration,
    cnc::LinearAxis,
    curve::Curve,
    geometry::Place,
    gradient::Gradient,
    heat::CHANNELS,
    lag::{Lag, SmoothingFactor},
    pitch::Pitch,
    tool::Direction,
    travel::{Fraction, backlash},
    units::{Fine, MicroDegrees, Position, Rpm, Temperature},
};

/// The most terms of a calibration.
pub const MAX_TERMS: usize = 16;

/// What a term changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// The elongation by the first source; another one was not what the term was fitted to.
    Elongation,
    /// The error of an axis.
    Axis(LinearAxis),
}

/// A term.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Term<'a> {
    /// What it changes.
    pub target: Target,
    /// Added as well.
    pub constant: Fine,
    /// How.
    pub effect: Effect<'a>,
}

/// What a term does; see the head of this file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect<'a> {
    /// The constant alone.
    Offset,
    /// p + m·p; of an elongation alone.
    Gain(Scaled),
    /// p + m·(p²/2²⁴), p held to ±1.05 mm there; of an elongation alone.
    Curvature(Scaled),
    /// At most this; of an elongation alone.
    Saturation(Fine),
    /// + m·(lag(T) − reference).
    Heat {
        /// Of the temperature.
        channel: u8,
        /// Of its lag, for 100 ms.
        smoothing: SmoothingFactor,
        /// T_ref.
        reference: Temperature,
        /// m, in 1/256 nm per temperature unit.
        per_temperature: Scaled,
    },
    /// + m·(1 − e^(−t/τ)), t since the start of the board.
    Time {
        /// For 100 ms.
        smoothing: SmoothingFactor,
        /// m, in 1/256 nm per [`UNIT_STEP`].
        amplitude: Scaled,
    },
    /// + m·n², n in r/min.
    Speed(Scaled),
    /// + m·F, F in 1/256 N.
    Load(Scaled),
    /// + gradient·P.
    Position {
        /// Of P.
        axis: LinearAxis,
        /// From 0.
        gradient: Gradient,
    },
    /// + β·(width + gradient·P), P and β of the term's own axis.
    Reversed {
        /// At P = 0.
        width: Fine,
        /// From 0.
        gradient: Gradient,
    },
    /// A table of the term's own axis for either direction.
    Table(Pitch<'a>),
    /// A curve.
    Curve {
        /// Over which axis.
        axis: LinearAxis,
        /// The curve.
        curve: Curve<'a>,
    },
    /// + a·sin(2π·P/L + φ), P of the term's own axis.
    Wave {
        /// 2⁶⁴ turns over the position unit: 2⁶⁴·10 nm/L.
        turns: u64,
        /// φ in 2⁻³² turns.
        phase: u32,
        /// a.
        amplitude: Fine,
    },
}

/// 1 of what a term over time follows.
pub const UNIT_STEP: i32 = 1 << 30;

/// A coefficient: mantissa/2^shift.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Scaled {
    /// With the sign; ±2³⁰, so that a product with 33 bits fits.
    pub mantissa: i32,
    /// Held to 62.
    pub shift: u8,
}

impl Scaled {
    /// The product with `x`, rounded to the nearest; saturates. |x| up to 2³².
    ///
    /// ```
    /// use trueup_core::{term::Scaled, units::Fine};
    /// let three_eighths = Scaled { mantissa: 3, shift: 3 };
    /// assert_eq!(three_eighths.times(100), Fine(38)); // 37.5, rounded up
    /// assert_eq!(three_eighths.times(-100), Fine(-37));
    /// ```
    #[must_use]
    pub fn times(self, x: i64) -> Fine {
        let shift = u32::from(self.shift.min(62));
        let half = if shift == 0 { 0 } else { 1_i64.wrapping_shl(shift.wrapping_sub(1)) };
        let product = x.saturating_mul(i64::from(self.mantissa)).saturating_add(half);
        Fine::saturating(product.wrapping_shr(shift))
    }
}

/// What the terms remember: their lags, and what heat and time have made of them.
#[derive(Clone, Debug, Default)]
pub struct TermStates {
    lags: [Option<Lag>; MAX_TERMS],
    values: [Fine; MAX_TERMS],
    known: Set,
}

/// Some of the terms of a calibration. That all of them are there is one comparison.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Set(u16);

impl Set {
    /// The terms of heat, which need a temperature.
    #[must_use]
    pub fn of_heat(calibration: &Calibration<'_>) -> Self {
        let mut set = Self::default();
        for (index, term) in (0..).zip(&calibration.terms) {
            if term.is_some_and(|term| matches!(term.effect, Effect::Heat { .. })) {
                set.insert(index);
            }
        }
        set
    }

    fn insert(&mut self, index: u32) {
        self.0 |= 1_u16.checked_shl(index).unwrap_or(0);
    }
}

impl TermStates {
    /// A step of 100 ms of term `index`, if it is one of heat or time. A temperature that is missing
    /// leaves it as it is.
    pub fn step(
        &mut self,
        calibration: &Calibration<'_>,
        index: usize,
        temperatures: &[Option<Temperature>; CHANNELS],
    ) {
        let (Some(Some(term)), Some(lag), Some(value)) =
            (calibration.terms.get(index), self.lags.get_mut(index), self.values.get_mut(index))
        else {
            return;
        };
        match term.effect {
            Effect::Heat { channel, smoothing, reference, per_temperature } => {
                let temperature = temperatures.get(usize::from(channel)).copied().flatten();
                if let Some(Temperature(now)) = temperature {
                    let lag = lag.get_or_insert(Lag::settled(now));
                    lag.step(now, smoothing);
                    self.known.insert(u32::try_from(index).unwrap_or(u32::MAX));
                    *value =
                        per_temperature.times(i64::from(lag.value().saturating_sub(reference.0)));
                }
            }
            Effect::Time { smoothing, amplitude } => {
                let lag = lag.get_or_insert(Lag::settled(0));
                lag.step(UNIT_STEP, smoothing);
                *value = amplitude.times(i64::from(lag.value()));
            }
            _ => {}
        }
    }

    /// Whether each of these has had a temperature.
    #[must_use]
    pub fn knows(&self, terms: Set) -> bool {
        terms.0 & !self.known.0 == 0
    }

    fn value(&self, index: usize) -> Fine {
        self.values.get(index).copied().unwrap_or_default()
    }
}

/// What the CNC says of the spindle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OperatingPoint {
    /// Its speed; `None` if nobody knows.
    pub speed: Option<Rpm>,
    /// The axial cutting force in 1/256 N, pushing the tool back is positive; ±2²⁴ of them.
    pub load: i32,
}

impl Calibration<'_> {
    /// The elongation with its terms.
    #[must_use]
    pub fn with_terms(
        &self,
        elongation: Fine,
        states: &TermStates,
        operating: OperatingPoint,
    ) -> Fine {
        let mut p = elongation;
        for (index, term) in self.terms.iter().enumerate() {
            let Some(term) = term else { break };
            if term.target == Target::Elongation {
                p = match term.effect {
                    Effect::Gain(m) => p.plus(m.times(i64::from(p.0))),
                    Effect::Curvature(m) => {
                        let held = i64::from(p.0.clamp(-(1 << 28), 1 << 28));
                        p.plus(m.times(held.wrapping_mul(held) >> 24))
                    }
                    Effect::Saturation(limit) => p.min(limit),
                    Effect::Heat { .. } | Effect::Time { .. } => p.plus(states.value(index)),
                    Effect::Speed(m) => {
                        let rpm = i64::from(operating.speed.unwrap_or_default().0);
                        p.plus(m.times(rpm.wrapping_mul(rpm)))
                    }
                    Effect::Load(m) => p.plus(m.times(i64::from(operating.load))),
                    _ => p,
                }
                .plus(term.constant);
            }
        }
        p
    }

    /// What the terms of the axes add, and whether a position is outside a table.
    #[must_use]
    pub fn axis_terms(&self, states: &TermStates, place: &Place) -> ([Fine; 3], bool) {
        let (mut errors, mut outside) = ([Fine::ZERO; 3], false);
        for (index, term) in self.terms.iter().enumerate() {
            let Some(term) = term else { break };
            let Target::Axis(own) = term.target else { continue };
            let Some(error) = errors.get_mut(own as usize) else { continue };
            let (part, beyond) = term.effect.at(own, states.value(index), place);
            *error = error.plus(part).plus(term.constant);
            outside |= beyond;
        }
        (errors, outside)
    }
}

impl Effect<'_> {
    /// What it adds to the error of its own axis, and whether that is the end of a table held.
    fn at(&self, own: LinearAxis, states: Fine, place: &Place) -> (Fine, bool) {
        let of = |axis: LinearAxis| place.position.get(axis as usize).copied().unwrap_or_default();
        let reversal = || {
            place.travel.get(own as usize).map_or(Fraction::ZERO, crate::travel::Travel::reversal)
        };
        let inside = |part| (part, false);
        match self {
            Self::Heat { .. } | Self::Time { .. } => inside(states),
            Self::Position { axis, gradient } => inside(gradient.over(Position(0), of(*axis))),
            Self::Reversed { width, gradient } => {
                inside(backlash(width.plus(gradient.over(Position(0), of(own))), reversal()))
            }
            Self::Table(pitch) => pitch.at(of(own), reversal()),
            Self::Curve { axis, curve } => curve.at(of(*axis)),
            Self::Wave { turns, phase, amplitude } => {
                inside(wave(*turns, *phase, *amplitude, of(own)))
            }
            // Of an elongation alone, or the constant alone.
            _ => inside(Fine::ZERO),
        }
    }
}

/// a·sin(2π·(P·turns + φ)); whole turns wrap away.
#[allow(clippy::cast_possible_truncation, reason = "a word of two, and less than 2³¹")]
fn wave(turns: u64, phase: u32, amplitude: Fine, position: Position) -> Fine {
    const TURN: u64 = 360 * MicroDegrees::PER_DEGREE.unsigned_abs() as u64;
    const HALF: i64 = 1 << (Direction::FRACTION_BITS - 1);
    // Modulo 2⁶⁴ a product with a negative number is that with its complement.
    let turned = i64::from(position.0).cast_unsigned().wrapping_mul(turns) >> 32;
    let turned = (turned as u32).wrapping_add(phase);
    let angle = MicroDegrees((u64::from(turned).wrapping_mul(TURN) >> 32) as i32);
    let (sine, _) = sine_cosine(angle);
    let along = i64::from(sine).wrapping_mul(i64::from(amplitude.0));
    Fine::saturating(along.wrapping_add(HALF) >> Direction::FRACTION_BITS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{kinematics::Kinematics, limits::Limits, travel::Travel, units::Nanometres};
    extern crate std;
    use std::vec::Vec;

    /// The nearest coefficient to `value`, as the host makes it.
    fn scaled(value: f64) -> Scaled {
        let mut shift = 62_u8;
        while (value * 2_f64.powi(shift.into())).abs() >= 1_073_741_823.0 {
            shift -= 1;
        }
        let mantissa = (value * 2_f64.powi(shift.into())).round() as i32;
        Scaled { mantissa, shift }
    }

    fn with(terms: &[(Target, i32, Effect<'static>)]) -> Calibration<'static> {
        let mut calibration = Calibration {
            thermometers: [None; CHANNELS],
            spindle: Default::default(),
            kinematics: Kinematics { zero: Direction::DOWN, axes: [None; 2] },
            axes: Default::default(),
            straightness: Default::default(),
            squareness: Default::default(),
            terms: [None; MAX_TERMS],
            limits: Limits {
                max: [Nanometres(0); 3],
                slew_nm_per_s: 0,
                link_timeout_ms: 0,
                hold_ms: 0,
            },
        };
        for (place, &(target, constant, effect)) in calibration.terms.iter_mut().zip(terms) {
            *place = Some(Term { target, constant: Fine(constant), effect });
        }
        calibration
    }

    fn um(fine: Fine) -> f64 {
        f64::from(fine.0) / 256_000.0
    }

    #[test]
    fn products_are_right_to_half_a_unit_over_all_coefficients() {
        let mut worst: f64 = 0.0;
        for exponent in -40..20 {
            for mantissa in [1.0, -1.234_567, 1.999_999] {
                let value = mantissa * 2_f64.powi(exponent);
                for x in [1_i64, -77, 3_456_789, -(1 << 31), 1 << 32] {
                    let exact = x as f64 * value;
                    if exact.abs() < 2e9 {
                        let got = f64::from(scaled(value).times(x).0);
                        // The coefficient itself is right to 2⁻³⁰ of its size.
                        let bound = 0.5 + exact.abs() * 2_f64.powi(-29);
                        assert!((got - exact).abs() <= bound, "{value}·{x}: {got}, {exact}");
                        worst = worst.max((got - exact).abs() - exact.abs() * 2_f64.powi(-29));
                    }
                }
            }
        }
        std::println!("largest error of a product: {worst:.3} units of 1/256 nm");
        assert_eq!(Scaled { mantissa: i32::MAX, shift: 0 }.times(i64::MAX), Fine(i32::MAX));
        assert_eq!(Scaled { mantissa: i32::MIN, shift: 255 }.times(i64::MAX), Fine(-2));
    }

    #[test]
    fn terms_of_the_elongation_apply_in_their_order() {
        let gain = (Target::Elongation, 0, Effect::Gain(scaled(1.0)));
        let offset = (Target::Elongation, 256_000, Effect::Offset);
        let p = Fine(10 * 256_000);
        let (states, operating) = (TermStates::default(), OperatingPoint::default());
        assert_eq!(um(with(&[gain, offset]).with_terms(p, &states, operating)), 21.0);
        assert_eq!(um(with(&[offset, gain]).with_terms(p, &states, operating)), 22.0);
    }

    #[test]
    fn what_a_sensor_a_spindle_and_a_cut_do() {
        let states = TermStates::default();
        let operating = OperatingPoint { speed: Some(Rpm(12_000)), load: 500 * 256 };
        // c·p² with c in 1/µm: p² in fine units is 256 000 times µm², halved 24 times.
        let curvature = scaled(0.01 / 256_000.0 * 2_f64.powi(24));
        for (effect, wanted) in [
            (Effect::Curvature(curvature), 75.0),
            (Effect::Saturation(Fine(40 * 256_000)), 40.0),
            (Effect::Speed(scaled(0.05 * 256_000.0 / 1e6)), 57.2),
            (Effect::Load(scaled(-0.01 * 1_000.0)), 45.0),
        ] {
            let calibration = with(&[(Target::Elongation, 0, effect)]);
            let got = um(calibration.with_terms(Fine(50 * 256_000), &states, operating));
            assert!((got - wanted).abs() < 1e-5, "{effect:?}: {got}");
        }
    }

    #[test]
    fn heat_follows_its_lag_and_time_its_own() {
        let kelvin = f64::from(Temperature::PER_KELVIN);
        // −3 µm/K from 25 °C, with a smoothing factor of a quarter a step.
        let heat = Effect::Heat {
            channel: 2,
            smoothing: SmoothingFactor(1 << 30),
            reference: Temperature(25 * Temperature::PER_KELVIN),
            per_temperature: scaled(-3.0 * 256_000.0 / kelvin),
        };
        let amplitude = scaled(8.0 * 256_000.0 / f64::from(UNIT_STEP));
        let time = Effect::Time { smoothing: SmoothingFactor(1 << 30), amplitude };
        let x = Target::Axis(LinearAxis::X);
        let calibration = with(&[(x, 0, heat), (Target::Elongation, 0, time)]);
        let mut states = TermStates::default();
        let heated = Set::of_heat(&calibration);
        assert!(!states.knows(heated));
        let mut temperatures = [None; CHANNELS];
        let mut heat_up = |temperatures: &_| {
            states.step(&calibration, 0, temperatures);
            states.step(&calibration, 1, temperatures);
            let (errors, _) = calibration.axis_terms(&states, &Place::default());
            let elongation = calibration.with_terms(Fine::ZERO, &states, OperatingPoint::default());
            (um(errors[0]), um(elongation))
        };
        let near = |got: (f64, f64), wanted: (f64, f64)| {
            assert!((got.0 - wanted.0).abs() < 1e-5 && (got.1 - wanted.1).abs() < 1e-5, "{got:?}");
        };
        near(heat_up(&temperatures), (0.0, 2.0));
        temperatures[2] = Some(Temperature(27 * Temperature::PER_KELVIN));
        near(heat_up(&temperatures), (-6.0, 3.5));
        temperatures[2] = Some(Temperature(31 * Temperature::PER_KELVIN));
        near(heat_up(&temperatures), (-9.0, 4.625));
        temperatures[2] = None;
        near(heat_up(&temperatures), (-9.0, 8.0 * (1.0 - 0.75_f64.powi(4))));
        assert!(states.knows(heated));
    }

    #[test]
    fn what_an_axis_adds_depends_on_its_place_and_direction() {
        let x = Target::Axis(LinearAxis::X);
        let metre = 1_000 * Position::PER_MILLIMETRE;
        // 8 µm/m, as in `gradient`.
        let gradient = Gradient((8.0 * 1e-5 * 2_f64.powi(36)) as i32);
        let mut place = Place { position: [Position(metre / 4); 3], ..Place::default() };
        place.position[1] = Position(metre / 2);
        let at = |effect, place: &Place| {
            um(with(&[(x, 0, effect)]).axis_terms(&TermStates::default(), place).0[0])
        };
        let scale = Effect::Position { axis: LinearAxis::X, gradient };
        let cross = Effect::Position { axis: LinearAxis::Y, gradient };
        let reversed = Effect::Reversed { width: Fine(-25 * 256_000), gradient };
        assert!((at(scale, &place) - 2.0).abs() < 1e-5);
        assert!((at(cross, &place) - 4.0).abs() < 1e-5);
        assert_eq!(at(reversed, &place), 0.0);
        place.travel[0] = Travel::new();
        place.travel[0].update(&crate::travel::Config::default(), Position(0), -1);
        assert!((at(reversed, &place) + 23.0).abs() < 1e-5);
    }

    #[test]
    fn a_wave_repeats_over_the_whole_travel() {
        let mut worst: f64 = 0.0;
        for period_mm in [0.25, 1.0, 5.0, 37.3, 2_500.0] {
            let turns = (2_f64.powi(64) / (period_mm * 1e5)) as u64;
            // The period as it is stored: right to 2⁻⁵³ of itself.
            for (degrees, phase) in [(0.0, 0), (90.0, 1 << 30), (-90.0, 3 << 30)] {
                for n in -4000..4000 {
                    let position = Position(n * 386_117);
                    let effect = Effect::Wave { turns, phase, amplitude: Fine(100 * 256_000) };
                    let place = Place { position: [position; 3], ..Place::default() };
                    let got = um(effect.at(LinearAxis::Z, Fine::ZERO, &place).0);
                    let turn = f64::from(position.0) / 1e5 / period_mm + degrees / 360.0;
                    let exact = 100.0 * (std::f64::consts::TAU * turn).sin();
                    worst = worst.max((got - exact).abs());
                }
            }
        }
        std::println!("a wave of 100 µm: {:.4} nm at most", worst * 1e3);
        assert!(worst < 5e-6, "{worst} µm");
    }

    #[test]
    fn nothing_extreme_panics() {
        let extremes = [i32::MIN, -1, 0, 1, i32::MAX];
        let mut effects = Vec::new();
        for m in extremes {
            let scaled = Scaled { mantissa: m, shift: m.unsigned_abs() as u8 };
            effects.extend([
                Effect::Gain(scaled),
                Effect::Curvature(scaled),
                Effect::Saturation(Fine(m)),
                Effect::Speed(scaled),
                Effect::Load(scaled),
                Effect::Position { axis: LinearAxis::Z, gradient: Gradient(m) },
                Effect::Reversed { width: Fine(m), gradient: Gradient(m) },
                Effect::Wave { turns: u64::MAX, phase: u32::MAX, amplitude: Fine(m) },
                Effect::Heat {
                    channel: 255,
                    smoothing: SmoothingFactor(u32::MAX),
                    reference: Temperature(m),
                    per_temperature: scaled,
                },
                Effect::Heat {
                    channel: 0,
                    smoothing: SmoothingFactor(7),
                    reference: Temperature(m),
                    per_temperature: scaled,
                },
                Effect::Time { smoothing: SmoothingFactor(m.unsigned_abs()), amplitude: scaled },
            ]);
        }
        for effect in effects {
            for target in [Target::Elongation, Target::Axis(LinearAxis::Y)] {
                let calibration = with(&[(target, i32::MAX, effect); MAX_TERMS]);
                for x in extremes {
                    let mut states = TermStates::default();
                    for index in 0..=MAX_TERMS {
                        states.step(&calibration, index, &[Some(Temperature(x)); CHANNELS]);
                    }
                    let place = Place { position: [Position(x); 3], ..Place::default() };
                    let _ = calibration.axis_terms(&states, &place);
                    let operating = OperatingPoint { speed: Some(Rpm(u16::MAX)), load: i32::MIN };
                    let _ = calibration.with_terms(Fine(x), &states, operating);
                }
            }
        }
    }
}
