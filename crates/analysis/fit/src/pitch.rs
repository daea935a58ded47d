//! The position errors of an axis and its backlash, from measured runs (`docs/physics.md` section 5).
//!
//! | module | does |
//! |---|---|
//! | `readings` | readings at targets from the rows, with the rules that they must keep |
//! | `grid_selection` | at which points the table stands |
//! | `table` | a table of equal steps from errors at any targets |
//! | `judge` | which correction holds on runs that it has not seen |
//! | `scatter` | how far repeats lie apart, next to how far targets do |
//! | `page` | the figures of ISO 230-2 as a page |
//! | `summary` | what was found, in a report |
//! | `backlash` | backlash alone |
//! | `gantry` | the tables of an axis with two drives |
//! | `by_feed` | whether it depends on the feed, and which feed counts |
//! | `pitch_aliasing` | pitches that the targets cannot see |
//!
//! [`fit`] excludes what stands alone among the repeats of its target, and leaves the decision to
//! [`trueup_numerics::repeats`], which `trueup diagnose` uses as well: the targets must differ by more
//! than their repeats, every run that is held out must gain, and of
//!
//! ```text
//! one table, one table and a backlash, a table for each direction
//! ```
//!
//! that predict the runs equally well the one with the fewest values is taken. A constant alone is not a
//! finding: the zero of the measurement is arbitrary. If no table holds, the report says why, and what
//! to measure.
//! The errors are actual minus commanded, and the fit predicts what `trueup predict` does, because
//! it is judged with the machine's own model.
//!
//! Measured on real data, fitted to the runs 1–3 and tested on 4–5 (root mean square, µm; the
//! test `pitch_real` prints them): x 33.2 → 4.8, z 11.6 → 1.2, and the stage `muts_x` is refused.

mod backlash;
mod cross_validation;
mod feed_dependence;
mod gantry;
mod grid_selection;
mod html_report;
mod pitch_aliasing;
mod pitch_report;
mod pitch_table;
mod readings;
mod reversal_difference;
mod scatter;

use trueup_machine::{
    InputFileError,
    applied_offsets::UncompensatedRun,
    machine_file::{Backlash, Feedback, LinearAxis, PitchErrorTable},
};

pub use backlash::{BacklashFit, BacklashWidthRule, fit_backlash};
pub use gantry::fit_both_drives;
pub use html_report::build_page;
pub use pitch_aliasing::find_aliased_pitches;

use trueup_numerics::repeats::{self, TableSelection};

use self::{
    cross_validation::{CorrectionModel, DirectionSums, cross_validate},
    grid_selection::choose_table_grid,
    pitch_report::{
        add_measurement_statistics, add_pitch_correction, add_warnings, interpolation_caveat,
        rejection_reasons, suggest_measurement,
    },
    pitch_table::TableGrid,
    readings::{PitchReading, PitchReadings, ReadingSelection, measured_column_name},
};
use crate::{
    iso230_2::{Iso230Results, TargetReadings},
    report::{FitReport, FitVerdict, ResidualStatistics},
};

/// The table that is required.
#[derive(Clone, Debug, PartialEq)]
pub struct PitchFitOptions {
    /// One table or two.
    pub ways: TableMode,
    /// Only the runs with these numbers; `None`: all.
    pub runs: Option<Vec<f64>>,
    /// The step of the table in mm, above 0; `None`: that of the targets if it is equal, else the
    /// widest that keeps what was measured.
    pub step_mm: Option<f64>,
    /// The most points that a table may have, at least 2.
    pub most_points: usize,
    /// Where the axis's position is measured: backlash belongs to the screw.
    pub feedback: Feedback,
    /// The prediction of other sections of the machine file for each row of the run, in µm: it is taken off
    /// before the fit. NaN: not known.
    pub known_um: Option<Vec<f64>>,
    /// Which width [`fit_backlash`] takes.
    pub width: BacklashWidthRule,
    /// The feed that parts are cut at, in mm/min, where backlash depends on it; `None`: the slowest
    /// that was measured.
    pub feed_mm_per_min: Option<f64>,
}

