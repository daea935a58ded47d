//! A run as constants are made of it: without what a thermometer shows for a fault, and with the directions of
//! approach that its positions imply.
//!
//! | step | does |
//! |---|---|
//! | faults | a fault value of a thermometer becomes a missing one ([`crate::thermometer_faults`]) |
//! | directions | where `dir_x` is missing and `x_mm` sweeps there and back, it is derived; Y and Z as well |
//!
//! Each step is reported with its place: nothing is left out, and nothing added, in silence.

use crate::{
    check::Warning,
    keys::reader::is_temperature_column,
    location::Location,
    machine_file::Machine,
    run_file::RunFile,
    sections::LinearAxis,
    thermometer_faults::{MAX_ROW_GAP_S, ThermometerFault, find_thermometer_faults},
};

/// A column of which more than this share is fault values is left unchanged: then it is no temperature at all,
/// which the units of its values show.
const MAX_FAULT_FRACTION: f64 = 0.5;
/// A step over more than this many of the usual rows is a pause.
const MAX_ORDINARY_ROW_INTERVALS: f64 = 2.0;
/// Positions fall as often as they rise if the rarer of the two is at least this share of the other: a
/// sweep back may have fewer targets, or be cut off.
const MIN_DIRECTION_RATIO: f64 = 0.5;
/// Rows of a sweep, on average. Positions in no order turn in two of three rows, and say nothing of how they
/// were approached.
const MIN_MEAN_SWEEP_ROWS: f64 = 3.0;

/// Returns `run` with both steps done, and what is reported of them.
#[must_use]
pub fn preprocess_run(run: RunFile, machine: Option<&Machine>) -> (RunFile, Vec<Warning>) {
    let (run, mut warnings) = without_fault_values(run);
    let (run, derived) = with_approach_directions(run, machine);
    warnings.extend(derived);
    (run, warnings)
}

/// Returns `run` with a missing value for each fault value of a thermometer, and what was excluded: how often
/// which column shows which value, and where first.
#[must_use]
pub fn without_fault_values(mut run: RunFile) -> (RunFile, Vec<Warning>) {
    let (follows, near) = classify_row_gaps(&run);
    let mut warnings = Vec::new();
    let thermometers = run.columns().iter().filter(|column| is_temperature_column(&column.name));
    let found: Vec<(String, Vec<usize>)> = thermometers
        .map(|column| {
            let absent = find_thermometer_faults(&column.values, &follows, &near).into_iter();
            let rows = absent.flat_map(|fault| match fault {
                ThermometerFault::Absent { rows, .. } => rows,
                ThermometerFault::Frozen { .. } | ThermometerFault::Jump { .. } => Vec::new(),
            });
            let mut rows: Vec<usize> = rows.flatten().collect();
            rows.sort_unstable();
            (column.name.clone(), rows)
        })
        .collect();
    for (name, rows) in found {
        let Some(values) = run.column(&name) else { continue };
        if rows.is_empty() || rows.len() as f64 > MAX_FAULT_FRACTION * values.len() as f64 {
            continue;
        }
        let mut cleaned = values.to_vec();
        // Value, rows, and the first of them.
        let mut shown: Vec<(f64, usize, usize)> = Vec::new();
        for &row in &rows {
            match shown.iter_mut().find(|(value, ..)| *value == values[row]) {
                Some((_, count, _)) => *count += 1,
                None => shown.push((values[row], 1, row)),
            }
            cleaned[row] = f64::NAN;
        }
        for (value, count, first) in shown {
            let place = run.value_location(first, &name);
            let rows = if count == 1 { "1 row".to_string() } else { format!("{count} rows") };
            let what = format!(
                "{name} shows {value} in {rows} (first in line {}), as a thermometer with a fault does: excluded",
                place.line
            );
            let help =
                "look at its plug and its cable; leave the cell empty where nothing was measured";
            warnings.push(Warning { place, what, help: help.into() });
        }
        run.replace_column(&name, cleaned);
    }
    (run, warnings)
}

/// By row: whether it is an ordinary time after the one before, and whether at most [`MAX_ROW_GAP_S`].
fn classify_row_gaps(run: &RunFile) -> (Vec<bool>, Vec<bool>) {
    let (time_s, number) = (run.column("time_s"), run.column("run"));
    let apart = |row: usize| time_s.map_or(f64::NAN, |time_s| time_s[row] - time_s[row - 1]);
    let mut all: Vec<f64> = (1..run.row_count()).map(apart).filter(|s| *s > 0.0).collect();
    all.sort_unstable_by(f64::total_cmp);
    let usual_s = all.get(all.len() / 2).copied();
    let is_new_run = |row: usize| {
        time_s.is_none()
            && number.is_some_and(|number| {
                number[row] != number[row - 1]
                    && !(number[row].is_nan() && number[row - 1].is_nan())
            })
    };
    let follows = |row: usize| {
        let is_pause =
            usual_s.is_some_and(|usual_s| apart(row) > MAX_ORDINARY_ROW_INTERVALS * usual_s);
        !(apart(row) < 0.0 || is_new_run(row) || is_pause)
    };
    let rows = || 0..run.row_count();
    let near = |row: usize| is_near_in_time(apart(row)) && !is_new_run(row);
    (
        rows().map(|row| row > 0 && follows(row)).collect(),
        rows().map(|row| row > 0 && near(row)).collect(),
    )
}

