//! Quiet years of a small shop under `trueup trust`: how often it alarms, and how soon it finds a change.
//!
//! `cargo run --release -p trueup-campaigns --example trust_years -- 20 600` prints the figures of twenty years of two machines from seed
//! 600 on. The first forty readings (twenty days of work) are the record from when all was right; the rest of the year is watched
//! with one false alarm in 1,000 hours stated. After an alarm the watch begins anew at the next reading. The change is four times the
//! noise of a reading, on every reading from a day in the second half of the year on.
#![allow(clippy::print_stdout, reason = "an example prints its figures")]

use std::{env, path::Path};

use trueup_campaigns::simulated_year::{
    MachineKind, SimulatedYear, YearConfig, simulate_year_with_outliers,
};
use trueup_learn::calibration_monitoring::monitor_calibration;
use trueup_machine::{Machine, MachineFile, RunFile};

const FALSE_ALARM_INTERVAL_H: f64 = 1000.0;
/// Two readings a day.
const CALIBRATION_DAYS: usize = 20;
const CHANGE_DAY: usize = 150;
const CHANGE_UM: f64 = 8.0;
/// The readings of two shifts and of ten.
const READINGS_IN_TWO_SHIFTS: usize = 4;
const READINGS_IN_TEN_SHIFTS: usize = 20;

/// Returns the rows of these days that have a reading, `added_um` more in each; with their header.
fn collect_rows(year: &SimulatedYear, days: std::ops::Range<usize>, added_um: f64) -> Vec<String> {
    let mut all = Vec::new();
    for day in &year.days[days] {
        let mut lines = day.csv.lines();
        let header = lines.next().expect("a header").to_string();
        if all.is_empty() {
            all.push(header);
        }
        all.extend(lines.map(|line| {
            let (rest, um) = line.rsplit_once(',').expect("fields");
            um.parse::<f64>().map_or(line.into(), |um| format!("{rest},{}", um + added_um))
        }));
    }
    all
}

fn parse_run(lines: &[String]) -> RunFile {
    RunFile::from_reader(lines.join("\n").as_bytes(), Path::new("days.csv")).expect("a run")
}

/// Returns the readings that are watched, and after how many of them each alarm comes.
fn find_alarms(machine: &Machine, then: &RunFile, lines: &[String]) -> (usize, Vec<usize>) {
    let is_reading = |line: &String| !line.ends_with(',');
    let all = lines[1..].iter().filter(|line| is_reading(line)).count();
    let (mut from, mut found) = (1, Vec::new());
    while lines[from..].iter().any(is_reading) {
        let rest: Vec<String> = lines[..1].iter().chain(&lines[from..]).cloned().collect();
        let watched =
            monitor_calibration(machine, then, &parse_run(&rest), None, FALSE_ALARM_INTERVAL_H)
                .expect("it is watched");
        let Some(alarm) = watched.alarm else { break };
        from += alarm.row;
        found.push(lines[1..from].iter().filter(|line| is_reading(line)).count());
    }
    (all, found)
}

fn main() {
    let mut numbers = env::args().skip(1).filter_map(|argument| argument.parse::<u64>().ok());
    let (count, first) = (numbers.next().unwrap_or(5), numbers.next().unwrap_or(600));
    for bad in [0.0, 0.01, 0.05] {
        let (mut readings, mut raised, mut hours) = (0, 0, 0.0);
        let (mut soon, mut late, mut changed) = (0, 0, 0);
        for seed in first..first + count {
            for kind in [MachineKind::Spindle, MachineKind::Axis] {
                let drawn = simulate_year_with_outliers(seed, kind, YearConfig::default(), bad);
                let machine = MachineFile::parse(&drawn.machine, Path::new("m.toml"));
                let machine = machine.expect("a machine file");
                let then = parse_run(&collect_rows(&drawn, 0..CALIBRATION_DAYS, 0.0));
                let quiet = collect_rows(&drawn, CALIBRATION_DAYS..drawn.days.len(), 0.0);
                let (all, found) = find_alarms(&machine, &then, &quiet);
                readings += all;
                raised += found.len();
                hours += (drawn.days.len() - CALIBRATION_DAYS) as f64 * 7.0 / 5.0 * 24.0;
                let after = collect_rows(&drawn, CHANGE_DAY..drawn.days.len(), CHANGE_UM);
                let (_, found) = find_alarms(&machine, &then, &after);
                changed += 1;
                soon += usize::from(found.first().is_some_and(|n| *n <= READINGS_IN_TWO_SHIFTS));
                late += usize::from(found.first().is_some_and(|n| *n <= READINGS_IN_TEN_SHIFTS));
            }
        }
        let [by_hours, by_readings] =
            [hours, readings as f64].map(|all| 1000.0 * raised as f64 / all);
        println!(
            "{:.0} % bad: {raised} false alarms in {readings} readings, {by_hours:.2} in 1,000 h (stated: 1), {by_readings:.2} in \
             1,000 readings; 8 µm found within two shifts in {soon} of {changed}, within ten in {late}",
            100.0 * bad
        );
    }
}
