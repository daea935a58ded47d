//! Records of a bridge, and run files as people have them, as a user hands them in.

use std::ops::Range;

use crate::desk::Desk;
use serde_json::Value;
use trueup_machine::{MachineFile, compile};

const PAPER: &str = include_str!("../../../../../data/paper_spindle.toml");

/// Returns a spindle that warms up and cools while a bridge corrects what the machine file says, four fifths of
/// it, from row 100 to row 300; it ramps out for 5 rows, and a logger has lost the quality of 2.
fn record(calibration: u32) -> String {
    record_of(calibration, 1.0, 100..300)
}

/// Returns the same of a CNC that moves by `factor` times the offset, engaged in these rows.
fn record_of(calibration: u32, factor: f64, engaged: Range<i32>) -> String {
    let mut text = String::from(
        "time_s,offset_x_um,offset_y_um,offset_z_um,quality,flags,age_ms,calibration_crc,\
         sensor_counts,measured_elongation_um\n",
    );
    let mut grown_um = 0.0;
    for row in 0..400 {
        grown_um += (if row % 200 < 120 { 60.0 } else { 0.0 } - grown_um) / 40.0;
        let believed_um = grown_um / 1.25;
        let (offset_um, quality) = match row {
            50 | 51 => (0.0, ""),
            _ if engaged.contains(&row) => (believed_um, "1"),
            300..305 => (believed_um * f64::from(305 - row) / 5.0, "5"),
            _ => (0.0, "0"),
        };
        let gauge_um = [0.11, -0.14, 0.03, 0.17, -0.06, -0.12, 0.01][row as usize % 7];
        text += &format!(
            "{},0,0,{offset_um:.2},{quality},0,1,{calibration},{:.2},{:.3}\n",
            10 * row,
            5_048.0 + believed_um * 65.536,
            grown_um - factor * offset_um + gauge_um,
        );
    }
    text
}

#[test]
fn the_record_of_a_bridge_is_diagnosed_and_fitted_without_what_it_applied() {
    let machine = MachineFile::parse(PAPER, "m.toml".as_ref()).expect("the project's own");
    let own = compile(&machine).expect("it fits").crc();
    let desk = Desk::new(&[("m.toml", PAPER), ("r.csv", &record(own)), ("other.csv", &record(7))]);
    let (out, err) = desk.run_expecting("diagnose --machine m.toml --run r.csv --out d", 0);
    assert!(out.contains("sensor-gain"), "{out}");
    for phase in ["5 of 400 rows are excluded: the bridge held", "2 of 400 rows are excluded"] {
        assert!(err.contains(&format!("warning: r.csv: measured_elongation_um: {phase}")), "{err}");
    }
    let answer: Value = serde_json::from_str(&desk.text("d/diagnosis.json")).expect("JSON");
    assert_eq!(answer["notes"].as_array().expect("a list").len(), 2);
    let findings = answer["findings"].as_array().expect("a list");
    let gain = findings[0]["parameters"]["gain"]["value"].as_f64().expect("a number");
    assert_eq!(findings.len(), 1, "{out}");
    assert!((gain - 1.25).abs() < 0.002, "{gain}");

    let (_, err) = desk.run_expecting("fit elongation --machine m.toml --run r.csv -o f.toml", 0);
    assert!(err.contains("2 of 400 rows are excluded"), "{err}");
    let fitted = MachineFile::read(&desk.path("f.toml")).expect("a machine file");
    let um_per_count = fitted.spindle.sensor.expect("fitted").um_per_count;
    assert!((um_per_count * 65.536 - 1.25).abs() < 0.002, "{um_per_count}");

    for line in [
        "diagnose --machine m.toml --run other.csv --out d2",
        "diagnose --machine m.toml --run r.csv --holdout other.csv --out d2",
        "fit elongation --machine m.toml --run other.csv -o f2.toml",
    ] {
        let (_, err) = desk.run_expecting(line, 2);
        let place = "other.csv:2:18: calibration_crc 7 is another calibration than that of this";
        assert!(err.contains(place), "{line}: {err}");
    }
    assert!(!desk.path("f2.toml").exists());
}

