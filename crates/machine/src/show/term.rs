//! The board's terms back to `[[term]]` tables.
//!
//! A calibration does not know which of two causes with the same formula it came from: a form is shown
//! as the first of the list that has it, each wave on its own.
//! What was corrected in the machine's constants is shown there.

use std::fmt::Write as _;

use trueup_core::{
    calibration::Calibration,
    cnc::LinearAxis,
    fixed::Scaled,
    term::{Effect, Target, Term, UNIT_STEP},
};

use super::{
    FINE_PER_NM, FINE_PER_UM, GRADIENT_PER_UM_PER_M, PER_KELVIN, UNITS_PER_MM, Written, column,
    curve_difference, fewest_decimals, is_smoothing, metre_of, read_curve, read_pitch,
    time_constant_s, written, written_time_constant_s,
};
use crate::{
    compile::term::{PARTS_OF_N, TWO_24, scaled},
    effect::{Heat, OnBoard, Quantity},
    file::{self, write::Edit},
};

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
    let axis_of = |axis: &LinearAxis| file::LinearAxis::ALL[*axis as usize];
    let own = match &term.target {
        Target::Elongation => None,
        Target::Axis(axis) => Some(axis_of(axis)),
    };
    let quantity = own.map_or(Quantity::Elongation, Quantity::of_axis);
    let mut constant_um = written(term.constant.0, FINE_PER_UM);
    let form = match &term.effect {
        Effect::Offset => OnBoard::Offset(0.0),
        Effect::Gain(m) => {
            OnBoard::Gain(fewest_decimals(1.0 + value(*m), |gain| is(gain - 1.0, *m)))
        }
        Effect::Curvature(m) => OnBoard::Curvature(number(*m, TWO_24 / FINE_PER_UM)),
        Effect::Saturation(limit) => OnBoard::Saturation(written(limit.0, FINE_PER_UM)),
        Effect::Heat { channel, smoothing, reference, per_temperature } => OnBoard::Heat(Heat {
            column: column(channel).to_string(),
            um_per_c: number(*per_temperature, FINE_PER_UM / PER_KELVIN),
            time_constant_s: written_time_constant_s(*smoothing),
            reference_c: written(reference.0, PER_KELVIN),
        }),
        Effect::Time { smoothing, amplitude } => OnBoard::Time {
            amplitude_um: number(*amplitude, FINE_PER_UM / f64::from(UNIT_STEP)),
            time_constant_s: written_time_constant_s(*smoothing),
            start_s: 0.0,
        },
        Effect::Speed(m) => OnBoard::Speed(number(*m, FINE_PER_UM / 1e6)),
        Effect::Load(m) => OnBoard::Load(number(*m, FINE_PER_UM / PARTS_OF_N)),
        Effect::Position { axis, gradient } => {
            let (axis, um_per_m) = (axis_of(axis), written(gradient.0, GRADIENT_PER_UM_PER_M));
            if own == Some(axis) {
                OnBoard::OwnPosition(um_per_m)
            } else {
                OnBoard::Position { axis, um_per_m }
            }
        }
        Effect::Reversed { width, gradient } => OnBoard::Reversed {
            width_um: written(width.0, FINE_PER_UM),
            um_per_m: written(gradient.0, GRADIENT_PER_UM_PER_M),
        },
        Effect::Table(pitch) => OnBoard::Table(read_pitch(pitch)),
        Effect::Curve { axis, curve } => OnBoard::Curve(axis_of(axis), read_curve(curve)),
        Effect::Wave { turns, phase, amplitude } => {
            let period_mm = 2_f64.powi(64) / (*turns as f64 * UNITS_PER_MM);
            OnBoard::Wave {
                period_mm: fewest_decimals(period_mm, |mm| {
                    (2_f64.powi(64) / (mm * UNITS_PER_MM)).round() == *turns as f64
                }),
                harmonic: 1,
                amplitude_um: written(amplitude.0, FINE_PER_UM),
                phase_deg: written(*phase, 2_f64.powi(32) / 360.0),
            }
        }
    };
    // Each form has a cause that it is shown as (tested).
    if let Some(effect) = file::Effect::from_board(own, &form, &mut constant_um) {
        let term = file::Term { quantity, constant_um, effect };
        let edit = Edit { appended: vec![term.section()], ..Edit::default() };
        write!(toml, "\n{}", edit.to_toml())?;
    }
    Ok(())
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
