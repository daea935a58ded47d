//! Years of a small shop, drawn: what learning leaves of a day's error, and which events it names.
//!
//! `cargo run --release -p trueup-campaigns --example year -- 20` prints the figures of twenty seeds; a second number is the first
//! seed, and `-v` lists the events.
//!
//! The floor is what the constants of the file allow: fitted without noise to all rows of the ten days before, as far as these
//! are after the last event. No learner that changes these alone is better for long: a thermometer that was moved shows a
//! share of the air, which no constant takes off. With the air, one more value is fitted: the share of its rise over the air that
//! the thermometer does not show. The learner has that value as well, from the moment at which a thermometer may have moved.
//!
//! In each seed's year with a drift and without checks only the question for a check is judged: after 28 days, and on every day
//! from then on.
#![allow(clippy::print_stdout, reason = "an example prints its figures")]

use std::{collections::BTreeSet, env, path::Path};

use trueup_campaigns::simulated_year::{MachineKind, SimulatedYear, YearConfig, simulate_year};
use trueup_learn::{EventKind, LearnerState, LearningLimits, learn_from_run};
use trueup_machine::{MachineFile, RunFile, predict::RunPredictor};
use trueup_numerics::least_squares::GivensQr;

/// The readings of two shifts and of ten.
const READINGS_IN_TWO_SHIFTS: usize = 4;
const READINGS_IN_TEN_SHIFTS: usize = 20;
/// Four times the noise of a reading, in µm.
const LARGE_EFFECT_UM: f64 = 8.0;
const SECONDS_PER_DAY: f64 = 86_400.0;
/// Days that are used for the fit of the floor.
const FITTED_DAYS: usize = 10;
/// Of a constant, to see what it does.
const FINITE_DIFFERENCE_STEP: f64 = 0.01;

/// How a planted event was found.
#[derive(Clone, Default)]
struct EventDetection {
    /// Readings until it was reported.
    reported: Option<usize>,
    /// Readings until its name was among those that were given.
    named: Option<usize>,
    /// The names that were given last.
    names: Vec<String>,
}

/// A year that was lived.
struct YearResult {
    /// RMS of each day in µm: of the user's file, of the file in force at its start.
    days: Vec<[f64; 2]>,
    memory: LearnerState,
    found: Vec<EventDetection>,
    /// Whether a check of the probe was asked for on every day after the first four weeks without one, and on none of these.
    is_asked: bool,
}

fn prediction_error_rms_um(machine: &str, run: &RunFile, truth_um: &[f64], index: usize) -> f64 {
    let all = predict_um(machine, run, index).into_iter().zip(truth_um);
    let squares: f64 = all.map(|(own, um)| (own - um).powi(2)).sum();
    (squares / truth_um.len() as f64).sqrt()
}

fn predict_um(machine: &str, run: &RunFile, index: usize) -> Vec<f64> {
    let machine = MachineFile::parse(machine, Path::new("m.toml")).expect("a machine file");
    let rows = RunPredictor::new(&machine, run).expect("a prediction");
    rows.model_values().map(|values| values.to_array()[index]).collect()
}

/// Returns how much more is predicted where the thermometer shows all of its rise over the air once more, by row in µm.
fn air_temperature_sensitivity(
    year: &SimulatedYear,
    run: &RunFile,
    file: &[f64],
    index: usize,
) -> Vec<f64> {
    let name = if index == 0 { "temp_front_c" } else { "temp_screw_c" };
    let air_c = run.column("temp_air_c").expect("the air").to_vec();
    let altered = run.with_altered_values(run.row_count(), |column, values| {
        if column == name {
            values
                .iter_mut()
                .zip(&air_c)
                .for_each(|(c, air_c)| *c += FINITE_DIFFERENCE_STEP * (*c - air_c));
        }
    });
    let more = predict_um(&year.machine, &altered, index).into_iter().zip(file);
    more.map(|(more, file)| (more - file) / FINITE_DIFFERENCE_STEP).collect()
}

