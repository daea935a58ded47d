//! Faulty channels, excluded before anything is searched: a thermometer that is absent, frozen or has
//! jumped, a column that is a copy of another.
//!
//! Where a channel did not measure for a while its values are taken from the line between those around,
//! and the rows do not count; nor those that a jump has parted from the longest stretch. One that did not
//! measure for most of the time, or is a copy, is no column of the runs that are searched, unless the
//! machine file needs it. All of it is reported.

use std::{ops::Range, sync::Arc};

use trueup_machine::{
    RunFile,
    model::required_columns,
    thermometer_faults::{
        EQUALITY_FALSE_ALARM_RATE, MAX_ROW_GAP_S, ThermometerFault, find_thermometer_faults,
    },
};
use trueup_numerics::{parallel::parallel_map, repeats::SIGNIFICANCE_LEVEL};

use super::{
    data_table::DataTable,
    table_columns::{ColumnGroup, NamedColumn},
};

/// A step over more than this many of the usual rows is a pause, and the rows are no neighbours: twice is one row that is
/// not there.
pub(crate) const MIN_PAUSE_INTERVALS: f64 = 2.0;
/// Rows before and after an instant by which it is asked whether a neighbour turned there.
const SLOPE_HALF_WINDOW_ROWS: usize = 10;
/// Below this many rows threads cost more than they bring: a channel of 10,000 takes a millisecond.
const MIN_PARALLEL_ROWS: usize = 1_000;
/// A jump back is one to the level before if what is left is less than this share of the largest jump: by a tenth its
/// own size is known, which is several times the noise.
const MAX_LEVEL_DIFFERENCE_RATIO: f64 = 0.1;

impl DataTable {
    /// Without the columns that are not to be believed: nothing is to be explained by them.
    pub(crate) fn without_untrusted_columns(mut self) -> Self {
        let copies = find_duplicate_columns(&self);
        for (name, other) in &copies {
            self.notes.push(format!(
                "{}{name} is excluded: in every row it is a copy of {other}",
                file_name_prefix(&self, 0)
            ));
        }
        for name in &self.distrusted {
            self.notes.push(format!("{}{name} is excluded as a whole", file_name_prefix(&self, 0)));
        }
        let distrusted = std::mem::take(&mut self.distrusted);
        let is_kept = |(name, _): &NamedColumn| {
            !distrusted.contains(name) && !copies.iter().any(|(copy, _)| copy == name)
        };
        self.columns[ColumnGroup::Temperatures].retain(is_kept);
        self.columns[ColumnGroup::Others].retain(is_kept);
        self
    }
}

/// Excludes where a channel lies, and says so; `runs` are the files of `data`.
pub(super) fn exclude_channel_faults(data: &mut DataTable, runs: &[&RunFile]) {
    let needed = required_columns(&data.setting.machine);
    let follows = consecutive_row_mask(data);
    let near = near_previous_row_mask(data);
    let files = file_row_ranges(data);
    let mut lost = vec![false; data.rows];
    let found = parallel_map(data.temperatures(), data.rows > MIN_PARALLEL_ROWS, |(_, values)| {
        let of_file = |rows: &Range<usize>| {
            find_thermometer_faults(
                &values[rows.clone()],
                &follows[rows.clone()],
                &near[rows.clone()],
            )
        };
        files.iter().map(of_file).collect::<Vec<_>>()
    });
    for (column, found) in found.into_iter().enumerate() {
        let name = data.temperatures()[column].0.clone();
        let is_needed = needed.contains(&name);
        let mut own = vec![false; data.rows];
        let mut moved = vec![false; data.rows];
        for (number, (rows, faults)) in files.iter().zip(found).enumerate() {
            let line =
                |row: usize| runs.get(number).map_or(0, |run| run.value_location(row, &name).line);
            let mut jumps = Vec::new();
            for fault in faults {
                let at = |range: &Range<usize>| rows.start + range.start..rows.start + range.end;
                let description = match &fault {
                    ThermometerFault::Absent { shown, rows: all } => {
                        all.iter().for_each(|range| own[at(range)].fill(true));
                        let count: usize = all.iter().map(Range::len).sum();
                        let first = all.first().map_or(0, |range| line(range.start));
                        format!(
                            "shows {shown} in {count} rows (first in line {first}), as one that is not connected does"
                        )
                    }
                    ThermometerFault::Frozen { shown, rows: range } => {
                        if has_other_channel_change(data, column, at(range).start, rows)
                            && has_other_channel_change(data, column, at(range).end, rows)
                        {
                            continue;
                        }
                        own[at(range)].fill(true);
                        let (from, to) = (range.start + 1, range.end);
                        format!("stands still at {shown} from row {from} to {to}")
                    }
                    ThermometerFault::Jump { by, row } => {
                        if has_other_channel_change(data, column, rows.start + row, rows) {
                            continue;
                        }
                        jumps.push((rows.start + row, *by));
                        format!("jumps by {by:.3} °C at row {}, and no other one does", row + 1)
                    }
                };
                let file = file_name_prefix(data, rows.start);
                data.notes.push(format!("{file}{name} {description}"));
            }
            for (range, by) in find_shifted_segments(rows, &jumps) {
                moved[range.clone()].fill(true);
                Arc::make_mut(&mut data.columns[ColumnGroup::Temperatures][column].1)[range]
                    .iter_mut()
                    .for_each(|value| *value -= by);
            }
        }
        let lies = |rows: &&Range<usize>| own[(*rows).clone()].contains(&true);
        for rows in files.iter().filter(lies) {
            let values = Arc::make_mut(&mut data.columns[ColumnGroup::Temperatures][column].1);
            interpolate_gaps(&mut values[rows.clone()], &own[rows.clone()]);
        }
        let count = own.iter().zip(&moved).filter(|(own, moved)| **own || **moved).count();
        if !is_needed && 2 * count > data.rows {
            data.distrusted.push(name);
            continue;
        }
        lost.iter_mut().zip(&moved).for_each(|(lost, moved)| *lost |= moved);
        // The line between its neighbours does for a single row.
        let is_long = |&row: &usize| {
            let at = |row: Option<usize>| row.is_some_and(|row| own.get(row) == Some(&true));
            own[row] && (at(row.checked_sub(1)) || at(Some(row + 1)))
        };
        (0..data.rows).filter(is_long).for_each(|row| lost[row] = true);
    }
    let count = lost.iter().filter(|is_lost| **is_lost).count();
    if count > 0 {
        let file = file_name_prefix(data, 0);
        data.notes
            .push(format!("{file}{count} rows do not count: a temperature in them is not true"));
    }
    Arc::make_mut(&mut data.measured).iter_mut().zip(&lost).for_each(|(um, lost)| {
        if *lost {
            *um = f64::NAN;
        }
    });
}

