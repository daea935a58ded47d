//! The board does what is written for it: no terms that only hold each other up, and the error
//! that is stated is the one that is left.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{fmt::Write as _, path::Path};

use trueup_diagnose::{Diagnosis, diagnose};
use trueup_machine::{
    Machine, MachineFile, RunFile, effect::BoardTerm, machine_file::Quantity, predict::RunPredictor,
};
use trueup_numerics::{block_resampling::rms, random::RandomGenerator};
use trueup_twin::{Scenario, simulate};

/// Believed: 2.2 µm for each kelvin of the front bearing, seven minutes late.
const SHOP: &str = "[machine]\nname = \"shop\"\nkind = \"3-axis\"\n[inputs]\n\
                    temp_front_c = { channel = 0, kind = \"pt100\" }\n[spindle]\nsource = \"temperature\"\n\
                    [spindle.temperature]\nsensor = \"temp_front_c\"\nreference_c = 20.0\nk_um_per_c = 2.2\n\
                    lag_s = 420.0\n[limits]\nmax_um = { x = 200.0, y = 200.0, z = 300.0 }\n";

/// A working week: five days of ten hours, probed each half hour, in whatever season; touched off at another
/// temperature, and one reading that is none, which may be the first.
struct Week {
    csv: String,
    /// The growth in each row, in µm.
    truth_um: Vec<f64>,
    zero_um: f64,
}

fn week(seed: u64) -> Week {
    let mut chance = RandomGenerator::new(1000 + seed);
    let season_c = 18.0 + 10.0 * chance.uniform();
    let zero_um = 18.0 * chance.uniform() - 9.0;
    // The machine is as believed, or a little another one.
    let [k, lag_s]: [f64; 2] = if seed.is_multiple_of(2) { [2.2, 420.0] } else { [2.6, 300.0] };
    let bad = if seed.is_multiple_of(3) { 0 } else { chance.uniform_index(99) };
    let (mut front_c, mut lagged_c, mut rpm, mut until) = (season_c, season_c, 0.0, 0);
    let mut csv = String::from("time_s,spindle_rpm,temp_front_c,measured_elongation_um\n");
    let (mut truth_um, mut probed) = (Vec::new(), 0);
    for minute in 0..3000_u32 {
        let (day, of_day) = (minute / 600, minute % 600);
        if of_day == 0 {
            front_c = season_c + 0.3 * chance.normal();
        }
        if minute >= until {
            rpm = 2000.0 * chance.uniform_index(5) as f64;
            until = minute + 4 + chance.uniform_index(45) as u32;
        }
        let target_c = season_c + 2.0 + 9.0 * (rpm / 8000.0_f64).powf(1.5);
        front_c += (target_c - front_c) * (1.0 - (-60.0_f64 / 1100.0).exp());
        // Over night it settles.
        let elapsed_s: f64 = if minute == 0 || of_day == 0 { 50_000.0 } else { 60.0 };
        lagged_c += (front_c - lagged_c) * (1.0 - (-elapsed_s / lag_s).exp());
        let um = k * (lagged_c - 20.0) + zero_um;
        truth_um.push(um);
        let mut cell = String::new();
        if minute % 30 == 20 && probed < 99 {
            let far_um = if probed == bad { -(30.0 + 45.0 * chance.uniform()) } else { 0.0 };
            cell = format!("{:.2}", um + 2.0 * chance.normal() + far_um);
            probed += 1;
        }
        let time_s = 2_000_000 + 60 * minute + 50_400 * day;
        let _ = writeln!(csv, "{time_s},{rpm},{:.2},{cell}", front_c + 0.03 * chance.normal());
    }
    Week { csv, truth_um, zero_um }
}

fn run(csv: &str) -> RunFile {
    RunFile::from_reader(csv.as_bytes(), Path::new("r.csv")).expect("the test's own run")
}

fn diagnosed(machine: &str, csv: &str) -> (Diagnosis, Machine) {
    let believed = MachineFile::parse(machine, Path::new("m.toml")).expect("the test's own file");
    let answer = diagnose(&believed, &[run(csv)], &[], None, &mut |_, _| {}).expect("comparable");
    let extended =
        answer.render_extended_toml(machine, Path::new("m.toml")).expect("a machine file");
    let extended = MachineFile::parse(&extended, Path::new("e.toml")).expect("it can be loaded");
    (answer, extended)
}