/// Computes the RMS of each day in µm that the constants of the file allow, with the air as a second temperature or without.
fn compute_rms_floor(year: &SimulatedYear, has_air: bool) -> Vec<f64> {
    let index = usize::from(year.quantity == "dx");
    let keys = ["k_um_per_c", "um_per_c", "slope_um_per_m_per_c", "reference_c", "width_um"];
    let lines = year.machine.lines();
    let lines = lines.filter(|line| keys.iter().any(|key| line.starts_with(&format!("{key} = "))));
    // A reference that comes again is the same zero.
    let lines: BTreeSet<&str> = lines.collect();
    let others = lines.into_iter().map(|line| {
        let (key, value) = line.split_once(" = ").expect("a key");
        let value: f64 = value.parse().expect("a number");
        year.machine.replacen(
            line,
            &format!("{key} = {:?}", value * (1.0 + FINITE_DIFFERENCE_STEP)),
            1,
        )
    });
    let others: Vec<String> = others.collect();
    let mut starts = Vec::new();
    let days = year.days.iter().map(|day| {
        let run = RunFile::from_reader(day.csv.as_bytes(), Path::new("day.csv")).expect("a run");
        starts.push(run.column("time_s").expect("a clock")[0]);
        let file = predict_um(&year.machine, &run, index);
        let less = |um: Vec<f64>| -> Vec<f64> {
            um.iter().zip(&file).map(|(um, file)| (um - file) / FINITE_DIFFERENCE_STEP).collect()
        };
        let by_constant = others.iter().map(|machine| less(predict_um(machine, &run, index)));
        let by_air = has_air.then(|| air_temperature_sensitivity(year, &run, &file, index));
        let by_value: Vec<Vec<f64>> = by_constant.chain(by_air).collect();
        let row = |(row, truth): (usize, &f64)| {
            let g = by_value.iter().map(|um| um[row]).collect();
            (g, truth - file[row])
        };
        day.truth_um.iter().enumerate().map(row).collect()
    });
    let days: Vec<Vec<(Vec<f64>, f64)>> = days.collect();
    let of_day = |day: usize| {
        let event = year.events.iter().map(|event| starts.partition_point(|s| *s < event.at_s));
        let since = event.filter(|first| *first < day).max().unwrap_or(0);
        let values = others.len() + usize::from(has_air);
        let mut triangle = GivensQr::new(values);
        days[since.max(day.saturating_sub(FITTED_DAYS))..day]
            .iter()
            .flatten()
            .for_each(|(g, um)| triangle.add_row(g, *um));
        let fitted = triangle.solve().map_or(vec![0.0; values], |solution| solution.coefficients);
        let left = |(g, um): &(Vec<f64>, f64)| {
            (um - g.iter().zip(&fitted).map(|(g, x)| g * x).sum::<f64>()).powi(2)
        };
        (days[day].iter().map(left).sum::<f64>() / days[day].len() as f64).sqrt()
    };
    (0..days.len()).map(of_day).collect()
}

