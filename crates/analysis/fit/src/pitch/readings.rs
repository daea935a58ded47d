//! From the rows of a run to readings at targets, by direction and repeat; what breaks a rule of
//! such a measurement is refused with its place.
//!
//! A target is a position that is meant to be the same: positions nearer to each other than a tenth
//! of the smallest step of any sweep are one target. A record of more positions than
//! [`MAX_UNBINNED_TARGETS`] is not a list of targets; it is gathered in as many cells of equal width.
//!
//! Repeats have their number in the column `run`. Without it the j-th arrival at a target in one
//! direction is of run j; where no position comes again, the j-th sweep in a direction is.

use std::{borrow::Cow, collections::HashMap};

use trueup_machine::{
    InputFileError, applied_offsets::UncompensatedRun, machine_file::LinearAxis,
    model::is_negative_direction,
};
use trueup_numerics::repeats::{self, find_gross_errors, group_positions};

use crate::report::ExcludedRow;

/// The column of the feed.
pub(super) const FEED_COLUMN: &str = "feed_mm_per_min";
/// Feeds nearer than this share are one, as speeds of a spindle are.
pub(super) const FEED_RELATIVE_TOLERANCE: f64 = 0.02;
/// More positions than this are gathered in cells.
pub(super) const MAX_UNBINNED_TARGETS: usize = 2048;

/// One measured value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PitchReading {
    /// Its row in the file, from 0.
    pub row: usize,
    /// Its target, from 0.
    pub target: usize,
    /// 0 approached in the positive, 1 in the negative direction.
    pub way: usize,
    /// Its run, from 0.
    pub run: usize,
    /// The feed of its approach, by its place in [`PitchReadings::feeds_mm_per_min`].
    pub feed: usize,
    /// The error in µm.
    pub um: f64,
}

/// The readings of one axis.
#[derive(Clone, Debug)]
pub(super) struct PitchReadings {
    /// The targets in mm, rising.
    pub targets_mm: Vec<f64>,
    /// Feeds of the approach, rising; one, 0, where they are not asked for or not known.
    pub feeds_mm_per_min: Vec<f64>,
    /// In the order of the rows.
    pub list: Vec<PitchReading>,
    /// Runs that have a reading.
    pub runs: usize,
    /// Rows that lack a value, or are about another quantity.
    pub rows_incomplete: usize,
    /// Whether the positions were gathered in cells.
    pub is_record: bool,
}

/// The selection of the readings of a run.
pub(super) struct ReadingSelection<'a> {
    pub axis: LinearAxis,
    /// Only runs with these numbers.
    pub runs: Option<&'a [f64]>,
    /// Taken off each row's value, in µm.
    pub known_um: Option<&'a [f64]>,
    /// Whether readings at several feeds are to be distinguished.
    pub by_feed: bool,
    /// Whether positions must rise and fall with the direction of approach.
    pub in_order: bool,
}

/// A row that has all its values.
struct CompleteRow {
    row: usize,
    position_mm: f64,
    way: usize,
    run: f64,
    /// 0 where it is not asked for.
    feed: f64,
    um: f64,
}

/// The names of an axis's columns.
struct AxisColumnNames {
    position: String,
    direction: String,
    measured: String,
}

pub(super) fn measured_column_name(axis: LinearAxis) -> String {
    format!("measured_d{}_um", axis.name())
}

impl PitchReadings {
    /// Reads what `selection` names from `file`.
    ///
    /// # Errors
    /// A column is missing or in another unit; a value is missing in a row of this quantity; no
    /// reading is left; positions do not agree with their direction; a position comes twice in a run.
    pub(super) fn from_run(
        file: &UncompensatedRun<'_>,
        selection: &ReadingSelection<'_>,
    ) -> Result<Self, InputFileError> {
        let axis = selection.axis.name();
        let names = AxisColumnNames {
            position: format!("{axis}_mm"),
            direction: format!("dir_{axis}"),
            measured: measured_column_name(selection.axis),
        };
        let (mut rows, rows_incomplete) = collect_complete_rows(file, &names, selection)?;
        if file.column("run").is_none() {
            let (_, target_of_row, is_record) = assign_targets(&rows);
            assign_run_numbers(&mut rows, &target_of_row, is_record);
            // Only now do these rows have the numbers by which they may be requested.
            if let Some(runs) = selection.runs {
                rows.retain(|raw| runs.contains(&raw.run));
            }
        }
        if rows.is_empty() {
            let mut bad = header_error(file, &names.measured);
            bad.rule = format!("no row of the selected runs has a {}", names.measured);
            return Err(bad);
        }
        let (targets_mm, target_of_row, is_record) = assign_targets(&rows);
        if !is_record {
            check_for_duplicate_readings(file, &names, &rows, &target_of_row)?;
            if selection.in_order {
                check_position_order(file, &names, &rows, &target_of_row)?;
            }
        }
        let mut numbers: Vec<f64> = rows.iter().map(|raw| raw.run).collect();
        numbers.sort_by(f64::total_cmp);
        numbers.dedup();
        let mut feeds: Vec<f64> = rows.iter().map(|raw| raw.feed).collect();
        feeds.sort_by(f64::total_cmp);
        feeds.dedup_by(|b, a| *b <= *a * (1.0 + FEED_RELATIVE_TOLERANCE));
        let list = rows.iter().zip(&target_of_row).map(|(raw, &target)| PitchReading {
            row: raw.row,
            target,
            way: raw.way,
            run: numbers.partition_point(|&number| number < raw.run),
            feed: feeds.partition_point(|&feed| feed <= raw.feed).saturating_sub(1),
            um: raw.um,
        });
        let list = list.collect();
        Ok(Self {
            targets_mm,
            feeds_mm_per_min: feeds,
            list,
            runs: numbers.len(),
            rows_incomplete,
            is_record,
        })
    }