/// Returns the stretches of a file between jumps at these rows that are not at the level of the longest, each
/// with how much higher it is. Whether the thermometer is still at its place there is not known: they do
/// not count, and are moved to that level only for what has a memory.
fn find_shifted_segments(rows: &Range<usize>, jumps: &[(usize, f64)]) -> Vec<(Range<usize>, f64)> {
    let mut level = 0.0;
    let mut stretches = vec![(rows.clone(), level)];
    for &(row, by) in jumps {
        level += by;
        if let Some((last, _)) = stretches.last_mut() {
            last.end = row;
        }
        stretches.push((row..rows.end, level));
    }
    let Some((_, kept)) = stretches.iter().max_by_key(|(range, _)| range.len()).cloned() else {
        return Vec::new();
    };
    let largest = jumps.iter().fold(0.0, |largest: f64, (_, by)| largest.max(by.abs()));
    let relative = stretches.into_iter().map(|(range, level)| (range, level - kept));
    relative.filter(|(_, by)| by.abs() > MAX_LEVEL_DIFFERENCE_RATIO * largest).collect()
}

/// Returns the columns that are another one, or what was measured, with its name.
fn find_duplicate_columns(data: &DataTable) -> Vec<(String, String)> {
    let needed = required_columns(&data.setting.machine);
    let all: Vec<&NamedColumn> = data.temperatures().iter().chain(data.unknown_columns()).collect();
    let mut copies: Vec<(String, String)> = Vec::new();
    for (number, (name, values)) in all.iter().enumerate() {
        if needed.contains(name) {
            continue;
        }
        let of_another = || {
            all.iter().enumerate().find(|(at, (other, theirs))| {
                let is_first = *at < number && !copies.iter().any(|(copy, _)| copy == other);
                *at != number
                    && (is_first || needed.contains(other))
                    && is_duplicate(values, theirs)
            })
        };
        if is_duplicate(values, &data.measured) {
            copies.push((name.clone(), "what was measured".into()));
        } else if let Some((_, (other, _))) = of_another() {
            copies.push((name.clone(), other.clone()));
        }
    }
    copies
}

/// Returns whether two columns are one: equal wherever both are there, through many changes.
fn is_duplicate(values: &[f64], others: &[f64]) -> bool {
    let mut changes = 0_i32;
    let mut before = f64::NAN;
    for (&value, &other) in values.iter().zip(others) {
        if value.is_nan() && other.is_nan() {
            continue;
        }
        if value != other {
            return false;
        }
        changes += i32::from(value != before && !before.is_nan());
        before = value;
    }
    // Each would be as likely as not in one of them alone.
    0.5_f64.powi(changes) <= EQUALITY_FALSE_ALARM_RATE
}

