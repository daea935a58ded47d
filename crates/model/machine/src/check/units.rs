//! The values of a run's columns, held against what can be measured on a machine: °F, kelvin or tenths for °C,
//! milliseconds or minutes for seconds, millimetres or inches for micrometres, metres for millimetres.
//!
//! | rule | is recognised by |
//! |---|---|
//! | temperature | what a thermometer of the model shows at its coldest, and whether it is a warm machine in another unit |
//! | clock | how long a spindle runs without a stop, how fast a part warms |
//! | error | whether any gauge resolves it, whether any machine has it |
//!
//! Impossible is refused, unlikely is a warning; the user accepts a column by its name. A furnace next to the
//! machine, a record of weeks and a warm start are none of these: what only another column than the model's
//! shows is never refused.

use super::{
    plausibility::{ImplausibleValue, Plausibility},
    thermal::looks_like_kelvin,
    warning::Warning,
};
use crate::{
    effect::Quantity,
    keys::reader::is_temperature_column,
    machine_file::Machine,
    model::required_columns,
    run_file::{RunColumn, RunFile},
};

/// Rows that a statement about a whole column needs.
const MIN_COLUMN_ROWS: usize = 3;
/// The coldest that a thermometer of a spindle or an axis shows is not above this in °C: insulation of class E
/// ends there (IEC 60085), and grease before it.
const MAX_LOWEST_READING_C: f64 = 120.0;
/// The ends of IEC 60751: no resistance thermometer shows what is beyond.
const RTD_RANGE_C: [f64; 2] = [-200.0, 850.0];
/// A machine that stands is at 10 to 35 °C, which is this many °F …
const IDLE_TEMPERATURE_RANGE_F: std::ops::RangeInclusive<f64> = 50.0..=95.0;
/// Parts that stand in one workshop are no further apart than this, in °C.
const MAX_WORKSHOP_SPREAD_K: f64 = 5.0;
/// … and what runs in it at 60 °C at most.
const MAX_MACHINE_TEMPERATURE_F: f64 = 140.0;
/// A clock of seconds that is beyond this counts milliseconds of Unix: as seconds it is the year 5138.
const MAX_PLAUSIBLE_TIME_S: f64 = 1e11;
/// No spindle runs for longer without a stop, in s: a week.
const MAX_SPINDLE_RUN_S: f64 = 7.0 * 86_400.0;
/// A part takes no longer than this through the whole range of its temperatures at its fastest, in s: two days.
const MAX_RANGE_TRAVERSAL_S: f64 = 2.0 * 86_400.0;
/// A range that is a machine's own heat, not that of its hall, in K.
const MIN_SELF_HEATING_K: f64 = 8.0;
/// A part of a machine warms by no more than this, in K/s: 10 K/min, what a live thermometer is believed.
const MAX_HEATING_RATE_C_PER_S: f64 = 10.0 / 60.0;
/// It is tested over this many rows, between means of this many at both ends that are at least this many K apart: noise
/// is not.
const RATE_WINDOW_ROWS: usize = 20;
const RATE_MEAN_ROWS: usize = 3;
const MIN_RATE_CHANGE_K: f64 = 2.0;
/// No gauge of a workshop resolves what stays below this, in µm.
const GAUGE_RESOLUTION_UM: f64 = 0.1;
/// No error or growth has a wider range than this in µm; the board takes 4000.
const MAX_ERROR_RANGE_UM: f64 = 20_000.0;
/// A spindle that never turns faster than this in r/min has its speed in 1000 r/min.
const MAX_SPEED_KRPM: f64 = 40.0;