    /// Takes out the readings that stand alone among the repeats of their target, and says why.
    pub(super) fn exclude_gross_errors(
        &mut self,
        file: &UncompensatedRun<'_>,
        axis: LinearAxis,
    ) -> Vec<ExcludedRow> {
        if self.is_record {
            // A cell holds the slope of the error as well.
            return Vec::new();
        }
        // Readings at different feeds are no repeats of each other.
        let of_feed =
            |(repeat, reading): (repeats::RepeatReading, &PitchReading)| repeats::RepeatReading {
                place: repeat.place + reading.feed * self.targets_mm.len(),
                ..repeat
            };
        let by_feed: Vec<_> =
            self.to_repeat_readings().into_iter().zip(&self.list).map(of_feed).collect();
        let found = find_gross_errors(&by_feed);
        let measured = measured_column_name(axis);
        let aside = |(reading, _): (&PitchReading, &bool)| ExcludedRow {
            place: file.value_location(reading.row, &measured),
            measured_um: reading.um,
            reason: "far from the other readings at its target".into(),
        };
        let outliers =
            self.list.iter().zip(&found).filter(|(_, found)| **found).map(aside).collect();
        let mut found = found.into_iter();
        self.list.retain(|_| !found.next().unwrap_or(false));
        outliers
    }

    /// Returns the readings for a decision by their repeats.
    pub(super) fn to_repeat_readings(&self) -> Vec<repeats::RepeatReading> {
        let of = |reading: &PitchReading| repeats::RepeatReading {
            place: reading.target,
            side: reading.way,
            cycle: reading.run,
            value: reading.um,
        };
        self.list.iter().map(of).collect()
    }

    /// Returns whether there is a reading in each of the two directions.
    pub(super) fn measured_directions(&self) -> [bool; 2] {
        [0, 1].map(|way| self.list.iter().any(|reading| reading.way == way))
    }

    /// Returns the values at each target, by direction.
    pub(super) fn values_by_target(&self) -> Vec<[Vec<f64>; 2]> {
        let mut values = vec![[const { Vec::new() }; 2]; self.targets_mm.len()];
        for reading in &self.list {
            values[reading.target][reading.way].push(reading.um);
        }
        values
    }
}

/// Returns an error at the header, its rule still to be stated.
fn header_error(file: &UncompensatedRun<'_>, name: &str) -> InputFileError {
    // The empty name is never there, so that the place comes even where `name` is.
    let place =
        file.require_column("").map_or_else(|bad| bad.place, |_| file.value_location(0, name));
    InputFileError::new(place, String::new())
}

/// Returns the column `stem_unit`, which must not be there in another unit, be it next to it or instead.
fn require_column_in_unit<'f>(
    file: &'f UncompensatedRun<'_>,
    stem: &str,
    unit: &str,
) -> Result<&'f [f64], InputFileError> {
    const LENGTH_UNITS: [&str; 7] = ["nm", "um", "mm", "cm", "m", "in", "inch"];
    let name = format!("{stem}_{unit}");
    for other in LENGTH_UNITS.iter().filter(|&&other| other != unit) {
        let wrong = format!("{stem}_{other}");
        if file.column(&wrong).is_some() {
            let mut bad = header_error(file, &wrong);
            bad.rule = match file.column(&name) {
                Some(_) => format!("mixed units: there are both {name} and {wrong}"),
                None => {
                    format!("{wrong} is in another unit: it must be given in {unit}, as {name}")
                }
            };
            return Err(bad);
        }
    }
    file.require_column(&name)
}

