//! `trueup simulate` as a user runs it, and the twin's challenges against the host's own model.

use std::path::Path;

use crate::desk::Desk;
use trueup_campaigns::hidden_effects::{HiddenCause, TestCase, draw_test_case};
use trueup_machine::{MachineFile, RunFile, predict::RunPredictor};

const WARMUP: &str = include_str!("../../../../../data/scenario-warmup.toml");
const AXIS: &str = include_str!("../../../../../data/scenario-axis.toml");

fn desk() -> Desk {
    Desk::new(&[("warmup.toml", WARMUP), ("axis.toml", AXIS)])
}

#[test]
fn simulate_writes_a_run_file_that_repeats_by_its_seed() {
    let desk = desk();
    for (line, rows, named) in [
        ("simulate --scenario warmup.toml --seed 7 -o a.csv", 976, "measured_elongation_um"),
        ("simulate --scenario axis.toml --seed 7 -o a.csv", 12 * (9 + 30), "measured_dy_um"),
    ] {
        let (printed, _) = desk.run_expecting(line, 0);
        assert!(printed.starts_with(&format!("a.csv: {rows} rows of time_s, run, ")), "{printed}");
        let run = RunFile::read(&desk.path("a.csv")).expect("it is a run file");
        assert_eq!(run.row_count(), rows);
        assert!(run.column(named).is_some_and(|column| column.iter().any(|um| um.abs() > 1.0)));

        let first = desk.read("a.csv");
        desk.run_expecting(&line.replace("a.csv", "b.csv"), 0);
        assert!(first == desk.read("b.csv"));
        desk.run_expecting(&line.replace("--seed 7", "--seed 8").replace("a.csv", "b.csv"), 0);
        assert!(first != desk.read("b.csv"));
    }
}

#[test]
fn simulate_prints_json_if_asked() {
    let desk = desk();
    let (out, _) =
        desk.run_expecting("simulate --json --scenario axis.toml --seed 1 -o run.csv", 0);
    let json: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!(json["rows"], 468);
    assert_eq!(json["scenario"], "an axis through heat-up");
    assert_eq!(json["columns"][0], "time_s");
}

#[test]
fn what_is_wrong_with_a_scenario_is_reported_with_its_place_and_nothing_is_written() {
    let desk = desk();
    let wrong = WARMUP.replace("gain = 0.85", "gian = 0.85");
    let line = wrong.lines().position(|line| line.starts_with("gian")).expect("there") + 1;
    desk.write("wrong.toml", wrong);
    let before = desk.files(".");
    for (scenario, complaint) in [
        ("wrong.toml", format!("wrong.toml:{line}:1: unknown field `gian`")),
        ("nowhere.toml", "nowhere.toml:1:1: cannot be read".to_string()),
    ] {
        let (out, stderr) =
            desk.run_expecting(&format!("simulate --scenario {scenario} --seed 1 -o run.csv"), 2);
        assert_eq!(out, "", "{stderr}");
        assert!(stderr.starts_with(&complaint) && stderr.lines().count() == 1, "{stderr}");
    }
    desk.run_expecting("simulate --scenario axis.toml --seed 1 -o axis.toml", 2);
    assert_eq!(desk.text("axis.toml"), AXIS, "a scenario is not written over");
    assert_eq!(desk.files("."), before);
}

/// Returns the largest difference between what the twin and the host's model make of a machine file.
fn largest_difference_um(test_case: &TestCase) -> f64 {
    let machine = MachineFile::parse(&test_case.machine, Path::new("m.toml"))
        .unwrap_or_else(|bad| panic!("{bad}\n{}", test_case.machine));
    let quantity = ["elongation", "dx", "dy", "dz"]
        .iter()
        .position(|name| *name == test_case.quantity)
        .expect("one of the four");
    let predicted = |csv: &String| {
        let run = RunFile::from_reader(csv.as_bytes(), Path::new("r.csv"))
            .unwrap_or_else(|bad| panic!("{bad}"));
        let predictor = RunPredictor::new(&machine, &run).expect("all that it needs is there");
        assert_eq!(predictor.missing_columns(), [] as [String; 0]);
        predictor.predictions().map(|row| row.model.to_array()[quantity]).collect::<Vec<f64>>()
    };
    let training: Vec<f64> = test_case.runs.iter().flat_map(&predicted).collect();
    let holdout = predicted(&test_case.holdout);
    let truth = &test_case.truth;
    let both = training.iter().chain(&holdout);
    let believed = truth.believed_um.iter().chain(&truth.holdout_believed_um);
    assert_eq!(training.len(), truth.believed_um.len());
    assert_eq!(holdout.len(), truth.holdout_believed_um.len());
    both.zip(believed).map(|(model, twin)| (model - twin).abs()).fold(0.0, f64::max)
}

/// Two programs without a line in common agree on what the believed machine says: so all that a
/// diagnosis can find in a challenge is what was hidden there.
#[test]
fn what_the_twin_believes_is_what_the_model_predicts_in_every_test_case() {
    let (mut worst, mut drawn) = (0.0_f64, 0);
    for &cause in HiddenCause::ALL {
        for seed in 0..4 {
            let apart_um = largest_difference_um(&draw_test_case(cause, 3.0, seed));
            assert!(apart_um < 1e-9, "{} seed {seed}: {apart_um} µm", cause.name());
            worst = worst.max(apart_um);
            drawn += 1;
        }
    }
    println!("{drawn} challenges: the two sides differ by at most {worst:.1e} µm");
}
