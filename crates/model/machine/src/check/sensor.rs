//! The displacement sensor: whether it can read what the file says, and in these units.

use super::warning::Warning;
use crate::{inputs::SensorInput, machine_file::Machine, sections::SensorModel};

/// A SIMATIC S7's analogue input gives this many counts at 10 V (its manual); the paper's controller, and
/// with it many examples, 32768.
pub(super) const S7_FULL_SCALE_COUNTS: f64 = 27_648.0;
/// Counts of a signed 16-bit input at full scale.
pub(super) const INT16_FULL_SCALE_COUNTS: f64 = 32_768.0;

/// The shortest and the longest measuring range of a displacement sensor in µm: capacitive ones begin at
/// 10 µm, and what measures more than 10 mm (eddy current, triangulation) does not fit a spindle nose.
const PLAUSIBLE_MEASURING_RANGE_UM: [f64; 2] = [10.0, 10_000.0];

pub(super) fn warnings(machine: &Machine) -> Vec<Warning> {
    let Some(model) = &machine.spindle.sensor else { return Vec::new() };
    let input = machine.inputs.as_ref().and_then(|inputs| inputs.sensor);
    let of_input = input.map(|input| {
        [
            zero_beyond_full_scale_warning(machine, model, &input),
            mismatched_full_scale_warning(machine, model, &input),
            implausible_range_warning(machine, model, &input),
        ]
    });
    negative_gain_warning(machine, model)
        .into_iter()
        .chain(of_input.into_iter().flatten().flatten())
        .collect()
}

fn zero_beyond_full_scale_warning(
    machine: &Machine,
    model: &SensorModel,
    input: &SensorInput,
) -> Option<Warning> {
    let SensorModel { zero_counts, .. } = model;
    if input.is_in_range(*zero_counts) {
        return None;
    }
    let full = input.counts_full_scale;
    Some(Warning::for_key(
        machine,
        "spindle.sensor.zero_counts",
        &format!("{zero_counts} is beyond full scale: the input gives 0 to {full} counts"),
        "write what the sensor reads when the machine is cold, in the counts of [inputs] sensor",
    ))
}

fn negative_gain_warning(machine: &Machine, model: &SensorModel) -> Option<Warning> {
    (model.um_per_count < 0.0).then(|| {
        Warning::for_key(
            machine,
            "spindle.sensor.um_per_count",
            &format!(
                "{} is negative: the spindle would shrink where the sensor's voltage rises",
                model.um_per_count
            ),
            "push the spindle with a finger: if the counts rise as the tool comes out, leave out the minus",
        )
    })
}

/// 500 µm over 27648 counts next to a full scale of 32768, or the other way round: the range of the sensor
/// is a round number by one of the two inputs, and not by the one that the file names.
fn mismatched_full_scale_warning(
    machine: &Machine,
    model: &SensorModel,
    input: &SensorInput,
) -> Option<Warning> {
    let other = match input.counts_full_scale {
        INT16_FULL_SCALE_COUNTS => S7_FULL_SCALE_COUNTS,
        S7_FULL_SCALE_COUNTS => INT16_FULL_SCALE_COUNTS,
        _ => return None,
    };
    let range_um = |counts: f64| model.um_per_count.abs() * counts;
    let (here_um, there_um) = (range_um(input.counts_full_scale), range_um(other));
    if is_round_range(here_um) || !is_round_range(there_um) {
        return None;
    }
    Some(Warning::for_key(
        machine,
        "inputs.sensor.counts_full_scale",
        &format!(
            "{} does not go with um_per_count = {}: the sensor's range would be {here_um:.1} µm, with \
             {other} counts at full scale it is {there_um:.0} µm",
            input.counts_full_scale, model.um_per_count
        ),
        "a SIMATIC S7 input reaches 10 V at 27648 counts, the paper's at 32768: write what yours does",
    ))
}

/// Returns whether a measuring range is one that stands on a data sheet: a multiple of 50 µm, to a part in 10 000.
/// One in a hundred ranges that are none is so by chance.
fn is_round_range(range_um: f64) -> bool {
    const RANGE_STEP_UM: f64 = 50.0;
    let nearest = (range_um / RANGE_STEP_UM).round() * RANGE_STEP_UM;
    nearest > 0.0 && (range_um - nearest).abs() <= 1e-4 * range_um
}

fn implausible_range_warning(
    machine: &Machine,
    model: &SensorModel,
    input: &SensorInput,
) -> Option<Warning> {
    let range_um = model.um_per_count.abs() * input.counts_full_scale;
    let [least, most] = PLAUSIBLE_MEASURING_RANGE_UM;
    if (least..=most).contains(&range_um) {
        return None;
    }
    Some(Warning::for_key(
        machine,
        "spindle.sensor.um_per_count",
        &format!(
            "{} makes a sensor of {range_um:.3} µm from 0 to full scale; they have {least} to {most}",
            model.um_per_count
        ),
        "write µm for one count: the sensor's range in µm, divided by counts_full_scale",
    ))
}
