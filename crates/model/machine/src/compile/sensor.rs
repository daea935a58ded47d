//! The displacement sensor's law in reading units, with Z, S and K what is stored:
//!
//! ```text
//! Z = round(reading of V₀)
//! S = round(2²⁸ · nm per reading unit)
//! K = round(K₀ + (Z − V₀)·S/2²⁸)       V₀ exact: K takes up what rounding Z has moved
//! elongation in nm = K + (reading − Z)·S/2²⁸
//! ```
//!
//! The stored law is linear, as the model is, so the largest difference between the two over the
//! input range is at one of its ends. It is measured at both for every calibration and refused
//! above [`MAX_MODEL_DIFFERENCE_NM`]. Measured: 0 nm for the paper's sensor, whose constants are
//! exact here, and at most 0.506 nm over 200 000 random sensors with the zero reading in range, of
//! which 0.5 nm is K's rounding (`the_stored_law_is_within_0_51_nm_…`). When the board
//! runs the law, it adds the rounding of the reading (half a unit, 0.06 nm for the paper's sensor) and of
//! the result (half a nanometre).

use trueup_core::{
    displacement_sensor::{SensorLaw, SensorSlope},
    units::{Nanometres, READING_UNITS_PER_CODE, SensorReading},
};

use super::part_differences::MAX_MODEL_DIFFERENCE_NM;
use crate::{
    inputs::SensorInput,
    location::InputFileError,
    machine_file::Machine,
    model,
    sections::SensorModel,
    unit_conversion::{NM_PER_UM, round_to_i32},
};

const SENSOR_SLOPE_SCALE: f64 = (1_u64 << SensorSlope::FRACTION_BITS) as f64;

/// A slope that the board's integers hold as 0; a machine file must not state 0 itself.
pub(crate) const NEAR_ZERO_SLOPE_UM_PER_COUNT: f64 = 1e-12;

/// Returns the elongation in nm that `law` gives at full resolution: before the board rounds the reading
/// and the result.
#[must_use]
pub(crate) fn exact_elongation_nm(law: &SensorLaw, reading: f64) -> f64 {
    let slope_nm = f64::from(law.slope.0) / SENSOR_SLOPE_SCALE;
    f64::from(law.k0.0) + (reading - f64::from(law.zero.0)) * slope_nm
}

/// Returns the law, and its largest difference from the model in nm.
pub(super) fn compile(
    machine: &Machine,
    model: &SensorModel,
) -> Result<(SensorLaw, f64), InputFileError> {
    let Some(input) = machine.inputs.as_ref().and_then(|inputs| inputs.sensor) else {
        let rule = "is missing: the board must know how the sensor's counts reach it";
        return Err(machine.places.key_error("inputs.sensor", rule));
    };
    let readings_per_count = input.exact_reading_from_counts(1.0);
    let slope_nm = model.um_per_count * NM_PER_UM / readings_per_count;
    let zero_reading = input.exact_reading_from_counts(model.zero_counts);

    let slope = round_to_i32(slope_nm * SENSOR_SLOPE_SCALE).ok_or_else(|| {
        let rule = format!(
            "{} is {slope_nm:.3} nm for one of the board's reading units, which must be below 8: \
             at most {} µm a count with this input",
            model.um_per_count,
            8.0 * readings_per_count / NM_PER_UM
        );
        machine.places.key_error("spindle.sensor.um_per_count", rule)
    })?;
    let zero = round_to_i32(zero_reading).ok_or_else(|| {
        let rule = format!("{} is outside what the board can store", model.zero_counts);
        machine.places.key_error("spindle.sensor.zero_counts", rule)
    })?;
    let moved_by_zero = (f64::from(zero) - zero_reading) * (f64::from(slope) / SENSOR_SLOPE_SCALE);
    let k0 = round_to_i32(model.k0_um * NM_PER_UM + moved_by_zero).ok_or_else(|| {
        let rule = format!("{} is beyond the board's ±2147483 µm", model.k0_um);
        machine.places.key_error("spindle.sensor.k0_um", rule)
    })?;
    let law =
        SensorLaw { k0: Nanometres(k0), zero: SensorReading(zero), slope: SensorSlope(slope) };

    let largest_difference_nm = max_difference_nm(&law, model, &input);
    if largest_difference_nm > MAX_MODEL_DIFFERENCE_NM {
        let rule = format!(
            "{} is so far outside the input range that the board's law would be \
             {largest_difference_nm:.1} nm off, more than {MAX_MODEL_DIFFERENCE_NM} nm",
            model.zero_counts
        );
        return Err(machine.places.key_error("spindle.sensor.zero_counts", rule));
    }
    for counts in [0.0, input.counts_full_scale] {
        let elongation_um = model::elongation_um(model, counts);
        if round_to_i32(elongation_um * NM_PER_UM).is_none() {
            let rule = format!(
                "gives {elongation_um} µm at {counts} counts, beyond the board's ±2147483 µm"
            );
            return Err(machine.places.key_error("spindle.sensor", rule));
        }
    }
    Ok((law, largest_difference_nm))
}

/// At the ends of the input range, where a linear function is largest.
fn max_difference_nm(law: &SensorLaw, model: &SensorModel, input: &SensorInput) -> f64 {
    let difference = |counts: f64| {
        let stored = exact_elongation_nm(law, input.exact_reading_from_counts(counts));
        (stored - model::elongation_um(model, counts) * NM_PER_UM).abs()
    };
    difference(0.0).max(difference(input.counts_full_scale))
}

/// Returns the law in counts that are codes.
pub(super) fn decompile(law: &SensorLaw) -> SensorModel {
    let readings_per_count = f64::from(READING_UNITS_PER_CODE);
    let slope_nm = f64::from(law.slope.0) / SENSOR_SLOPE_SCALE;
    SensorModel {
        k0_um: f64::from(law.k0.0) / NM_PER_UM,
        zero_counts: f64::from(law.zero.0) / readings_per_count,
        um_per_count: match law.slope.0 {
            0 => NEAR_ZERO_SLOPE_UM_PER_COUNT,
            _ => slope_nm * readings_per_count / NM_PER_UM,
        },
        temperature: None,
    }
}
