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
    heat::is_kelvin,
    range::{Finding, Grade},
    warning::Warning,
};
use crate::{
    file::{Machine, Quantity, is_temperature_column},
    model::required_columns,
    run_file::{Column, RunFile},
};

/// Rows that a statement about a whole column needs.
const MIN_ROWS: usize = 3;
/// The coldest that a thermometer of a spindle or an axis shows is not above this in °C: insulation of class E
/// ends there (IEC 60085), and grease before it.
const MAX_COLDEST_C: f64 = 120.0;
/// The ends of IEC 60751: no resistance thermometer shows what is beyond.
const ENDS_C: [f64; 2] = [-200.0, 850.0];
/// A machine that stands is at 10 to 35 °C, which is this many °F …
const STANDING_F: std::ops::RangeInclusive<f64> = 50.0..=95.0;
/// Parts that stand in one workshop are no further apart than this, in °C.
const APART_C: f64 = 5.0;
/// … and what runs in it at 60 °C at most.
const MAX_F: f64 = 140.0;
/// A clock of seconds that is beyond this counts milliseconds of Unix: as seconds it is the year 5138.
const MAX_CLOCK_S: f64 = 1e11;
/// No spindle runs for longer without a stop, in s: a week.
const LONGEST_RUN_S: f64 = 7.0 * 86_400.0;
/// A part takes no longer than this through the whole range of its temperatures at its fastest, in s: two days.
const LONGEST_THROUGH_S: f64 = 2.0 * 86_400.0;
/// A range that is a machine's own heat, not that of its hall, in K.
const OWN_HEAT_C: f64 = 8.0;
/// A part of a machine warms by no more than this, in K/s: 10 K/min, what a live thermometer is believed.
const MAX_C_PER_S: f64 = 10.0 / 60.0;
/// It is asked over this many rows, between means of this many at both ends that are at least this many K apart: noise
/// is not.
const RATE_ROWS: usize = 20;
const RATE_MEAN: usize = 3;
const RATE_C: f64 = 2.0;
/// No gauge of a workshop resolves what stays below this, in µm.
const MIN_LARGEST_UM: f64 = 0.1;
/// No error or growth has a wider range than this in µm; the board takes 4000.
const MAX_RANGE_UM: f64 = 20_000.0;
/// A spindle that never turns faster than this in r/min has its speed in 1000 r/min.
const MAX_KRPM: f64 = 40.0;

/// Returns the columns of `run` that are in another unit than their names say; `others` are runs of the same machine that
/// are read together with it.
pub(super) fn findings(
    run: &RunFile,
    machine: Option<&Machine>,
    others: &[RunFile],
) -> Vec<Finding> {
    let of_laws: Vec<String> = machine.map(required_columns).unwrap_or_default();
    let thermometers: Vec<&Column> =
        run.columns().iter().filter(|column| is_temperature_column(&column.name)).collect();
    let mut findings = Vec::new();
    for column in &thermometers {
        let is_law = of_laws.contains(&column.name);
        // Where no law says which it is, the only one is.
        let is_asked = is_law || thermometers.len() == 1;
        let may_be_f = may_be_fahrenheit(column, &thermometers) && !continues_one(column, others);
        findings.extend(temperature(run, column, is_law, [is_asked, may_be_f]));
    }
    // What is no temperature says nothing of the clock.
    let sound: Vec<&Column> = thermometers
        .into_iter()
        .filter(|column| findings.iter().all(|finding: &Finding| finding.key != column.name))
        .collect();
    findings.extend(clock(run, &sound));
    for quantity in Quantity::ALL {
        let name = format!("measured_{}_um", quantity.name());
        findings
            .extend(run.columns().iter().find(|it| it.name == name).and_then(|it| error(run, it)));
    }
    findings.extend(speed(run));
    findings
}

fn finding(run: &RunFile, column: &str, grade: Grade, what: &str, help: &str) -> Finding {
    let row = run.column(column).and_then(|values| values.iter().position(|it| !it.is_nan()));
    let place = run.place(row.unwrap_or(0), column);
    let warning = Warning { place, what: format!("{column} {what}"), help: help.into() };
    Finding { key: column.into(), grade, warning }
}

