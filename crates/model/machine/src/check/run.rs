//! The columns of a run, held against the machine file: volts, the end of an input, the travel, the size and the
//! sign of what was measured.

use super::{
    geometry,
    plausibility::{self, ImplausibleValue, Plausibility},
    sensor::{INT16_FULL_SCALE_COUNTS, S7_FULL_SCALE_COUNTS},
    warning::Warning,
};
use crate::{
    effect::Quantity,
    machine_file::Machine,
    predict::RunPredictor,
    run_file::{RunColumn, RunFile},
    sections::LinearAxis,
};

/// Measured and predicted are in units a thousand (or a million) apart where the line through both has a
/// slope within a factor of two of it …
const MAX_SLOPE_RATIO: f64 = 2.0;
/// … and explains more than half of what was measured: noise does not follow a prediction.
const MIN_R_SQUARED: f64 = 0.5;

/// Rows that a statement about a whole column needs: of three values in the wrong unit none is in the right
/// one by chance.
const MIN_COLUMN_ROWS: usize = 3;

/// This many rows are held against the model: a long run need not be predicted whole to know its unit.
const MAX_CHECKED_ROWS: usize = 10_000;

/// Largest output of a sensor, in V: 10 V, and a tenth more where it overruns.
const MAX_SENSOR_VOLTS: f64 = 11.0;

pub(super) fn warnings(run: &RunFile, machine: Option<&Machine>) -> Vec<Warning> {
    let mut warnings = Vec::new();
    if let Some(column) = run.columns().iter().find(|column| column.name == "sensor_counts") {
        warnings.extend(machine.and_then(|machine| s7_full_scale_warning(run, column, machine)));
    }
    if let Some(machine) = machine {
        warnings.extend(outside_travel_warnings(run, machine));
        warnings.extend(
            find_model_mismatches(run, machine)
                .into_iter()
                .filter(|comparison| !comparison.is_unit)
                .map(|comparison| comparison.warning),
        );
    }
    warnings
}

/// Returns the columns that look like another unit next to the machine file.
pub(super) fn find_implausible_columns(
    run: &RunFile,
    machine: Option<&Machine>,
) -> Vec<ImplausibleValue> {
    let of_sensor = run.columns().iter().find(|column| column.name == "sensor_counts");
    let volts =
        of_sensor.and_then(|column| Some(("sensor_counts".into(), voltage_warning(run, column)?)));
    // A file that no machine has says nothing of the run's units.
    let is_sound = |machine: &&Machine| {
        plausibility::find_implausible_values(machine)
            .iter()
            .all(|finding| finding.grade != Plausibility::Impossible)
    };
    let of_machine = machine.filter(is_sound).into_iter().flat_map(|machine| {
        let units =
            find_model_mismatches(run, machine).into_iter().filter(|comparison| comparison.is_unit);
        units
            .map(|comparison| (comparison.column, comparison.warning))
            .chain(position_unit_warnings(run, machine))
    });
    let finding = |(key, warning)| ImplausibleValue { key, grade: Plausibility::Unlikely, warning };
    volts.into_iter().chain(of_machine).map(finding).collect()
}

fn known_values(column: &RunColumn) -> impl Iterator<Item = f64> {
    column.values.iter().copied().filter(|value| !value.is_nan())
}

/// Returns the least and the most of a column with values enough.
fn value_range(column: &RunColumn) -> Option<[f64; 2]> {
    let (mut range, mut rows) = ([f64::INFINITY, f64::NEG_INFINITY], 0);
    for value in known_values(column) {
        range = [range[0].min(value), range[1].max(value)];
        rows += 1;
    }
    (rows >= MIN_COLUMN_ROWS).then_some(range)
}

fn column_warning(run: &RunFile, column: &str, what: &str, help: impl Into<String>) -> Warning {
    let row = run.column(column).and_then(|values| values.iter().position(|value| !value.is_nan()));
    let place = run.value_location(row.unwrap_or(0), column);
    Warning { place, what: format!("{column} {what}"), help: help.into() }
}

