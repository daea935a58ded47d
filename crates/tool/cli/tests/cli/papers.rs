//! `program`, `compare` and `trend` as a user runs them.

use std::fmt::Write as _;

use crate::desk::Desk;

const MACHINE: &str =
    "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n[axis.x]\ntravel_mm = [0.0, 1000.0]\n";

/// Returns what an indicator shows at the rows of a template: no error upwards, `width` downwards.
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
    let (out, err) = desk.run_expecting(line, 0);
    assert!(
        out.starts_with("backlash_x.nc: 42 readings") && out.contains("x 51.3 to 998 mm"),
        "{out}"
    );
    assert!(err.contains("no program for y: the travel of y is not known"), "{err}");
    assert_eq!(desk.files("out"), ["backlash-x.csv", "backlash_x.nc"]);
    // Again is the same; but what a user has filled in is not overwritten.
    desk.run_expecting(line, 0);
    desk.write("out/backlash-x.csv", filled(&desk.text("out/backlash-x.csv"), 5.0));
    let (_, err) = desk.run_expecting(line, 2);
    assert!(err.contains("move it away first"), "{err}");
    let (out, _) = desk.run_expecting("fit backlash --run out/backlash-x.csv -o b.toml", 0);
    assert!(out.contains("width_um = 5."), "{out}");
    for (wrong, rule) in [
        ("--axis y", "travel of y is not known"),
        ("--range x=5:1", "the smaller first"),
        ("--range x=5:nan", "the smaller first"),
        ("--travel x=0:1 --range x=0:2", "--range x is given twice"),
        (
            "--range x=0:1001",
            "--range x=0:1001 is outside the machine file's travel_mm of 0 to 1000 mm",
        ),
        ("--range x=5:6", "leaves less than 2 mm"),
        ("--margin 500", "within the margin of 500 mm"),
        ("--margin -1", "--margin must be 0 or more"),
        ("--approach 0", "--approach must be above 0"),
        ("--clearance 50", "must be like y=50"),
        ("--clearance y=50", "the travel of y is not known"),
        ("--feed 0", "--feed must be above 0"),
        ("--repeats 0", "at least 1"),
    ] {
        let (_, err) = desk.run_expecting(&format!("{line} {wrong}"), 2);
        assert!(err.contains(rule), "{wrong}: {err}");
    }
    for (wrong, rule) in [
        ("circle --axis x", "a circle needs two axes"),
        ("circle --at x", "must be like x=400,y=300"),
        ("circle --at x=1,x=2", "--at x is given twice"),
        ("circle --range y=0:300 --radius 0", "--radius must be above 0"),
        ("circle --range y=0:300 --at x=30", "Give a smaller --radius, another centre"),
        ("sphere", "a sphere is probed with three axes"),
        ("sphere --range y=0:300,z=-200:0 --stylus 6", "--at x=MM"),
        ("sphere --range y=0:300,z=-200:0 --stylus 6 --at x=1,y=1,z=1", "give --ball"),
        (
            "sphere --range y=0:300,z=-200:0 --stylus 6 --at x=9,y=90,z=-90 --ball 20",
            "x would go to",
        ),
        (
            "sphere --range y=0:300,z=-200:0 --stylus 6 --at x=90,y=90,z=-90 --ball 20 --search 9",
            "too far",
        ),
        (
            "sphere --range y=0:300,z=-200:0 --stylus 6 --at x=90,y=90,z=-90 --ball 20 --angle c=0,30",
            "has no C",
        ),
        ("sphere --angle c=0,x", "must be like c=-60,0,60"),
        ("plate --balls 5", "must be like 5x5"),
        (
            "plate --range y=0:300,z=-200:0 --stylus 6 --at x=90,y=90,z=-90 --ball 20",
            "give --step-mm",
        ),
        (
            "plate --range y=0:300,z=-200:0 --stylus 6 --at x=90,y=90,z=-90 --ball 20 --step-mm 30",
            "the stylus needs",
        ),
        ("square --range y=0:300,z=-200:0 --stylus 6 --at x=90,y=90,z=-90", "give --size"),
        (
            "square --range y=0:300,z=-200:0 --stylus 6 --at x=90,y=90,z=-90 --size 300",
            "y would go to",
        ),
    ] {
        let (_, err) =
            desk.run_expecting(&format!("program {wrong} --machine m.toml --for linuxcnc -o w"), 2);
        assert!(err.contains(rule), "{wrong}: {err}");
    }
    assert!(!desk.path("w").exists(), "{:?}", desk.files("w"));
    let (json, _) =
        desk.run_expecting("--json program pitch --machine m.toml --for siemens -o p", 0);
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(json["programs"][0]["program"], "pitch_x.mpf");
}

