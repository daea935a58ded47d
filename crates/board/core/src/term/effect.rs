//! The parts of a term, and the effect at a place of one that depends on it.

use crate::{
    cnc::LinearAxis,
    curve::Curve,
    design_parameters::MAX_TERMS,
    fixed_point::{self, ScaledCoefficient},
    gradient::Gradient,
    index_set::IndexSet,
    lag::SmoothingFactor,
    machine_position::MachinePosition,
    pitch_table::PitchErrorTable,
    reversal::backlash_error,
    term::{
        category::{ConditionLevels, ToolTable},
        tilt::Tilt,
    },
    tool_direction::ToolDirection,
    trigonometry::sin_cos,
    units::{FineNanometres, MicroDegrees, Position, Rpm, Temperature},
};

/// Binary places of the position in a slope by heat.
pub const HEAT_SLOPE_BITS: u32 = 27;

/// The terms of a calibration; those that are there come first.
pub type Terms<'a> = [Option<Term<'a>>; MAX_TERMS];

/// The quantity that a term changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// The elongation by the first source; the term was not fitted to another one.
    Elongation,
    /// The error of an axis.
    Axis(LinearAxis),
}

/// A term.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Term<'a> {
    /// The quantity that it changes.
    pub target: Target,
    /// Added as well, in 1/256 nm: an error of the axis, or an elongation.
    pub constant: FineNanometres,
    /// How it changes it.
    pub effect: Effect<'a>,
}

/// The effect of a term; the formulas stand at the head of [`term`](crate::term).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect<'a> {
    /// The constant alone.
    Offset,
    /// p + m·p; of an elongation alone.
    Gain(ScaledCoefficient),
    /// p + m·(p²/2²⁴), p held to ±1.05 mm there; of an elongation alone.
    Curvature(ScaledCoefficient),
    /// At most this; of an elongation alone.
    Saturation(FineNanometres),
    /// + m·(lag(T) − reference).
    Heat {
        /// The channel of T, 0…7.
        channel: u8,
        /// α of the lag of T, per step of 100 ms.
        smoothing: SmoothingFactor,
        /// T_ref, in 1/4096 mK.
        reference: Temperature,
        /// m, in 1/256 nm per temperature unit.
        per_temperature: ScaledCoefficient,
    },
    /// + m·(lag(T) − reference)·P/2²⁷, P of the term's own axis: 2²⁷ position units are 1.34 m.
    HeatSlope {
        /// The channel of T, 0…7.
        channel: u8,
        /// α of the lag of T, per step of 100 ms.
        smoothing: SmoothingFactor,
        /// T_ref, in 1/4096 mK.
        reference: Temperature,
        /// m, in 1/256 nm per temperature unit.
        per_temperature: ScaledCoefficient,
    },
    /// + m·lag(x), x a power of the speed; cold (0) at the start.
    SpeedHeat {
        /// Which power.
        power: SpeedExponent,
        /// α of the lag, per step of 100 ms.
        smoothing: SmoothingFactor,
        /// m, in 1/256 nm for each of [`SpeedExponent::heat_input`]'s units.
        per_unit: ScaledCoefficient,
    },
    /// + m·(1 − e^(−t/τ)), t since the start of the board.
    Time {
        /// α = 1 − e^(−0.1 s/τ), per step of 100 ms.
        smoothing: SmoothingFactor,
        /// m, in 1/256 nm per [`UNIT_STEP`](crate::term::UNIT_STEP).
        amplitude: ScaledCoefficient,
    },
    /// + m·n², n in r/min.
    Speed(ScaledCoefficient),
    /// + m·F, F in 1/256 N.
    Load(ScaledCoefficient),
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
        width: FineNanometres,
        /// From 0.
        gradient: Gradient,
    },
    /// A table of the term's own axis for either direction.
    Table(PitchErrorTable<'a>),
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
        amplitude: FineNanometres,
    },
    /// + θ·(L − L₀), θ = gradient·P.
    TiltLine(Tilt<Gradient>),
    /// + θ·(L − L₀), θ a curve over P.
    TiltCurve(Tilt<Curve<'a>>),
    /// + m(tool)·f.
    Tool(ToolTable<'a>),
    /// + m·f, m by a condition that holds or does not.
    Condition(ConditionLevels),
}

/// The power of the spindle's speed by which it heats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpeedExponent {
    /// n: friction of constant force.
    First,
    /// n²: friction that grows with the speed.
    Second,
}