impl Default for PitchFitOptions {
    fn default() -> Self {
        Self {
            ways: TableMode::Automatic,
            runs: None,
            step_mm: None,
            most_points: 512,
            feedback: Feedback::Screw,
            known_um: None,
            width: BacklashWidthRule::Automatic,
            feed_mm_per_min: None,
        }
    }
}

/// How many tables.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TableMode {
    /// One for each direction only if that gains on held-out runs.
    #[default]
    Automatic,
    /// One for both directions, next to it a backlash if that gains.
    One,
    /// One for each direction.
    Both,
}

/// A fitted table.
#[derive(Clone, Debug, PartialEq)]
pub struct PitchFit {
    /// The result, with the changes in the machine file.
    pub report: FitReport,
    /// The table; `None` if the axis should not be corrected.
    pub pitch: Option<PitchErrorTable>,
    /// The backlash that belongs to it.
    pub backlash: Option<Backlash>,
    /// The figures of ISO 230-2, before any correction; `None` without repeats at targets.
    pub iso230: Option<Iso230Results>,
}

/// Returns the table of `axis` from the columns `<axis>_mm`, `dir_<axis>`, `measured_d<axis>_um` and, where
/// it is there, `run`.
///
/// # Errors
/// A column is missing or in another unit, a cell of a row is empty, a position comes twice in a
/// run and direction, positions do not agree with their direction, there are fewer than two targets,
/// or a required direction is missing; with the place and the rule.
pub fn fit(
    run: &UncompensatedRun<'_>,
    axis: LinearAxis,
    options: &PitchFitOptions,
) -> Result<PitchFit, InputFileError> {
    let selection = ReadingSelection {
        axis,
        runs: options.runs.as_deref(),
        known_um: options.known_um.as_deref(),
        by_feed: false,
        in_order: true,
    };
    let mut readings = PitchReadings::from_run(run, &selection)?;
    check_target_coverage(run, axis, &readings, options)?;
    let mut report = FitReport::new("pitch", measured_column_name(axis));
    // The figures of the standard are of all that was read.
    let all = readings.values_by_target();
    report.excluded = readings.exclude_gross_errors(run, axis);
    let sums = DirectionSums::from_readings(readings.targets_mm.len(), readings.list.iter());
    let grid = choose_table_grid(&readings, &sums, options, &mut report);
    let laws = candidate_models(&readings, options);
    let judged =
        if readings.runs > 1 { cross_validate(&readings, &grid, &laws) } else { Vec::new() };
    let decision = select_table(&readings, &laws);

    let by_target = readings.values_by_target();
    let iso230 =
        if readings.is_record { None } else { evaluate_iso230(&readings.targets_mm, &all) };
    add_measurement_statistics(&mut report, &readings, &iso230);
    report.table = iso230.as_ref().map(ToString::to_string).unwrap_or_default();
    let best = judged
        .iter()
        .filter(|score| score.law > CorrectionModel::Constant)
        .min_by(|a, b| a.rms_um().total_cmp(&b.rms_um()));
    let is_one_pass = is_single_pass(&readings, &decision);
    let taken = if is_one_pass {
        Ok(CorrectionModel::OneTable)
    } else {
        decision.taken.map(CorrectionModel::from)
    };
    let Ok(law) = taken else {
        let mut why = rejection_reasons(&readings, &judged, best, &by_target);
        why.extend(suggest_measurement(&readings, &decision, &by_target));
        report.verdict = FitVerdict::DoNotCompensate(why);
        report.held_out =
            best.and_then(|best| ResidualStatistics::from_residuals(&best.residuals_um));
        return Ok(PitchFit { report, pitch: None, backlash: None, iso230 });
    };
    let fitted = sums.fit(&readings.targets_mm, &grid, law);
    let residual = |reading: &PitchReading| {
        reading.um - fitted.evaluate(readings.targets_mm[reading.target], reading.way)
    };
    // A table of one pass goes through each of its readings: that nothing is left says nothing.
    report.in_sample =
        ResidualStatistics::from_residuals(&readings.list.iter().map(residual).collect::<Vec<_>>())
            .filter(|_| !is_one_pass);
    let judged = judged.iter().find(|judged| judged.law == law);
    report.held_out =
        judged.and_then(|judged| ResidualStatistics::from_residuals(&judged.residuals_um));
    report.warnings.extend(interpolation_caveat(&readings, law));
    add_warnings(&mut report, &readings, &iso230);
    add_pitch_correction(&mut report, axis, &readings, &sums, &grid, &fitted);
    let backlash =
        fitted.width_um.map(|width_um| Backlash { width_um, ramp_mm: 0.0, hysteresis_um: 0.0 });
    Ok(PitchFit { report, pitch: fitted.pitch, backlash, iso230 })
}