/// Returns the name of the file of a row, for a note.
fn file_name_prefix(data: &DataTable, row: usize) -> String {
    let name = data.places.file.get(row).and_then(|&file| data.setting.files.get(file as usize));
    name.map_or(String::new(), |name| format!("{name}: "))
}

/// Returns the rows of each file.
fn file_row_ranges(data: &DataTable) -> Vec<Range<usize>> {
    let mut files: Vec<Range<usize>> = vec![0..0; data.setting.files.len()];
    for (row, &file) in data.places.file.iter().enumerate() {
        let rows = &mut files[file as usize];
        if rows.start == rows.end {
            rows.start = row;
        }
        rows.end = row + 1;
    }
    files
}

/// Returns whether a row is the usual time after the one before; without time, whether it is of the same run.
fn consecutive_row_mask(data: &DataTable) -> Vec<bool> {
    let apart = |row: usize| data.time_s().map_or(f64::NAN, |time_s| time_s[row] - time_s[row - 1]);
    let mut all: Vec<f64> = (1..data.rows).map(apart).filter(|s| *s > 0.0).collect();
    all.sort_unstable_by(f64::total_cmp);
    let usual_s = all.get(all.len() / 2).copied();
    (0..data.rows)
        .map(|row| {
            if row == 0 || data.places.series[row] != data.places.series[row - 1] {
                return false;
            }
            // Where a time is missing a pause cannot be detected.
            let is_pause = |usual_s: f64| apart(row) > MIN_PAUSE_INTERVALS * usual_s;
            !usual_s.is_some_and(is_pause)
        })
        .collect()
}

/// Returns whether a row is at most [`MAX_ROW_GAP_S`] after the one before; without time, nothing says that it is not.
fn near_previous_row_mask(data: &DataTable) -> Vec<bool> {
    let apart = |row: usize| data.time_s().map_or(0.0, |time_s| time_s[row] - time_s[row - 1]);
    (0..data.rows)
        .map(|row| {
            row > 0
                && data.places.series[row] == data.places.series[row - 1]
                && apart(row) <= MAX_ROW_GAP_S
        })
        .collect()
}

/// Returns whether another thermometer, the speed or the load turned at this row as it rarely does: then what
/// happened, happened to the machine.
fn has_other_channel_change(
    data: &DataTable,
    column: usize,
    row: usize,
    rows: &Range<usize>,
) -> bool {
    let others = data.temperatures().iter().enumerate().filter(|(at, _)| *at != column);
    let columns = others.map(|(_, (_, values))| &values[..]);
    let drives = [data.spindle_rpm(), data.load_n()].into_iter().flatten();
    columns.chain(drives).any(|values| has_slope_change(&values[rows.clone()], row - rows.start))
}

/// Returns whether a column's mean slope changes at `row` by more than in all but a hundredth of the others.
fn has_slope_change(values: &[f64], row: usize) -> bool {
    let turn = |at: usize| {
        let [before, now, after] =
            [at.checked_sub(SLOPE_HALF_WINDOW_ROWS)?, at, at + SLOPE_HALF_WINDOW_ROWS]
                .map(|row| values.get(row));
        let turn = (after? - now? - (now? - before?)).abs();
        (!turn.is_nan()).then_some(turn)
    };
    let Some(here) = turn(row) else { return false };
    // What is near it turns with it.
    let elsewhere = (0..values.len()).filter(|at| at.abs_diff(row) > 2 * SLOPE_HALF_WINDOW_ROWS);
    let (more, all) = elsewhere
        .filter_map(turn)
        .fold((0_u32, 0_u32), |(more, all), turn| (more + u32::from(turn >= here), all + 1));
    here > 0.0 && f64::from(more) <= SIGNIFICANCE_LEVEL * f64::from(all)
}

/// The line between the values around in the place of those that are `not_measured`; at an end, the
/// value next to it.
fn interpolate_gaps(values: &mut [f64], not_measured: &[bool]) {
    let mut row = 0;
    while row < values.len() {
        if !not_measured[row] {
            row += 1;
            continue;
        }
        let end = (row..values.len()).find(|&at| !not_measured[at]).unwrap_or(values.len());
        let before = row.checked_sub(1).map(|at| values[at]).filter(|value| !value.is_nan());
        let after = values.get(end).copied().filter(|value| !value.is_nan());
        let (from, to) = match (before, after) {
            (Some(before), Some(after)) => (before, after),
            (Some(only), None) | (None, Some(only)) => (only, only),
            (None, None) => (f64::NAN, f64::NAN),
        };
        let steps = (end - row + 1) as f64;
        for (step, value) in values[row..end].iter_mut().enumerate() {
            *value = from + (to - from) * (step + 1) as f64 / steps;
        }
        row = end;
    }
}

#[cfg(test)]
mod tests;