fn simulate_learning(year: &SimulatedYear) -> YearResult {
    let index = usize::from(year.quantity == "dx");
    let mut machine = year.machine.clone();
    let mut memory: Option<LearnerState> = None;
    let mut days = Vec::new();
    let mut found = vec![EventDetection::default(); year.events.len()];
    let mut after = vec![0; year.events.len()];
    let (mut is_asked, mut first_s) = (true, None);
    for day in &year.days {
        let run = RunFile::from_reader(day.csv.as_bytes(), Path::new("day.csv")).expect("a run");
        days.push(
            [&year.machine, &machine]
                .map(|machine| prediction_error_rms_um(machine, &run, &day.truth_um, index)),
        );
        let (path, limits) = (Path::new("m.toml"), LearningLimits::default());
        let learned = learn_from_run(&year.machine, path, &run, None, memory.take(), &limits)
            .unwrap_or_else(|error| panic!("{error}"));
        let starts = run.column("time_s").map_or(0.0, |times| times[0]);
        let since_s = starts - *first_s.get_or_insert(starts);
        // On the last of these days the reading may be later than the first one was.
        let is_due = since_s > 28.0 * SECONDS_PER_DAY;
        let asks = learned.notes.iter().any(|note| note.starts_with("No check of the probe"));
        is_asked &= asks == is_due || since_s == 28.0 * SECONDS_PER_DAY;
        for (place, planted) in year.events.iter().enumerate() {
            let end = year.events.get(place + 1).map_or(f64::INFINITY, |next| next.at_s);
            if starts < planted.at_s || starts >= end {
                continue;
            }
            after[place] += learned.readings.len();
            for event in &learned.memory.events {
                let at = event.at.unwrap_or(0.0);
                let is_slow = matches!(event.event, EventKind::Wear | EventKind::ProbeDrift);
                if is_slow || at < planted.at_s - 3.0 * SECONDS_PER_DAY || at >= end {
                    continue;
                }
                let it = &mut found[place];
                it.reported.get_or_insert(after[place]);
                it.names = match event.alternatives.is_empty() {
                    true => vec![event.event.name().to_string()],
                    false => event
                        .alternatives
                        .iter()
                        .map(|alternative| alternative.name().to_string())
                        .collect(),
                };
                if it.names.iter().any(|name| name == planted.name) {
                    it.named.get_or_insert(after[place]);
                }
            }
        }
        machine = learned.machine;
        memory = Some(learned.memory);
    }
    YearResult { days, memory: memory.expect("a year has days"), found, is_asked }
}

/// Returns true for a day that is worse than without learning by more than 10 % and 1 µm.
fn is_worse([file_um, own_um]: [f64; 2]) -> bool {
    own_um > 1.1 * file_um && own_um > file_um + 1.0
}

fn quantile(mut all: Vec<f64>, share: f64) -> f64 {
    all.sort_by(f64::total_cmp);
    all[((all.len() - 1) as f64 * share) as usize]
}

/// Prints the events that were reported, and the days beyond the target.
fn print_days(drawn: &SimulatedYear, it: &YearResult) {
    it.memory.events.iter().for_each(|event| println!("    {}", event.describe()));
    let parts = it.days.chunks(65).map(|part| {
        let own = part.iter().map(|day| day[1]).collect();
        format!("{:.1}", quantile(own, 0.95))
    });
    let parts: Vec<String> = parts.collect();
    println!("    95 % of days by quarter: {}", parts.join(" "));
    let at = drawn.events.iter().map(|event| (event.at_s / SECONDS_PER_DAY / 7.0 * 5.0) as usize);
    println!("    events on days {:?}", at.collect::<Vec<_>>());
    let bad = it.days.iter().enumerate().filter(|(_, d)| d[1] > 3.0);
    let bad: Vec<String> = bad.map(|(n, d)| format!("{n}:{:.0}", d[1])).collect();
    println!("    days beyond 3: {}", bad.join(" "));
    let worse = it.days.iter().enumerate().filter(|(_, day)| is_worse(**day));
    let worse: Vec<String> =
        worse.map(|(n, [file, own])| format!("{n}:{file:.1}->{own:.1}")).collect();
    println!("    days worse than the file: {}", worse.join(" "));
}