/// Returns the least and the most of a column with values enough.
fn range(values: &[f64]) -> Option<[f64; 2]> {
    let there = values.iter().copied().filter(|value| !value.is_nan());
    let (mut range, mut rows) = ([f64::INFINITY, f64::NEG_INFINITY], 0);
    for value in there {
        range = [range[0].min(value), range[1].max(value)];
        rows += 1;
    }
    (rows >= MIN_ROWS).then_some(range)
}

fn temperature(
    run: &RunFile,
    column: &Column,
    is_law: bool,
    [is_asked, may_be_f]: [bool; 2],
) -> Option<Finding> {
    let [least, most] = range(&column.values)?;
    let is_tenths = is_machine(least / 10.0) && is_machine(most / 10.0) && least > MAX_COLDEST_C;
    let as_kelvin = is_kelvin(least) && is_kelvin(most);
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
    let told = |grade| {
        Some(finding(run, &column.name, grade, &format!("is from {least} to {most}: {unit}"), help))
    };
    if least > ENDS_C[1] || most < ENDS_C[0] || (is_law && least > MAX_COLDEST_C) {
        return told(Grade::Impossible);
    }
    if as_kelvin || (is_asked && is_tenths) {
        return told(Grade::Unlikely);
    }
    (is_asked && may_be_f && STANDING_F.contains(&least) && most <= MAX_F).then(|| {
        let what = format!(
            "is from {least} to {most}: that looks like °F, not °C, for a machine that begins cold"
        );
        finding(run, &column.name, Grade::Unlikely, &what, "temperatures are in °C: (°F − 32)/1.8")
    })
}

/// Returns whether the other thermometers allow that a column is in °F: all of them may be, or those that are not show
/// what it would in °C. A column that is warm from the first row on is no °F next to them.
fn may_be_fahrenheit(column: &Column, thermometers: &[&Column]) -> bool {
    let Some([least_f, most_f]) = range(&column.values) else { return true };
    let others = thermometers.iter().filter(|other| other.name != column.name);
    let in_c = others.filter_map(|other| range(&other.values));
    let in_c = in_c.filter(|[least, _]| !STANDING_F.contains(least));
    let around = in_c.reduce(|[low, high], [least, most]| [low.min(least), high.max(most)]);
    around.is_none_or(|[low, high]| {
        celsius(most_f) >= low - APART_C && celsius(least_f) <= high + APART_C
    })
}

/// Returns whether another run has the column, in °C beyond doubt, and up to where this one begins: a run of the warm
/// end, next to that of the cold one. One that begins well below the other's end, and in °F where the other begins,
/// may be the same cold start again.
fn continues_one(column: &Column, others: &[RunFile]) -> bool {
    let Some([coldest, _]) = range(&column.values) else { return false };
    let same = others.iter().filter_map(|run| range(run.column(&column.name)?));
    same.filter(|[least, _]| !STANDING_F.contains(least)).any(|[least_c, most_c]| {
        let is_again = (celsius(coldest) - least_c).abs() <= APART_C && coldest + APART_C < most_c;
        least_c <= coldest && coldest <= most_c + APART_C && !is_again
    })
}

fn celsius(fahrenheit: f64) -> f64 {
    (fahrenheit - 32.0) / 1.8
}

/// Returns whether a machine has this temperature, in °C.
fn is_machine(temperature_c: f64) -> bool {
    let [coldest, hottest] = super::heat::OF_A_MACHINE_C;
    (coldest..=hottest).contains(&temperature_c)
}