fn collect_complete_rows(
    file: &UncompensatedRun<'_>,
    names: &AxisColumnNames,
    selection: &ReadingSelection<'_>,
) -> Result<(Vec<CompleteRow>, usize), InputFileError> {
    let axis = selection.axis.name();
    let measured = require_column_in_unit(file, &format!("measured_d{axis}"), "um")?;
    let positions = require_column_in_unit(file, axis, "mm")?;
    let directions = match (file.column(&names.direction), monotonic_direction(positions)) {
        (Some(stated), _) => Cow::Borrowed(stated),
        // The order says it.
        (None, Some(way)) => Cow::Owned(vec![way; positions.len()]),
        (None, None) => {
            Cow::Borrowed(file.require_column(&names.direction).map_err(|mut bad| {
                bad.rule += "; it states the side from which each position was approached, 1 or -1";
                bad
            })?)
        }
    };
    let numbers = file.column("run");
    let feeds = if selection.by_feed { file.column(FEED_COLUMN) } else { None };
    let (mut rows, mut rows_incomplete) = (Vec::new(), 0);
    for (row, ((&um, &position_mm), &direction)) in
        measured.iter().zip(positions).zip(&*directions).enumerate()
    {
        let run = numbers.map_or(f64::NAN, |numbers| numbers[row]);
        if selection.runs.is_some_and(|runs| !run.is_nan() && !runs.contains(&run)) {
            continue;
        }
        // A reading that was not taken is an empty cell, as it is for `diagnose`.
        let is_numbered = numbers.is_none() || !run.is_nan();
        let feed = feeds.map_or(0.0, |feeds| feeds[row]);
        if feed.is_nan()
            || um.is_nan()
            || position_mm.is_nan()
            || direction.is_nan()
            || !is_numbered
        {
            rows_incomplete += 1;
            continue;
        }
        let known = selection.known_um.map_or(0.0, |known| known.get(row).copied().unwrap_or(0.0));
        if known.is_nan() {
            let rule =
                "cannot be compared: the machine's other sections predict nothing for this row";
            return Err(file.value_error(row, &names.measured, rule));
        }
        let way = usize::from(is_negative_direction(direction));
        rows.push(CompleteRow { row, position_mm, way, run, feed, um: um - known });
    }
    Ok((rows, rows_incomplete))
}

/// Returns the direction of positions that only rise (1) or only fall (−1); `None` for all others.
fn monotonic_direction(positions_mm: &[f64]) -> Option<f64> {
    let there: Vec<f64> = positions_mm.iter().copied().filter(|mm| !mm.is_nan()).collect();
    let mut steps = there.windows(2).map(|pair| (pair[1] - pair[0]).signum());
    let first = steps.next()?;
    (there.windows(2).all(|pair| pair[0] != pair[1]) && steps.all(|step| step == first))
        .then_some(first)
}

/// Returns the smallest step from row to row within a sweep; `None` where no sweep has two positions.
fn smallest_step_mm(rows: &[CompleteRow]) -> Option<f64> {
    let same_sweep =
        |a: &CompleteRow, b: &CompleteRow| a.way == b.way && (a.run == b.run || a.run.is_nan());
    rows.windows(2)
        .filter_map(|pair| match pair {
            [a, b] if same_sweep(a, b) => Some((b.position_mm - a.position_mm).abs()),
            _ => None,
        })
        .filter(|step| *step > 0.0)
        .reduce(f64::min)
}

/// Returns the targets in mm, rising; the target of each position; whether they are cells of a record.
fn assign_targets(rows: &[CompleteRow]) -> (Vec<f64>, Vec<usize>, bool) {
    let positions: Vec<f64> = rows.iter().map(|raw| raw.position_mm).collect();
    let (targets, target_of) = group_positions(&positions, smallest_step_mm(rows).unwrap_or(0.0));
    let (Some(&start), Some(&end)) = (targets.first(), targets.last()) else {
        return (targets, target_of, false);
    };
    if targets.len() <= MAX_UNBINNED_TARGETS {
        return (targets, target_of, false);
    }
    // The mean of each cell that has a position.
    let mut cells = vec![(0.0, 0.0); MAX_UNBINNED_TARGETS];
    let cell = |position: f64| {
        let share = (position - start) / (end - start);
        ((share * MAX_UNBINNED_TARGETS as f64).max(0.0) as usize).min(MAX_UNBINNED_TARGETS - 1)
    };
    for &position in &positions {
        let (sum, count) = &mut cells[cell(position)];
        *sum += position;
        *count += 1.0;
    }
    let mut number = vec![0; MAX_UNBINNED_TARGETS];
    let mut targets = Vec::new();
    for (cell, (sum, count)) in cells.into_iter().enumerate().filter(|(_, (_, n))| *n > 0.0) {
        number[cell] = targets.len();
        targets.push(sum / count);
    }
    (targets, positions.into_iter().map(|position| number[cell(position)]).collect(), true)
}

