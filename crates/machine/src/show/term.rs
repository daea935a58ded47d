//! The board's terms back to `[[term]]` tables.
//!
//! A calibration does not know which of two causes with the same formula it came from: heat is shown
//! as an `extra-heat-path`, a gain as a `sensor-gain`, each wave as a `pitch-periodic` of its own.
//! What was corrected in the machine's constants is shown there.

use std::fmt::Write as _;

use trueup_core::{
    calibration::Calibration,
    cnc::LinearAxis,
    term::{Effect, Scaled, Target, Term, UNIT_STEP},
    units::Fine,
};

use super::{
    FINE_PER_NM, FINE_PER_UM, GRADIENT_PER_UM_PER_M, PER_KELVIN, UNITS_PER_MM, Written, column,
    curve_difference, fewest_decimals, is_smoothing, metre_of, name_of, time_constant_s,
    write_curve, write_pitch, written, written_time_constant_s,
};
use crate::compile::term::{PARTS_OF_N, TWO_24, scaled};

/// Lags that fall at another rate than they rise.
pub(super) fn write_falling(toml: &mut String, calibration: &Calibration<'_>) -> Written {
    let spindle = calibration.spindle.temperature.map(|it| (it.smoothing, it.smoothing_falling));
    let axes = calibration
        .axes
        .iter()
        .map(|axis| axis.thermal.map(|it| (it.smoothing, it.smoothing_falling)));
    let quantities = ["elongation", "dx", "dy", "dz"];
    for (quantity, factors) in quantities.into_iter().zip([spindle].into_iter().chain(axes)) {
        if let Some((rising, falling)) = factors
            && rising != falling
        {
            let time_s = fewest_decimals(time_constant_s(falling), |it| is_smoothing(it, falling));
            writeln!(toml, "\n[[term]]\ncause = \"cooling-asymmetry\"")?;
            writeln!(toml, "quantity = \"{quantity}\"\ntime_constant_s = {time_s:?}")?;
        }
    }
    Ok(())
}