/// Returns the columns of `run` that are in another unit than their names say; `others` are runs of the same machine that
/// are read together with it.
pub(super) fn findings(
    run: &RunFile,
    machine: Option<&Machine>,
    others: &[RunFile],
) -> Vec<ImplausibleValue> {
    let of_laws: Vec<String> = machine.map(required_columns).unwrap_or_default();
    let thermometers: Vec<&RunColumn> =
        run.columns().iter().filter(|column| is_temperature_column(&column.name)).collect();
    let mut findings = Vec::new();
    for column in &thermometers {
        let is_law = of_laws.contains(&column.name);
        // Where no law says which it is, the only one is.
        let is_requested = is_law || thermometers.len() == 1;
        let may_be_f =
            may_be_fahrenheit(column, &thermometers) && !continues_celsius_run(column, others);
        findings.extend(find_wrong_temperature_unit(run, column, is_law, [is_requested, may_be_f]));
    }
    // What is no temperature says nothing of the clock.
    let sound: Vec<&RunColumn> = thermometers
        .into_iter()
        .filter(|column| {
            findings.iter().all(|finding: &ImplausibleValue| finding.key != column.name)
        })
        .collect();
    findings.extend(find_wrong_time_unit(run, &sound));
    for quantity in Quantity::ALL {
        let name = format!("measured_{}_um", quantity.name());
        findings.extend(
            run.columns()
                .iter()
                .find(|column| column.name == name)
                .and_then(|columns| find_wrong_error_unit(run, columns)),
        );
    }
    findings.extend(find_wrong_speed_unit(run));
    findings
}

fn new_implausible_value(
    run: &RunFile,
    column: &str,
    grade: Plausibility,
    what: &str,
    help: &str,
) -> ImplausibleValue {
    let row = run.column(column).and_then(|values| values.iter().position(|value| !value.is_nan()));
    let place = run.value_location(row.unwrap_or(0), column);
    let warning = Warning { place, what: format!("{column} {what}"), help: help.into() };
    ImplausibleValue { key: column.into(), grade, warning }
}

/// Returns the least and the most of a column with values enough.
fn value_range(values: &[f64]) -> Option<[f64; 2]> {
    let there = values.iter().copied().filter(|value| !value.is_nan());
    let (mut range, mut rows) = ([f64::INFINITY, f64::NEG_INFINITY], 0);
    for value in there {
        range = [range[0].min(value), range[1].max(value)];
        rows += 1;
    }
    (rows >= MIN_COLUMN_ROWS).then_some(range)
}

fn find_wrong_temperature_unit(
    run: &RunFile,
    column: &RunColumn,
    is_law: bool,
    [is_requested, may_be_f]: [bool; 2],
) -> Option<ImplausibleValue> {
    let [least, most] = value_range(&column.values)?;
    let is_tenths = is_machine_temperature(least / 10.0)
        && is_machine_temperature(most / 10.0)
        && least > MAX_LOWEST_READING_C;
    let as_kelvin = looks_like_kelvin(least) && looks_like_kelvin(most);
    let (unit, help) = match (as_kelvin, is_tenths) {
        (true, _) => {
            ("that looks like kelvin, not °C", "temperatures are in °C: take 273.15 away from each")
        }
        (_, true) => (
            "that looks like tenths of a degree, not °C",
            "temperatures are in °C: divide each by 10",
        ),
        _ => (
            "no thermometer of a machine shows that",
            "temperatures are in °C: is it another unit, or counts?",
        ),
    };
    let finding = |grade| {
        Some(new_implausible_value(
            run,
            &column.name,
            grade,
            &format!("is from {least} to {most}: {unit}"),
            help,
        ))
    };
    if least > RTD_RANGE_C[1] || most < RTD_RANGE_C[0] || (is_law && least > MAX_LOWEST_READING_C) {
        return finding(Plausibility::Impossible);
    }
    if as_kelvin || (is_requested && is_tenths) {
        return finding(Plausibility::Unlikely);
    }
    (is_requested && may_be_f && IDLE_TEMPERATURE_RANGE_F.contains(&least) && most <= MAX_MACHINE_TEMPERATURE_F).then(|| {
        let what = format!(
            "is from {least} to {most}: that looks like °F, not °C, for a machine that begins cold"
        );
        new_implausible_value(run, &column.name, Plausibility::Unlikely, &what, "temperatures are in °C: (°F − 32)/1.8")
    })
}

/// Returns whether the other thermometers allow that a column is in °F: all of them may be, or those that are not show
/// what it would in °C. A column that is warm from the first row on is no °F next to them.
fn may_be_fahrenheit(column: &RunColumn, thermometers: &[&RunColumn]) -> bool {
    let Some([least_f, most_f]) = value_range(&column.values) else { return true };
    let others = thermometers.iter().filter(|other| other.name != column.name);
    let in_c = others.filter_map(|other| value_range(&other.values));
    let in_c = in_c.filter(|[least, _]| !IDLE_TEMPERATURE_RANGE_F.contains(least));
    let around = in_c.reduce(|[low, high], [least, most]| [low.min(least), high.max(most)]);
    around.is_none_or(|[low, high]| {
        fahrenheit_to_celsius(most_f) >= low - MAX_WORKSHOP_SPREAD_K
            && fahrenheit_to_celsius(least_f) <= high + MAX_WORKSHOP_SPREAD_K
    })
}

