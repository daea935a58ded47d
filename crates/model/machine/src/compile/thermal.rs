//! Laws over temperature: of an axis, of the spindle.

use trueup_core::{
    calibration::{AxisThermalModel, SpindleTemperatureModel},
    gradient::Gradient,
    thermal::{THERMAL_LAW_SEGMENT_SIZE, ThermalExpansionLaw, ThermalLawSegment},
    units::{FineNanometres, Position, Temperature},
};

use super::{curve::ErrorMessage, inputs::temperature_column_name, lag::decompile_time_constant_s};
use crate::{
    model,
    sections::{TemperatureModel, ThermalLaw, ThermalMode, ThermalRow},
    unit_conversion::{
        FINE_UNITS_PER_UM, GRADIENT_UNITS_PER_UM_PER_M, POSITION_UNITS_PER_MM,
        SLOPE_UNITS_PER_INVERSE_KELVIN, TEMPERATURE_UNITS_PER_KELVIN, round_to_i32, to_user_value,
    },
};

/// Within these temperatures a law is held against the model.
const CHECKED_TEMPERATURE_RANGE_C: (i32, i32) = (-20, 100);
/// So far from its origin.
const MAX_CHECKED_DISTANCE_MM: f64 = 15_000.0;

/// The pieces of a law.
pub(super) type ThermalLawSegments = Vec<[u8; THERMAL_LAW_SEGMENT_SIZE]>;

/// Returns a temperature in the board's unit.
pub(super) fn temperature_from_celsius(celsius: f64) -> Option<Temperature> {
    round_to_i32(celsius * f64::from(Temperature::PER_KELVIN)).map(Temperature)
}

/// Returns the law of an axis, and its largest difference from the model in nm.
pub(super) fn compile_axis_law(
    thermal: &ThermalLaw,
) -> Result<(ThermalLawSegments, f64), ErrorMessage> {
    let rows;
    let table: &[ThermalRow] = match &thermal.table {
        Some(table) => table,
        None => {
            rows = [
                ThermalRow {
                    temperature_c: thermal.reference_c,
                    constant_um: 0.0,
                    slope_um_per_m: 0.0,
                },
                ThermalRow {
                    temperature_c: thermal.reference_c + 1.0,
                    constant_um: thermal.constant_um_per_c,
                    slope_um_per_m: thermal.slope_um_per_m_per_c,
                },
            ];
            &rows
        }
    };
    let (has_constant, has_position) =
        (thermal.mode.has_constant_term(), thermal.mode.has_position_term());
    let masked = table.iter().map(|row| ThermalRow {
        temperature_c: row.temperature_c,
        constant_um: if has_constant { row.constant_um } else { 0.0 },
        slope_um_per_m: if has_position { row.slope_um_per_m } else { 0.0 },
    });
    let masked: Vec<ThermalRow> = masked.collect();
    let pieces = match thermal.table {
        Some(_) => encode_table_segments(&masked)?,
        // One straight line for all temperatures.
        None => vec![encode_law_segment(&masked[0], Some(&masked[1]))?],
    };
    let difference_nm = axis_law_difference_nm(thermal, &pieces);
    Ok((pieces, difference_nm))
}

/// Returns the law of a spindle's temperature: k·(T − T₀).
pub(super) fn compile_spindle_law(
    k_um_per_c: f64,
    reference_c: f64,
) -> Result<ThermalLawSegments, ErrorMessage> {
    let at =
        |temperature_c, constant_um| ThermalRow { temperature_c, constant_um, slope_um_per_m: 0.0 };
    let line = encode_law_segment(&at(reference_c, 0.0), Some(&at(reference_c + 1.0, k_um_per_c)))?;
    Ok(vec![line])
}

/// Returns a line from row to row; before the first and after the last their values are held.
fn encode_table_segments(rows: &[ThermalRow]) -> Result<ThermalLawSegments, ErrorMessage> {
    let (Some(first), Some(last)) = (rows.first(), rows.last()) else { return Ok(Vec::new()) };
    let mut pieces = vec![encode_law_segment(first, None)?];
    for pair in rows.windows(2) {
        pieces.push(encode_law_segment(&pair[0], Some(&pair[1]))?);
    }
    if rows.len() > 1 {
        pieces.push(encode_law_segment(last, None)?);
    }
    Ok(pieces)
}

/// From `row` on: towards `next`, or level.
fn encode_law_segment(
    row: &ThermalRow,
    next: Option<&ThermalRow>,
) -> Result<[u8; THERMAL_LAW_SEGMENT_SIZE], ErrorMessage> {
    let stored = |value: f64, what: &str, unit: &str, written: f64| {
        round_to_i32(value)
            .ok_or_else(|| format!("{what} {written} {unit} is more than the board can store"))
    };
    let slope = |of: fn(&ThermalRow) -> f64| {
        next.map_or(0.0, |next| (of(next) - of(row)) / (next.temperature_c - row.temperature_c))
    };
    let constant_slope = slope(|row| row.constant_um);
    let gradient_slope = slope(|row| row.slope_um_per_m);
    let start = temperature_from_celsius(row.temperature_c).ok_or_else(|| {
        format!("temperature {} °C is beyond the board's ±524 °C", row.temperature_c)
    })?;
    Ok(ThermalLawSegment {
        start,
        constant: FineNanometres(stored(
            row.constant_um * FINE_UNITS_PER_UM,
            "K0",
            "µm",
            row.constant_um,
        )?),
        constant_slope: stored(
            constant_slope * FINE_UNITS_PER_UM * SLOPE_UNITS_PER_INVERSE_KELVIN,
            "K0's slope",
            "µm/K",
            constant_slope,
        )?,
        gradient: Gradient(stored(
            row.slope_um_per_m * GRADIENT_UNITS_PER_UM_PER_M,
            "slope",
            "µm/m",
            row.slope_um_per_m,
        )?),
        gradient_slope: stored(
            gradient_slope * GRADIENT_UNITS_PER_UM_PER_M * SLOPE_UNITS_PER_INVERSE_KELVIN,
            "slope",
            "µm/m per K",
            gradient_slope,
        )?,
    }
    .to_bytes())
}

