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

/// Returns the machine as its builder believes it, a bridge whose CNC is engaged when the tool's log says so, and the
/// tool's line.
fn begun() -> (Desk, String) {
    let desk = Desk::new(&[("m.toml", PAPER), ("s.toml", SCENARIO)]);
    let log = desk.path("all/log.txt");
    let (port, _) = bridge_steered(move || {
        let text = fs::read_to_string(&log).unwrap_or_default();
        text.lines().last().is_some_and(|line| line.ends_with("then engage at the CNC"))
    });
    desk.run_expecting("simulate --scenario s.toml --seed 1 -o off.csv", 0);
    let line = format!(
        "commission --machine m.toml --port {port} --for linuxcnc --rpm 24000 --out all --readings"
    );
    (desk, line)
}

/// Where the bridge is, in the tool's line.
fn port(line: &str) -> &str {
    line.split(' ').skip_while(|word| *word != "--port").nth(1).expect("it has one")
}

/// Writes the indicator's record with compensation: what the fitted file leaves of `quantity`, next to the columns
/// that `accept` pairs rows by.
fn with_compensation(desk: &Desk, machine: &str, quantity: &str, retained: &[&str]) {
    desk.run_expecting(&format!("predict --machine {machine} --run off.csv -o predicted.csv"), 0);
    let run = RunFile::read(&desk.path("predicted.csv")).expect("a run file");
    let column = |name: &str| run.column(name).unwrap_or_else(|| panic!("no {name}"));
    let measured = format!("measured_{quantity}_um");
    let predicted = column(&format!("predicted_{quantity}_um"));
    let mut text = format!("{},{measured}\n", retained.join(","));
    for (row, (measured, predicted)) in column(&measured).iter().zip(predicted).enumerate() {
        let left = measured - predicted;
        retained.iter().for_each(|name| text += &format!("{},", column(name)[row]));
        text += &format!("{left:.2}\n");
    }
    desk.write("on.csv", text);
}

#[test]
fn a_machine_is_commissioned_in_two_sittings() {
    let (desk, line) = begun();
    desk.write("first.txt", "# the tip went back by\n-9.5\noff.csv\n");
    let (out, err) = desk.run_expecting(&format!("{line} first.txt"), 3);
    assert!(!err.contains("all/sign.toml:"), "what pretends on purpose is not doubted: {err}");
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
        assert!(files.iter().any(|other| other == file), "{file}: {files:?}");
    }
    assert!(!desk.files("all/program").is_empty());

    with_compensation(&desk, "all/machine-1.toml", "elongation", &["time_s", "sensor_counts"]);
    desk.write("second.txt", "on.csv\n");
    let (out, _) = desk.run_expecting(&format!("{line} second.txt"), 0);
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
    desk.run_expecting(&format!("{line} second.txt"), 0);
    // Another machine needs another folder.
    desk.write("m.toml", PAPER.replace("hold_ms = 2000", "hold_ms = 1000"));
    let (_, err) = desk.run_expecting(&format!("{line} second.txt"), 2);
    assert!(err.contains("was begun with another machine file"), "{err}");
}

#[test]
fn a_wrong_sign_stops_it_before_anything_is_measured() {
    let (desk, line) = begun();
    for (answer, phrase) in [
        ("10.2", "WRONG SIGN"),
        ("0.3", "nothing has moved"),
        ("-0.01e6", "another distance moved: check the unit"),
        ("ten", "is not a reading in µm"),
    ] {
        desk.write("answers.txt", answer);
        let (out, err) = desk.run_expecting(&format!("{line} answers.txt"), 3);
        assert!(err.contains(phrase), "{answer}: {err}");
        assert!(out.contains("stopped at \"sign test at 10 µm\""), "{out}");
        assert!(!desk.path("all/off-1.csv").exists() && !desk.path("all/program").exists());
        // What the board held is back, whatever became of the test.
        let (out, _) =
            desk.run_expecting(&format!("bridge info --machine m.toml --port {}", port(&line)), 0);
        assert!(out.ends_with("m.toml: the bridge runs on it\n"), "{answer}: {out}");
    }
    let saved = desk.files("all").into_iter().filter(|name| name.starts_with("before-"));
    assert_eq!(saved.count(), 1);
}

#[test]
fn a_run_that_nothing_can_be_fitted_to_is_reported_once_and_written_down() {
    let (desk, line) = begun();
    desk.write("one.csv", "time_s,sensor_counts,measured_elongation_um\n0,5048,0\n");
    desk.write("answers.txt", "-10\none.csv\n");
    let (_, err) = desk.run_expecting(&format!("{line} answers.txt"), 2);
    let message = "1 of 1 rows are complete";
    assert_eq!(err.matches(message).count(), 1, "{err}");
    assert!(desk.text("all/log.txt").contains(message), "{message}");
}

#[test]
fn what_is_not_enough_is_not_accepted_and_the_next_round_begins() {
    let (desk, line) = begun();
    // Nothing is gone: the same readings again.
    desk.write("answers.txt", "-10\noff.csv\noff.csv\n");
    let (out, _) = desk.run_expecting(&format!("{line} answers.txt"), 3);
    assert!(out.contains("not passed\n") && out.contains("stopped at \"measure without"), "{out}");
    assert!(desk.text("all/commission.json").contains("\"round\": 2"));
    assert!(desk.path("all/accept-1/report.html").exists());
}

