//! The two runs side by side: the same time since the start, or the same positions in the same order.

use std::{borrow::Cow, collections::BTreeMap};

use serde::Serialize;

use trueup_compare::run_comparison::resolve_common_quantity;
use trueup_machine::{
    InputFileError, Location, Machine, RunFile,
    applied_offsets::{OffsetApplication, PairedRuns, UncompensatedRun, predict_um},
    machine_file::Quantity,
    tool_column::TOOL_COLUMN,
};
use trueup_numerics::{
    repeats::{self, cycle_numbers, find_gross_errors, group_positions},
    robust::{MIN_SERIES_ROWS, find_series_outliers},
};

use crate::ErrorSummary;

/// Parts that a run is looked at in.
const RUN_SEGMENT_COUNT: usize = 4;
/// Speeds that differ by more than this share are another working condition: Smax belongs to one.
const RELATIVE_SPEED_TOLERANCE: f64 = 0.02;
/// Positions that differ by more than this are others, in mm: a tenth of the finest spacing in use.
const POSITION_TOLERANCE_MM: f64 = 0.1;

/// A part of the run.
#[derive(Clone, Debug, Serialize)]
pub struct RunSegment {
    /// Where it begins and ends, in the unit of `over`.
    pub from: f64,
    /// Its end.
    pub to: f64,
    /// The column that these are of: `time_s`, `x_mm`, `row`.
    pub over: String,
    /// Without the compensation.
    pub before: ErrorSummary,
    /// With it.
    pub after: ErrorSummary,
}

/// Readings of both runs at the same times or places.
#[derive(Clone, Debug)]
pub(crate) struct PairedReadings {
    pub quantity: Quantity,
    /// Where: seconds since the start, positions or row numbers.
    pub at: Vec<f64>,
    /// The column that `at` is.
    pub over: String,
    pub off_um: Vec<f64>,
    pub on_um: Vec<f64>,
    /// The offset applied in `on` minus that in `off`, in µm; NaN where that is not known.
    pub offset_um: Vec<f64>,
    /// The machine file's prediction for `on` minus that for `off`, in µm; NaN where there is none.
    pub predicted_um: Vec<f64>,
    pub notes: Vec<String>,
}