/// At every quarter of a kelvin, and 15 m to either side of the origin where the board's lengths
/// reach so far.
fn axis_law_difference_nm(thermal: &ThermalLaw, pieces: &ThermalLawSegments) -> f64 {
    let law = ThermalExpansionLaw { pieces };
    let mut worst: f64 = 0.0;
    for quarter in CHECKED_TEMPERATURE_RANGE_C.0 * 4..=CHECKED_TEMPERATURE_RANGE_C.1 * 4 {
        let celsius = f64::from(quarter) / 4.0;
        let Some(t) = temperature_from_celsius(celsius) else { continue };
        let (constant, gradient) = law.evaluate(t);
        let exact =
            |mm: f64| model::thermal_error_um(thermal, celsius, thermal.origin_mm + mm) * 1_000.0;
        let board = |mm: f64| {
            let units = mm * f64::from(Position::PER_MILLIMETRE);
            f64::from(constant.0) / f64::from(FineNanometres::PER_NANOMETRE)
                + f64::from(gradient.0) * units / (1_u64 << Gradient::FRACTION_BITS) as f64
        };
        for mm in [0.0, MAX_CHECKED_DISTANCE_MM, -MAX_CHECKED_DISTANCE_MM] {
            // A gradient that is held at its largest belongs to errors beyond any limit.
            if exact(mm).abs() < 8_000_000.0 {
                worst = worst.max((board(mm) - exact(mm)).abs());
            }
        }
    }
    worst
}

/// Returns the law of a spindle's temperature as a user writes it.
pub(super) fn decompile_spindle_temperature(
    temperature: &SpindleTemperatureModel<'_>,
) -> TemperatureModel {
    let piece =
        temperature.law.pieces.first().map(ThermalLawSegment::from_bytes).unwrap_or_default();
    TemperatureModel {
        sensor: temperature_column_name(temperature.channel),
        reference_c: to_user_value(piece.start.0, TEMPERATURE_UNITS_PER_KELVIN),
        k_um_per_c: to_user_value(
            piece.constant_slope,
            FINE_UNITS_PER_UM * SLOPE_UNITS_PER_INVERSE_KELVIN,
        ),
        lag_s: decompile_time_constant_s(temperature.smoothing),
    }
}

/// Returns the law of an axis as a user writes it.
pub(super) fn decompile_axis_thermal(thermal: &AxisThermalModel<'_>) -> ThermalLaw {
    let pieces: Vec<ThermalLawSegment> =
        thermal.law.pieces.iter().map(ThermalLawSegment::from_bytes).collect();
    let has_constant = pieces
        .iter()
        .any(|piece| piece.constant != FineNanometres::ZERO || piece.constant_slope != 0);
    let mode = match (has_constant, thermal.law.depends_on_position()) {
        (true, true) => ThermalMode::Both,
        (true, false) => ThermalMode::Constant,
        (false, _) => ThermalMode::Position,
    };
    let first = pieces.first().copied().unwrap_or_default();
    let starts_at_zero = first.constant == FineNanometres::ZERO && first.gradient == Gradient::ZERO;
    let mut axis = ThermalLaw {
        mode,
        sensor: temperature_column_name(thermal.channel),
        reference_c: 0.0,
        constant_um_per_c: 0.0,
        slope_um_per_m_per_c: 0.0,
        origin_mm: to_user_value(thermal.origin.0, POSITION_UNITS_PER_MM),
        lag_s: decompile_time_constant_s(thermal.smoothing),
        table: None,
    };
    if pieces.len() > 1 || !starts_at_zero {
        // The first of several holds what is below the first row.
        let rows = pieces.get(1..).filter(|rows| !rows.is_empty()).unwrap_or(&pieces);
        let row = |row: &ThermalLawSegment| ThermalRow {
            temperature_c: to_user_value(row.start.0, TEMPERATURE_UNITS_PER_KELVIN),
            constant_um: to_user_value(row.constant.0, FINE_UNITS_PER_UM),
            slope_um_per_m: to_user_value(row.gradient.0, GRADIENT_UNITS_PER_UM_PER_M),
        };
        axis.table = Some(rows.iter().map(row).collect());
    } else {
        axis.reference_c = to_user_value(first.start.0, TEMPERATURE_UNITS_PER_KELVIN);
        axis.constant_um_per_c =
            to_user_value(first.constant_slope, FINE_UNITS_PER_UM * SLOPE_UNITS_PER_INVERSE_KELVIN);
        axis.slope_um_per_m_per_c = to_user_value(
            first.gradient_slope,
            GRADIENT_UNITS_PER_UM_PER_M * SLOPE_UNITS_PER_INVERSE_KELVIN,
        );
    }
    axis
}