/// Returns whether another run has the column, in °C beyond doubt, and up to where this one begins: a run of the warm
/// end, next to that of the cold one. One that begins well below the other's end, and in °F where the other begins,
/// may be the same cold start again.
fn continues_celsius_run(column: &RunColumn, others: &[RunFile]) -> bool {
    let Some([coldest, _]) = value_range(&column.values) else { return false };
    let same = others.iter().filter_map(|run| value_range(run.column(&column.name)?));
    same.filter(|[least, _]| !IDLE_TEMPERATURE_RANGE_F.contains(least)).any(|[least_c, most_c]| {
        let is_again = (fahrenheit_to_celsius(coldest) - least_c).abs() <= MAX_WORKSHOP_SPREAD_K
            && coldest + MAX_WORKSHOP_SPREAD_K < most_c;
        least_c <= coldest && coldest <= most_c + MAX_WORKSHOP_SPREAD_K && !is_again
    })
}

fn fahrenheit_to_celsius(fahrenheit: f64) -> f64 {
    (fahrenheit - 32.0) / 1.8
}

/// Returns whether a machine has this temperature, in °C.
fn is_machine_temperature(temperature_c: f64) -> bool {
    let [coldest, hottest] = super::thermal::MACHINE_TEMPERATURE_RANGE_C;
    (coldest..=hottest).contains(&temperature_c)
}

fn find_wrong_time_unit(run: &RunFile, thermometers: &[&RunColumn]) -> Option<ImplausibleValue> {
    let time_s = run.column("time_s")?;
    let [_, last_s] = value_range(time_s)?;
    let ms = "times are in s: divide each by 1000";
    if last_s > MAX_PLAUSIBLE_TIME_S {
        let what = format!("reaches {last_s}: that looks like milliseconds of Unix, not s");
        return Some(new_implausible_value(run, "time_s", Plausibility::Impossible, &what, ms));
    }
    let days = |seconds: f64| seconds / 86_400.0;
    let unlikely = |what: String, help: &str| {
        Some(new_implausible_value(run, "time_s", Plausibility::Unlikely, &what, help))
    };
    if let Some(longest_s) = run.column("spindle_rpm").map(|rpm| longest_spindle_run_s(time_s, rpm))
        && longest_s > MAX_SPINDLE_RUN_S
    {
        return unlikely(
            format!(
                "has the spindle turning for {:.0} days without a stop: that looks like ms, not s",
                days(longest_s)
            ),
            ms,
        );
    }
    for column in thermometers {
        if let Some(through_s) = fastest_range_traversal_s(time_s, &column.values)
            && through_s > MAX_RANGE_TRAVERSAL_S
        {
            return unlikely(
                format!(
                    "has {} take {:.0} days through its range at its fastest: that looks like ms, not s",
                    column.name,
                    days(through_s)
                ),
                ms,
            );
        }
    }
    // A part of a machine that turns: a rod over a flame and a printer's bed are faster.
    run.column("spindle_rpm")?;
    let parts = thermometers.iter().filter(|column| !is_fluid_column(&column.name));
    let fastest = parts.filter_map(|part| Some((max_rate_c_per_s(time_s, &part.values)?, part)));
    let (c_per_s, column) = fastest.max_by(|a, b| a.0.total_cmp(&b.0))?;
    if c_per_s <= MAX_HEATING_RATE_C_PER_S {
        return None;
    }
    unlikely(
        format!(
            "has {} change by {:.0} K in a minute: that looks like minutes or hours, not s",
            column.name,
            60.0 * c_per_s
        ),
        "times are in s: multiply minutes by 60",
    )
}

/// Coolant, oil and air change faster than a part of a machine.
fn is_fluid_column(name: &str) -> bool {
    ["coolant", "oil", "air", "water"].iter().any(|word| name.contains(word))
}