/// Columns over which readings are compared.
#[derive(Clone, Copy)]
enum Abscissa<'a> {
    Time(&'a [f64]),
    Place(&'a str),
}

/// Returns the rows of a time series that leave it alone. A burst counts: what lasts is what the machine does.
fn find_time_series_outliers(time_s: &[f64], um: &[f64]) -> Vec<usize> {
    let found: Vec<usize> =
        find_series_outliers(time_s, um).iter().map(|outlier| outlier.row).collect();
    let is_alone = |row: &&usize| {
        let mut others = found.iter().filter(|other| other != row);
        !others.any(|other| other.abs_diff(**row) <= 2)
    };
    found.iter().filter(is_alone).copied().collect()
}

/// Returns the rows that stand alone among the repeats of their place and direction: in the series of the place's own
/// readings where these are many, since the machine may warm from one to the next; else among all repeats.
fn find_repeat_outliers(run: &RunFile, name: &str, um: &[f64]) -> Vec<usize> {
    let (Some(at), Some(axis)) = (run.column(name), name.get(..1)) else { return Vec::new() };
    let rows: Vec<usize> =
        (0..run.row_count()).filter(|row| at[*row].is_finite() && um[*row].is_finite()).collect();
    let positions: Vec<f64> = rows.iter().map(|row| at[*row]).collect();
    let (_, place_of) = group_positions(&positions, 10.0 * POSITION_TOLERANCE_MM);
    let directions = run.column(&format!("dir_{axis}"));
    let side = |row: usize| usize::from(directions.is_some_and(|all| all[row] < 0.0));
    let stops: Vec<(usize, usize)> =
        rows.iter().zip(place_of).map(|(row, place)| (place, side(*row))).collect();
    let mut of_stop: BTreeMap<(usize, usize), Vec<usize>> = BTreeMap::new();
    for (row, stop) in rows.iter().zip(&stops) {
        of_stop.entry(*stop).or_default().push(*row);
    }
    if of_stop.values().all(|rows| rows.len() >= MIN_SERIES_ROWS) {
        let alone = of_stop.into_values().flat_map(|rows| {
            let numbers: Vec<f64> = (0..rows.len()).map(|number| number as f64).collect();
            let um: Vec<f64> = rows.iter().map(|row| um[*row]).collect();
            find_time_series_outliers(&numbers, &um).into_iter().map(move |number| rows[number])
        });
        let mut alone: Vec<usize> = alone.collect();
        alone.sort_unstable();
        // One after the other at different places: it lasts.
        let lasts = |row: &usize| alone.iter().any(|neighbour| neighbour.abs_diff(*row) == 1);
        return alone.iter().filter(|row| !lasts(row)).copied().collect();
    }
    let cycles = cycle_numbers(&stops);
    let readings = rows.iter().zip(stops).zip(cycles).map(|((row, (place, side)), cycle)| {
        repeats::RepeatReading { place, side, cycle, value: um[*row] }
    });
    let found = find_gross_errors(&readings.collect::<Vec<_>>());
    rows.into_iter().zip(found).filter(|(_, found)| *found).map(|(row, _)| row).collect()
}

/// One of the runs, row by row: what was measured, what the bridge applied, what the machine file predicts.
struct RunSeries {
    measured_um: Vec<f64>,
    offset_um: Vec<f64>,
    predicted_um: Vec<f64>,
}

impl RunSeries {
    fn from_run(
        run: &RunFile,
        quantity: Quantity,
        machine: Option<&Machine>,
    ) -> Result<Self, InputFileError> {
        let measured_um = run.require_column(&format!("measured_{}_um", quantity.name()))?;
        let unaided =
            |machine| UncompensatedRun::from_run(Cow::Borrowed(run), machine, Some(quantity)).ok();
        // Another calibration is compared all the same: without the file the tool points down.
        let unaided = machine.and_then(|machine| unaided(Some(machine))).or_else(|| unaided(None));
        let offset_um = match unaided {
            Some((unaided, _)) => unaided
                .applied_offset_um(quantity)
                .map_or(vec![0.0; run.row_count()], <[f64]>::to_vec),
            None => vec![f64::NAN; run.row_count()],
        };
        let predicted = machine.and_then(|machine| predict_um(machine, run, quantity));
        let predicted_um = predicted.unwrap_or_else(|| vec![f64::NAN; run.row_count()]);
        Ok(Self { measured_um: measured_um.to_vec(), offset_um, predicted_um })
    }

    /// Takes out the readings that stand alone; the sentence that lists them by line.
    fn exclude_outliers(
        &mut self,
        run: &RunFile,
        quantity: Quantity,
        over: Abscissa<'_>,
    ) -> Option<String> {
        let found = match over {
            Abscissa::Time(time_s) => find_time_series_outliers(time_s, &self.measured_um),
            Abscissa::Place(name) => find_repeat_outliers(run, name, &self.measured_um),
        };
        let column = format!("measured_{}_um", quantity.name());
        let text = found.iter().map(|row| {
            format!(
                "{} ({:+.1} µm)",
                run.value_location(*row, &column).line,
                self.measured_um[*row]
            )
        });
        let text: Vec<String> = text.collect();
        found.iter().for_each(|row| self.measured_um[*row] = f64::NAN);
        let path = run.path().display();
        (!text.is_empty()).then(|| {
            format!(
                "Excluded as outliers in {path}: line {}. They do not count.",
                text.join(", line ")
            )
        })
    }

    fn values_at_row(&self, row: usize) -> [f64; 3] {
        [self.measured_um[row], self.offset_um[row], self.predicted_um[row]]
    }
}

impl PairedReadings {
    /// # Errors
    /// The runs do not measure the same, or have nothing in common.
    pub(crate) fn from_runs(
        off: &RunFile,
        on: &RunFile,
        requested: Option<Quantity>,
        machine: Option<&Machine>,
    ) -> Result<Self, InputFileError> {
        let quantity =
            resolve_common_quantity(on, (off, "the run without compensation"), requested)?;
        let side = |run| RunSeries::from_run(run, quantity, machine);
        let mut sides = [side(off)?, side(on)?];
        let mut pair = Self {
            quantity,
            at: Vec::new(),
            over: String::new(),
            off_um: Vec::new(),
            on_um: Vec::new(),
            offset_um: Vec::new(),
            predicted_um: Vec::new(),
            notes: Vec::new(),
        };
        let times = |run: &RunFile| {
            run.column("time_s").map(|times| {
                let first = times.iter().copied().find(|time| time.is_finite()).unwrap_or(0.0);
                times.iter().map(|time| time - first).collect::<Vec<f64>>()
            })
        };
        let axis = quantity.axis().map(|axis| axis.column_name());
        let place = axis.filter(|name| off.column(name).is_some() && on.column(name).is_some());
        for (run, side) in [off, on].into_iter().zip(&mut sides) {
            let times = times(run).unwrap_or_default();
            let over = match &place {
                Some(name) => Abscissa::Place(name),
                None if times.is_empty() => continue,
                None => Abscissa::Time(&times),
            };
            pair.notes.extend(side.exclude_outliers(run, quantity, over));
        }
        let sides = &sides;
        match (place, times(off), times(on)) {
            (Some(place), ..) => pair.pair_by_row([off, on], sides, &place)?,
            (None, Some(off_s), Some(on_s)) => {
                pair.pair_by_time([&off_s, &on_s], sides);
                pair.append_condition_difference_notes([off, on], [&off_s, &on_s], machine);
            }
            _ => pair.pair_by_row([off, on], sides, "row")?,
        }
        if pair.at.len() < 2 * RUN_SEGMENT_COUNT {
            let rule = format!(
                "{} readings in common are too few, {} are needed",
                pair.at.len(),
                2 * RUN_SEGMENT_COUNT
            );
            return Err(InputFileError::new(Location::start_of_file(on.path()), rule));
        }
        if quantity.axis().is_some() {
            pair.notes.push(
                "The zero of an axis's gauge is arbitrary: the mean of each run does not count."
                    .into(),
            );
            for um in [&mut pair.off_um, &mut pair.on_um] {
                let mean = um.iter().sum::<f64>() / um.len() as f64;
                um.iter_mut().for_each(|um| *um -= mean);
            }
        }
        Ok(pair)
    }

    /// Readings of `off`, each with what `on` showed at that time since its start, linear between.
    fn pair_by_time(&mut self, [off_s, on_s]: [&[f64]; 2], [off, on]: &[RunSeries; 2]) {
        self.over = "time_s".into();
        let is_known = |time: f64, um: f64| time.is_finite() && um.is_finite();
        let known: Vec<(f64, usize)> = on_s
            .iter()
            .enumerate()
            .filter(|(row, time)| is_known(**time, on.measured_um[*row]))
            .map(|(row, time)| (*time, row))
            .collect();
        for (row, time) in off_s.iter().enumerate() {
            if !is_known(*time, off.measured_um[row]) {
                continue;
            }
            let next = known.partition_point(|(known_s, _)| known_s < time);
            let before = next.checked_sub(1).and_then(|before| known.get(before));
            let there = match (before, known.get(next)) {
                (_, Some((at, there))) if at == time => on.values_at_row(*there),
                (Some((a_s, a)), Some((b_s, b))) if b_s > a_s => {
                    let share = (time - a_s) / (b_s - a_s);
                    let (a, b) = (on.values_at_row(*a), on.values_at_row(*b));
                    [0, 1, 2].map(|of| a[of] + (b[of] - a[of]) * share)
                }
                // Beyond the shorter of the two nothing is known.
                _ => continue,
            };
            self.push_pair(*time, off.values_at_row(row), there);
        }
        let known = off.measured_um.iter().filter(|um| um.is_finite()).count();
        if self.at.len() < known {
            self.notes.push(format!(
                "{} readings without compensation lie outside the run with it, and do not count.",
                known - self.at.len()
            ));
        }
    }

    /// A reading of both.
    fn push_pair(&mut self, at: f64, off: [f64; 3], on: [f64; 3]) {
        self.at.push(at);
        self.off_um.push(off[0]);
        self.on_um.push(on[0]);
        self.offset_um.push(on[1] - off[1]);
        self.predicted_um.push(on[2] - off[2]);
    }

    /// Returns the factor by which the machine applies the offsets of the bridge.
    pub(crate) fn estimate_offset_application(&self) -> OffsetApplication {
        let rows = self.on_um.iter().zip(&self.off_um);
        let difference_um: Vec<f64> = rows.map(|(on, off)| on - off).collect();
        // Places come in any order: their readings have no memory of each other that is known.
        let numbers: Vec<f64> = (0..self.at.len()).map(|row| row as f64).collect();
        PairedRuns {
            at: if self.over == "time_s" { &self.at } else { &numbers },
            difference_um: &difference_um,
            offset_um: &self.offset_um,
            predicted_um: &self.predicted_um,
        }
        .estimate_offset_application()
    }

    /// Row by row: both runs went to the same places.
    fn pair_by_row(
        &mut self,
        [off, on]: [&RunFile; 2],
        sides: &[RunSeries; 2],
        over: &str,
    ) -> Result<(), InputFileError> {
        if off.row_count() != on.row_count() {
            let rule = format!(
                "{} rows, but {} has {}: run the same program in both",
                on.row_count(),
                off.path().display(),
                off.row_count()
            );
            return Err(InputFileError::new(Location::start_of_file(on.path()), rule));
        }
        self.over = over.into();
        let places = |run: &RunFile| run.column(over).map(<[f64]>::to_vec);
        if let (Some(a), Some(b)) = (places(off), places(on))
            && let Some(row) =
                a.iter().zip(&b).position(|(a, b)| (a - b).abs() > POSITION_TOLERANCE_MM)
        {
            let rule =
                format!("{} is not {}, where the run without compensation was", b[row], a[row]);
            return Err(on.value_error(row, over, rule));
        }
        let [is_off, is_on] = sides;
        let is_known = |row: &usize| {
            is_off.measured_um[*row].is_finite() && is_on.measured_um[*row].is_finite()
        };
        for row in (0..off.row_count()).filter(is_known) {
            let at = off.column(over).map_or(row as f64, |all| all[row]);
            self.push_pair(at, is_off.values_at_row(row), is_on.values_at_row(row));
        }
        Ok(())
    }

    /// Notes where the two were not driven alike.
    fn append_condition_difference_notes(
        &mut self,
        runs: [&RunFile; 2],
        times: [&[f64]; 2],
        machine: Option<&Machine>,
    ) {
        let inputs = machine.and_then(|machine| machine.inputs.as_ref());
        let conditions = inputs.iter().flat_map(|inputs| inputs.conditions.keys());
        let conditions = conditions.map(|name| (name.as_str(), format!("{name} was not alike")));
        let columns = [
            ("spindle_rpm", "The spindle did not turn alike".to_string()),
            (TOOL_COLUMN, "The tools were not alike".to_string()),
        ];
        for (column, what) in columns.into_iter().chain(conditions) {
            let [Some(off), Some(on)] = runs.map(|run| run.column(column)) else { continue };
            let at = |time: f64| {
                let row = times[1].partition_point(|known| *known < time);
                on.get(row).copied().unwrap_or(f64::NAN)
            };
            let may_differ = if column == "spindle_rpm" { RELATIVE_SPEED_TOLERANCE } else { 0.0 };
            let differs = |row: &usize| {
                let (a, b) = (off[*row], at(times[0][*row]));
                (a - b).abs() > may_differ * a.abs().max(b.abs())
            };
            let rows = (0..off.len()).filter(differs).count();
            // Where it changes, a row may stand on either side of it.
            if rows > off.len() / 20 {
                self.notes.push(format!(
                    "{what} in the two runs ({rows} of {} rows): what is gone is not the compensation's alone.",
                    off.len()
                ));
            }
        }
    }

    /// Returns the run in parts of equal length.
    pub(crate) fn split_into_segments(&self) -> Vec<RunSegment> {
        let mut order: Vec<usize> = (0..self.at.len()).collect();
        order.sort_by(|a, b| self.at[*a].total_cmp(&self.at[*b]));
        let (low, high) = (self.at[order[0]], self.at[order[order.len() - 1]]);
        let width = (high - low) / RUN_SEGMENT_COUNT as f64;
        let edge = |part: usize| low + width * part as f64;
        (0..RUN_SEGMENT_COUNT)
            .filter_map(|part| {
                let is_in = |at: f64| {
                    at >= edge(part) && (at < edge(part + 1) || part + 1 == RUN_SEGMENT_COUNT)
                };
                let of = |um: &[f64]| -> Vec<f64> {
                    order.iter().filter(|row| is_in(self.at[**row])).map(|row| um[*row]).collect()
                };
                let (off, on) = (of(&self.off_um), of(&self.on_um));
                (!off.is_empty()).then(|| RunSegment {
                    from: edge(part),
                    to: edge(part + 1),
                    over: self.over.clone(),
                    before: ErrorSummary::from_errors(&off),
                    after: ErrorSummary::from_errors(&on),
                })
            })
            .collect()
    }
}
