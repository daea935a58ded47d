//! `program`, `compare` and `trend` as a user runs them.

use std::fmt::Write as _;

use crate::desk::Desk;

const MACHINE: &str =
    "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n[axis.x]\ntravel_mm = [0.0, 1000.0]\n";

/// What an indicator shows at the rows of a template: no error upwards, `width` downwards.
fn filled(template: &str, width: f64) -> String {
    let mut text = String::new();
    for (n, line) in template.lines().enumerate() {
        let is_row = line.ends_with(',');
        let um = if line.contains(",-1,") { width } else { 0.0 };
        let noise = ((n * 7919) % 13) as f64 / 60.0 - 0.1;
        let value = if is_row { (um + noise).to_string() } else { String::new() };
        writeln!(text, "{line}{value}").expect("a string takes all");
    }
    text
}

#[test]
fn a_program_its_filled_run_file_and_the_fit_go_together() {
    let desk = Desk::new(&[("m.toml", MACHINE)]);
    let line = "program backlash --machine m.toml --for fanuc -o out";
    let (out, err) = desk.said(line, 0);
    assert!(
        out.starts_with("backlash_x.nc: 42 readings") && out.contains("x 0 to 1000 mm"),
        "{out}"
    );
    assert!(err.contains("no program for y: the travel of y is not known"), "{err}");
    assert_eq!(desk.files("out"), ["backlash-x.csv", "backlash_x.nc"]);
    // Again is the same; but what somebody has filled in is not written over.
    desk.said(line, 0);
    desk.write("out/backlash-x.csv", filled(&desk.text("out/backlash-x.csv"), 5.0));
    let (_, err) = desk.said(line, 2);
    assert!(err.contains("move it away first"), "{err}");
    let (out, _) = desk.said("fit backlash --run out/backlash-x.csv -o b.toml", 0);
    assert!(out.contains("width_um = 5."), "{out}");
    for (wrong, rule) in [
        ("--axis y", "travel of y is not known"),
        ("--travel x=5:1", "the smaller first"),
        ("--feed 0", "--feed must be above 0"),
        ("--repeats 0", "at least 1"),
    ] {
        let (_, err) = desk.said(&format!("{line} {wrong}"), 2);
        assert!(err.contains(rule), "{wrong}: {err}");
    }
    let (json, _) = desk.said("--json program pitch --machine m.toml --for siemens -o p", 0);
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(json["programs"][0]["program"], "pitch_x.mpf");
}

#[test]
fn compare_and_trend_tell_what_has_worn() {
    let desk = Desk::new(&[("m.toml", MACHINE)]);
    desk.said("program backlash --machine m.toml --for linuxcnc -o out", 0);
    let template = desk.text("out/backlash-x.csv");
    std::fs::create_dir(desk.path("years")).expect("a new folder");
    for (date, width) in [("2024-03-01", 4.0), ("2025-03-01", 5.5), ("2026-03-01", 7.0)] {
        desk.write(&format!("years/mill-{date}.csv"), filled(&template, width));
    }
    let line = "compare years/mill-2024-03-01.csv years/mill-2026-03-01.csv --out c";
    let (out, _) = desk.said(line, 0);
    assert!(out.starts_with("they differ: backlash\n  Backlash has changed by +3.0"), "{out}");
    assert_eq!(desk.files("c"), ["comparison.json", "report.html"]);
    desk.said(&format!("{line} --limit-um 1"), 3);
    desk.said(&format!("{line} --limit-um 2"), 0);
    let (out, _) = desk.said("trend years --limit-um 1.5 --out t", 0);
    assert!(out.contains("axis.x.backlash.width_um: changes by +1.50 ±"), "{out}");
    assert!(out.contains("measure again") && out.contains("2027-0"), "{out}");
    assert_eq!(desk.files("t"), ["report.html", "trend.json"]);
    let (_, err) = desk.said("trend out", 2);
    assert!(err.contains("no date like 2026-11-22") && err.contains("no dated .csv"), "{err}");
}
