//! The position errors of an axis and its backlash, from measured runs (`docs/physics.md` section 5).
//!
//! | module | does |
//! |---|---|
//! | `readings` | readings at targets from the rows, with the rules that they must keep |
//! | `resample` | at which points the table stands |
//! | `table` | a table of equal steps from errors at any targets |
//! | `judge` | which correction holds on runs that it has not seen |
//! | `scatter` | how far repeats lie apart, next to how far targets do |
//! | `page` | the figures of ISO 230-2 as a page |
//! | `summary` | what was found, in a report |
//! | `backlash` | backlash alone |
//! | `gantry` | the tables of an axis with two drives |
//! | `by_feed` | whether it depends on the feed, and which feed counts |
//! | `test_points` | pitches that the targets cannot see |
//!
//! [`fit`] sets aside what stands alone among the repeats of its target, and leaves the decision to
//! [`trueup_numerics::repeats`], which `trueup diagnose` asks as well: the targets must differ by more
//! than their repeats, every run that is left out must gain, and of
//!
//! ```text
//! one table, one table and a backlash, a table for each direction
//! ```
//!
//! that foresee the runs equally well the one with the fewest values is taken. A constant alone is not a
//! finding: the zero of the measurement is arbitrary. If no table holds, the report says why, and what
//! to measure.
//! The errors are actual minus commanded, and the fit predicts what `trueup predict` does, because
//! it is judged with the machine's own model.
//!
//! Measured on real data, fitted to the runs 1–3 and tested on 4–5 (root mean square, µm; the
//! test `pitch_real` prints them): x 33.2 → 4.8, z 11.6 → 1.2, and the stage `muts_x` is refused.

mod backlash;
mod by_feed;
mod difference;
mod gantry;
mod judge;
mod page;
mod readings;
mod resample;
mod scatter;
mod summary;
mod table;
mod test_points;

use trueup_machine::{
    BadInput,
    applied::Uncompensated,
    file::{Backlash, Feedback, LinearAxis, Pitch},
};

pub use backlash::{BacklashFit, WidthRule, fit_backlash};
pub use gantry::{Drive, fit_both};
pub use page::page;
pub use test_points::hidden_pitches;

use trueup_numerics::repeats::{self, Decision};

use self::{
    judge::{Law, Sums, judge},
    readings::{Reading, Readings, Wanted, measured_column},
    resample::choose_grid,
    summary::{between_points, describe, reasons, to_measure, warn, write},
    table::Grid,
};
use crate::{
    iso230::{Iso230, Target},
    report::{Report, Spread, Verdict},
};

/// How a table is wanted.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
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
    pub width: WidthRule,
    /// The feed that parts are cut at, in mm/min, where backlash depends on it; `None`: the slowest
    /// that was measured.
    pub feed_mm_per_min: Option<f64>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            ways: TableMode::Automatic,
            runs: None,
            step_mm: None,
            most_points: 512,
            feedback: Feedback::Screw,
            known_um: None,
            width: WidthRule::Automatic,
            feed_mm_per_min: None,
        }
    }
}

/// How many tables.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TableMode {
    /// One for each direction only if that gains on runs left out.
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
    pub report: Report,
    /// The table; `None` if the axis should not be corrected.
    pub pitch: Option<Pitch>,
    /// The backlash that belongs to it.
    pub backlash: Option<Backlash>,
    /// The figures of ISO 230-2, before any correction; `None` without repeats at targets.
    pub iso230: Option<Iso230>,
}