/// At least two targets, and the directions that are requested.
fn check_target_coverage(
    run: &UncompensatedRun<'_>,
    axis: LinearAxis,
    readings: &PitchReadings,
    options: &PitchFitOptions,
) -> Result<(), InputFileError> {
    if let [only] = readings.targets_mm[..] {
        let rule = format!("{only} is the only position: a table needs at least 2 test points");
        return Err(run.value_error(0, &axis.column_name(), rule));
    }
    if options.ways == TableMode::Both {
        let directions = [(1, "positive"), (-1, "negative")];
        for (has, (value, name)) in readings.measured_directions().into_iter().zip(directions) {
            if !has {
                let rule = format!(
                    "is never {value}: a table for each direction needs positions approached in \
                     the {name} direction as well"
                );
                return Err(run.value_error(0, &format!("dir_{}", axis.name()), rule));
            }
        }
    }
    if let Some(step_mm) = options.step_mm
        && !(step_mm > 0.0
            && TableGrid::with_step(&readings.targets_mm, step_mm).points <= MAX_TABLE_POINTS)
    {
        let rule = format!(
            "cannot have a table with a step of {step_mm} mm: it must be above 0 and give at most \
             {MAX_TABLE_POINTS} points"
        );
        return Err(run.value_error(0, &axis.column_name(), rule));
    }
    Ok(())
}

/// The largest number of points that a user may request.
const MAX_TABLE_POINTS: usize = 4096;

/// Returns the corrections to try, from the simplest on; the first two are none.
fn candidate_models(readings: &PitchReadings, options: &PitchFitOptions) -> Vec<CorrectionModel> {
    let mut laws = vec![CorrectionModel::Nothing, CorrectionModel::Constant];
    let both = readings.measured_directions() == [true; 2];
    let screw = options.feedback == Feedback::Screw;
    laws.push(if both && options.ways == TableMode::Both {
        CorrectionModel::BothTables
    } else {
        CorrectionModel::OneTable
    });
    if both && screw && options.ways != TableMode::Both {
        laws.push(CorrectionModel::TableAndBacklash);
    }
    if both && options.ways == TableMode::Automatic {
        laws.push(CorrectionModel::BothTables);
    }
    laws
}

/// Returns true for one pass in one direction: a screw's file of a control, a certificate. Nothing in it says
/// whether the axis repeats, so it is taken over as it stands.
fn is_single_pass(readings: &PitchReadings, decision: &TableSelection) -> bool {
    let each_once = readings.list.len() == readings.targets_mm.len();
    readings.runs < 2
        && !readings.is_record
        && each_once
        && readings.targets_mm.len() >= repeats::MIN_TABLE_POSITIONS
        && decision.taken == Err(repeats::TableRejection::TooFew)
}

/// Returns the decision that `trueup diagnose` takes as well.
fn select_table(readings: &PitchReadings, laws: &[CorrectionModel]) -> TableSelection {
    let laws: Vec<repeats::TableLaw> = laws.iter().filter_map(|law| law.as_table_law()).collect();
    let none = vec![false; readings.list.len()];
    repeats::select_table(&readings.to_repeat_readings(), &none, readings.targets_mm.len(), &laws)
}

fn evaluate_iso230(targets_mm: &[f64], by_target: &[[Vec<f64>; 2]]) -> Option<Iso230Results> {
    let targets: Vec<TargetReadings> = targets_mm
        .iter()
        .zip(by_target)
        .map(|(&position_mm, [forward_um, reverse_um])| TargetReadings {
            position_mm,
            forward_um: forward_um.clone(),
            reverse_um: reverse_um.clone(),
        })
        .collect();
    Iso230Results::from_targets(&targets).ok()
}
