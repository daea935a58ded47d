//! The board's terms back to `[[term]]` tables.
//!
//! A calibration does not know which of two causes with the same formula it came from: a form is
//! shown as the first of the list that has it, each wave on its own. A correction of the
//! machine's constants is shown there.

use trueup_core::{
    calibration::Calibration,
    fixed_point::ScaledCoefficient,
    term::{Effect, Target, Term, Tilt, UNIT_STEP},
    units::FineNanometres,
};

use super::{
    HEAT_SLOPE_REFERENCE_M, LOAD_UNITS_PER_NEWTON, ONE_Q24, REFERENCE_LEVER_M, category,
    compile_coefficient,
};
use crate::{
    compile::{
        curve, inputs::temperature_column_name, lag, pitch, squareness::linear_axis_from_board,
    },
    effect::{
        self, BoardTerm, CoolingAsymmetry, Quantity, SpeedHeatResponse, TemperatureResponse,
        relative_heat_input,
    },
    machine_file,
    sections::AngleProfile,
    unit_conversion::{
        FINE_UNITS_PER_UM, GRADIENT_UNITS_PER_UM_PER_M, POSITION_UNITS_PER_MM,
        TEMPERATURE_UNITS_PER_KELVIN, shortest_decimal, to_user_value,
    },
};

/// Returns the terms as a user writes them.
pub(in crate::compile) fn decompile(calibration: &Calibration<'_>) -> Vec<machine_file::Term> {
    let terms = calibration.terms.iter().flatten().filter_map(decompile_term);
    decompile_cooling_asymmetry_terms(calibration).into_iter().chain(terms).collect()
}

/// Lags that fall at another rate than they rise.
fn decompile_cooling_asymmetry_terms(calibration: &Calibration<'_>) -> Vec<machine_file::Term> {
    let spindle = calibration
        .spindle
        .temperature
        .map(|temperature| (temperature.smoothing, temperature.smoothing_falling));
    let axes = calibration
        .axes
        .iter()
        .map(|axis| axis.thermal.map(|thermal| (thermal.smoothing, thermal.smoothing_falling)));
    let mut terms = Vec::new();
    for (quantity, factors) in Quantity::ALL.into_iter().zip([spindle].into_iter().chain(axes)) {
        if let Some((rising, falling)) = factors
            && rising != falling
        {
            let time_constant_s = lag::decompile_time_constant_s(falling);
            let effect = effect::Effect::CoolingAsymmetry(CoolingAsymmetry { time_constant_s });
            terms.push(machine_file::Term { quantity, constant_um: 0.0, effect });
        }
    }
    terms
}

