//! The acceptance loop of the warm-up paper on the virtual bridge: run without, run with, compare, change
//! what the acceptance says; from constants that are 40 % wrong it passes in at most three turns.
//!
//! The board's application runs in this process; it sends what the board sends, to the bit.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::path::Path;

use trueup_accept::{AcceptanceCriteria, AcceptanceResult, evaluate_acceptance};
use trueup_campaigns::{
    physical_faults::{MachineKind, Plant},
    run_file::{parse_run, with_columns},
};
use trueup_demo::{
    bench_machine,
    playback::{PlaybackParameters, check_offsets, play},
    stepped_board::BoardSource,
};
use trueup_machine::{MachineFile, RunFile, compile, machine_file::Quantity};
use trueup_twin::{Scenario, simulate};

const MEASURED: &str = "measured_elongation_um";
/// The machine's clock runs this many times as fast as the board's.
const FASTER: f64 = 100.0;
/// Hours of a warm-up, from cold.
const HOURS: f64 = 5.0;

/// Returns a spindle that warms up at one speed, and the constants that its file should have.
fn spindle() -> (Scenario, String) {
    let plant = Plant::draw(MachineKind::WarmupSpindle, 5);
    let mut scenario = plant.scenario_for_day(0, &[]);
    let mut run = scenario.segment[0].clone();
    run.spindle_rpm = scenario.spindle.as_ref().expect("a spindle").max_rpm;
    (run.load_n, run.duration_s) = (0.0, Some(3600.0 * HOURS));
    scenario.segment = vec![run];
    (scenario, plant.machine)
}

/// Returns the file with growth and time times these.
fn wrong(source: &str, growth: f64, time: f64) -> String {
    let changed = source.lines().map(|line| match line.split_once(" = ") {
        Some((key, value)) if ["max_um", "warm_s"].contains(&key) => {
            let factor = if key == "max_um" { growth } else { time };
            let value: f64 = value.parse().expect("a number");
            format!("{key} = {:?}\n", value * factor)
        }
        _ => format!("{line}\n"),
    });
    changed.collect()
}

fn recorded(scenario: &Scenario, seed: u64) -> RunFile {
    parse_run(&simulate(scenario, seed, || {}).to_csv(), "run.csv").expect("a run file")
}

/// Returns what the gauge shows when the bridge runs with the file `source`.
fn with_bridge(source: &str, run: &RunFile) -> RunFile {
    let (source, _) = bench_machine::add_missing_inputs(source, run).expect("a machine file");
    let machine = bench_machine::build_bench_machine(&source, FASTER).expect("a machine file");
    let pace = PlaybackParameters::from_timestamps(run, FASTER).expect("it has a time");
    let played = BoardSource::InProcess
        .run(&compile(&machine).expect("it fits the board"), |bridge| {
            play(bridge, &machine, run, &pace, &|_| true, &mut |_| {})
        })
        .expect("the board lives");
    check_offsets(&played, |_| true).expect("an offset in every row");
    let corrected = played.estimated_error_um(Quantity::Elongation, &machine);
    let seen = run.column(MEASURED).expect("measured").iter().zip(corrected);
    let seen = seen.map(|(um, corrected)| um - corrected).collect();
    with_columns(run, &[(MEASURED.into(), seen)]).expect("a run file")
}

/// Returns the acceptance of `source`, on days of its own.
fn turn(scenario: &Scenario, source: &str, number: u64) -> AcceptanceResult {
    let off = recorded(scenario, 2 * number);
    let on = with_bridge(source, &recorded(scenario, 2 * number + 1));
    let machine = MachineFile::parse(source, Path::new("m.toml")).expect("a machine file");
    evaluate_acceptance(&off, &on, None, Some((source, &machine)), AcceptanceCriteria::default())
        .expect("comparable")
}

fn passes_within_three_turns(growth: f64, time: f64) {
    let (scenario, right) = spindle();
    let mut source = wrong(&right, growth, time);
    for number in 0..3 {
        let acceptance = turn(&scenario, &source, number);
        println!(
            "turn {}: {:.1} % gone, {} constants to change",
            number + 1,
            100.0 * acceptance.reduction,
            acceptance.advice.changes.len()
        );
        acceptance.advice.sentences.iter().for_each(|sentence| println!("  {sentence}"));
        assert!(number > 0 || !acceptance.passed, "40 % wrong is not good enough");
        if acceptance.passed {
            assert!(acceptance.adjusted_machine_file().is_none());
            return;
        }
        assert!(
            acceptance
                .render_html("m", &trueup_accept::Provenance::default(), &[])
                .contains("Not passed")
        );
        source = acceptance.adjusted_machine_file().expect("it says what to change").to_string();
    }
    panic!("not passed in three turns");
}

#[test]
fn from_constants_40_percent_too_small_it_passes_within_three_turns() {
    passes_within_three_turns(0.6, 0.6);
}

#[test]
fn from_constants_40_percent_too_large_it_passes_within_three_turns() {
    passes_within_three_turns(1.4, 1.4);
}

/// The right constants pass at once, and nothing is to be changed.
#[test]
fn the_right_constants_pass_at_once() {
    let (scenario, right) = spindle();
    let acceptance = turn(&scenario, &right, 7);
    assert!(acceptance.passed, "{:.3}", acceptance.reduction);
    assert!(acceptance.advice.changes.is_empty());
}
