//! Who is who: what a bridge runs on against a machine file, what a load changes and whether it asks, a board
//! that is saved and restored, and a port that is another program's.
#![cfg(target_os = "linux")]

use std::sync::{Arc, Mutex};

use crate::desk::Desk;
use crate::pretended::{PAPER, PretendedFault, bridge_many, bridge_with, paper};
use crate::terminal::Terminal;

/// Returns the paper's machine, and the same with another gain and slew limit.
fn desk() -> Desk {
    let other = PAPER
        .replace("0.0152587890625 # 500/32768", "0.0170")
        .replace("slew_um_per_s = 20.0", "slew_um_per_s = 10.0");
    let desk = Desk::new(&[("m.toml", PAPER), ("other.toml", &other)]);
    desk.run_expecting("compile other.toml -o other.bin", 0);
    desk.run_expecting("compile m.toml -o same.bin", 0);
    desk
}

#[test]
fn info_says_whether_the_bridge_runs_on_the_machine_file() {
    let desk = desk();
    let (port, _) = bridge_many(PretendedFault::None, true);
    let (out, _) = desk.run_expecting(&format!("bridge info --machine m.toml --port {port}"), 0);
    assert!(out.ends_with("m.toml: the bridge runs on it\n"), "{out}");
    let (out, _) =
        desk.run_expecting(&format!("bridge info --machine other.toml --port {port}"), 3);
    // The zero stays; at the converter's last code, 32966 counts, 426.0 µm become 474.6.
    for phrase in [
        "other.toml: the bridge does NOT run on it; with it:\n",
        "\n  spindle growth: its law, up to 48.61",
        "\n  slew limit: 20 becomes 10 µm/s\n",
    ] {
        assert!(out.contains(phrase), "{phrase}: {out}");
    }
    let (out, _) =
        desk.run_expecting(&format!("bridge info --json --machine other.toml --port {port}"), 3);
    let json: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!(json["differs_from_machine"].as_array().map(Vec::len), Some(2), "{json}");
}

#[test]
fn a_firmware_of_another_commit_is_reported_on_connecting() {
    let desk = desk();
    let (out, _) = desk.run_expecting("--version", 0);
    let tool = out.trim_end().strip_prefix("trueup ").expect("its name").to_owned();
    let message = format!(
        "the bridge's firmware is {} (00000007), this tool {tool}",
        env!("CARGO_PKG_VERSION")
    );
    let is_known = env!("TRUEUP_COMMIT") != "unknown";
    let (port, _) = bridge_with(PretendedFault::OtherSource, false);
    let (_, err) = desk.run_expecting(&format!("bridge info --port {port}"), 0);
    assert_eq!(err.contains(&message), is_known, "{err}");
    let (port, _) = bridge_with(PretendedFault::OtherSource, false);
    let mut terminal =
        Terminal::start(&desk, &format!("bridge monitor --port {port}"), (200, 30), true);
    if is_known {
        terminal.shows(&["the bridge's firmware is", "(00000007)"]);
    }
    terminal.press("q");
    terminal.ended();
    // One that does not know its own is not doubted.
    let (port, _) = bridge_with(PretendedFault::None, false);
    let (_, err) = desk.run_expecting(&format!("bridge info --port {port}"), 0);
    assert!(!err.contains("firmware"), "{err}");
}

#[test]
fn a_calibration_that_corrects_nothing_is_reported_before_it_is_loaded() {
    let desk = desk();
    desk.write("nothing.toml", "[machine]\nname = \"m\"\nkind = \"3-axis\"\n");
    desk.run_expecting("compile nothing.toml -o nothing.bin", 0);
    let (port, _) = bridge_many(PretendedFault::None, false);
    // Nobody is there to be asked.
    for (file, is_reported) in [("nothing.bin", true), ("other.bin", false)] {
        let (_, err) = desk.run_expecting(&format!("bridge load {file} --port {port}"), 2);
        let message = format!("{file}: corrects nothing: a board with it leaves every offset at 0");
        assert_eq!(err.contains(&message), is_reported, "{err}");
    }
}