fn main() {
    let mut numbers = env::args().skip(1).filter_map(|argument| argument.parse::<u64>().ok());
    let (count, first) = (numbers.next().unwrap_or(5), numbers.next().unwrap_or(0));
    let is_loud = env::args().any(|argument| argument == "-v");
    let (mut days, mut worse) = (Vec::<[f64; 2]>::new(), 0);
    let mut floors = [Vec::new(), Vec::new()];
    let mut air_floors = [Vec::new(), Vec::new()];
    let mut own_days = [Vec::new(), Vec::new()];
    let (mut large, mut large_reported) = (0, 0);
    let (mut planted, mut reported, mut named, mut both) = (0, 0, 0, 0);
    let (mut wear, mut wears, mut quiet, mut asked, mut bytes) = (0, 0, 0, 0, 0);
    for seed in first..first + count {
        for kind in [MachineKind::Spindle, MachineKind::Axis] {
            let drift = seed % 2 == 1;
            let drawn =
                simulate_year(seed, kind, YearConfig { events: true, drift, checks: drift });
            let it = simulate_learning(&drawn);
            let place = usize::from(kind == MachineKind::Axis);
            floors[place].extend(compute_rms_floor(&drawn, false));
            air_floors[place].extend(compute_rms_floor(&drawn, true));
            own_days[place].extend(it.days.iter().map(|day| day[1]));
            worse += it.days.iter().filter(|day| is_worse(**day)).count();
            days.extend(&it.days);
            for (event, found) in drawn.events.iter().zip(&it.found) {
                planted += 1;
                let first = &event.effect_um[..READINGS_IN_TWO_SHIFTS];
                let squares: f64 = first.iter().map(|um| um * um).sum();
                let is_large = squares >= LARGE_EFFECT_UM.powi(2) * first.len() as f64;
                large += usize::from(is_large);
                large_reported += usize::from(
                    is_large && found.reported.is_some_and(|n| n <= READINGS_IN_TWO_SHIFTS),
                );
                reported +=
                    usize::from(found.reported.is_some_and(|n| n <= READINGS_IN_TWO_SHIFTS));
                let is_named = found.named.is_some_and(|n| n <= READINGS_IN_TEN_SHIFTS);
                named += usize::from(is_named && found.names.len() == 1);
                both += usize::from(is_named && found.names.len() > 1);
                if is_loud {
                    let EventDetection { reported, named, names } = found;
                    let (name, size) = (event.name, event.size);
                    println!(
                        "{seed} {kind:?} {name} {size:+.2}: {reported:?} {named:?} {names:?} {first:.0?}"
                    );
                }
            }
            if is_loud {
                print_days(&drawn, &it);
            }
            if kind == MachineKind::Axis {
                wears += 1;
                let worn = it.memory.events.iter().find(|event| event.event == EventKind::Wear);
                wear += usize::from(worn.is_some_and(|event| (event.size - 5.0).abs() <= 1.0));
            }
            bytes = bytes.max(it.memory.to_json().expect("it can be written").len());
            let drifts = YearConfig { events: true, drift: true, checks: false };
            asked += usize::from(simulate_learning(&simulate_year(seed, kind, drifts)).is_asked);
            let calm = simulate_learning(&simulate_year(seed, kind, YearConfig::default()));
            quiet += calm.memory.events.len();
            if is_loud {
                let events = calm.memory.events.iter();
                events.for_each(|event| println!("    quiet year: {}", event.describe()));
            }
        }
    }
    let of = |index: usize| quantile(days.iter().map(|day| day[index]).collect(), 0.95);
    let (file_um, own_um) = (of(0), of(1));
    println!(
        "{count} years of two machines: 95 % of days within {file_um:.1} µm by the file alone"
    );
    println!("learned: {own_um:.1} µm (target: 3)");
    for (place, kind) in ["spindle", "axis"].into_iter().enumerate() {
        let all = [&own_days[place], &floors[place], &air_floors[place]];
        let [own_um, floor_um, air_um] = all.map(|all| quantile(all.clone(), 0.95));
        println!(
            "  {kind}: {own_um:.1} µm, and {floor_um:.1} µm is the floor, {air_um:.1} µm with the air"
        );
    }
    let [floor_um, air_um] = [&floors, &air_floors].map(|all| quantile(all.concat(), 0.95));
    println!("floor of both: {floor_um:.1} µm, {air_um:.1} µm with the air");
    let share = 100.0 * worse as f64 / days.len() as f64;
    println!("days worse by more than 10 % and 1 µm: {share:.2} % (target: 1)");
    println!("events reported within two shifts: {reported} of {planted} (target: 90 %)");
    println!("of those of 4 times the noise in these two shifts: {large_reported} of {large}");
    println!("named right within ten shifts: {named} of {planted}, among several names: {both}");
    println!("wear within 20 % in December: {wear} of {wears}");
    println!("a check asked for, and in time, in years without: {asked} of {}", 2 * count);
    println!("events in as many quiet years: {quiet} (target: 0)");
    println!("largest state: {bytes} bytes (target: 200000)");
}
