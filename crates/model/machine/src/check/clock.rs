//! The clock of a run: an hour of summer time, a clock that was set, and pauses in a record that is otherwise regular.
//!
//! A step of the clock is a pause where the values went on changing in the meantime, and a slip where they did not:
//! straight lines through the rows before and after it say which. Values that do not move say neither.
//!
//! | step | values went on as in one row | they changed as in that time | they say neither |
//! |---|---|---|---|
//! | an hour more than a row | slip | remark | warning |
//! | longer than 3 rows | slip | remark, from 20 rows on | the same |
//!
//! A clock that runs back within a run is refused where the run is read.

use super::{
    plausibility::{ImplausibleValue, Plausibility},
    warning::Warning,
};
use crate::{keys::reader::is_temperature_column, run_file::RunFile};

/// Steps that make a record regular: at least as many, of which this share is within a tenth of the median.
const MIN_REGULAR_STEPS: usize = 50;
const MIN_REGULAR_FRACTION: f64 = 0.95;
const RELATIVE_STEP_TOLERANCE: f64 = 0.1;
/// From this many medians on a step is a pause …
const MIN_PAUSE_RATIO: f64 = 20.0;
/// … and from this many on it may be a clock that was set.
const MIN_CLOCK_JUMP_RATIO: f64 = 3.0;
/// A change to summer time, in s.
const DST_SHIFT_S: f64 = 3600.0;
/// The longest step, in s, next to which an hour can be distinguished from a pause of the logger.
const MAX_MEDIAN_STEP_S: f64 = 600.0;
/// Rows on each side of a step through which the lines are laid, and the fewest of them.
const MAX_FIT_ROWS: usize = 12;
const MIN_FIT_ROWS: usize = 5;
/// A change is visible from this many standard errors on.
const MIN_CHANGE_STANDARD_ERRORS: f64 = 5.0;
/// Lines before and after of which the steeper is at most this much steeper are one course.
const MAX_SLOPE_RATIO: f64 = 2.5;

/// The findings about the clock of a run.
#[derive(Default)]
pub(super) struct ClockFindings {
    /// Slips: constants that are fitted to this time are wrong.
    pub(super) slips: Vec<ImplausibleValue>,
    /// An hour that may be a slip.
    pub(super) warnings: Vec<Warning>,
    /// Pauses.
    pub(super) remarks: Vec<Warning>,
}

/// A step of the clock that is longer than the others.
struct ClockStep {
    row: usize,
    step_s: f64,
    is_hour: bool,
    /// Whether the values show a slip; `None` where they do not move.
    is_clock_error: Option<bool>,
}

/// Returns what the steps of the clock are.
pub(super) fn check_clock(run: &RunFile) -> ClockFindings {
    let Some((steps, median_s)) = find_irregular_clock_steps(run) else {
        return ClockFindings::default();
    };
    let at = |step: &ClockStep, what: String, help: String| Warning {
        place: run.value_location(step.row, "time_s"),
        what,
        help,
    };
    let line = |step: &ClockStep| run.value_location(step.row, "time_s").line;
    let mut clock = ClockFindings::default();
    let slips: Vec<&ClockStep> =
        steps.iter().filter(|step| step.is_clock_error == Some(true)).collect();
    if let Some(step) = slips.first() {
        let kind = if step.is_hour { "summer time begins" } else { "the clock was set" };
        let others = match slips.len() - 1 {
            0 => String::new(),
            others => format!(" ({others} more such steps follow)"),
        };
        let what = format!(
            "time_s steps by {} s here, where the other rows are {} s apart and the values show no step: {kind}{others}",
            round_to_milliseconds(step.step_s),
            round_to_milliseconds(median_s)
        );
        let help = format!(
            "take {} s off from line {} on: lags and drifts are fitted to the time",
            round_to_milliseconds(step.step_s - median_s),
            line(step)
        );
        let warning = at(step, what, help);
        clock.slips.push(ImplausibleValue {
            key: "time_s".into(),
            grade: Plausibility::Unlikely,
            warning,
        });
    }
    let hour = steps.iter().find(|step| step.is_hour && step.is_clock_error.is_none());
    clock.warnings.extend(hour.map(|step| {
        let what = format!(
            "time_s steps by {} s here, an hour more than between the other rows: the begin of summer time, or a pause",
            round_to_milliseconds(step.step_s)
        );
        let help = format!(
            "if the clock was changed, take 3600 s off from line {} on: lags and drifts are fitted to the time",
            line(step)
        );
        at(step, what, help)
    }));
    let is_pause = |step: &&ClockStep| {
        step.step_s > MIN_PAUSE_RATIO * median_s
            && step.is_clock_error != Some(true)
            && !(step.is_hour && step.is_clock_error.is_none())
    };
    let pauses: Vec<&ClockStep> = steps.iter().filter(is_pause).collect();
    let longest = pauses.iter().max_by(|a, b| a.step_s.total_cmp(&b.step_s));
    clock.remarks.extend(longest.map(|longest| {
        let what = match pauses.len() {
            1 => format!("time_s has a pause of {} s here", round_to_milliseconds(longest.step_s)),
            count => format!("time_s has {count} pauses, the longest of {} s here", round_to_milliseconds(longest.step_s)),
        };
        let what = format!("{what}; the other rows are {} s apart", round_to_milliseconds(median_s));
        let help = "nothing to do if nothing was recorded then; number the parts in a column run if each shall start settled";
        at(longest, what, help.into())
    }));
    clock
}