/// Returns the table of `axis` from the columns `<axis>_mm`, `dir_<axis>`, `measured_d<axis>_um` and, where
/// it is there, `run`.
///
/// # Errors
/// A column is missing or in another unit, a cell of a row is empty, a position comes twice in a
/// run and direction, positions do not go with their direction, there are fewer than two targets,
/// or a direction is missing that is asked for; with the place and the rule.
pub fn fit(
    run: &Uncompensated<'_>,
    axis: LinearAxis,
    options: &Options,
) -> Result<PitchFit, BadInput> {
    let wanted = Wanted {
        axis,
        runs: options.runs.as_deref(),
        known_um: options.known_um.as_deref(),
        by_feed: false,
        in_order: true,
    };
    let mut readings = Readings::of(run, &wanted)?;
    check_extent(run, axis, &readings, options)?;
    let mut report = Report::new("pitch", measured_column(axis));
    // The figures of the standard are of all that was read.
    let all = readings.by_target();
    report.set_aside = readings.set_gross_aside(run, axis);
    let sums = Sums::of(readings.targets_mm.len(), readings.list.iter());
    let grid = choose_grid(&readings, &sums, options, &mut report);
    let laws = laws(&readings, options);
    let judged = if readings.runs > 1 { judge(&readings, &grid, &laws) } else { Vec::new() };
    let decision = decision(&readings, &laws);

    let by_target = readings.by_target();
    let iso230 = if readings.is_record { None } else { figures(&readings.targets_mm, &all) };
    describe(&mut report, &readings, &iso230);
    report.table = iso230.as_ref().map(ToString::to_string).unwrap_or_default();
    let best = judged
        .iter()
        .filter(|it| it.law > Law::Constant)
        .min_by(|a, b| a.rms_um().total_cmp(&b.rms_um()));
    let is_one_pass = is_one_pass(&readings, &decision);
    let taken = if is_one_pass { Ok(Law::OneTable) } else { decision.taken.map(Law::from) };
    let Ok(law) = taken else {
        let mut why = reasons(&readings, &judged, best, &by_target);
        why.extend(to_measure(&readings, &decision, &by_target));
        report.verdict = Verdict::DoNotCompensate(why);
        report.left_out = best.and_then(|best| Spread::of(&best.residuals_um));
        return Ok(PitchFit { report, pitch: None, backlash: None, iso230 });
    };
    let fitted = sums.fit(&readings.targets_mm, &grid, law);
    let residual = |it: &Reading| it.um - fitted.at(readings.targets_mm[it.target], it.way);
    // A table of one pass goes through each of its readings: that nothing is left says nothing.
    report.in_sample = Spread::of(&readings.list.iter().map(residual).collect::<Vec<_>>())
        .filter(|_| !is_one_pass);
    let judged = judged.iter().find(|judged| judged.law == law);
    report.left_out = judged.and_then(|judged| Spread::of(&judged.residuals_um));
    report.warnings.extend(between_points(&readings, law));
    warn(&mut report, &readings, &iso230);
    write(&mut report, axis, &readings, &sums, &grid, &fitted);
    let backlash =
        fitted.width_um.map(|width_um| Backlash { width_um, ramp_mm: 0.0, hysteresis_um: 0.0 });
    Ok(PitchFit { report, pitch: fitted.pitch, backlash, iso230 })
}

/// At least two targets, and the directions that are asked for.
fn check_extent(
    run: &Uncompensated<'_>,
    axis: LinearAxis,
    readings: &Readings,
    options: &Options,
) -> Result<(), BadInput> {
    if let [only] = readings.targets_mm[..] {
        let rule = format!("{only} is the only position: a table needs at least 2 test points");
        return Err(run.bad(0, &format!("{}_mm", axis.name()), rule));
    }
    if options.ways == TableMode::Both {
        let directions = [(1, "positive"), (-1, "negative")];
        for (has, (value, name)) in readings.has_way().into_iter().zip(directions) {
            if !has {
                let rule = format!(
                    "is never {value}: a table for each direction needs positions approached in \
                     the {name} direction as well"
                );
                return Err(run.bad(0, &format!("dir_{}", axis.name()), rule));
            }
        }
    }
    if let Some(step_mm) = options.step_mm
        && !(step_mm > 0.0 && Grid::with_step(&readings.targets_mm, step_mm).points <= LARGEST)
    {
        let rule = format!(
            "cannot have a table with a step of {step_mm} mm: it must be above 0 and give at most \
             {LARGEST} points"
        );
        return Err(run.bad(0, &format!("{}_mm", axis.name()), rule));
    }
    Ok(())
}

/// The largest number of points that a user may ask for.
const LARGEST: usize = 4096;

/// Returns the corrections to try, from the simplest on; the first two are none.
fn laws(readings: &Readings, options: &Options) -> Vec<Law> {
    let mut laws = vec![Law::Nothing, Law::Constant];
    let both = readings.has_way() == [true; 2];
    let screw = options.feedback == Feedback::Screw;
    laws.push(if both && options.ways == TableMode::Both {
        Law::BothTables
    } else {
        Law::OneTable
    });
    if both && screw && options.ways != TableMode::Both {
        laws.push(Law::TableAndBacklash);
    }
    if both && options.ways == TableMode::Automatic {
        laws.push(Law::BothTables);
    }
    laws
}

/// Returns true for one pass in one direction: a screw's file of a control, a certificate. Nothing in it says
/// whether the axis repeats, so it is taken over as it stands.
fn is_one_pass(readings: &Readings, decision: &Decision) -> bool {
    let each_once = readings.list.len() == readings.targets_mm.len();
    readings.runs < 2
        && !readings.is_record
        && each_once
        && readings.targets_mm.len() >= repeats::MIN_PLACES
        && decision.taken == Err(repeats::Refusal::TooFew)
}

/// Returns the decision that `trueup diagnose` takes as well.
fn decision(readings: &Readings, laws: &[Law]) -> Decision {
    let laws: Vec<repeats::Law> = laws.iter().filter_map(|law| law.table()).collect();
    let none = vec![false; readings.list.len()];
    repeats::decide(&readings.repeats(), &none, readings.targets_mm.len(), &laws)
}

fn figures(targets_mm: &[f64], by_target: &[[Vec<f64>; 2]]) -> Option<Iso230> {
    let targets: Vec<Target> = targets_mm
        .iter()
        .zip(by_target)
        .map(|(&position_mm, [forward_um, reverse_um])| Target {
            position_mm,
            forward_um: forward_um.clone(),
            reverse_um: reverse_um.clone(),
        })
        .collect();
    Iso230::of(&targets).ok()
}
