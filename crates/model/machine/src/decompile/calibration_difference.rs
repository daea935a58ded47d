//! How far two calibrations are apart in what the board computes by them.

use std::f64::consts::E;

use trueup_core::{
    calibration::{self, Calibration},
    curve::{Curve, CurveSegment},
    gradient::Gradient,
    lag::SmoothingFactor,
    pitch_table::PitchErrorTable,
    reversal::Fraction,
    term::{Effect, Term},
    thermal::ThermalExpansionLaw,
    tool_direction::ToolDirection,
    units::{AdcCode, Position, READING_UNITS_PER_CODE, Temperature},
    volumetric_error::VolumetricErrorModel,
    warmup,
};

use crate::{
    compile::{exact_elongation_nm, term::MAX_LEVER_RATIO, time_constant_s},
    unit_conversion::{FINE_UNITS_PER_NM, GRADIENT_UNITS_PER_UM_PER_M, NM_PER_UM},
};

const FULL_FRACTION_SCALE: f64 = (1_u64 << warmup::WarmupModel::FULL_FRACTION_BITS) as f64;
const RATED_HEAT_INPUT: f64 = warmup::WarmupModel::RATED_HEAT_INPUT as f64;

/// Returns the largest difference in nm between what the board computes by `a` and by `b`; `None` where they
/// differ in more than numbers of nanometres.
pub(super) fn calibration_difference_nm(a: &Calibration<'_>, b: &Calibration<'_>) -> Option<f64> {
    /// A tool direction is held against the other with this elongation.
    const CHECKED_ELONGATION_NM: f64 = 1e6;
    let is_alike = a.thermometers == b.thermometers
        && a.kinematics.axes == b.kinematics.axes
        && a.limits == b.limits
        && a.cold_within == b.cold_within
        && a.guards == b.guards
        && a.names == b.names;
    if !is_alike {
        return None;
    }
    let mut worst = spindle_difference_nm(&a.spindle, &b.spindle)?;
    for (a, b) in a.kinematics.zero.0.into_iter().zip(b.kinematics.zero.0) {
        let off = f64::from(a.abs_diff(b)) / f64::from(ToolDirection::ONE);
        worst = worst.max(off * CHECKED_ELONGATION_NM);
    }
    for (a, b) in a.axes.iter().zip(&b.axes) {
        worst = worst.max(axis_difference_nm(a, b)?);
    }
    for (a, b) in a.straightness.iter().zip(&b.straightness) {
        worst = worst.max(curve_difference(a, b) / FINE_UNITS_PER_NM);
    }
    for (a, b) in a.squareness.iter().zip(b.squareness) {
        worst = worst.max(gradient_difference_nm(*a, b));
    }
    let volume = option_difference(a.volume.as_ref(), b.volume.as_ref(), volume_difference_nm)?;
    worst = worst.max(volume * MAX_LEVER_RATIO);
    for (a, b) in a.terms.iter().zip(&b.terms) {
        worst = worst.max(option_difference(a.as_ref(), b.as_ref(), term_difference_nm)?);
    }
    Some(worst)
}

/// Of two things that are both there, or both not.
fn option_difference<T>(
    a: Option<T>,
    b: Option<T>,
    difference: impl Fn(T, T) -> Option<f64>,
) -> Option<f64> {
    match (a, b) {
        (Some(a), Some(b)) => difference(a, b),
        (None, None) => Some(0.0),
        _ => None,
    }
}

/// Returns the difference of two gradients over 1 m, in nm.
pub(super) fn gradient_difference_nm(a: Gradient, b: Gradient) -> f64 {
    f64::from(a.0.abs_diff(b.0)) / GRADIENT_UNITS_PER_UM_PER_M * NM_PER_UM
}

pub(super) fn spindle_difference_nm(
    a: &calibration::SpindleModel<'_>,
    b: &calibration::SpindleModel<'_>,
) -> Option<f64> {
    if a.chain != b.chain {
        return None;
    }
    let mut worst: f64 = 0.0;
    if a.chain.contains(&Some(calibration::ElongationSource::Sensor)) {
        let last = f64::from(AdcCode::FULL_SCALE * READING_UNITS_PER_CODE);
        for reading in [0.0, last] {
            let off =
                exact_elongation_nm(&a.sensor, reading) - exact_elongation_nm(&b.sensor, reading);
            worst = worst.max(off.abs());
        }
    }
    let temperature = option_difference(a.temperature, b.temperature, |a, b| {
        let laws = thermal_law_difference_nm(a.law, b.law)
            + lag_difference_nm(a.smoothing, b.smoothing, max_thermal_law_value_nm(a.law));
        (a.channel == b.channel).then_some(laws)
    })?;
    let warmup = option_difference(a.warmup, b.warmup, |a, b| {
        let max_nm = f64::from(a.law.max.0).abs() / FINE_UNITS_PER_NM;
        let max = f64::from(a.law.max.0.abs_diff(b.law.max.0)) / FINE_UNITS_PER_NM;
        let full = f64::from(a.law.full.abs_diff(b.law.full)) / FULL_FRACTION_SCALE * max_nm;
        let lags = lag_difference_nm(a.law.smoothing_heating, b.law.smoothing_heating, max_nm)
            + lag_difference_nm(a.law.smoothing_cooling, b.law.smoothing_cooling, max_nm);
        let power = curve_difference(&a.power, &b.power) / RATED_HEAT_INPUT * max_nm;
        (a.law.lag_ms == b.law.lag_ms).then_some(max + full + lags + power)
    })?;
    Some(worst.max(temperature).max(warmup))
}

