//! `trueup diagnose` as a user runs it: what it prints, what it leaves, and how it ends.

mod desk;

use std::path::Path;

use desk::Desk;
use serde_json::Value;
use trueup_machine::RunFile;

const PAPER: &str = include_str!("../../../data/paper_spindle.toml");
const TABLE: &str = include_str!("../../../data/spindle_paper_table1.csv");

fn desk() -> Desk {
    Desk::new(&[("m.toml", PAPER), ("run.csv", TABLE)])
}

fn answer(desk: &Desk) -> Value {
    serde_json::from_str(&desk.text("d/diagnosis.json")).expect("it is JSON")
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
    let desk = desk();
    let (out, _) = desk.said("diagnose --machine m.toml --run run.csv --out d", 0);
    assert!(out.starts_with("explained: "), "{out}");
    let answer = answer(&desk);
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
    let page = desk.text("d/report.html");
    assert!(page.contains("<svg") && !page.contains("http://") | page.contains("www.w3.org"));
}

#[test]
fn predict_on_the_extended_file_gives_the_figures_of_after() {
    let desk = desk();
    desk.said("diagnose --machine m.toml --run run.csv --out d", 0);
    desk.said("predict --machine d/extended.toml --run run.csv -o p.csv", 0);
    let answer = answer(&desk);
    let after = answer["after"]["rms_um"].as_f64().expect("a number");
    let there = rms_against(&desk.path("p.csv"), "predicted_elongation_um");
    assert!((after - there).abs() < 1e-5, "{after} {there}");
}

#[test]
fn json_is_printed_and_the_rows_are_written() {
    let desk = desk();
    let (out, _) = desk.said("--json diagnose --machine m.toml --run run.csv --out d", 0);
    let printed: Value = serde_json::from_str(&out).expect("JSON and nothing else");
    assert_eq!(printed["schema"], 1);
    assert_eq!(printed["rows"], 15);
    assert_eq!(desk.text("d/residuals.csv").lines().count(), 16);
}

#[test]
fn what_cannot_be_compared_is_refused_with_its_place() {
    let desk = desk();
    desk.write("none.csv", "sensor_counts\n5048\n");
    desk.write("two.csv", "sensor_counts,measured_dx_um,measured_dz_um\n5048,1,2\n");
    desk.write("blind.csv", "x_mm,measured_elongation_um\n1,2\n");
    for (run, complaint) in [
        ("none.csv", "none.csv:1:1: a column measured_elongation_um"),
        ("two.csv", "two.csv:1:1: several quantities are measured: choose one by --quantity dx"),
        ("blind.csv", "blind.csv:1:1: column sensor_counts is missing"),
    ] {
        let (_, err) = desk.said(&format!("diagnose --machine m.toml --run {run} --out d"), 2);
        assert!(err.starts_with(complaint), "{err}");
    }
}