/// Returns the steps that differ from the others, and the median step; `None` where the record is not regular.
fn find_irregular_clock_steps(run: &RunFile) -> Option<(Vec<ClockStep>, f64)> {
    let time_s = run.column("time_s")?;
    let runs = run.column("run");
    let rows: Vec<usize> = (0..time_s.len()).filter(|row| !time_s[*row].is_nan()).collect();
    let is_one_run = |pair: &[usize]| runs.is_none_or(|runs| runs[pair[0]] == runs[pair[1]]);
    let pairs: Vec<(usize, f64)> = rows
        .windows(2)
        .enumerate()
        .filter(|(_, pair)| is_one_run(pair))
        .map(|(index, pair)| (index, time_s[pair[1]] - time_s[pair[0]]))
        .collect();
    let mut sorted: Vec<f64> = pairs.iter().map(|(_, step_s)| *step_s).collect();
    sorted.sort_by(f64::total_cmp);
    let median_s = *sorted.get(sorted.len() / 2)?;
    let near = sorted
        .iter()
        .filter(|step_s| (**step_s - median_s).abs() <= RELATIVE_STEP_TOLERANCE * median_s)
        .count();
    if sorted.len() < MIN_REGULAR_STEPS
        || median_s <= 0.0
        || (near as f64) < MIN_REGULAR_FRACTION * sorted.len() as f64
    {
        return None;
    }
    let is_hour = |step_s: f64| {
        median_s <= MAX_MEDIAN_STEP_S
            && (step_s - median_s - DST_SHIFT_S).abs() <= 0.5 * median_s.min(120.0)
    };
    let long = pairs.into_iter().filter(|(_, step_s)| *step_s > MIN_CLOCK_JUMP_RATIO * median_s);
    let steps = long.map(|(index, step_s)| {
        let is_clock_error = is_clock_error(run, &rows, index, step_s, median_s);
        ClockStep { row: rows[index + 1], step_s, is_hour: is_hour(step_s), is_clock_error }
    });
    Some((steps.collect(), median_s))
}

/// Returns whether the values went on over the step after `rows[index]` as from one row to the next; `None` where they
/// do not move enough to say that.
fn is_clock_error(
    run: &RunFile,
    rows: &[usize],
    index: usize,
    step_s: f64,
    median_s: f64,
) -> Option<bool> {
    // A circle begins where it ends, and a diagonal at its own zero, whatever the pause between two of them.
    let is_value = |name: &str| {
        is_temperature_column(name)
            || name.starts_with("measured_")
                && !["measured_dr_um", "measured_diagonal_um"].contains(&name)
    };
    let votes = run.columns().iter().filter(|column| is_value(&column.name)).filter_map(|column| {
        let side =
            |rows: &[usize]| -> Vec<f64> { rows.iter().map(|row| column.values[*row]).collect() };
        let before = side(&rows[(index + 1).saturating_sub(MAX_FIT_ROWS)..=index]);
        let after = side(&rows[index + 1..rows.len().min(index + 1 + MAX_FIT_ROWS)]);
        let [before, after] = [StraightLine::fit(&before)?, StraightLine::fit(&after)?];
        let error = (before.end_error.powi(2) + after.end_error.powi(2)).sqrt();
        // In one row, and in as many rows as the clock says.
        let slope = 0.5 * (before.slope + after.slope);
        let beyond = (after.first - before.last - slope).abs();
        let [flat, steep] =
            [before.slope.abs().min(after.slope.abs()), before.slope.abs().max(after.slope.abs())];
        let rows_passed = ((step_s - median_s) / median_s).abs();
        let expected = flat * rows_passed;
        let is_course = before.slope * after.slope > 0.0 && steep <= MAX_SLOPE_RATIO * flat;
        let allowed = MIN_CHANGE_STANDARD_ERRORS * error + steep;
        if is_course && expected > 2.0 * allowed && beyond <= allowed {
            return Some(true);
        }
        (beyond > allowed && beyond > 0.0).then_some(false)
    });
    let votes: Vec<bool> = votes.collect();
    (!votes.is_empty()).then(|| votes.iter().all(|vote| *vote))
}

/// The straight line through values at equal distances.
struct StraightLine {
    first: f64,
    last: f64,
    /// The change from one value to the next.
    slope: f64,
    /// The standard error of the line's ends.
    end_error: f64,
}

