//! `trueup simulate` as a user runs it, and the twin's challenges against the host's own model.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use tempfile::TempDir;
use trueup_machine::{MachineFile, RunFile, predict::Predictor};
use trueup_twin::hidden::{Challenge, Hidden, draw};

const WARMUP: &str = include_str!("../../../data/scenario-warmup.toml");
const AXIS: &str = include_str!("../../../data/scenario-axis.toml");

fn desk() -> TempDir {
    let desk = tempfile::tempdir().expect("a writable folder for temporary files");
    fs::write(desk.path().join("warmup.toml"), WARMUP).expect("a writable folder");
    fs::write(desk.path().join("axis.toml"), AXIS).expect("a writable folder");
    desk
}

fn trueup(desk: &TempDir, line: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_trueup"))
        .args(line.split(' '))
        .current_dir(desk.path())
        .output()
        .expect("the tool was built for this test")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("text")
}

#[test]
fn simulate_writes_a_run_file_that_repeats_by_its_seed() {
    let desk = desk();
    for (line, rows, named) in [
        ("simulate --scenario warmup.toml --seed 7 -o a.csv", 976, "measured_elongation_um"),
        ("simulate --scenario axis.toml --seed 7 -o a.csv", 12 * (9 + 30), "measured_dy_um"),
    ] {
        let output = trueup(&desk, line);
        let printed = text(&output.stdout);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        assert!(printed.starts_with(&format!("a.csv: {rows} rows of time_s, run, ")), "{printed}");
        let run = RunFile::read(&desk.path().join("a.csv")).expect("it is a run file");
        assert_eq!(run.rows(), rows);
        assert!(run.column(named).is_some_and(|column| column.iter().any(|um| um.abs() > 1.0)));

        let first = fs::read(desk.path().join("a.csv")).expect("it was written");
        trueup(&desk, &line.replace("a.csv", "b.csv"));
        assert!(first == fs::read(desk.path().join("b.csv")).expect("it was written"));
        trueup(&desk, &line.replace("--seed 7", "--seed 8").replace("a.csv", "b.csv"));
        assert!(first != fs::read(desk.path().join("b.csv")).expect("it was written"));
    }
}

#[test]
fn simulate_prints_json_if_asked() {
    let desk = desk();
    let output = trueup(&desk, "simulate --json --scenario axis.toml --seed 1 -o run.csv");
    let told: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(told["rows"], 468);
    assert_eq!(told["scenario"], "an axis through heat-up");
    assert_eq!(told["columns"][0], "time_s");
}

#[test]
fn what_is_wrong_with_a_scenario_is_told_with_its_place_and_nothing_is_written() {
    let desk = desk();
    let wrong = WARMUP.replace("gain = 0.85", "gian = 0.85");
    let line = wrong.lines().position(|line| line.starts_with("gian")).expect("there") + 1;
    fs::write(desk.path().join("wrong.toml"), wrong).expect("a writable folder");
    let before = fs::read_dir(desk.path()).expect("readable").count();
    for (scenario, complaint) in [
        ("wrong.toml", format!("wrong.toml:{line}:1: unknown field `gian`")),
        ("nowhere.toml", "nowhere.toml:1:1: cannot be read".to_string()),
    ] {
        let output = trueup(&desk, &format!("simulate --scenario {scenario} --seed 1 -o run.csv"));
        let told = text(&output.stderr);
        assert_eq!((output.status.code(), output.stdout.len()), (Some(2), 0), "{told}");
        assert!(told.starts_with(&complaint) && told.lines().count() == 1, "{told}");
    }
    let output = trueup(&desk, "simulate --scenario axis.toml --seed 1 -o axis.toml");
    assert_eq!(output.status.code(), Some(2), "a scenario is not written over");
    assert_eq!(fs::read_dir(desk.path()).expect("readable").count(), before);
}

/// The largest difference between what the twin and the host's model make of a machine file.
fn largest_difference_um(challenge: &Challenge) -> f64 {
    let machine = MachineFile::parse(&challenge.machine, Path::new("m.toml"))
        .unwrap_or_else(|bad| panic!("{bad}\n{}", challenge.machine));
    let quantity = ["elongation", "dx", "dy", "dz"]
        .iter()
        .position(|name| *name == challenge.quantity)
        .expect("one of the four");
    let predicted = |csv: &String| {
        let run = RunFile::from_reader(csv.as_bytes(), Path::new("r.csv"))
            .unwrap_or_else(|bad| panic!("{bad}"));
        let predictor = Predictor::new(&machine, &run).expect("all that it needs is there");
        assert_eq!(predictor.missing_columns(), [] as [String; 0]);
        predictor.rows().map(|row| row.model.all()[quantity]).collect::<Vec<f64>>()
    };
    let training: Vec<f64> = challenge.runs.iter().flat_map(&predicted).collect();
    let holdout = predicted(&challenge.holdout);
    let truth = &challenge.truth;
    let both = training.iter().chain(&holdout);
    let believed = truth.believed_um.iter().chain(&truth.holdout_believed_um);
    assert_eq!(training.len(), truth.believed_um.len());
    assert_eq!(holdout.len(), truth.holdout_believed_um.len());
    both.zip(believed).map(|(model, twin)| (model - twin).abs()).fold(0.0, f64::max)
}

/// Two programs without a line in common agree on what the believed machine says: so all that a
/// diagnosis can find in a challenge is what was hidden there.
#[test]
fn what_the_twin_believes_is_what_the_model_predicts_in_every_challenge() {
    let (mut worst, mut drawn) = (0.0_f64, 0);
    for &cause in Hidden::ALL {
        for seed in 0..4 {
            let apart_um = largest_difference_um(&draw(cause, 3.0, seed));
            assert!(apart_um < 1e-9, "{} seed {seed}: {apart_um} µm", cause.name());
            worst = worst.max(apart_um);
            drawn += 1;
        }
    }
    println!("{drawn} challenges: the two sides differ by at most {worst:.1e} µm");
}