#[test]
fn a_cnc_that_applies_the_offset_otherwise_is_named_and_nothing_is_made_of_its_record() {
    let machine = MachineFile::parse(PAPER, "m.toml".as_ref()).expect("the project's own");
    let own = compile(&machine).expect("it fits").crc();
    let of = |factor: f64, engaged| record_of(own, factor, engaged);
    let desk = Desk::new(&[
        ("m.toml", PAPER),
        ("middle.csv", &of(-1.0, 100..300)),
        ("off.csv", &of(-1.0, 0..0)),
        ("on.csv", &of(-1.0, 0..400)),
        ("right.csv", &of(1.0, 0..400)),
    ]);
    let diagnosed = |line: &str, code: i32| {
        let (out, _) =
            desk.run_expecting(&format!("diagnose --machine m.toml {line} --out d"), code);
        assert_eq!(desk.text("d/extended.toml"), PAPER, "{line}");
        let json: Value = serde_json::from_str(&desk.text("d/diagnosis.json")).expect("JSON");
        (out, json)
    };
    for line in ["--run middle.csv", "--run on.csv --off off.csv"] {
        let (out, json) = diagnosed(line, 0);
        assert!(out.contains("applied-factor: For 1 µm of offset"), "{out}");
        let first = &json["findings"][0];
        assert!(first["cause"] == "applied-factor" && first["claimed"] == true, "{first}");
        let factor = first["parameters"]["factor"]["value"].as_f64().expect("a number");
        assert!((factor + 1.0).abs() < 0.05, "{factor}");
    }
    for line in ["--run on.csv", "--run right.csv"] {
        let (_, json) = diagnosed(line, 3);
        let first = &json["findings"][0];
        assert!(first["claimed"] == false && first["compensated"] == false, "{first}");
        assert_eq!(first["rivals"][0]["cause"], "applied-factor", "{first}");
        assert!(
            first["next_test"].as_str().is_some_and(|text| text.contains("disengaged")),
            "{first}"
        );
    }
    let known = "diagnose --machine m.toml --run right.csv --applied-once --out e";
    desk.run_expecting(known, 0);
    assert!(desk.text("e/extended.toml").contains("sensor-gain"));
    for (run, why) in [("middle.csv", "For 1 µm of offset"), ("on.csv", "disengaged")] {
        let line = format!("fit elongation --machine m.toml --run {run} -o f.toml");
        let (_, err) = desk.run_expecting(&line, 2);
        assert!(err.contains(why) && !desk.path("f.toml").exists(), "{err}");
    }
}

#[test]
fn a_column_that_looks_like_a_known_one_is_a_warning_and_an_error_where_it_is_needed() {
    let rows: String =
        (0..40).map(|row| format!("{},{},1\n", 5_048 + 50 * row, f64::from(row))).collect();
    let desk = Desk::new(&[
        ("m.toml", PAPER),
        ("slip.csv", &format!("# a logger\nsensor_counts,measured_elongation_mm,x_mm\n{rows}")),
        ("warn.csv", &format!("sensor_counts,measured_elongation_um,X (mm)\n{rows}")),
    ]);
    for line in [
        "diagnose --machine m.toml --run slip.csv --out d",
        "fit elongation --machine m.toml --run slip.csv -o f.toml",
    ] {
        let (_, err) = desk.run_expecting(line, 2);
        let message =
            "slip.csv:2:15: column measured_elongation_um is missing; measured_elongation_mm is";
        assert!(err.contains(message), "{line}: {err}");
    }
    for line in [
        "diagnose --machine m.toml --run warn.csv --out d",
        "fit elongation --machine m.toml --run warn.csv -o f.toml",
        "predict --machine m.toml --run warn.csv -o p.csv",
    ] {
        let output = desk.trueup(line);
        let err = String::from_utf8_lossy(&output.stderr).into_owned();
        let message =
            "warning: warn.csv:1:38: X (mm) is no column that is known; did you mean x_mm?";
        assert_eq!(err.matches(message).count(), 1, "{line}: {err}");
    }
}