/// A screw that is 20 µm too long in a metre, and 4 µm of play.
const AXIS: &str = "name = \"axis\"\nmeasure = [\"dx\"]\ninterval_s = 10.0\n\
    [axis.x]\npitch_um_per_m = 20.0\nbacklash_um = 4.0\n\
    [instrument]\nquantum_um = 0.1\nnoise_um = 0.1\n\
    [[segment]]\nkind = \"positions\"\naxis = \"x\"\nrange_mm = [0.0, 1000.0]\ntargets = 11\ncycles = 5\n\
    feed_mm_per_min = 5000.0\n";

#[test]
fn an_axis_is_commissioned_by_its_pitch() {
    let machine =
        "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n[axis.x]\ntravel_mm = [-5.0, 1005.0]\n";
    let (desk, line) = begun();
    desk.write("m.toml", machine);
    desk.write("s.toml", AXIS);
    desk.run_expecting("simulate --scenario s.toml --seed 1 -o off.csv", 0);
    let line = line.replace("commission", "commission pitch --axis x").replace("--rpm 24000 ", "");
    // The axis stands 10 µm too far for the board, and is brought back.
    desk.write("first.txt", "-10\noff.csv\n");
    // Another machine's board is left alone.
    let (_, err) = desk.run_expecting(&format!("{line} first.txt"), 2);
    assert!(err.contains("is of \"mill\", and this bridge works for \"paper\""), "{err}");
    std::fs::remove_dir_all(desk.path("all")).expect("it was begun");
    desk.write("m.toml", machine.replace("mill", "paper"));
    // What this one corrects stays without a yes.
    let (out, err) = desk.run_expecting(&format!("{line} first.txt"), 3);
    assert!(err.contains("May the sign test replace it") && out.contains("stopped at"), "{err}");
    desk.write("p.toml", PAPER);
    let (out, _) =
        desk.run_expecting(&format!("bridge info --machine p.toml --port {}", port(&line)), 0);
    assert!(out.ends_with("p.toml: the bridge runs on it\n"), "{out}");
    desk.write("first.txt", "y\n-10\noff.csv\n");
    let (out, err) = desk.run_expecting(&format!("{line} first.txt"), 3);
    assert!(out.contains("stopped at \"measure with compensation\""), "{out}{err}");
    with_compensation(&desk, "all/machine-1.toml", "dx", &["x_mm", "dir_x"]);
    desk.write("second.txt", "on.csv\n");
    let (out, _) = desk.run_expecting(&format!("{line} second.txt"), 0);
    assert!(out.ends_with("accepted; all of it is in all\n"), "{out}");
    let log = desk.text("all/log.txt");
    for phrase in [
        "set a gauge along X to zero",
        "trueup program pitch --machine all/machine.toml --for linuxcnc --out all/program --axis x",
        "trueup fit pitch --run all/off-1.csv --machine all/machine.toml -o all/machine-1.toml --quantity dx",
        "--quantity dx",
    ] {
        assert!(log.contains(phrase), "{phrase}: {log}");
    }
    let (_, err) =
        desk.run_expecting(&line.replace("pitch", "backlash").replace("--readings", "--rpm 1"), 2);
    assert!(err.contains("was begun for pitch x; give another folder"), "{err}");
}

#[test]
#[cfg(target_os = "linux")]
fn ctrl_c_in_the_sign_test_puts_back_what_the_board_held() {
    use crate::terminal::Terminal;
    let (desk, line) = begun();
    let line = line.trim_end_matches(" --readings").to_owned();
    for key in ["\u{3}", "\u{1b}\r"] {
        let mut terminal = Terminal::start(&desk, &line, (140, 50), true);
        terminal.shows(&["how far has the housing moved, in µm"]);
        terminal.press(key);
        terminal.shows(&["the previous state of the bridge is restored"]);
        assert_eq!(terminal.ended().code(), Some(3), "{}", terminal.text());
        let (out, _) =
            desk.run_expecting(&format!("bridge info --machine m.toml --port {}", port(&line)), 0);
        assert!(out.ends_with("m.toml: the bridge runs on it\n"), "{out}");
    }
}

#[test]
fn what_is_to_be_commissioned_is_asked_where_the_file_does_not_say_it() {
    let machine =
        "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n[axis.x]\ntravel_mm = [0.0, 100.0]\n";
    let desk = Desk::new(&[("m.toml", machine)]);
    desk.write("spindle.toml", PAPER);
    for (words, phrase) in [
        ("--machine spindle.toml", "spindle.toml: the speed is not known: give --rpm"),
        ("-m m.toml pitch --axis y", "the travel of y is not known"),
        (
            "-m m.toml",
            "m.toml has no [spindle]: choose what to commission: trueup commission warmup, or pitch",
        ),
        ("-m m.toml pitch", "pitch needs an axis: --axis x, --axis y or --axis z"),
        ("-m m.toml warmup -a x", "an axis is commissioned by its pitch or its backlash"),
        ("-m m.toml backlash --axis q", "must be x, y or z"),
    ] {
        let line = format!("commission -p tcp:127.0.0.1:1 -f fanuc -o all {words}");
        let (_, err) = desk.run_expecting(line.trim(), 2);
        assert!(err.contains(phrase), "{words}: {err}");
        assert!(!desk.path("all").exists(), "nothing is begun");
    }
}