pub(super) fn write(toml: &mut String, term: &Term<'_>) -> Written {
    let own = match term.target {
        Target::Elongation => None,
        Target::Axis(axis) => Some(axis),
    };
    let quantity = own.map_or("elongation", |axis| match axis {
        LinearAxis::X => "dx",
        LinearAxis::Y => "dy",
        LinearAxis::Z => "dz",
    });
    let head = |toml: &mut String, cause: &str| -> Written {
        writeln!(toml, "\n[[term]]\ncause = \"{cause}\"\nquantity = \"{quantity}\"")?;
        match term.constant {
            Fine::ZERO => Ok(()),
            constant => writeln!(toml, "constant_um = {:?}", written(constant.0, FINE_PER_UM)),
        }
    };
    match &term.effect {
        Effect::Offset if own.is_none() => {
            writeln!(toml, "\n[[term]]\ncause = \"sensor-offset\"\nquantity = \"{quantity}\"")?;
            writeln!(toml, "offset_um = {:?}", written(term.constant.0, FINE_PER_UM))
        }
        Effect::Offset => {
            head(toml, "pitch-scale")?;
            writeln!(toml, "um_per_m = 0.0")
        }
        Effect::Gain(m) => {
            head(toml, "sensor-gain")?;
            let gain = fewest_decimals(1.0 + value(*m), |gain| is(gain - 1.0, *m));
            writeln!(toml, "gain = {gain:?}")
        }
        Effect::Curvature(m) => {
            head(toml, "sensor-curvature")?;
            writeln!(toml, "per_um = {:?}", number(*m, TWO_24 / FINE_PER_UM))
        }
        Effect::Saturation(limit) => {
            head(toml, "sensor-saturation")?;
            writeln!(toml, "limit_um = {:?}", written(limit.0, FINE_PER_UM))
        }
        Effect::Heat { channel, smoothing, reference, per_temperature } => {
            head(toml, "extra-heat-path")?;
            writeln!(toml, "column = \"{}\"", column(channel))?;
            writeln!(toml, "um_per_c = {:?}", number(*per_temperature, FINE_PER_UM / PER_KELVIN))?;
            writeln!(toml, "time_constant_s = {:?}", written_time_constant_s(*smoothing))?;
            writeln!(toml, "reference_c = {:?}", written(reference.0, PER_KELVIN))
        }
        Effect::Time { smoothing, amplitude } => {
            head(toml, "slow-mode")?;
            let amplitude_um = number(*amplitude, FINE_PER_UM / f64::from(UNIT_STEP));
            writeln!(toml, "amplitude_um = {amplitude_um:?}")?;
            writeln!(toml, "time_constant_s = {:?}", written_time_constant_s(*smoothing))
        }
        Effect::Speed(m) => {
            head(toml, "centrifugal-growth")?;
            writeln!(toml, "um_per_krpm2 = {:?}", number(*m, FINE_PER_UM / 1e6))
        }
        Effect::Load(m) => {
            head(toml, "cutting-load")?;
            writeln!(toml, "um_per_n = {:?}", number(*m, -FINE_PER_UM / PARTS_OF_N))
        }
        Effect::Position { axis, gradient } => {
            let um_per_m = written(gradient.0, GRADIENT_PER_UM_PER_M);
            if own == Some(*axis) {
                head(toml, "pitch-scale")?;
            } else {
                head(toml, "cross-axis")?;
                writeln!(toml, "axis = \"{}\"", name_of(*axis))?;
            }
            writeln!(toml, "um_per_m = {um_per_m:?}")
        }
        Effect::Reversed { width, gradient } if gradient.0 == 0 => {
            head(toml, "backlash")?;
            writeln!(toml, "width_um = {:?}", written(width.0, FINE_PER_UM))
        }
        Effect::Reversed { gradient, .. } => {
            head(toml, "position-dependent-backlash")?;
            writeln!(toml, "um_per_m = {:?}", written(gradient.0, GRADIENT_PER_UM_PER_M))
        }
        Effect::Table(pitch) => {
            head(toml, "pitch-error")?;
            write_pitch(toml, pitch)
        }
        Effect::Curve { axis, curve } => {
            head(toml, "straightness")?;
            writeln!(toml, "along = \"{}\"", name_of(*axis))?;
            write_curve(toml, curve)
        }
        Effect::Wave { turns, phase, amplitude } => {
            head(toml, "pitch-periodic")?;
            let period_mm = 2_f64.powi(64) / (*turns as f64 * UNITS_PER_MM);
            let period_mm = fewest_decimals(period_mm, |mm| {
                (2_f64.powi(64) / (mm * UNITS_PER_MM)).round() == *turns as f64
            });
            writeln!(toml, "period_mm = {period_mm:?}\nharmonic = 1")?;
            writeln!(toml, "amplitude_um = {:?}", written(amplitude.0, FINE_PER_UM))?;
            writeln!(toml, "phase_deg = {:?}", written(*phase, 2_f64.powi(32) / 360.0))
        }
    }
}

fn value(coefficient: Scaled) -> f64 {
    f64::from(coefficient.mantissa) / 2_f64.powi(coefficient.shift.into())
}

/// Whether `number` is stored as this coefficient.
fn is(number: f64, coefficient: Scaled) -> bool {
    scaled(number, 0.0).is_ok_and(|(stored, _)| stored == coefficient)
}

/// What a user writes for a coefficient of which `per_unit` are one of the user's unit.
fn number(coefficient: Scaled, per_unit: f64) -> f64 {
    fewest_decimals(value(coefficient) / per_unit, |number| is(number * per_unit, coefficient))
}

/// How far two terms are apart, in nm; `None` where they are not the same kind of thing.
pub(super) fn difference_nm(a: &Term<'_>, b: &Term<'_>) -> Option<f64> {
    /// So far from 0 waves are held against each other, in position units: 15 m.
    const REACH: f64 = 1.5e9;
    if a.target != b.target || a.constant != b.constant {
        return None;
    }
    match (&a.effect, &b.effect) {
        (a, b) if a == b => Some(0.0),
        (Effect::Curve { axis, curve }, Effect::Curve { axis: other, curve: second })
            if axis == other =>
        {
            Some(curve_difference(curve, second) / FINE_PER_NM)
        }
        (
            Effect::Wave { turns, phase, amplitude },
            Effect::Wave { turns: other, phase: second, amplitude: third },
        ) if amplitude == third => {
            let turned = turns.abs_diff(*other) as f64 / 2_f64.powi(64) * REACH
                + f64::from(phase.abs_diff(*second)) / 2_f64.powi(32);
            Some(f64::from(amplitude.0) / FINE_PER_NM * std::f64::consts::TAU * turned)
        }
        (
            Effect::Position { axis, gradient },
            Effect::Position { axis: other, gradient: second },
        ) if axis == other => Some(metre_of(*gradient, *second)),
        _ => None,
    }
}