fn voltage_warning(run: &RunFile, column: &RunColumn) -> Option<Warning> {
    let [least, most] = value_range(column)?;
    let has_fraction = known_values(column).any(|value| value.fract() != 0.0);
    (has_fraction && least >= 0.0 && most <= MAX_SENSOR_VOLTS && most > 0.0).then(|| {
        let what = format!("is from {least} to {most}: that looks like volts, not counts");
        let help = "counts = V · counts_full_scale / volts_full_scale of [inputs] sensor";
        column_warning(run, &column.name, &what, help)
    })
}

/// Readings that pile up at 27648 where the file's full scale is 32768: the input ends there.
fn s7_full_scale_warning(run: &RunFile, column: &RunColumn, machine: &Machine) -> Option<Warning> {
    let input = machine.inputs.as_ref()?.sensor?;
    let [_, most] = value_range(column)?;
    let at_end = known_values(column).filter(|&value| value == S7_FULL_SCALE_COUNTS).count();
    (input.counts_full_scale == INT16_FULL_SCALE_COUNTS && most == S7_FULL_SCALE_COUNTS && at_end >= MIN_COLUMN_ROWS).then(|| {
        let what = format!(
            "ends at {S7_FULL_SCALE_COUNTS} in {at_end} rows, and the machine file's counts_full_scale is {INT16_FULL_SCALE_COUNTS}"
        );
        let help = "a SIMATIC S7 input reaches 10 V at 27648 counts: write counts_full_scale = 27648";
        column_warning(run, &column.name, &what, help)
    })
}

/// Returns the positions of each axis that the machine file has a travel of: their column, range and travel.
fn axis_travels(run: &RunFile, machine: &Machine) -> Vec<(String, [f64; 2], [f64; 2])> {
    let axes = LinearAxis::ALL.into_iter().filter_map(|axis| {
        let travel_mm = machine.axes[axis.index()].travel_mm?;
        let name = axis.column_name();
        let column = run.columns().iter().find(|column| column.name == name)?;
        Some((name, value_range(column)?, travel_mm))
    });
    axes.collect()
}

/// Positions in another unit.
fn position_unit_warnings(run: &RunFile, machine: &Machine) -> Vec<(String, Warning)> {
    let axes = axis_travels(run, machine).into_iter().filter_map(|(name, [least, most], [low, high])| {
        let unit = suspected_position_unit([least, most], [low, high])?;
        let what = format!(
            "is from {least} to {most}, and the travel_mm of the machine file {low} to {high}: it looks like {unit}, not mm"
        );
        let warning = column_warning(run, &name, &what, "positions are in mm");
        Some((name, warning))
    });
    axes.collect()
}

/// Positions that the axis cannot have.
fn outside_travel_warnings(run: &RunFile, machine: &Machine) -> Vec<Warning> {
    let axes = axis_travels(run, machine).into_iter().filter_map(|(name, [least, most], [low, high])| {
        let spare_mm = geometry::OVERTRAVEL_FRACTION * (high - low);
        if suspected_position_unit([least, most], [low, high]).is_some() {
            return None;
        }
        (least < low - spare_mm || most > high + spare_mm).then(|| {
            let what = format!(
                "is from {least} to {most} mm, outside the travel_mm of the machine file, {low} to {high}"
            );
            column_warning(run, &name, &what, "positions are those of the machine's own coordinates, in mm")
        })
    });
    axes.collect()
}

/// Returns the unit in which positions go from one end of the travel to the other; `None` where that is mm, or they do
/// not.
fn suspected_position_unit(range: [f64; 2], travel_mm: [f64; 2]) -> Option<&'static str> {
    const FULL_TRAVEL_RATIO_RANGE: std::ops::RangeInclusive<f64> = 0.8..=1.02;
    let length = |[low, high]: [f64; 2]| high - low;
    let share = |mm_per_unit: f64| length(range) * mm_per_unit / length(travel_mm);
    let is_within = |mm_per_unit: f64| {
        let spare_mm = geometry::OVERTRAVEL_FRACTION * length(travel_mm);
        range[0] * mm_per_unit >= travel_mm[0] - spare_mm
            && range[1] * mm_per_unit <= travel_mm[1] + spare_mm
    };
    let units = [(1e3, "m"), (25.4, "inches"), (1e-3, "µm")].into_iter();
    let mut whole =
        units.filter(|(mm, _)| FULL_TRAVEL_RATIO_RANGE.contains(&share(*mm)) && is_within(*mm));
    whole.next().map(|(_, unit)| unit)
}

