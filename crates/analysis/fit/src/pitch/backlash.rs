//! Backlash alone: how far the table is left behind after a reversal (`docs/physics.md` section 5).
//!
//! At each position the axis arrives from both sides, several times; b is the reading from the
//! negative side minus that from the positive side, and b̄ᵢ its mean at position i. A test at the
//! middle and near the ends (three positions or fewer) gives B = the b̄ᵢ of largest magnitude, with
//! its sign: a CNC that over-compensates has a negative one. A sweep over more positions gives
//! their mean, because the largest of many would over-compensate at all the others.
//!
//! Readings at several feeds are distinguished in `by_feed`: where the width depends on the feed, one feed's
//! alone is fitted.
//!
//! Whether b̄ᵢ changes along the axis is tested by analysis of variance: the scatter of the b̄ᵢ next to
//! that of the repeats, F at 95 %. Whether B is worth laying in is tested on held-out runs.

use trueup_machine::{
    InputFileError,
    applied_offsets::UncompensatedRun,
    machine_file::writer::{MachineFileEdit, round_to_decimals},
    machine_file::{Backlash, Feedback, LinearAxis},
};

use super::{
    PitchFitOptions,
    cross_validation::{fold_count, fold_index, is_significant_gain},
    feed_dependence,
    pitch_report::{confidence_half_width, describe_folds},
    pitch_table::TABLE_DECIMALS,
    readings::{FEED_COLUMN, PitchReadings, ReadingSelection, measured_column_name},
    reversal_difference::{ReversalDifference, compute_reversal_differences},
};
use crate::pooled_rows::f_test_p_value;
use crate::report::{FitDetail, FitParameter, FitReport, FitVerdict, ResidualStatistics};

/// This many positions are a test of backlash, more are a sweep.
const MAX_BACKLASH_TEST_POSITIONS: usize = 3;

/// Below this probability a difference between positions is not chance.
const SIGNIFICANCE_LEVEL: f64 = 0.05;

/// Which of the means is the width.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BacklashWidthRule {
    /// The largest of up to three positions, the mean of more.
    #[default]
    Automatic,
    /// The mean of largest magnitude.
    Largest,
    /// The mean over the positions.
    Mean,
}

/// A fitted backlash.
#[derive(Clone, Debug, PartialEq)]
pub struct BacklashFit {
    /// The result, with the changes in the machine file.
    pub report: FitReport,
    /// The width; `None` if it should not be laid in.
    pub backlash: Option<Backlash>,
    /// b̄ᵢ by position in mm, in µm: reverse minus forward.
    pub by_position: Vec<(f64, f64)>,
    /// Whether it changes along the axis by more than the repeats scatter.
    pub depends_on_position: bool,
}

