//! `commission` on a bridge in this process, with the virtual machine tool as the machine and its indicator as
//! the gauge: the sign test, a stop, going on, acceptance.

use std::fs;

use crate::desk::Desk;
use crate::pretended::{PAPER, bridge_steered};
use trueup_machine::RunFile;

/// Two hours at full speed and one hour of cooling: a sensor that shows too little.
const SCENARIO: &str = "name = \"warm-up\"\nmeasure = [\"elongation\"]\ninterval_s = 60.0\n\
    [ambient]\nmean_c = 21.0\n[coolant]\ntemperature_c = 20.0\n[spindle]\nshaft_share = 0.15\n\
    [sensor]\nzero_counts = 5048.0\num_per_count = 0.0152587890625\ngain = 0.7\nnoise_um = 0.03\n\
    [instrument]\nquantum_um = 0.1\nnoise_um = 0.15\n\
    [[segment]]\nkind = \"spindle\"\nduration_s = 7200.0\nspindle_rpm = 24000.0\n\
    [[segment]]\nkind = \"spindle\"\nduration_s = 3600.0\n";

/// The machine as its builder believes it, a bridge whose CNC is engaged when the tool's log says so, and the
/// tool's line.
fn begun() -> (Desk, String) {
    let desk = Desk::new(&[("m.toml", PAPER), ("s.toml", SCENARIO)]);
    let log = desk.path("all/log.txt");
    let (port, _) = bridge_steered(move || {
        let text = fs::read_to_string(&log).unwrap_or_default();
        text.lines().last().is_some_and(|line| line.ends_with("then engage at the CNC"))
    });
    desk.said("simulate --scenario s.toml --seed 1 -o off.csv", 0);
    let line = format!(
        "commission --machine m.toml --port {port} --for linuxcnc --rpm 24000 --out all --readings"
    );
    (desk, line)
}

/// What the indicator shows with compensation: what the fitted file leaves.
fn with_compensation(desk: &Desk, machine: &str) {
    desk.said(&format!("predict --machine {machine} --run off.csv -o predicted.csv"), 0);
    let run = RunFile::read(&desk.path("predicted.csv")).expect("a run file");
    let column = |name: &str| run.column(name).expect(name);
    let [time_s, counts, measured, predicted] =
        ["time_s", "sensor_counts", "measured_elongation_um", "predicted_elongation_um"]
            .map(column);
    let mut text = "time_s,sensor_counts,measured_elongation_um\n".to_owned();
    for row in 0..run.rows() {
        let left = measured[row] - predicted[row];
        text += &format!("{},{},{left:.2}\n", time_s[row], counts[row]);
    }
    desk.write("on.csv", text);
}

#[test]
#[ignore = "long: calibrations go over the line at its pace"]
fn a_machine_is_commissioned_in_two_sittings() {
    let (desk, line) = begun();
    desk.write("first.txt", "# the tip went back by\n-9.5\noff.csv\n");
    let (out, _) = desk.said(&format!("{line} first.txt"), 3);
    assert!(
        out.ends_with(
            "stopped at \"measure with compensation\"; the same command goes on from here\n"
        ),
        "{out}"
    );
    let files = desk.files("all");
    for file in
        ["commission.json", "log.txt", "machine-1.bin", "machine-1.toml", "off-1.csv", "sign.toml"]
    {
        assert!(files.iter().any(|it| it == file), "{file}: {files:?}");
    }
    assert!(!desk.files("all/program").is_empty());

    with_compensation(&desk, "all/machine-1.toml");
    desk.write("second.txt", "on.csv\n");
    let (out, _) = desk.said(&format!("{line} second.txt"), 0);
    assert!(out.contains("passed\n") && out.ends_with("accepted; all of it is in all\n"), "{out}");

    // A colleague reads what was done, and can do it by hand.
    let log = desk.text("all/log.txt");
    for phrase in [
        "round 1: sign test at 10 µm",
        "measured -9.5 µm: the sign is right",
        "trueup program warmup --machine all/machine.toml --for linuxcnc",
        "trueup fit elongation --run all/off-1.csv --machine all/machine.toml -o all/machine-1.toml",
        "trueup bridge load all/machine-1.bin --yes --port tcp:",
        "trueup accept --off all/off-1.csv --on all/on-1.csv --require 90",
        " accepted",
    ] {
        assert!(log.contains(phrase), "{phrase}: {log}");
    }
    // It is done, and says so again.
    desk.said(&format!("{line} second.txt"), 0);
    // Another machine needs another folder.
    desk.write("m.toml", PAPER.replace("hold_ms = 2000", "hold_ms = 1000"));
    let (_, err) = desk.said(&format!("{line} second.txt"), 2);
    assert!(err.contains("was begun with another machine file"), "{err}");
}

#[test]
#[ignore = "long: calibrations go over the line at its pace"]
fn a_wrong_sign_stops_it_before_anything_is_measured() {
    let (desk, line) = begun();
    for (answer, phrase) in [
        ("10.2", "WRONG SIGN"),
        ("0.3", "nothing has moved"),
        ("-0.01e6", "it is not 10 µm that moved"),
        ("ten", "is not a reading in µm"),
    ] {
        desk.write("answers.txt", answer);
        let (out, err) = desk.said(&format!("{line} answers.txt"), 3);
        assert!(err.contains(phrase), "{answer}: {err}");
        assert!(out.contains("stopped at \"sign test at 10 µm\""), "{out}");
        assert!(!desk.path("all/off-1.csv").exists() && !desk.path("all/program").exists());
    }
}

#[test]
#[ignore = "long: calibrations go over the line at its pace"]
fn what_is_not_enough_is_not_accepted_and_the_next_round_begins() {
    let (desk, line) = begun();
    // Nothing is gone: the same readings again.
    desk.write("answers.txt", "-10\noff.csv\noff.csv\n");
    let (out, _) = desk.said(&format!("{line} answers.txt"), 3);
    assert!(out.contains("not passed\n") && out.contains("stopped at \"measure without"), "{out}");
    assert!(desk.text("all/commission.json").contains("\"round\": 2"));
    assert!(desk.path("all/accept-1/report.html").exists());
}