/// A column that is the predicted one times a factor.
struct ModelMismatch {
    column: String,
    warning: Warning,
    /// The factor is that of a unit, not of a sign.
    is_unit: bool,
}

/// Returns what was measured compared with what the model says: the same curve, a thousand times as large or as small,
/// or minus it.
fn find_model_mismatches(run: &RunFile, machine: &Machine) -> Vec<ModelMismatch> {
    let names = Quantity::ALL.map(|quantity| format!("measured_{}_um", quantity.name()));
    if names.iter().all(|name| run.column(name).is_none()) {
        return Vec::new();
    }
    // What a bridge has corrected is measured without what the model predicts.
    if run.column("quality").is_some() {
        return Vec::new();
    }
    let first = run.with_altered_values(MAX_CHECKED_ROWS, |_, _| {});
    let Ok(predictor) = RunPredictor::new(machine, &first) else { return Vec::new() };
    let predicted: Vec<[f64; 4]> =
        predictor.model_values().map(|values| values.to_array()).collect();
    let units = names.iter().enumerate().filter_map(|(number, name)| {
        let measured = run.column(name)?;
        let pairs = predicted.iter().zip(measured).map(|(row, um)| (row[number], *um));
        let slope = regression_slope(pairs.filter(|(a, b)| !a.is_nan() && !b.is_nan()))?;
        if (-MAX_SLOPE_RATIO..=-1.0 / MAX_SLOPE_RATIO).contains(&slope) {
            let what = "is minus what the machine file predicts: the sign is that of an error measured the other \
                        way round (errors are actual minus commanded)";
            let help = "look at one reading: where the machine goes too far, the error must be \
                positive. An elongation is positive where the tool comes out of the spindle";
            let warning = column_warning(run, name, what, help);
            return Some(ModelMismatch { column: name.clone(), warning, is_unit: false });
        }
        let is_near =
            |factor: f64| (factor / MAX_SLOPE_RATIO..=factor * MAX_SLOPE_RATIO).contains(&slope);
        let (unit, how) = [
            (1e-3, ("mm", "a thousandth")),
            (1e-6, ("m", "a millionth")),
            (1e3, ("nm", "a thousand times")),
            (1.0 / 25_400.0, ("inches", "a 25 000th")),
            (1.0 / 25.4, ("thousandths of an inch", "a 25th")),
        ]
        .into_iter()
        .find_map(|(factor, words)| is_near(factor).then_some(words))?;
        let what =
            format!("is {how} of what the machine file predicts: it looks like {unit}, not µm");
        let help = "write it in µm, or look for the unit in the machine file";
        Some(ModelMismatch { column: name.clone(), warning: column_warning(run, name, &what, help), is_unit: true })
    });
    units.collect()
}

/// Returns the slope of the line through pairs (predicted, measured), where it explains more than half of the
/// latter; `None` where there is nothing to compare.
fn regression_slope(pairs: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let pairs: Vec<(f64, f64)> = pairs.collect();
    if pairs.len() < MIN_COLUMN_ROWS {
        return None;
    }
    let count = pairs.len() as f64;
    let (sum_x, sum_y) = pairs.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + x, b + y));
    let (mean_x, mean_y) = (sum_x / count, sum_y / count);
    let [mut xx, mut xy, mut yy] = [0.0; 3];
    for (x, y) in pairs.iter().map(|(x, y)| (x - mean_x, y - mean_y)) {
        xx += x * x;
        xy += x * y;
        yy += y * y;
    }
    (xx > 0.0 && yy > 0.0 && xy * xy > MIN_R_SQUARED * xx * yy).then(|| xy / xx)
}