/// Numbers the runs of a file without the column, from 1.
fn assign_run_numbers(rows: &mut [CompleteRow], target_of_row: &[usize], is_record: bool) {
    let mut arrivals: HashMap<(usize, usize, u64), usize> = HashMap::new();
    let mut comes_again = false;
    for (raw, &target) in rows.iter_mut().zip(target_of_row) {
        let arrivals = arrivals.entry((target, raw.way, raw.feed.to_bits())).or_default();
        *arrivals += 1;
        comes_again |= *arrivals > 1;
        raw.run = *arrivals as f64;
    }
    if comes_again && !is_record {
        return;
    }
    let half = half_range_mm(rows);
    let mut sweeps = [0_usize; 2];
    let mut before: Option<(usize, f64)> = None;
    for raw in rows {
        let goes_on = before.is_some_and(|(way, position_mm)| {
            way == raw.way && -signed_step(way, raw.position_mm - position_mm) < half
        });
        if !goes_on {
            sweeps[raw.way] += 1;
        }
        before = Some((raw.way, raw.position_mm));
        raw.run = sweeps[raw.way] as f64;
    }
}

fn half_range_mm(rows: &[CompleteRow]) -> f64 {
    let ends = |(low, high): (f64, f64), raw: &CompleteRow| {
        (low.min(raw.position_mm), high.max(raw.position_mm))
    };
    let (low, high) = rows.iter().fold((f64::INFINITY, f64::NEG_INFINITY), ends);
    (high - low) / 2.0
}

/// `step` counted in the direction of approach.
fn signed_step(way: usize, step: f64) -> f64 {
    if way == 0 { step } else { -step }
}

fn direction_name(way: usize) -> &'static str {
    ["positive", "negative"][way]
}

/// Within a run a position is measured once in each direction.
fn check_for_duplicate_readings(
    file: &UncompensatedRun<'_>,
    names: &AxisColumnNames,
    rows: &[CompleteRow],
    target_of_row: &[usize],
) -> Result<(), InputFileError> {
    let mut seen: HashMap<(usize, usize, u64, u64), usize> = HashMap::with_capacity(rows.len());
    for (raw, &target) in rows.iter().zip(target_of_row) {
        let once = (target, raw.way, raw.run.to_bits(), raw.feed.to_bits());
        if let Some(first) = seen.insert(once, raw.row) {
            let rule = format!(
                "{} is measured twice in run {}, approached in the {} direction (before in line \
                 {}): number the repeats in the column run",
                raw.position_mm,
                raw.run,
                direction_name(raw.way),
                file.value_location(first, &names.position).line
            );
            return Err(file.value_error(raw.row, &names.position, rule));
        }
    }
    Ok(())
}

/// Within a sweep positions rise where they are approached in the positive direction, and fall in
/// the negative one; or all sweeps of a direction are listed the other way round, which is a list sorted
/// by position. Without run numbers a step back to a target that was there before, or over half the
/// travel, begins the next sweep.
fn check_position_order(
    file: &UncompensatedRun<'_>,
    names: &AxisColumnNames,
    rows: &[CompleteRow],
    target_of_row: &[usize],
) -> Result<(), InputFileError> {
    let is_numbered = file.column("run").is_some();
    let half = half_range_mm(rows);
    let mut seen: HashMap<(usize, usize), ()> = HashMap::new();
    let mut before: Option<&CompleteRow> = None;
    // By direction: whether a row follows in order, and the first two that do not.
    let mut in_order = [false; 2];
    let mut out_of_order: [Option<(&CompleteRow, &CompleteRow)>; 2] = [None; 2];
    for (raw, &target) in rows.iter().zip(target_of_row) {
        let is_new = seen.insert((target, raw.way), ()).is_none();
        if let Some(before) = before.filter(|before| before.way == raw.way) {
            let back = -signed_step(raw.way, raw.position_mm - before.position_mm);
            let same_sweep =
                if is_numbered { before.run == raw.run } else { is_new && back < half };
            if back > 0.0 && same_sweep {
                out_of_order[raw.way].get_or_insert((before, raw));
            }
            in_order[raw.way] |= back < 0.0 && same_sweep;
        }
        before = Some(raw);
    }
    for (way, (verb, direction)) in [("rise", 1), ("fall", -1)].into_iter().enumerate() {
        if let (true, Some((before, raw))) = (in_order[way], out_of_order[way]) {
            let rule = format!(
                "{} follows {} though {} is {direction}: positions approached in the {} \
                 direction {verb} from row to row of a sweep",
                raw.position_mm,
                before.position_mm,
                names.direction,
                direction_name(way)
            );
            return Err(file.value_error(raw.row, &names.position, rule));
        }
    }
    Ok(())
}