#[test]
fn load_prints_what_changes_and_requires_confirmation() {
    let desk = desk();
    // Without a terminal the load cannot be confirmed, and nothing reaches the bridge.
    let (port, received) = bridge_many(PretendedFault::None, false);
    let (out, err) = desk.run_expecting(&format!("bridge load other.bin --port {port}"), 2);
    assert!(out.is_empty() && err.contains("--yes loads it without confirmation"), "{err}");
    for (answer, code, phrase) in [
        ("\r", 2, "not loaded: you did not confirm"),
        ("n\r", 2, "not loaded: you did not confirm"),
        ("y\r", 0, "the bridge has restarted and uses it"),
    ] {
        let line = format!("bridge load other.bin --port {port}");
        let mut terminal = Terminal::start(&desk, &line, (100, 24), true);
        terminal.shows(&["what changes:", "slew limit: 20 becomes 10 µm/s", "Load it? [y/N]"]);
        terminal.press(answer);
        terminal.shows(&[phrase]);
        assert_eq!(terminal.ended().code(), Some(code), "{}", terminal.text());
    }
    assert!(received.lock().expect("no holder panics").frames > 0);
    let (_, err) = desk.run_expecting(&format!("bridge load other.bin --yes --port {port}"), 0);
    assert!(err.contains("the bridge runs on the same laws already"), "{err}");
}

#[test]
fn a_board_is_saved_and_another_one_takes_its_place() {
    let desk = desk();
    let (port, _) = bridge_many(PretendedFault::None, false);
    desk.run_expecting(&format!("bridge load other.bin --yes --port {port}"), 0);
    let (out, _) = desk.run_expecting(&format!("bridge save board.json --port {port}"), 0);
    assert!(out.starts_with("board.json: calibration ") && out.contains("of \"paper\""), "{out}");

    // Another board, which runs on what it came with.
    let (port, _) = bridge_many(PretendedFault::None, false);
    let (out, err) =
        desk.run_expecting(&format!("bridge restore board.json --yes --port {port}"), 0);
    assert!(err.contains("slew limit: 20 becomes 10 µm/s"), "{err}");
    assert!(out.ends_with("restored\n"), "{out}");
    let (out, _) =
        desk.run_expecting(&format!("bridge info --machine other.toml --port {port}"), 0);
    assert!(out.ends_with("other.toml: the bridge runs on it\n"), "{out}");
    // To the byte, and so what is saved of it.
    desk.run_expecting(&format!("bridge save again.json --port {port}"), 0);
    let calibration = |file: &str| {
        let all: serde_json::Value = serde_json::from_str(&desk.text(file)).expect("JSON");
        all["calibration"].as_str().map(str::to_owned)
    };
    assert_eq!(calibration("board.json"), calibration("again.json"));
}

#[test]
fn the_reference_that_zero_had_taken_goes_with_it_and_where_it_cannot_that_is_reported() {
    let desk = desk();
    let (port, _) = bridge_many(PretendedFault::Zeroed, false);
    desk.run_expecting(&format!("bridge save board.json --port {port}"), 0);
    let saved: serde_json::Value = serde_json::from_str(&desk.text("board.json")).expect("JSON");
    assert_eq!(saved["reference"]["elongation_nm"], 2_500, "{saved}");

    // Another board, which has none.
    let (port, _) = bridge_many(PretendedFault::None, false);
    let line = format!("bridge restore board.json --yes --port {port}");
    let (out, err) = desk.run_expecting(&format!("{line} --keep-running"), 3);
    assert!(out.contains("stored for the next start"), "all else is there: {out}");
    let message =
        "the reference that Zero had taken is NOT on this board (elongation +2.50 µm, X +0.00";
    assert!(err.contains(message) && err.contains("let the CNC set Zero again"), "{err}");
    let (out, err) = desk.run_expecting(&line, 0);
    // It is offered: until Confirm at the CNC nothing is engaged.
    assert!(out.contains("elongation +2.50 µm, X +0.00"), "{out}");
    assert!(out.contains("OFFERED, not in force") && out.contains("reference-offered"), "{out}");
    assert!(!err.contains("NOT"), "{err}");
    let (out, _) = desk.run_expecting(&format!("bridge info --port {port}"), 0);
    assert!(out.contains("restored from a file over serial") && out.contains("OFFERED"), "{out}");
    desk.run_expecting(&format!("bridge save again.json --port {port}"), 0);
    let again: serde_json::Value = serde_json::from_str(&desk.text("again.json")).expect("JSON");
    assert_eq!(again["reference"], saved["reference"]);

    // A firmware that does not let it be written.
    let (port, _) = bridge_many(PretendedFault::Older, false);
    let line = format!("bridge restore board.json --yes --port {port}");
    let (_, err) = desk.run_expecting(&line, 3);
    assert!(err.contains(message) && err.contains("object 2010:1"), "{err}");
    let (out, _) = desk.run_expecting(&format!("{line} --json"), 3);
    assert!(out.contains("\"reference\":false"), "{out}");
}