/// Returns what the board leaves of `truth_um` with `machine`.
fn left_um(machine: &Machine, csv: &str, truth_um: &[f64]) -> f64 {
    let run = run(csv);
    let predictor = RunPredictor::new(machine, &run).expect("the columns are there");
    let rows = predictor.predictions().zip(truth_um);
    let left = rows.map(|(row, um)| row.bridge.expect("connected").elongation_um - um);
    rms(&left.collect::<Vec<f64>>())
}

/// Returns the largest constant or rise of what the board runs.
fn largest_um(machine: &Machine) -> f64 {
    let sizes = machine.terms.iter().filter(|term| term.effect.is_compensable()).map(|term| {
        let forms = term.effect.board_terms();
        let of_forms = forms.iter().map(|form| match form {
            BoardTerm::Offset(um) | BoardTerm::Time { amplitude_um: um, .. } => um.abs(),
            _ => 0.0,
        });
        of_forms.fold(term.constant_um.abs(), f64::max)
    });
    sizes.fold(0.0, f64::max)
}

/// Of `weeks` none has a term above 60 µm, and each is corrected that needs it.
fn are_right(weeks: std::ops::Range<u64>) {
    let believed = MachineFile::parse(SHOP, Path::new("m.toml")).expect("the test's own file");
    let (mut needed, mut helped) = (0, 0);
    for seed in weeks {
        let Week { csv, truth_um, zero_um } = week(seed);
        let (answer, extended) = diagnosed(SHOP, &csv);
        let um = largest_um(&extended);
        assert!(um < 60.0, "week {seed}: a term of {um:.0} µm, {:?}", answer.terms);
        let [before, after] =
            [&believed, &extended].map(|machine| left_um(machine, &csv, &truth_um));
        println!("week {seed}: {zero_um:+.1} µm off, {before:.2} µm before, {after:.2} after");
        assert!(after < 1.1 * before, "week {seed}: {before} {after}");
        needed += u32::from(before > 4.0);
        helped += u32::from(before > 4.0 && after < 0.5 * before);
    }
    assert!(10 * helped >= 9 * needed, "{helped} of {needed}");
}

#[test]
fn a_plain_week_is_corrected_without_terms_that_hold_each_other_up() {
    are_right(0..7);
}

#[test]
#[ignore = "long: a hundred weeks"]
fn a_hundred_plain_weeks_have_no_term_above_60_um() {
    are_right(0..100);
}

const WARMUP: &str = include_str!("../../../../data/scenario-warmup.toml");
const AXIS: &str = include_str!("../../../../data/scenario-axis.toml");
const SCREW: &str =
    "[machine]\nname = \"an axis\"\nkind = \"3-axis\"\n[axis.x]\nfeedback = \"screw\"\n";
const SENSOR: &str = "[machine]\nname = \"a spindle\"\nkind = \"3-axis\"\n[inputs]\n\
                      sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.328 }\n\
                      [spindle]\nsource = \"sensor\"\n[spindle.sensor]\nk0_um = 0.0\nzero_counts = 5048.0\n\
                      um_per_count = 0.0152587890625\ntemperature = \"temp_coil_c\"\n";

/// Returns a day of a scenario.
fn day(scenario: &str, seed: u64) -> RunFile {
    let scenario = Scenario::parse(scenario, Path::new("s.toml")).expect("it is shipped");
    run(&simulate(&scenario, seed, || {}).to_csv())
}

/// Returns what the board leaves of a day: RMS, in µm; of an axis about its zero.
fn board_leaves_um(machine: &Machine, day: &RunFile, quantity: Quantity) -> f64 {
    let measured = day.column(&format!("measured_{}_um", quantity.name())).expect("measured");
    let number =
        Quantity::ALL.iter().position(|candidate| *candidate == quantity).expect("one of four");
    let predictor = RunPredictor::new(machine, day).expect("the columns are there");
    let rows = predictor.predictions().zip(measured);
    let left = rows.map(|(row, um)| um - row.bridge.expect("a bridge").to_array()[number]);
    rms(&left.filter(|um| um.is_finite()).collect::<Vec<f64>>())
}