fn clock(run: &RunFile, thermometers: &[&Column]) -> Option<Finding> {
    let time_s = run.column("time_s")?;
    let [_, last_s] = range(time_s)?;
    let ms = "times are in s: divide each by 1000";
    if last_s > MAX_CLOCK_S {
        let what = format!("reaches {last_s}: that looks like milliseconds of Unix, not s");
        return Some(finding(run, "time_s", Grade::Impossible, &what, ms));
    }
    let days = |seconds: f64| seconds / 86_400.0;
    let unlikely =
        |what: String, help: &str| Some(finding(run, "time_s", Grade::Unlikely, &what, help));
    if let Some(longest_s) = run.column("spindle_rpm").map(|rpm| longest_turning_s(time_s, rpm))
        && longest_s > LONGEST_RUN_S
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
        if let Some(through_s) = through_s(time_s, &column.values)
            && through_s > LONGEST_THROUGH_S
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
    let parts = thermometers.iter().filter(|column| !is_fluid(&column.name));
    let fastest = parts.filter_map(|it| Some((fastest_c_per_s(time_s, &it.values)?, it)));
    let (c_per_s, column) = fastest.max_by(|a, b| a.0.total_cmp(&b.0))?;
    if c_per_s <= MAX_C_PER_S {
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
fn is_fluid(name: &str) -> bool {
    ["coolant", "oil", "air", "water"].iter().any(|word| name.contains(word))
}

/// Returns the longest time that the spindle turns without a stop, in s.
fn longest_turning_s(time_s: &[f64], rpm: &[f64]) -> f64 {
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
fn through_s(time_s: &[f64], values: &[f64]) -> Option<f64> {
    const ROWS: usize = 100;
    const SMOOTH: f64 = 0.03;
    const SLOW_ROWS_S: f64 = 1_000.0;
    let [least, most] = range(values)?;
    let mut steps: Vec<(f64, f64)> = time_s
        .windows(2)
        .zip(values.windows(2))
        .map(|(time, value)| (time[1] - time[0], (value[1] - value[0]).abs()))
        .filter(|(apart_s, step)| *apart_s > 0.0 && !step.is_nan())
        .collect();
    let mean = steps.iter().map(|(_, step)| step).sum::<f64>() / steps.len() as f64;
    if steps.len() < ROWS || most - least < OWN_HEAT_C || mean > SMOOTH * (most - least) {
        return None;
    }
    steps.sort_by(|a, b| (a.1 / a.0).total_cmp(&(b.1 / b.0)));
    let (apart_s, step) = steps[steps.len() - 1 - steps.len() / 20];
    (apart_s >= SLOW_ROWS_S).then(|| (most - least) * apart_s / step)
}

/// Returns the fastest change of a column over [`RATE_ROWS`] rows, in K/s.
fn fastest_c_per_s(time_s: &[f64], values: &[f64]) -> Option<f64> {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let windows = values.windows(RATE_ROWS).zip(time_s.windows(RATE_ROWS));
    let rates = windows.filter_map(|(values, time_s)| {
        let ends = |all: &[f64]| mean(&all[RATE_ROWS - RATE_MEAN..]) - mean(&all[..RATE_MEAN]);
        let (change, apart_s) = (ends(values).abs(), ends(time_s));
        (change >= RATE_C && apart_s > 0.0).then(|| change / apart_s)
    });
    rates.reduce(f64::max)
}

fn error(run: &RunFile, column: &Column) -> Option<Finding> {
    let [least, most] = range(&column.values)?;
    let largest = least.abs().max(most.abs());
    if most - least > MAX_RANGE_UM {
        let what = format!(
            "is from {least} to {most}: no machine errs by that; it looks like nm or counts, not µm"
        );
        return Some(finding(run, &column.name, Grade::Impossible, &what, "write it in µm"));
    }
    (most > least && largest < MIN_LARGEST_UM).then(|| {
        let what = format!(
            "is {largest} at the most: no gauge resolves that in µm; it looks like mm or inches, not µm"
        );
        let help = "write it in µm: multiply mm by 1000, inches by 25 400";
        finding(run, &column.name, Grade::Unlikely, &what, help)
    })
}

fn speed(run: &RunFile) -> Option<Finding> {
    let [_, most] = range(run.column("spindle_rpm")?)?;
    (most > 0.0 && most <= MAX_KRPM).then(|| {
        let what = format!("is {most} at the most: that looks like 1000 r/min, not r/min");
        finding(run, "spindle_rpm", Grade::Unlikely, &what, "speeds are in r/min")
    })
}

#[cfg(test)]
mod tests;