/// Returns how far two lags are apart after a step of this size: at most its e-th part for each part by
/// which their time constants differ.
fn lag_difference_nm(a: SmoothingFactor, b: SmoothingFactor, step_nm: f64) -> f64 {
    if a == b {
        return 0.0;
    }
    (time_constant_s(a) / time_constant_s(b) - 1.0).abs() * step_nm / E
}

/// Temperatures at which laws are held against each other: every quarter of a kelvin.
fn comparison_temperatures() -> impl Iterator<Item = Temperature> {
    const CHECKED_TEMPERATURE_RANGE_C: (i32, i32) = (-20, 100);
    let quarters = CHECKED_TEMPERATURE_RANGE_C.0 * 4..=CHECKED_TEMPERATURE_RANGE_C.1 * 4;
    quarters.map(|quarter| Temperature(quarter * (Temperature::PER_KELVIN / 4)))
}

/// Of K₀, or of what tanβ makes of 1 m, in nm.
pub(super) fn thermal_law_difference_nm(
    a: ThermalExpansionLaw<'_>,
    b: ThermalExpansionLaw<'_>,
) -> f64 {
    let at = |t| {
        let ((constant_a, gradient_a), (constant_b, gradient_b)) = (a.evaluate(t), b.evaluate(t));
        let constant = f64::from(constant_a.0.abs_diff(constant_b.0)) / FINE_UNITS_PER_NM;
        constant.max(gradient_difference_nm(gradient_a, gradient_b))
    };
    comparison_temperatures().map(at).fold(0.0, f64::max)
}

fn max_thermal_law_value_nm(law: ThermalExpansionLaw<'_>) -> f64 {
    thermal_law_difference_nm(law, ThermalExpansionLaw::default())
}

fn axis_difference_nm(
    a: &calibration::AxisModel<'_>,
    b: &calibration::AxisModel<'_>,
) -> Option<f64> {
    let thermal = option_difference(a.thermal, b.thermal, |a, b| {
        let laws = thermal_law_difference_nm(a.law, b.law)
            + lag_difference_nm(a.smoothing, b.smoothing, max_thermal_law_value_nm(a.law));
        (a.channel == b.channel && a.origin == b.origin).then_some(laws)
    })?;
    let pitch = option_difference(a.pitch, b.pitch, |a, b| pitch_difference_nm(&a, &b))?;
    let dual = option_difference(a.dual, b.dual, |a, b| {
        let off = pitch_difference_nm(&a.pitch, &b.pitch);
        off.filter(|_| a.across == b.across && a.beam == b.beam)
    })?;
    let backlash = f64::from(a.backlash.0.abs_diff(b.backlash.0)) / FINE_UNITS_PER_NM;
    (a.travel == b.travel).then_some(thermal.max(pitch).max(dual).max(backlash))
}

/// At the points, half way to the next, and half way from one direction to the other.
pub(super) fn pitch_difference_nm(a: &PitchErrorTable<'_>, b: &PitchErrorTable<'_>) -> Option<f64> {
    if (a.start, a.step, a.forward.len()) != (b.start, b.step, b.forward.len()) {
        return None;
    }
    let half = i64::from(a.step.length() / 2);
    let places = (0_i64..).take(a.forward.len() * 2).map(|n| {
        let place = i64::from(a.start.0) + n / 2 * i64::from(a.step.length()) + n % 2 * half;
        Position(i32::try_from(place).unwrap_or(i32::MAX))
    });
    let blends = [Fraction::ZERO, Fraction(Fraction::ONE.0 / 2), Fraction::ONE];
    let off = places.flat_map(|place| {
        blends.map(|blend| a.error_at(place, blend).0.0.abs_diff(b.error_at(place, blend).0.0))
    });
    Some(f64::from(off.max().unwrap_or(0)) / FINE_UNITS_PER_NM)
}