/// Returns whether rows so far apart are near; where a time is missing, nothing says that they are not.
fn is_near_in_time(apart_s: f64) -> bool {
    apart_s.is_nan() || (0.0..=MAX_ROW_GAP_S).contains(&apart_s)
}

/// Returns `run` with the directions of approach that its positions imply, where they are missing and the
/// positions go there and back; says so. Where positions are in no order it only says that they are missing, if
/// `machine` has an axis that depends on them.
#[must_use]
pub fn with_approach_directions(
    mut run: RunFile,
    machine: Option<&Machine>,
) -> (RunFile, Vec<Warning>) {
    let mut warnings = Vec::new();
    for axis in LinearAxis::ALL {
        let (position, direction) = (axis.column_name(), format!("dir_{}", axis.name()));
        let Some(values) = run.column(&position).filter(|_| run.column(&direction).is_none())
        else {
            continue;
        };
        let Some(sweeps) = BidirectionalSweeps::from_positions(values, run.column("run")) else {
            continue;
        };
        let is_needed = machine.is_some_and(|machine| depends_on_approach_direction(machine, axis));
        let is_measured = run.column(&format!("measured_d{}_um", axis.name())).is_some();
        let is_derived = sweeps.mean_rows >= MIN_MEAN_SWEEP_ROWS && (is_needed || is_measured);
        if !is_derived && !is_needed {
            continue;
        }
        let place =
            Location { column: run.value_location(0, &position).column, ..run.header_location() };
        let missing = format!("{direction} is missing: {position} falls as often as it rises");
        let what = match is_derived {
            true => format!(
                "{missing}. It is derived from {position}: +1 where that rises, −1 where it \
                 falls. A position that is repeated at a turn counts as approached from the \
                 other side"
            ),
            false => format!("{missing}. Every row counts as approached in the positive direction"),
        };
        let help = format!("add {direction}, the direction of approach (+1, −1), to each row");
        warnings.push(Warning { place, what, help });
        if is_derived {
            run.add_column(&direction, &position, sweeps.directions);
        }
    }
    (run, warnings)
}

/// Returns whether anything that the machine file says of an axis depends on the direction of approach.
fn depends_on_approach_direction(machine: &Machine, axis: LinearAxis) -> bool {
    let model = &machine.axes[axis.index()];
    let by_table = model.pitch.iter().chain(model.dual.as_ref().map(|dual| &dual.pitch));
    model.backlash.is_some()
        || by_table.into_iter().any(|pitch| pitch.reverse_um.is_some())
        || machine
            .terms
            .iter()
            .any(|term| term.quantity.axis() == Some(axis) && term.effect.depends_on_direction())
}

/// Positions that go there and back.
struct BidirectionalSweeps {
    /// +1 or −1 in each row.
    directions: Vec<f64>,
    /// How many rows a sweep has, on average.
    mean_rows: f64,
}

impl BidirectionalSweeps {
    /// `None` where positions do not fall about as often as they rise.
    fn from_positions(positions: &[f64], runs: Option<&[f64]>) -> Option<Self> {
        // From a row to the next that differs: +1, −1; 0 where it stays.
        let sign = |row: usize| {
            let step = positions[row] - positions[row - 1];
            if step.is_nan() || step == 0.0 { 0.0 } else { step.signum() }
        };
        let signs: Vec<f64> = (1..positions.len()).map(sign).collect();
        let count = |of: f64| signs.iter().filter(|sign| **sign == of).count();
        let (rises, falls) = (count(1.0), count(-1.0));
        let (rarer, other) = (rises.min(falls), rises.max(falls));
        // The way back to the start of a run is no measurement.
        if rarer < 2 || (rarer as f64) < MIN_DIRECTION_RATIO * other as f64 {
            return None;
        }
        let moving: Vec<f64> = signs.iter().copied().filter(|sign| *sign != 0.0).collect();
        let turns = moving.windows(2).filter(|pair| pair[0] != pair[1]).count();
        let mean_rows = moving.len() as f64 / (turns + 1) as f64;
        let before = |row: usize| signs[..row].iter().rev().copied().find(|sign| *sign != 0.0);
        let after = |row: usize| signs[row..].iter().copied().find(|sign| *sign != 0.0);
        let is_first_of_run =
            |row: usize| row > 0 && runs.is_some_and(|runs| runs[row] != runs[row - 1]);
        let directions = (0..positions.len()).map(|row| {
            let came = row.checked_sub(1).map_or(0.0, |step| signs[step]);
            if came != 0.0 && !is_first_of_run(row) {
                return came;
            }
            // The first row, and one that stays: at a turn it is the first of the way back.
            after(row).or_else(|| before(row)).unwrap_or(1.0)
        });
        Some(Self { directions: directions.collect(), mean_rows })
    }
}

#[cfg(test)]
mod tests;