/// Checks that the board leaves the error stated for it on the same rows and less than 2.5 times as much on other days,
/// and that no term that is written for it makes other days worse.
fn board_does_what_is_said(scenario: &str, machine: &str, quantity: Quantity, seed: u64) {
    let believed = MachineFile::parse(machine, Path::new("m.toml")).expect("the test's own file");
    let record = day(scenario, seed);
    let answer =
        diagnose(&believed, std::slice::from_ref(&record), &[], Some(quantity), &mut |_, _| {})
            .expect("comparable");
    let text = answer.render_extended_toml(machine, Path::new("m.toml")).expect("a machine file");
    let extended = MachineFile::parse(&text, Path::new("e.toml")).expect("it can be loaded");
    let stated_um = answer.report.after.compensated_rms_um;
    let same_um = board_leaves_um(&extended, &record, quantity);
    let days: Vec<RunFile> = (101..104).map(|seed| day(scenario, seed)).collect();
    let others = |machine: &Machine| {
        rms(&days.iter().map(|day| board_leaves_um(machine, day, quantity)).collect::<Vec<f64>>())
    };
    let other_um = others(&extended);
    println!(
        "{quantity:?} by {seed}: {stated_um:.3} stated, {same_um:.3} left, {other_um:.3} on other days"
    );
    // Bad readings are left out of the stated value.
    assert!((stated_um / same_um - 1.0).abs() < 0.05, "{stated_um} stated, {same_um} left");
    assert!(other_um < 2.5 * stated_um, "{stated_um} stated, {other_um} on other days");
    for number in 0..extended.terms.len() {
        let mut without = extended.clone();
        let term = without.terms.remove(number);
        if term.effect.is_compensable() && RunPredictor::new(&without, &record).is_ok() {
            let without_um = others(&without);
            assert!(
                without_um > 0.99 * other_um,
                "{term:?}: {without_um} without, {other_um} with"
            );
        }
    }
}

/// By seed 1 a drift, which no board runs, once held up 6.9 µm/K of the air: 0.52 µm were stated, 1.77 were left.
#[test]
fn what_the_board_leaves_of_a_warm_up_is_what_is_said() {
    for seed in [1, 2] {
        board_does_what_is_said(WARMUP, SENSOR, Quantity::Elongation, seed);
    }
}

#[test]
fn what_the_board_leaves_of_an_axis_is_what_is_said() {
    board_does_what_is_said(AXIS, SCREW, Quantity::Dx, 1);
    board_does_what_is_said(AXIS, SCREW, Quantity::Dy, 1);
}

/// A height sensor whose line is believed to be another one, and which is bent: the gain and the bend each do more than
/// twice what was measured, and together what was measured.
#[test]
fn a_gain_and_a_bend_of_a_sensor_are_one_characteristic_and_are_written() {
    let (mut fitted, mut held) =
        ("sensor_counts,measured_elongation_um\n".to_string(), String::new());
    held.push_str(&fitted);
    let mut noise = RandomGenerator::new(5);
    for row in 0..80 {
        let sensor_um = 10.0 * f64::from(row);
        // At most 625 µm at 500 µm; the gain alone adds 1200 µm at the end.
        let measured_um = 2.5 * sensor_um - 2.0 * sensor_um.powi(2) / 800.0 + noise.normal();
        let line = format!("{},{measured_um:.3}\n", sensor_um + 5000.0);
        if row % 2 == 0 { &mut fitted } else { &mut held }.push_str(&line);
    }
    let machine = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"sensor\"\n[spindle.sensor]\n\
                   k0_um = 0.0\nzero_counts = 5000.0\num_per_count = 1.0\n";
    let machine = MachineFile::parse(machine, Path::new("m.toml")).expect("the test's own file");
    let run =
        |text: &str| RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
    let diagnosis = diagnose(&machine, &[run(&fitted)], &[run(&held)], None, &mut |_, _| {});
    let report = diagnosis.expect("comparable").report;
    let (before_um, after_um) =
        (report.before.holdout_rms_um, report.after.compensated_holdout_rms_um);
    assert!(after_um < 0.02 * before_um, "{before_um} -> {after_um}: {:?}", report.findings);
}