/// An edited reference: by 2.1 m, and by 30 µm.
const HUGE: &str = r#""reference": {"elongation_nm": 2100000000, "x_nm": 0, "y_nm": 0, "z_nm": 0}"#;
const SMALL: &str = r#""reference": {"elongation_nm": 30000, "x_nm": 0, "y_nm": 0, "z_nm": 0}"#;

#[test]
fn a_saved_file_that_is_damaged_is_refused_before_anything_is_sent() {
    let desk = desk();
    let (port, received) = bridge_many(PretendedFault::None, false);
    desk.run_expecting(&format!("bridge save board.json --port {port}"), 0);
    let whole = desk.text("board.json");
    let crc = format!("{:08x}", paper().crc());
    let before = received.lock().expect("no holder panics").frames;
    for (damaged, phrase) in [
        (whole.replace("trueup-bridge-1", "else"), "is not what bridge save writes"),
        (whole.replace(&crc, "00000000"), "the calibration is not the one of its CRC"),
        (whole.replacen("\"calibration\": \"", "\"calibration\": \"zz", 1), "hexadecimal"),
        (whole.replace("\"reference\": null", "\"reference\": 3"), "is not four lengths in nm"),
        (whole.replacen("\"calibration\": \"", "\"calibration\": \"00", 1), "damaged.json: "),
        (whole[..whole.len() / 2].to_owned(), "is not what bridge save writes"),
        (
            whole.replace("\"machine_serial\": \"\"", "\"machine_serial\": \"7\""),
            "its checksum differs",
        ),
        (whole.replace("\"reference\": null", HUGE), "larger than a correction may be: max_um"),
        (whole.replace("\"reference\": null", SMALL), "its checksum differs"),
    ] {
        desk.write("damaged.json", damaged);
        let (out, err) =
            desk.run_expecting(&format!("bridge restore damaged.json --yes --port {port}"), 2);
        assert!(out.is_empty() && err.contains(phrase), "{phrase}: {err}");
    }
    assert_eq!(received.lock().expect("no holder panics").frames, before);
}

#[test]
fn another_machines_backup_is_not_replaced_without_a_yes() {
    let desk = desk();
    let (port, _) = bridge_many(PretendedFault::None, false);
    desk.run_expecting(&format!("bridge save board.json --port {port}"), 0);
    let own = desk.text("board.json");
    // Its own is, as often as you like.
    desk.run_expecting(&format!("bridge save board.json --port {port}"), 0);
    desk.write("lathe.toml", PAPER.replace("name = \"paper\"", "name = \"lathe\""));
    desk.run_expecting("compile lathe.toml -o lathe.bin", 0);
    let (port, _) = bridge_many(PretendedFault::None, false);
    desk.run_expecting(&format!("bridge load lathe.bin --yes --port {port}"), 0);
    let (_, err) = desk.run_expecting(&format!("bridge save board.json --port {port}"), 2);
    for phrase in ["is the backup of \"paper\"", "this bridge is of \"lathe\"", "--overwrite"] {
        assert!(err.contains(phrase), "{phrase}: {err}");
    }
    assert_eq!(desk.text("board.json"), own);
    desk.write("notes.txt", "not a backup");
    let (_, err) = desk.run_expecting(&format!("bridge save notes.txt --port {port}"), 2);
    assert!(err.contains("is no backup of a bridge"), "{err}");
    for (answer, code) in [("n\r", 2), ("y\r", 0)] {
        let line = format!("bridge save board.json --port {port}");
        let mut terminal = Terminal::start(&desk, &line, (120, 24), true);
        terminal.shows(&["Replace it? [y/N]"]);
        terminal.press(answer);
        assert_eq!(terminal.ended().code(), Some(code), "{}", terminal.text());
        assert_eq!(desk.text("board.json") == own, code == 2);
    }
    desk.run_expecting(&format!("bridge save notes.txt --overwrite --port {port}"), 0);
}