/// Returns the largest error of a table, at its points and in both directions, in nm.
pub(super) fn max_pitch_error_nm(pitch: &PitchErrorTable<'_>) -> Option<f64> {
    let places = (0_i64..).take(pitch.forward.len()).map(|n| {
        let place = i64::from(pitch.start.0) + n * i64::from(pitch.step.length());
        Position(i32::try_from(place).unwrap_or(i32::MAX))
    });
    let errors = places.flat_map(|place| {
        [Fraction::ZERO, Fraction::ONE].map(|blend| pitch.error_at(place, blend).0.0.unsigned_abs())
    });
    errors.max().map(|largest| f64::from(largest) / FINE_UNITS_PER_NM)
}

/// At the ends of the segments of `a` and at places between, in the curves' units.
pub(super) fn curve_difference(a: &Curve<'_>, b: &Curve<'_>) -> f64 {
    const INTERVALS_PER_SEGMENT: i64 = 17;
    let mut start = a.first_knot().0;
    let mut worst = 0;
    for bytes in a.segments() {
        let end = CurveSegment::from_bytes(bytes).end.0;
        for n in 0..=INTERVALS_PER_SEGMENT {
            let place =
                i64::from(start) + (i64::from(end) - i64::from(start)) * n / INTERVALS_PER_SEGMENT;
            let place = Position(i32::try_from(place).expect("between two of i32"));
            worst = worst.max(a.evaluate(place).0.0.abs_diff(b.evaluate(place).0.0));
        }
        start = end;
    }
    f64::from(worst)
}

/// Returns how far the errors of two volumes are apart at the board's lever, in nm; `None` where their axes or
/// points are others.
pub(super) fn volume_difference_nm(
    a: &VolumetricErrorModel<'_>,
    b: &VolumetricErrorModel<'_>,
) -> Option<f64> {
    let lines = |model: &VolumetricErrorModel<'_>| {
        model.rotary.map(|rotary| {
            rotary.map(|location| (location.axis, location.moves_workpiece, location.point))
        })
    };
    let points = |model: &VolumetricErrorModel<'_>| model.guides.map(|guide| guide.point);
    let is_alike =
        a.chain == b.chain && a.tool == b.tool && lines(a) == lines(b) && points(a) == points(b);
    if !is_alike {
        return None;
    }
    let mut worst: f64 = 0.0;
    let guides = a.guides.iter().zip(&b.guides);
    for (a, b) in guides.flat_map(|(a, b)| a.about.iter().zip(&b.about)) {
        // A slope is over 1 m, a curve where it is largest.
        let curves = curve_difference(&a.curve, &b.curve).max(curve_difference(&b.curve, &a.curve));
        worst = worst.max(gradient_difference_nm(a.slope, b.slope)).max(curves / FINE_UNITS_PER_NM);
    }
    for (a, b) in a.rotary.iter().flatten().zip(b.rotary.iter().flatten()) {
        let pairs = a.shift.iter().chain(&a.tilt).zip(b.shift.iter().chain(&b.tilt));
        let off = pairs.map(|(a, b)| a.0.abs_diff(b.0)).max().unwrap_or(0);
        worst = worst.max(f64::from(off) / FINE_UNITS_PER_NM);
    }
    Some(worst)
}

/// Returns how far two terms are apart, in nm; `None` where they are not the same kind of thing.
pub(super) fn term_difference_nm(a: &Term<'_>, b: &Term<'_>) -> Option<f64> {
    /// So far from 0 waves are held against each other, in position units: 15 m.
    const MAX_CHECKED_POSITION_UNITS: f64 = 1.5e9;
    if a.target != b.target || a.constant != b.constant {
        return None;
    }
    match (&a.effect, &b.effect) {
        (a, b) if a == b => Some(0.0),
        (Effect::Curve { axis, curve }, Effect::Curve { axis: other, curve: second })
            if axis == other =>
        {
            Some(curve_difference(curve, second) / FINE_UNITS_PER_NM)
        }
        (Effect::TiltCurve(tilt), Effect::TiltCurve(other))
            if (tilt.along, tilt.lever, tilt.origin)
                == (other.along, other.lever, other.origin) =>
        {
            let at_lever = curve_difference(&tilt.angle, &other.angle) / FINE_UNITS_PER_NM;
            Some(at_lever * MAX_LEVER_RATIO)
        }
        (
            Effect::Wave { turns, phase, amplitude },
            Effect::Wave { turns: other, phase: second, amplitude: third },
        ) if amplitude == third => {
            let turned = turns.abs_diff(*other) as f64 / 2_f64.powi(64)
                * MAX_CHECKED_POSITION_UNITS
                + f64::from(phase.abs_diff(*second)) / 2_f64.powi(32);
            Some(f64::from(amplitude.0) / FINE_UNITS_PER_NM * std::f64::consts::TAU * turned)
        }
        (
            Effect::Position { axis, gradient },
            Effect::Position { axis: other, gradient: second },
        ) if axis == other => Some(gradient_difference_nm(*gradient, *second)),
        _ => None,
    }
}