impl StraightLine {
    fn fit(values: &[f64]) -> Option<Self> {
        if values.len() < MIN_FIT_ROWS || values.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let middle = 0.5 * (count - 1.0);
        let offsets = (0..values.len()).map(|at| at as f64 - middle);
        let square: f64 = offsets.clone().map(|at| at * at).sum();
        let slope = offsets.clone().zip(values).map(|(at, value)| at * (value - mean)).sum::<f64>()
            / square;
        let rest =
            offsets.zip(values).map(|(at, value)| (value - mean - slope * at).powi(2)).sum::<f64>();
        let variance = rest / (count - 2.0);
        let end_error = (variance * (1.0 / count + middle * middle / square)).sqrt();
        Some(Self { first: mean - slope * middle, last: mean + slope * middle, slope, end_error })
    }
}

/// Seconds to a thousandth, without trailing zeros.
fn round_to_milliseconds(seconds: f64) -> f64 {
    (seconds * 1000.0).round() / 1000.0
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// Returns a row each 60 s for 120 rows, with these steps of the clock in the place of others. The temperature
    /// warms with 100 minutes by its own clock, in which `passed` of each step is real; `run` changes at the rows of
    /// `parts`.
    fn found(
        steps: &[(usize, f64)],
        parts: &[usize],
        passed: f64,
    ) -> (Vec<String>, Vec<String>, Vec<String>) {
        let (mut text, mut time_s, mut own_s, mut part) =
            (String::from("time_s,run,temp_a_c\n"), 100_000.0, 0.0, 0);
        for row in 0..120_usize {
            let step_s =
                steps.iter().find(|(at, _)| *at == row).map_or(60.0, |(_, step_s)| *step_s);
            time_s += step_s;
            own_s += 60.0 + passed * (step_s - 60.0);
            part += usize::from(parts.contains(&row));
            let noise = (row * 7919 % 13) as f64 / 13.0 * 0.04;
            let temp_c = 40.0 - 18.0 * f64::exp(-own_s / 6000.0) + noise;
            text += &format!("{time_s},{part},{temp_c:.3}\n");
        }
        let run =
            RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own run");
        let line = |warning: Warning| format!("{}: {}", warning.place.line, warning.what);
        let ClockFindings { slips, warnings, remarks } = check_clock(&run);
        (
            slips.into_iter().map(|slip| line(slip.warning)).collect(),
            warnings.into_iter().map(line).collect(),
            remarks.into_iter().map(line).collect(),
        )
    }

    #[test]
    fn a_clock_that_was_set_is_an_error_and_a_pause_is_a_remark() {
        let (slips, warnings, remarks) = found(&[], &[], 0.0);
        assert!(slips.is_empty() && warnings.is_empty() && remarks.is_empty());
        for (step_s, phrase) in [
            (3660.0, "summer time"),
            (1500.0, "clock was set"),
            (90_000.0, "clock was set"),
            (1e9, "clock was set"),
        ] {
            let (slips, _, remarks) = found(&[(40, step_s)], &[], 0.0);
            assert!(
                slips.len() == 1 && slips[0].starts_with("42: ") && slips[0].contains(phrase),
                "{step_s}: {slips:?}"
            );
            assert!(remarks.is_empty(), "{remarks:?}");
            let (slips, warnings, remarks) = found(&[(40, step_s)], &[], 1.0);
            assert!(slips.is_empty() && warnings.is_empty(), "{step_s}: {slips:?} {warnings:?}");
            assert!(
                remarks.len() == 1 && remarks[0].contains("a pause of"),
                "{step_s}: {remarks:?}"
            );
            let (slips, warnings, remarks) = found(&[(40, step_s)], &[40], 0.0);
            assert!(
                slips.is_empty() && warnings.is_empty() && remarks.is_empty(),
                "a new run is neither"
            );
        }
    }

    #[test]
    fn nights_are_one_remark_and_rows_that_were_missed_are_none() {
        let (slips, warnings, remarks) = found(&[(30, 57_600.0), (70, 60_000.0)], &[], 1.0);
        assert!(slips.is_empty() && warnings.is_empty());
        assert!(
            remarks.len() == 1 && remarks[0].starts_with("72: time_s has 2 pauses"),
            "{remarks:?}"
        );
        let (slips, warnings, remarks) = found(&[(30, 300.0), (70, 240.0)], &[], 1.0);
        assert!(
            slips.is_empty() && warnings.is_empty() && remarks.is_empty(),
            "{slips:?} {remarks:?}"
        );
    }

    #[test]
    fn an_hour_in_values_that_do_not_move_is_a_warning() {
        let mut text = String::from("time_s,temp_a_c\n");
        let mut time_s = 20_000.0;
        for row in 0..120 {
            time_s += if row == 50 { 3660.0 } else { 60.0 };
            text += &format!("{time_s},21.5\n");
        }
        let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
        let clock = check_clock(&run);
        assert!(clock.slips.is_empty() && clock.remarks.is_empty());
        assert!(clock.warnings.len() == 1 && clock.warnings[0].what.contains("an hour more"));
    }
}