/// Returns the longest time that the spindle turns without a stop, in s.
fn longest_spindle_run_s(time_s: &[f64], rpm: &[f64]) -> f64 {
    let (mut longest_s, mut since) = (0.0_f64, None);
    for (&now_s, &rpm) in time_s.iter().zip(rpm) {
        if rpm > 0.0 && !now_s.is_nan() {
            let start_s = *since.get_or_insert(now_s);
            longest_s = longest_s.max(now_s - start_s);
        } else {
            since = None;
        }
    }
    longest_s
}

/// Returns how long a smooth column takes through its range at its fastest, in s; `None` where it is not smooth, or its
/// range is that of a hall.
fn fastest_range_traversal_s(time_s: &[f64], values: &[f64]) -> Option<f64> {
    const MIN_CHECKED_STEPS: usize = 100;
    const MAX_MEAN_STEP_FRACTION: f64 = 0.03;
    const MIN_SUSPECT_ROW_INTERVAL_S: f64 = 1_000.0;
    let [least, most] = value_range(values)?;
    let mut steps: Vec<(f64, f64)> = time_s
        .windows(2)
        .zip(values.windows(2))
        .map(|(time, value)| (time[1] - time[0], (value[1] - value[0]).abs()))
        .filter(|(apart_s, step)| *apart_s > 0.0 && !step.is_nan())
        .collect();
    let mean = steps.iter().map(|(_, step)| step).sum::<f64>() / steps.len() as f64;
    if steps.len() < MIN_CHECKED_STEPS
        || most - least < MIN_SELF_HEATING_K
        || mean > MAX_MEAN_STEP_FRACTION * (most - least)
    {
        return None;
    }
    steps.sort_by(|a, b| (a.1 / a.0).total_cmp(&(b.1 / b.0)));
    let (apart_s, step) = steps[steps.len() - 1 - steps.len() / 20];
    (apart_s >= MIN_SUSPECT_ROW_INTERVAL_S).then(|| (most - least) * apart_s / step)
}

/// Returns the fastest change of a column over [`RATE_WINDOW_ROWS`] rows, in K/s.
fn max_rate_c_per_s(time_s: &[f64], values: &[f64]) -> Option<f64> {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let windows = values.windows(RATE_WINDOW_ROWS).zip(time_s.windows(RATE_WINDOW_ROWS));
    let rates = windows.filter_map(|(values, time_s)| {
        let ends = |all: &[f64]| {
            mean(&all[RATE_WINDOW_ROWS - RATE_MEAN_ROWS..]) - mean(&all[..RATE_MEAN_ROWS])
        };
        let (change, apart_s) = (ends(values).abs(), ends(time_s));
        (change >= MIN_RATE_CHANGE_K && apart_s > 0.0).then(|| change / apart_s)
    });
    rates.reduce(f64::max)
}

fn find_wrong_error_unit(run: &RunFile, column: &RunColumn) -> Option<ImplausibleValue> {
    let [least, most] = value_range(&column.values)?;
    let largest = least.abs().max(most.abs());
    if most - least > MAX_ERROR_RANGE_UM {
        let what = format!(
            "is from {least} to {most}: no machine errs by that; it looks like nm or counts, not µm"
        );
        return Some(new_implausible_value(
            run,
            &column.name,
            Plausibility::Impossible,
            &what,
            "write it in µm",
        ));
    }
    (most > least && largest < GAUGE_RESOLUTION_UM).then(|| {
        let what = format!(
            "is {largest} at the most: no gauge resolves that in µm; it looks like mm or inches, not µm"
        );
        let help = "write it in µm: multiply mm by 1000, inches by 25 400";
        new_implausible_value(run, &column.name, Plausibility::Unlikely, &what, help)
    })
}

fn find_wrong_speed_unit(run: &RunFile) -> Option<ImplausibleValue> {
    let [_, most] = value_range(run.column("spindle_rpm")?)?;
    (most > 0.0 && most <= MAX_SPEED_KRPM).then(|| {
        let what = format!("is {most} at the most: that looks like 1000 r/min, not r/min");
        new_implausible_value(
            run,
            "spindle_rpm",
            Plausibility::Unlikely,
            &what,
            "speeds are in r/min",
        )
    })
}

#[cfg(test)]
mod tests;
