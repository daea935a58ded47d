//! Quiet years of a small shop under `trueup trust`: how often it alarms, and how soon it finds a change.
//!
//! `cargo run --release -p trueup-learn --example trust_years -- 20 600` prints the figures of twenty years of two machines from seed
//! 600 on. The first forty readings (twenty days of work) are the record from when all was right; the rest of the year is watched
//! with one false alarm in 1,000 hours stated. After an alarm the watch begins anew at the next reading. The change is four times the
//! noise of a reading, on every reading from a day in the second half of the year on.
#![allow(clippy::print_stdout, reason = "an example prints its figures")]

use std::{env, path::Path};

use trueup_campaigns::year::{Happens, Kind, Year, year_with_bad};
use trueup_learn::trust::trust;
use trueup_machine::{Machine, MachineFile, RunFile};

const STATED_H: f64 = 1000.0;
/// Two readings a day.
const CALIBRATED_DAYS: usize = 20;
const CHANGED_FROM: usize = 150;
const CHANGE_UM: f64 = 8.0;
/// The readings of two shifts and of ten.
const TWO_SHIFTS: usize = 4;
const TEN_SHIFTS: usize = 20;

/// Returns the rows of these days that have a reading, `added_um` more in each; with their header.
fn rows(year: &Year, days: std::ops::Range<usize>, added_um: f64) -> Vec<String> {
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

fn run(lines: &[String]) -> RunFile {
    RunFile::from_reader(lines.join("\n").as_bytes(), Path::new("days.csv")).expect("a run")
}

/// Returns the readings that are watched, and after how many of them each alarm comes.
fn alarms(machine: &Machine, then: &RunFile, lines: &[String]) -> (usize, Vec<usize>) {
    let is_reading = |line: &String| !line.ends_with(',');
    let all = lines[1..].iter().filter(|line| is_reading(line)).count();
    let (mut from, mut found) = (1, Vec::new());
    while lines[from..].iter().any(is_reading) {
        let rest: Vec<String> = lines[..1].iter().chain(&lines[from..]).cloned().collect();
        let watched = trust(machine, then, &run(&rest), None, STATED_H).expect("it is watched");
        let Some(alarm) = watched.alarm else { break };
        from += alarm.row;
        found.push(lines[1..from].iter().filter(|line| is_reading(line)).count());
    }
    (all, found)
}

fn main() {
    let mut numbers = env::args().skip(1).filter_map(|it| it.parse::<u64>().ok());
    let (count, first) = (numbers.next().unwrap_or(5), numbers.next().unwrap_or(600));
    for bad in [0.0, 0.01, 0.05] {
        let (mut readings, mut raised, mut hours) = (0, 0, 0.0);
        let (mut soon, mut late, mut changed) = (0, 0, 0);
        for seed in first..first + count {
            for kind in [Kind::Spindle, Kind::Axis] {
                let drawn = year_with_bad(seed, kind, Happens::default(), bad);
                let machine = MachineFile::parse(&drawn.machine, Path::new("m.toml"));
                let machine = machine.expect("a machine file");
                let then = run(&rows(&drawn, 0..CALIBRATED_DAYS, 0.0));
                let quiet = rows(&drawn, CALIBRATED_DAYS..drawn.days.len(), 0.0);
                let (all, found) = alarms(&machine, &then, &quiet);
                readings += all;
                raised += found.len();
                hours += (drawn.days.len() - CALIBRATED_DAYS) as f64 * 7.0 / 5.0 * 24.0;
                let after = rows(&drawn, CHANGED_FROM..drawn.days.len(), CHANGE_UM);
                let (_, found) = alarms(&machine, &then, &after);
                changed += 1;
                soon += usize::from(found.first().is_some_and(|n| *n <= TWO_SHIFTS));
                late += usize::from(found.first().is_some_and(|n| *n <= TEN_SHIFTS));
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