/// Returns the backlash of `axis`, from the same columns as [`fit`](super::fit).
///
/// # Errors
/// A column is missing or in another unit, a cell of a row is empty, a position comes twice in a
/// run and direction, or no position was approached from both sides in one run.
pub fn fit_backlash(
    run: &UncompensatedRun<'_>,
    axis: LinearAxis,
    options: &PitchFitOptions,
) -> Result<BacklashFit, InputFileError> {
    let selection = ReadingSelection {
        axis,
        runs: options.runs.as_deref(),
        known_um: options.known_um.as_deref(),
        by_feed: true,
        in_order: false,
    };
    let mut readings = PitchReadings::from_run(run, &selection)?;
    let outliers = readings.exclude_gross_errors(run, axis);
    let mut reversal_differences = compute_reversal_differences(&readings);
    if reversal_differences.is_empty() {
        let direction = format!("dir_{}", axis.name());
        let rule = match readings.measured_directions() {
            [true, true] => "never has both 1 and -1 at one position in one run".to_string(),
            [true, false] => "is never -1".to_string(),
            _ => "is never 1".to_string(),
        } + ": backlash needs positions that were approached from both sides";
        return Err(run.value_error(0, &direction, rule));
    }
    let feed = feed_dependence::fit_backlash_by_feed(&readings, &reversal_differences, options)
        .map_err(|rule| {
            run.value_error(
                0,
                if run.column(FEED_COLUMN).is_some() { FEED_COLUMN } else { "" },
                rule,
            )
        })?;
    if let Some(feed) = &feed {
        readings.list.retain(|reading| reading.feed == feed.chosen);
        reversal_differences.retain(|difference| difference.feed == feed.chosen);
    }
    let by_target = group_differences_by_target(&readings, &reversal_differences);
    let means: Vec<(f64, f64)> =
        by_target.iter().map(|(x, um)| (*x, um.iter().sum::<f64>() / um.len() as f64)).collect();
    let rule = match options.width {
        BacklashWidthRule::Automatic if means.len() <= MAX_BACKLASH_TEST_POSITIONS => {
            BacklashWidthRule::Largest
        }
        BacklashWidthRule::Automatic => BacklashWidthRule::Mean,
        rule => rule,
    };
    let width_um =
        round_to_decimals(backlash_width_um(means.iter().map(|mean| mean.1), rule), TABLE_DECIMALS);
    let p = position_dependence_p_value(&by_target);
    let mut report = build_report(&readings, &reversal_differences, axis, rule, width_um);
    report.excluded = outliers;
    if let Some(feed) = feed {
        feed.add_to_report(&mut report, width_um);
    }
    let other = |rule| backlash_width_um(means.iter().map(|mean| mean.1), rule);
    report.facts.push(FitDetail::numbers("position_mm", means.iter().map(|mean| mean.0).collect()));
    report.facts.push(FitDetail::numbers("reversal_um", means.iter().map(|mean| mean.1).collect()));
    report.facts.push(FitDetail::number("largest_um", other(BacklashWidthRule::Largest)));
    report.facts.push(FitDetail::number("mean_um", other(BacklashWidthRule::Mean)));
    let depends_on_position = p.is_some_and(|p| p < SIGNIFICANCE_LEVEL);
    if depends_on_position {
        let um = || means.iter().map(|mean| mean.1);
        let (low, high) = (um().fold(f64::INFINITY, f64::min), um().fold(f64::MIN, f64::max));
        report.warnings.push(format!(
            "backlash changes along the axis, from {low:.1} to {high:.1} µm, by more than the \
             repeats scatter. One width is wrong at some positions; a table for each direction \
             (fit pitch) follows it"
        ));
    }
    if options.feedback == Feedback::Scale {
        report.verdict = FitVerdict::DoNotCompensate(vec![
            "the axis has its feedback from a scale, which sees the backlash itself".to_string(),
        ]);
    }
    let backlash = report.verdict.is_usable().then(|| {
        report.edit = MachineFileEdit::from_section(Backlash::width_section(axis, width_um));
        Backlash { width_um, ramp_mm: 0.0, hysteresis_um: 0.0 }
    });
    Ok(BacklashFit { report, backlash, by_position: means, depends_on_position })
}

/// Position in mm and differences in µm, of each target that has any.
fn group_differences_by_target(
    readings: &PitchReadings,
    reversal_differences: &[ReversalDifference],
) -> Vec<(f64, Vec<f64>)> {
    let mut targets: Vec<(f64, Vec<f64>)> =
        readings.targets_mm.iter().map(|&x| (x, Vec::new())).collect();
    for difference in reversal_differences {
        targets[difference.target].1.push(difference.um);
    }
    targets.retain(|(_, um)| !um.is_empty());
    targets
}

/// Returns the width of these means by `rule`.
fn backlash_width_um(means: impl Iterator<Item = f64> + Clone, rule: BacklashWidthRule) -> f64 {
    match rule {
        BacklashWidthRule::Largest => {
            means.fold(0.0, |largest: f64, um| if um.abs() > largest.abs() { um } else { largest })
        }
        _ => means.clone().sum::<f64>() / means.count() as f64,
    }
}

/// Returns how likely chance alone makes the positions differ so; `None` without repeats or with one
/// position.
fn position_dependence_p_value(by_target: &[(f64, Vec<f64>)]) -> Option<f64> {
    let count: usize = by_target.iter().map(|(_, um)| um.len()).sum();
    let freedom = (by_target.len().checked_sub(1)?, count - by_target.len());
    if freedom.0 == 0 || freedom.1 == 0 {
        return None;
    }
    let mean = |um: &[f64]| um.iter().sum::<f64>() / um.len() as f64;
    let all = by_target.iter().flat_map(|(_, um)| um).sum::<f64>() / count as f64;
    let between: f64 =
        by_target.iter().map(|(_, um)| um.len() as f64 * (mean(um) - all).powi(2)).sum();
    let within: f64 = by_target
        .iter()
        .map(|(_, um)| um.iter().map(|x| (x - mean(um)).powi(2)).sum::<f64>())
        .sum();
    f_test_p_value((between, freedom.0 as f64), (within, freedom.1 as f64))
}