#[test]
fn a_load_says_what_becomes_of_the_reference_and_the_older_one_is_offered() {
    let desk = desk();
    let (port, _) = bridge_many(PretendedFault::Zeroed, false);
    let (out, _) = desk.run_expecting(&format!("bridge info --port {port}"), 0);
    assert!(out.contains("reference    elongation +2.50 µm") && out.contains("in force"), "{out}");
    // The law differs by a little, and the reference that goes by 2.5 µm.
    let (out, err) = desk.run_expecting(&format!("bridge load other.bin --yes --port {port}"), 0);
    for phrase in ["the reference is dropped", "elongation +2.50 µm", "move by up to 2.50 µm"] {
        assert!(err.contains(phrase), "{phrase}: {err}");
    }
    assert!(out.contains("reference: the calibration's own zero"), "{out}");
    let (out, _) = desk.run_expecting(&format!("bridge load same.bin --yes --port {port}"), 0);
    for phrase in
        ["engages nothing until it is confirmed", "+2.50 µm", "OFFERED", "trueup.0.confirm"]
    {
        assert!(out.contains(phrase), "{phrase}: {out}");
    }
    let (out, _) = desk.run_expecting(&format!("bridge info --json --port {port}"), 0);
    let document: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!(document["asks"], serde_json::json!(["reference-offered"]), "{document}");
    assert_eq!(document["reference"]["offered"]["elongation_um"], 2.5);
    assert_eq!(document["has_reference"], false);
    let (out, _) = desk.run_expecting(&format!("bridge forget-reference --port {port}"), 0);
    assert!(out.contains("dropped: elongation +2.50 µm"), "{out}");
    let (out, _) = desk.run_expecting(&format!("bridge info --port {port}"), 0);
    assert!(
        out.contains("the calibration's own zero") && !out.contains("reference-offered"),
        "{out}"
    );
}

#[test]
fn a_calibration_that_waits_for_the_next_start_is_shown_used_or_dropped() {
    let desk = desk();
    let (port, _) = bridge_many(PretendedFault::None, false);
    let pending = format!("bridge pending --port {port}");
    let (out, _) = desk.run_expecting(&pending, 0);
    assert_eq!(out, "no calibration waits for the next start\n");
    let load = format!("bridge load other.bin --yes --keep-running --port {port}");
    let (out, _) = desk.run_expecting(&load, 0);
    assert!(out.contains("trueup bridge pending --cancel drops it"), "{out}");
    let (out, _) = desk.run_expecting(&format!("bridge info --port {port}"), 0);
    assert!(out.contains("WAITS for the next start"), "{out}");
    let (out, _) = desk.run_expecting(&pending, 0);
    assert!(
        out.contains("waits for the next start") && out.contains("slew limit: 20 becomes 10"),
        "{out}"
    );
    let (out, _) = desk.run_expecting(&format!("{pending} --cancel"), 0);
    assert!(out.contains("is dropped: the bridge stays on"), "{out}");
    desk.run_expecting(&format!("{pending} --use"), 0);
    let (out, _) = desk.run_expecting(&format!("bridge info --machine m.toml --port {port}"), 0);
    assert!(out.ends_with("m.toml: the bridge runs on it\n") && !out.contains("WAITS"), "{out}");
    desk.run_expecting(&load, 0);
    let (out, _) = desk.run_expecting(&format!("{pending} --use"), 0);
    assert!(out.contains("the bridge has restarted, and runs on"), "{out}");
    let (out, _) =
        desk.run_expecting(&format!("bridge info --machine other.toml --port {port}"), 0);
    assert!(out.ends_with("other.toml: the bridge runs on it\n"), "{out}");
}

#[test]
fn a_serial_device_that_another_program_has_is_busy() {
    use serialport::{SerialPort as _, TTYPort};
    let (mut ours, mut theirs) = TTYPort::pair().expect("this machine has pseudo terminals");
    ours.set_timeout(std::time::Duration::from_millis(1)).expect("a plain terminal");
    theirs.set_exclusive(false).expect("a plain terminal");
    let device = theirs.name().expect("a pseudo terminal has a name");
    drop(theirs);
    let received = Arc::new(Mutex::new(crate::wire::ReceivedBytes::default()));
    std::thread::spawn(move || {
        crate::pretended::live(
            crate::pretended::Tty(ours),
            PretendedFault::None,
            || true,
            &received,
        )
    });
    let desk = Desk::new(&[]);
    let line = format!("bridge monitor --port {device}");
    let mut first = Terminal::start(&desk, &line, (80, 24), true);
    first.shows(&["LIVE"]);
    let (out, err) = desk.run_expecting(&format!("bridge info --port {device}"), 1);
    assert!(out.is_empty() && err.contains(&format!("{device} is busy")), "{err}");
    first.press("q");
    first.ended();
}