/// Returns the term as the first cause of the list that has its form.
fn decompile_term(term: &Term<'_>) -> Option<machine_file::Term> {
    let own = match term.target {
        Target::Elongation => None,
        Target::Axis(axis) => Some(linear_axis_from_board(axis)),
    };
    let quantity = own.map_or(Quantity::Elongation, Quantity::from_axis);
    let mut constant_um = to_user_value(term.constant.0, FINE_UNITS_PER_UM);
    let form = match &term.effect {
        Effect::Offset => BoardTerm::Offset(0.0),
        Effect::Gain(m) => BoardTerm::Gain(shortest_decimal(1.0 + coefficient_value(*m), |gain| {
            is_stored_as(gain - 1.0, *m)
        })),
        Effect::Curvature(m) => {
            BoardTerm::Curvature(decompile_coefficient(*m, ONE_Q24 / FINE_UNITS_PER_UM))
        }
        Effect::Saturation(limit) => {
            BoardTerm::Saturation(to_user_value(limit.0, FINE_UNITS_PER_UM))
        }
        Effect::Heat { channel, smoothing, reference, per_temperature } => {
            let per_unit = FINE_UNITS_PER_UM / TEMPERATURE_UNITS_PER_KELVIN;
            BoardTerm::Heat(TemperatureResponse {
                column: temperature_column_name(*channel),
                um_per_c: decompile_coefficient(*per_temperature, per_unit),
                time_constant_s: lag::decompile_time_constant_s(*smoothing),
                reference_c: to_user_value(reference.0, TEMPERATURE_UNITS_PER_KELVIN),
            })
        }
        Effect::HeatSlope { channel, smoothing, reference, per_temperature } => {
            let per_unit =
                HEAT_SLOPE_REFERENCE_M * FINE_UNITS_PER_UM / TEMPERATURE_UNITS_PER_KELVIN;
            BoardTerm::HeatSlope(TemperatureResponse {
                column: temperature_column_name(*channel),
                um_per_c: decompile_coefficient(*per_temperature, per_unit),
                time_constant_s: lag::decompile_time_constant_s(*smoothing),
                reference_c: to_user_value(reference.0, TEMPERATURE_UNITS_PER_KELVIN),
            })
        }
        Effect::SpeedHeat { power, smoothing, per_unit } => {
            BoardTerm::SpeedHeat(SpeedHeatResponse {
                power: *power,
                um_per_unit: decompile_coefficient(
                    *per_unit,
                    FINE_UNITS_PER_UM * relative_heat_input(*power, 1.0)
                        / power.input_units_per_speed_power(),
                ),
                time_constant_s: lag::decompile_time_constant_s(*smoothing),
            })
        }
        Effect::Time { smoothing, amplitude } => BoardTerm::Time {
            amplitude_um: decompile_coefficient(
                *amplitude,
                FINE_UNITS_PER_UM / f64::from(UNIT_STEP),
            ),
            time_constant_s: lag::decompile_time_constant_s(*smoothing),
            start_s: 0.0,
        },
        Effect::Speed(m) => BoardTerm::Speed(decompile_coefficient(*m, FINE_UNITS_PER_UM / 1e6)),
        Effect::Load(m) => {
            BoardTerm::Load(decompile_coefficient(*m, FINE_UNITS_PER_UM / LOAD_UNITS_PER_NEWTON))
        }
        Effect::Position { axis, gradient } => {
            let (axis, um_per_m) = (
                linear_axis_from_board(*axis),
                to_user_value(gradient.0, GRADIENT_UNITS_PER_UM_PER_M),
            );
            if own == Some(axis) {
                BoardTerm::OwnPosition(um_per_m)
            } else {
                BoardTerm::Position { axis, um_per_m }
            }
        }
        Effect::Reversed { width, gradient } => BoardTerm::Reversed {
            width_um: to_user_value(width.0, FINE_UNITS_PER_UM),
            um_per_m: to_user_value(gradient.0, GRADIENT_UNITS_PER_UM_PER_M),
        },
        Effect::Table(table) => BoardTerm::Table(pitch::decompile(table)),
        Effect::Curve { axis, curve } => {
            BoardTerm::Curve(linear_axis_from_board(*axis), curve::decompile(curve))
        }
        Effect::TiltLine(it) => {
            let per_unit = GRADIENT_UNITS_PER_UM_PER_M * REFERENCE_LEVER_M;
            let angle = AngleProfile::Line(to_user_value(it.angle.0, per_unit));
            BoardTerm::Tilt(decompile_tilt(own, it, angle))
        }
        Effect::TiltCurve(it) => {
            let spline = curve::decompile_angle(&it.angle, REFERENCE_LEVER_M);
            BoardTerm::Tilt(decompile_tilt(own, it, AngleProfile::Curve(spline)))
        }
        Effect::Tool(table) => category::decompile_tool_table(table),
        Effect::Condition(it) => category::decompile_condition_levels(it),
        Effect::Wave { turns, phase, amplitude } => decompile_wave(*turns, *phase, *amplitude),
    };
    // Each form has a cause that it is shown as (tested).
    let effect = effect::Effect::from_board(own, &form, &mut constant_um)?;
    Some(machine_file::Term { quantity, constant_um, effect })
}

/// Returns the form of a wave of `turns` in 2⁻⁶⁴ turns over the position unit and of `phase` in 2⁻³² turns.
fn decompile_wave(turns: u64, phase: u32, amplitude: FineNanometres) -> BoardTerm {
    let period_mm = 2_f64.powi(64) / (turns as f64 * POSITION_UNITS_PER_MM);
    BoardTerm::Wave {
        period_mm: shortest_decimal(period_mm, |mm| {
            (2_f64.powi(64) / (mm * POSITION_UNITS_PER_MM)).round() == turns as f64
        }),
        harmonic: 1,
        amplitude_um: to_user_value(amplitude.0, FINE_UNITS_PER_UM),
        phase_deg: to_user_value(phase, 2_f64.powi(32) / 360.0),
    }
}

fn decompile_tilt<A>(
    own: Option<machine_file::LinearAxis>,
    it: &Tilt<A>,
    angle: AngleProfile,
) -> effect::Tilt {
    let along = Some(linear_axis_from_board(it.along)).filter(|along| own != Some(*along));
    let origin_mm = to_user_value(it.origin.0, POSITION_UNITS_PER_MM);
    effect::Tilt { along, lever: linear_axis_from_board(it.lever), origin_mm, angle }
}

fn coefficient_value(coefficient: ScaledCoefficient) -> f64 {
    f64::from(coefficient.mantissa) / 2_f64.powi(coefficient.shift.into())
}

/// Returns whether `number` is stored as this coefficient.
fn is_stored_as(number: f64, coefficient: ScaledCoefficient) -> bool {
    compile_coefficient(number, 0.0).is_ok_and(|(stored, _)| stored == coefficient)
}

/// Returns what a user writes for a coefficient of which `per_unit` are one of the user's unit.
fn decompile_coefficient(coefficient: ScaledCoefficient, per_unit: f64) -> f64 {
    shortest_decimal(coefficient_value(coefficient) / per_unit, |number| {
        is_stored_as(number * per_unit, coefficient)
    })
}