fn build_report(
    readings: &PitchReadings,
    reversal_differences: &[ReversalDifference],
    axis: LinearAxis,
    rule: BacklashWidthRule,
    width_um: f64,
) -> FitReport {
    let mut report = FitReport::new("backlash", measured_column_name(axis));
    let um: Vec<f64> = reversal_differences.iter().map(|difference| difference.um).collect();
    report.before = ResidualStatistics::from_residuals(&um);
    report.in_sample =
        ResidualStatistics::from_residuals(&um.iter().map(|um| um - width_um).collect::<Vec<_>>());
    report.rows_used = readings.list.len();
    report.rows_incomplete = readings.rows_incomplete;
    report.facts.push(FitDetail::number("runs", readings.runs as f64));
    report.facts.push(FitDetail::text(
        "width_is",
        if rule == BacklashWidthRule::Largest {
            "the largest mean"
        } else {
            "the mean of all positions"
        },
    ));
    let blocks = fold_count(readings.runs);
    let block = |difference: &ReversalDifference| fold_index(difference.run, readings.runs);
    let mut held_out = Vec::new();
    let (mut gains, mut own) = (Vec::new(), Vec::new());
    for out in 0..blocks {
        let retained: Vec<ReversalDifference> = reversal_differences
            .iter()
            .filter(|difference| block(difference) != out)
            .copied()
            .collect();
        let test: Vec<f64> = reversal_differences
            .iter()
            .filter(|difference| block(difference) == out)
            .map(|difference| difference.um)
            .collect();
        if retained.is_empty() || test.is_empty() {
            continue;
        }
        let retained_width = backlash_width_um(target_means(&retained).into_iter(), rule);
        let rest: Vec<f64> = test.iter().map(|um| um - retained_width).collect();
        let mean_square = |um: &[f64]| um.iter().map(|x| x * x).sum::<f64>() / um.len() as f64;
        gains.push(mean_square(&test) - mean_square(&rest));
        own.push(test.iter().sum::<f64>() / test.len() as f64);
        held_out.extend(rest);
    }
    // The largest mean is one position's own; a mean of all is known from the runs' own widths.
    let at_largest = reversal_differences.chunk_by(|a, b| a.target == b.target).max_by(|a, b| {
        let size = |group: &[ReversalDifference]| {
            backlash_width_um(target_means(group).into_iter(), rule).abs()
        };
        size(a).total_cmp(&size(b))
    });
    let sample = match (rule, at_largest) {
        (BacklashWidthRule::Largest, Some(group)) => {
            group.iter().map(|difference| difference.um).collect()
        }
        _ => own.clone(),
    };
    report.parameters.push(match confidence_half_width(&sample) {
        Some(half) => FitParameter::fitted("width_um", width_um, half),
        None => FitParameter::fixed("width_um", width_um),
    });
    if gains.len() < 2 {
        report.warnings.push(
            "there is only one run, so it is unknown whether the backlash repeats; seven readings at \
             each position are usual"
                .to_string(),
        );
        return report;
    }
    report.held_out = ResidualStatistics::from_residuals(&held_out);
    report.held_out_by = describe_folds(readings.runs);
    if !is_significant_gain(&gains) {
        let rms =
            |spread: Option<ResidualStatistics>| spread.map_or(f64::NAN, |spread| spread.rms_um);
        let each: Vec<String> = own.iter().map(|um| format!("{um:.1}")).collect();
        report.verdict = FitVerdict::DoNotCompensate(vec![format!(
            "on held-out runs the difference between the directions is {:.1} µm rms without a \
             correction and {:.1} µm with the width of the other runs. That is no reliable gain \
             (width run by run: {} µm)",
            rms(report.before),
            rms(report.held_out),
            each.join(", ")
        )]);
    }
    report
}

/// Returns the mean at each target.
fn target_means(reversal_differences: &[ReversalDifference]) -> Vec<f64> {
    // Sorted by target already.
    reversal_differences
        .chunk_by(|a, b| a.target == b.target)
        .map(|group| group.iter().map(|difference| difference.um).sum::<f64>() / group.len() as f64)
        .collect()
}