/// A mill whose Z would plunge.
const MILL: &str = "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n[spindle.warmup]\nlag_s = 60.0\n\
    warm_s = 5400.0\nmax_um = 80.0\nexponent = 4.0\nrated_rpm = 24000.0\n[axis.x]\ntravel_mm = [0.0, 800.0]\n\
    [axis.y]\ntravel_mm = [-500.0, 0.0]\n[axis.z]\ntravel_mm = [-450.0, 0.0]\n";

#[test]
fn a_vertical_axis_moves_only_where_the_user_says() {
    let desk = Desk::new(&[("m.toml", MILL)]);
    for (kind, others) in [
        ("backlash", &["backlash_x.nc", "backlash_y.nc"][..]),
        ("pitch", &["pitch_x.nc", "pitch_y.nc"]),
        ("straightness", &["straightness_x.nc", "straightness_y.nc"]),
        ("axis-heat", &["axis_heat_x.nc", "axis_heat_y.nc"]),
        ("diagonal", &["diagonal_xy.nc"]),
    ] {
        let line = format!("program {kind} --machine m.toml --for fanuc -o {kind}");
        let (_, err) = desk.run_expecting(&line, 0);
        assert!(err.contains("give --range z=LOW:HIGH"), "{kind}: {err}");
        let mut written = desk.files(kind);
        written.retain(|name| name.ends_with(".nc"));
        assert_eq!(written, others, "{kind}");
        // Without any other there is none: exit 2.
        let (_, err) = desk.run_expecting(&format!("{line}-z --axis z"), 2);
        assert!(err.contains("give --range z=LOW:HIGH"), "{kind}: {err}");
        let (out, err) = desk.run_expecting(&format!("{line}-all --range z=-120:-20"), 0);
        assert!(out.contains("z -120 to -20 mm") || out.contains("z -115"), "{kind}: {out}");
        assert!(!err.contains("--range"), "{kind}: {err}");
    }
    // What stands in old scripts is a range as well.
    let (out, _) = desk.run_expecting(
        "program pitch --machine m.toml --for fanuc -o t --axis z --travel z=-90:-20",
        0,
    );
    assert!(out.contains("z -90 to -20 mm"), "{out}");
    let line = "program axis-heat --machine m.toml --for fanuc -o h --axis x --range-mm 100:700";
    let (out, _) = desk.run_expecting(line, 0);
    assert!(out.contains("x 100 to "), "{out}");
    // A dial that has to be gone round, by an axis that is named; a gauge at a spindle that turns.
    desk.run_expecting(
        "program backlash --machine m.toml --for linuxcnc -o c --axis x --clearance y=50",
        0,
    );
    let text = desk.text("c/backlash_x.ngc");
    assert!(text.contains("G53 G1 Y-225 F500\n") && !text.contains(" Z-"), "{text}");
    desk.run_expecting("program warmup --machine m.toml --for linuxcnc -o w", 0);
    for file in ["w/warmup.ngc", "w/warmup-off.csv"] {
        assert!(desk.text(file).contains("nothing may touch what turns"), "{file}");
    }
}

#[test]
fn compare_and_trend_report_what_has_worn() {
    let desk = Desk::new(&[("m.toml", MACHINE)]);
    desk.run_expecting("program backlash --machine m.toml --for linuxcnc -o out", 0);
    let template = desk.text("out/backlash-x.csv");
    std::fs::create_dir(desk.path("years")).expect("a new folder");
    for (date, width) in [("2024-03-01", 4.0), ("2025-03-01", 5.5), ("2026-03-01", 7.0)] {
        desk.write(&format!("years/mill-{date}.csv"), filled(&template, width));
    }
    let line = "compare years/mill-2024-03-01.csv years/mill-2026-03-01.csv --out c";
    let (out, _) = desk.run_expecting(line, 0);
    assert!(out.starts_with("they differ: backlash\n  Backlash has changed by +3.0"), "{out}");
    assert_eq!(desk.files("c"), ["comparison.json", "report.html"]);
    desk.run_expecting(&format!("{line} --limit-um 1"), 3);
    desk.run_expecting(&format!("{line} --limit-um 2"), 0);
    let (out, _) = desk.run_expecting("trend years --limit-um 1.5 --out t --today 2026-04-01", 0);
    assert!(out.contains("axis.x.backlash.width_um: changes by +1.50 ±"), "{out}");
    assert!(out.contains("measure again") && out.contains("2027-0"), "{out}");
    assert_eq!(desk.files("t"), ["report.html", "trend.json"]);
    let (out, _) = desk.run_expecting("trend years --limit-um 1.5 --today 2030-04-01", 0);
    assert!(out.contains("is overdue since 2027-0"), "{out}");
    let (_, err) = desk.run_expecting("trend years --today 2025-12-01", 2);
    assert!(err.contains("mill-2026-03-01.csv is of a day in the future"), "{err}");
    let (_, err) = desk.run_expecting("trend out", 2);
    assert!(err.contains("no date like 2026-11-22") && err.contains("no dated .csv"), "{err}");
}
