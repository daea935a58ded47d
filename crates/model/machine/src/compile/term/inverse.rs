//! The board's terms back to `[[term]]` tables.
//!
//! A calibration does not know which of two causes with the same formula it came from: a form is
//! shown as the first of the list that has it, each wave on its own. A correction of the
//! machine's constants is shown there.

use trueup_core::{
    calibration::Calibration,
    fixed::Scaled,
    term::{Effect, Target, Term, Tilt, UNIT_STEP},
};

use super::{HEAT_SLOPE_M, LEVER_M, PARTS_OF_N, TWO_24, category, scaled};
use crate::{
    compile::{curve, inputs::column, lag, pitch, squareness::linear_inverse},
    effect::{self, Angle, CoolingAsymmetry, Heat, OnBoard, Quantity, SpeedHeat, heating},
    file,
    stored::{
        FINE_PER_UM, GRADIENT_PER_UM_PER_M, PER_KELVIN, UNITS_PER_MM, fewest_decimals, written,
    },
};

/// Returns the terms as a user writes them.
pub(in crate::compile) fn inverse(calibration: &Calibration<'_>) -> Vec<file::Term> {
    let terms = calibration.terms.iter().flatten().filter_map(term);
    falling(calibration).into_iter().chain(terms).collect()
}

/// Lags that fall at another rate than they rise.
fn falling(calibration: &Calibration<'_>) -> Vec<file::Term> {
    let spindle = calibration.spindle.temperature.map(|it| (it.smoothing, it.smoothing_falling));
    let axes = calibration
        .axes
        .iter()
        .map(|axis| axis.thermal.map(|it| (it.smoothing, it.smoothing_falling)));
    let mut terms = Vec::new();
    for (quantity, factors) in Quantity::ALL.into_iter().zip([spindle].into_iter().chain(axes)) {
        if let Some((rising, falling)) = factors
            && rising != falling
        {
            let time_constant_s = lag::written_time_constant_s(falling);
            let effect = file::Effect::CoolingAsymmetry(CoolingAsymmetry { time_constant_s });
            terms.push(file::Term { quantity, constant_um: 0.0, effect });
        }
    }
    terms
}

/// Returns the term as the first cause of the list that has its form.
fn term(term: &Term<'_>) -> Option<file::Term> {
    let own = match term.target {
        Target::Elongation => None,
        Target::Axis(axis) => Some(linear_inverse(axis)),
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
            column: column(*channel),
            um_per_c: number(*per_temperature, FINE_PER_UM / PER_KELVIN),
            time_constant_s: lag::written_time_constant_s(*smoothing),
            reference_c: written(reference.0, PER_KELVIN),
        }),
        Effect::HeatSlope { channel, smoothing, reference, per_temperature } => {
            OnBoard::HeatSlope(Heat {
                column: column(*channel),
                um_per_c: number(*per_temperature, HEAT_SLOPE_M * FINE_PER_UM / PER_KELVIN),
                time_constant_s: lag::written_time_constant_s(*smoothing),
                reference_c: written(reference.0, PER_KELVIN),
            })
        }
        Effect::SpeedHeat { power, smoothing, per_unit } => OnBoard::SpeedHeat(SpeedHeat {
            power: *power,
            um_per_unit: number(*per_unit, FINE_PER_UM * heating(*power, 1.0) / power.units()),
            time_constant_s: lag::written_time_constant_s(*smoothing),
        }),
        Effect::Time { smoothing, amplitude } => OnBoard::Time {
            amplitude_um: number(*amplitude, FINE_PER_UM / f64::from(UNIT_STEP)),
            time_constant_s: lag::written_time_constant_s(*smoothing),
            start_s: 0.0,
        },
        Effect::Speed(m) => OnBoard::Speed(number(*m, FINE_PER_UM / 1e6)),
        Effect::Load(m) => OnBoard::Load(number(*m, FINE_PER_UM / PARTS_OF_N)),
        Effect::Position { axis, gradient } => {
            let (axis, um_per_m) =
                (linear_inverse(*axis), written(gradient.0, GRADIENT_PER_UM_PER_M));
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
        Effect::Table(table) => OnBoard::Table(pitch::inverse(table)),
        Effect::Curve { axis, curve } => {
            OnBoard::Curve(linear_inverse(*axis), curve::inverse(curve))
        }
        Effect::TiltLine(it) => {
            let per_unit = GRADIENT_PER_UM_PER_M * LEVER_M;
            OnBoard::Tilt(tilt(own, it, Angle::Line(written(it.angle.0, per_unit))))
        }
        Effect::TiltCurve(it) => {
            let spline = curve::inverse_angle(&it.angle, LEVER_M);
            OnBoard::Tilt(tilt(own, it, Angle::Curve(spline)))
        }
        Effect::Tool(table) => category::tools_inverse(table),
        Effect::Condition(it) => category::condition_inverse(it),
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
    let effect = file::Effect::from_board(own, &form, &mut constant_um)?;
    Some(file::Term { quantity, constant_um, effect })
}

fn tilt<A>(own: Option<file::LinearAxis>, it: &Tilt<A>, angle: Angle) -> effect::Tilt {
    let along = Some(linear_inverse(it.along)).filter(|along| own != Some(*along));
    let origin_mm = written(it.origin.0, UNITS_PER_MM);
    effect::Tilt { along, lever: linear_inverse(it.lever), origin_mm, angle }
}

fn value(coefficient: Scaled) -> f64 {
    f64::from(coefficient.mantissa) / 2_f64.powi(coefficient.shift.into())
}

/// Returns whether `number` is stored as this coefficient.
fn is(number: f64, coefficient: Scaled) -> bool {
    scaled(number, 0.0).is_ok_and(|(stored, _)| stored == coefficient)
}

/// Returns what a user writes for a coefficient of which `per_unit` are one of the user's unit.
fn number(coefficient: Scaled, per_unit: f64) -> f64 {
    fewest_decimals(value(coefficient) / per_unit, |number| is(number * per_unit, coefficient))
}
