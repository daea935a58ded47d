//! `trueup diagnose` as a user runs it: what it prints, what it leaves, and how it ends.

use std::path::Path;

use crate::desk::Desk;
use serde_json::Value;
use trueup_machine::RunFile;

const PAPER: &str = include_str!("../../../../../data/paper_spindle.toml");
const TABLE: &str = include_str!("../../../../../data/spindle_paper_table1.csv");

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
    let (out, _) = desk.run_expecting("diagnose --machine m.toml --run run.csv --out d", 0);
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
    // The speed is the same in every row: nothing can be seen against it.
    assert!(!page.contains("against everything that has changed"), "{page}");
    assert!(page.contains("<svg") && !page.contains("http://") | page.contains("www.w3.org"));
}

#[test]
fn predict_on_the_extended_file_gives_the_figures_of_after() {
    let desk = desk();
    desk.run_expecting("diagnose --machine m.toml --run run.csv --out d", 0);
    desk.run_expecting("predict --machine d/extended.toml --run run.csv -o p.csv", 0);
    let answer = answer(&desk);
    let after = answer["after"]["rms_um"].as_f64().expect("a number");
    let there = rms_against(&desk.path("p.csv"), "predicted_elongation_um");
    assert!((after - there).abs() < 1e-5, "{after} {there}");
}

#[test]
fn json_is_printed_and_the_rows_are_written() {
    let desk = desk();
    let (out, _) = desk.run_expecting("--json diagnose --machine m.toml --run run.csv --out d", 0);
    let printed: Value = serde_json::from_str(&out).expect("JSON and nothing else");
    assert_eq!(printed["schema"], 1);
    assert_eq!(printed["rows"], 15);
    assert_eq!(desk.text("d/residuals.csv").lines().count(), 16);
}

/// Returns two thermometers, of which the board has one; the machine grows with both.
fn two_thermometers(rows: u32) -> Desk {
    let machine = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[inputs]\ntemp_front_c = { channel = 0, kind = \
                   \"pt100\" }\n[spindle]\nsource = \"temperature\"\n[spindle.temperature]\nsensor = \
                   \"temp_front_c\"\nreference_c = 20.0\nk_um_per_c = 2.0\n";
    let mut run = String::from("time_s,temp_front_c,temp_bed_c,measured_elongation_um\n");
    for row in 0..rows {
        let turn = f64::from(row) / f64::from(rows) * std::f64::consts::TAU;
        let (front, bed) = (24.0 + 4.0 * (3.0 * turn).sin(), 22.0 + 2.0 * (2.0 * turn).cos());
        let noise = f64::from(row.wrapping_mul(2_654_435_761) >> 20) / 4096.0 - 0.5;
        let um = 2.0 * (front - 20.0) + 1.5 * (bed - 20.0) + noise;
        run += &format!("{row},{front:.3},{bed:.3},{um:.3}\n");
    }
    Desk::new(&[("m.toml", machine), ("run.csv", &run)])
}

#[test]
fn what_the_board_lacks_for_a_term_is_given_as_lines_and_with_them_the_file_compiles() {
    let desk = two_thermometers(600);
    let (_, err) = desk.run_expecting("diagnose --machine m.toml --run run.csv --out d", 0);
    let line = "temp_bed_c = { channel = 1, kind = \"pt100\" }";
    assert!(err.contains(line), "{err}");
    assert_eq!(answer(&desk)["missing_inputs"], serde_json::json!([line]));
    assert!(desk.text("d/report.html").contains("temp_bed_c = { channel = 1"));
    desk.run_expecting("compile d/extended.toml -o cal.bin", 2);
    let pasted = desk.text("d/extended.toml").replace("[inputs]\n", &format!("[inputs]\n{line}\n"));
    desk.write("pasted.toml", pasted);
    desk.run_expecting("compile pasted.toml -o cal.bin", 0);
}

#[test]
fn a_report_says_what_it_was_made_from_and_is_small_however_long_the_run() {
    let desk = two_thermometers(20_000);
    desk.run_expecting("diagnose --machine m.toml --run run.csv --out d", 0);
    let page = desk.text("d/report.html");
    assert!(page.len() < 200_000, "{} bytes", page.len());
    assert!(page.contains("What is left against temp_"), "{page}");
    let foot = format!("Made by trueup {} on 20", env!("CARGO_PKG_VERSION"));
    assert!(page.contains(&foot) && page.contains("from m.toml (CRC-32 "), "{page}");
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
        let (_, err) =
            desk.run_expecting(&format!("diagnose --machine m.toml --run {run} --out d"), 2);
        assert!(err.starts_with(complaint), "{err}");
    }
}

#[test]
fn the_next_run_is_a_program_and_a_run_file_that_is_not_written_over() {
    // Two paths of heat that nobody can distinguish in a quarter of an hour.
    let trial = trueup_campaigns::spindle_trial::SpindleTrial::from_seed(53);
    let first = trial.simulate_day(&[(trueup_campaigns::spindle_trial::RATED_SPEED_RPM, 15.0)], 1);
    let desk = Desk::new(&[("m.toml", &trial.machine), ("first.csv", &first)]);
    let line = "diagnose --machine m.toml --run first.csv --next linuxcnc --out d";
    let (out, _) = desk.run_expecting(line, 3);
    println!("{out}");
    assert!(out.contains("next run, ") && out.contains(" r/min for "), "{out}");
    assert!(out.contains("times the noise of a reading"), "{out}");
    let program = desk.text("d/next.ngc");
    assert!(program.contains("M3 S") && program.contains("(read)"), "{program}");
    let next: Value = serde_json::from_str(&desk.text("d/next.json")).expect("it is JSON");
    assert!(next["told"][0]["score_gap"].as_f64().expect("a number") >= 6.0);
    let template = desk.text("d/next.csv");
    // The line that comes next can be typed: with the runs before, into a folder of its own.
    let then = "diagnose --machine m.toml --run first.csv --run d/next.csv --out d-next";
    assert!(out.contains(&format!("then: trueup {then}\n")), "{out}");
    assert!(template.contains(&format!("# then: trueup {then}\n")), "{template}");
    let head =
        "time_s,spindle_rpm,temp_front_c,temp_column_c,temp_housing_c,measured_elongation_um";
    assert!(template.lines().any(|line| line == head), "{template}");
    let second = trial.simulate_day(&[(trueup_campaigns::spindle_trial::RATED_SPEED_RPM, 20.0)], 2);
    desk.write("d/next.csv", &second);
    assert!(matches!(desk.trueup(then).status.code(), Some(0 | 3)));
    desk.write("d/next.csv", template.replacen(",,", ",20.5,", 1));
    let (_, error) = desk.run_expecting(line, 2);
    assert!(error.contains("is there already, and not empty"), "{error}");
    // What is claimed asks for nothing.
    desk.write("run.csv", TABLE);
    desk.write("paper.toml", PAPER);
    let (out, _) =
        desk.run_expecting("diagnose --machine paper.toml --run run.csv --next siemens --out e", 0);
    assert!(out.contains("next run: no cause is open"), "{out}");
}