impl SpeedExponent {
    /// Returns how hard a spindle of this speed heats, in units of the lag's input. An unknown speed does not heat.
    ///
    /// ```
    /// use trueup_core::{term::SpeedExponent, units::Rpm};
    /// assert_eq!(SpeedExponent::First.heat_input(Some(Rpm(3))), 98_304);
    /// assert_eq!(SpeedExponent::Second.heat_input(Some(Rpm(4_000))), 8_000_000);
    /// assert_eq!(SpeedExponent::Second.heat_input(None), 0);
    /// ```
    #[must_use]
    pub fn heat_input(self, speed: Option<Rpm>) -> i32 {
        let rpm = u32::from(speed.unwrap_or_default().0);
        // Below 2¹⁶, so that both are below 2³¹.
        match self {
            Self::First => rpm.wrapping_shl(15),
            Self::Second => rpm.wrapping_mul(rpm) >> 1,
        }
        .cast_signed()
    }

    /// Returns the units of a (r/min)^power.
    #[must_use]
    pub const fn input_units_per_speed_power(self) -> f64 {
        match self {
            Self::First => 32_768.0,
            Self::Second => 0.5,
        }
    }
}

/// Returns the terms of heat, which need a temperature or the heat that the speed has left.
#[must_use]
pub fn thermal_term_indices(terms: &Terms<'_>) -> IndexSet {
    let mut set = IndexSet::default();
    for (index, term) in terms.iter().enumerate() {
        if term.is_some_and(|term| {
            matches!(
                term.effect,
                Effect::Heat { .. } | Effect::HeatSlope { .. } | Effect::SpeedHeat { .. }
            )
        }) {
            set.insert(index);
        }
    }
    set
}

impl Effect<'_> {
    /// Returns what it adds to the error of its own axis, and whether that is the end of a table held.
    pub(super) fn error_at(
        &self,
        own: LinearAxis,
        warmth: FineNanometres,
        place: &MachinePosition,
    ) -> (FineNanometres, bool) {
        let of = |axis: LinearAxis| place.axis_position(axis);
        let reversal = || place.reversal(own);
        let inside = |part| (part, false);
        match self {
            Self::Heat { .. } | Self::SpeedHeat { .. } | Self::Time { .. } => inside(warmth),
            Self::HeatSlope { .. } => {
                let part = fixed_point::widening_mul(warmth.0, of(own).0);
                inside(FineNanometres::saturating_from(fixed_point::rounding_shift_right(
                    part,
                    HEAT_SLOPE_BITS,
                )))
            }
            Self::Position { axis, gradient } => {
                inside(gradient.error_over_travel(Position(0), of(*axis)))
            }
            Self::Reversed { width, gradient } => inside(backlash_error(
                width.saturating_add(gradient.error_over_travel(Position(0), of(own))),
                reversal(),
            )),
            Self::Table(pitch) => pitch.error_at(of(own), reversal()),
            Self::Curve { axis, curve } => curve.evaluate(of(*axis)),
            Self::Wave { turns, phase, amplitude } => {
                inside(evaluate_sine(*turns, *phase, *amplitude, of(own)))
            }
            Self::TiltLine(tilt) => {
                let error = tilt.angle.error_over_travel(Position(0), of(tilt.along));
                inside(tilt.scale_to_lever(error, place))
            }
            Self::TiltCurve(tilt) => {
                let (error, beyond) = tilt.angle.evaluate(of(tilt.along));
                (tilt.scale_to_lever(error, place), beyond)
            }
            // Of an elongation alone, the constant alone, or by category.
            _ => inside(FineNanometres::ZERO),
        }
    }
}

/// a·sin(2π·(P·turns + φ)); whole turns wrap away.
#[allow(clippy::cast_possible_truncation, reason = "a word of two, and less than 2³¹")]
fn evaluate_sine(
    turns: u64,
    phase: u32,
    amplitude: FineNanometres,
    position: Position,
) -> FineNanometres {
    const FULL_TURN_MICRO_DEGREES: u32 = 360 * MicroDegrees::PER_DEGREE.unsigned_abs();
    // Modulo 2⁶⁴ a product with a negative number is that with its complement.
    let turned = i64::from(position.0).cast_unsigned().wrapping_mul(turns) >> 32;
    let turned = (turned as u32).wrapping_add(phase);
    let angle =
        MicroDegrees(fixed_point::mul_high_unsigned(turned, FULL_TURN_MICRO_DEGREES).cast_signed());
    let (sine, _) = sin_cos(angle);
    let along = fixed_point::widening_mul(sine, amplitude.0);
    FineNanometres::saturating_from(fixed_point::rounding_shift_right(
        along,
        ToolDirection::FRACTION_BITS,
    ))
}
