//! `trueup diagnose` as a user runs it: what it prints, what it leaves, and how it ends.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use serde_json::Value;
use tempfile::TempDir;
use trueup_machine::RunFile;

const PAPER: &str = include_str!("../../../data/paper_spindle.toml");
const TABLE: &str = include_str!("../../../data/spindle_paper_table1.csv");

struct Desk(TempDir);

impl Desk {
    fn new() -> Self {
        let desk = Self(tempfile::tempdir().expect("a writable folder for temporary files"));
        desk.write("m.toml", PAPER);
        desk.write("run.csv", TABLE);
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, content: &str) {
        fs::write(self.path(name), content).expect("a writable folder");
    }

    fn trueup(&self, line: &str) -> Output {
        Command::new(env!("CARGO_BIN_EXE_trueup"))
            .args(line.split(' '))
            .current_dir(self.0.path())
            .output()
            .expect("the tool was built for this test")
    }

    fn json(&self, name: &str) -> Value {
        let text = fs::read_to_string(self.path(name)).expect("it was written");
        serde_json::from_str(&text).expect("it is JSON")
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Measured minus `column`, root mean square.
fn rms_against(path: &Path, column: &str) -> f64 {
    let run = RunFile::read(path).expect("predict writes run files");
    let measured = run.column("measured_elongation_um").expect("it was in the run");
    let predicted = run.column(column).expect("predict adds it");
    let sum: f64 = measured.iter().zip(predicted).map(|(m, p)| (m - p) * (m - p)).sum();
    (sum / measured.len() as f64).sqrt()
}

#[test]
fn the_papers_sensor_has_a_gain_and_an_offset() {
    let desk = Desk::new();
    let output = desk.trueup("diagnose --machine m.toml --run run.csv --out d");
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(0), "{out}{err}");
    assert!(out.starts_with("explained: "), "{out}");
    let answer = desk.json("d/diagnosis.json");
    let causes: Vec<&str> = answer["findings"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|finding| finding["cause"].as_str().expect("a name"))
        .collect();
    assert!(causes.contains(&"sensor-gain") && causes.contains(&"sensor-offset"), "{causes:?}");
    let left = answer["after"]["holdout_rms_um"].as_f64().expect("a number");
    println!("{causes:?}: left out {left:.3} µm RMS");
    assert!(left <= 0.95, "{left}");
    let page = fs::read_to_string(desk.path("d/report.html")).expect("it was written");
    assert!(page.contains("<svg") && !page.contains("http://") | page.contains("www.w3.org"));
}

#[test]
fn predict_on_the_extended_file_gives_the_figures_of_after() {
    let desk = Desk::new();
    desk.trueup("diagnose --machine m.toml --run run.csv --out d");
    let output = desk.trueup("predict --machine d/extended.toml --run run.csv -o p.csv");
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let answer = desk.json("d/diagnosis.json");
    let after = answer["after"]["rms_um"].as_f64().expect("a number");
    let there = rms_against(&desk.path("p.csv"), "predicted_elongation_um");
    assert!((after - there).abs() < 1e-5, "{after} {there}");
}

#[test]
fn json_is_printed_and_the_rows_are_written() {
    let desk = Desk::new();
    let output = desk.trueup("--json diagnose --machine m.toml --run run.csv --out d");
    let printed: Value = serde_json::from_slice(&output.stdout).expect("JSON and nothing else");
    assert_eq!(printed["schema"], 1);
    assert_eq!(printed["rows"], 15);
    let rows = fs::read_to_string(desk.path("d/residuals.csv")).expect("it was written");
    assert_eq!(rows.lines().count(), 16);
}

#[test]
fn what_cannot_be_compared_is_refused_with_its_place() {
    let desk = Desk::new();
    desk.write("none.csv", "sensor_counts\n5048\n");
    desk.write("two.csv", "sensor_counts,measured_dx_um,measured_dz_um\n5048,1,2\n");
    desk.write("blind.csv", "x_mm,measured_elongation_um\n1,2\n");
    for (run, complaint) in [
        ("none.csv", "none.csv:1:1: a column measured_elongation_um"),
        ("two.csv", "two.csv:1:1: several quantities are measured: choose one by --quantity dx"),
        ("blind.csv", "blind.csv:1:1: column sensor_counts is missing"),
    ] {
        let line = format!("diagnose --machine m.toml --run {run} --out d");
        let output = desk.trueup(&line);
        let err = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{err}");
        assert!(err.starts_with(complaint), "{err}");
    }
}
