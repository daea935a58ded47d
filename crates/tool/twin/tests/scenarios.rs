//! The scenario file: what is refused, and where; and how fast it runs.

use std::{path::Path, time::Instant};

use trueup_twin::{Scenario, simulate};

const GOOD: &str = "name = \"s\"
measure = [\"elongation\"]
[spindle]
length_m = 0.5
[[segment]]
kind = \"spindle\"
duration_s = 60.0
";

fn complaint(text: &str) -> String {
    let bad = Scenario::parse(text, Path::new("s.toml")).expect_err(text);
    assert_eq!(bad.to_string().lines().count(), 1);
    bad.to_string()
}

#[test]
fn a_mistake_is_reported_with_its_line_its_column_and_the_rule() {
    for (wrong, right, expected) in [
        ("length_m = 0.5", "lenght_m = 0.5", "s.toml:4:1: unknown field `lenght_m`"),
        (
            "length_m = 0.5",
            "length_m = -0.5",
            "s.toml:4:1: spindle.length_m must be above 0, not -0.5",
        ),
        ("length_m = 0.5", "length_m = \"long\"", "s.toml:4:12: invalid type: string \"long\""),
        (
            "length_m = 0.5",
            "length_m = nan",
            "s.toml:4:12: spindle.length_m must be a finite number",
        ),
        (
            "duration_s = 60.0",
            "duration_s = 0.0",
            "s.toml:7:1: segment[0].duration_s must be above 0, not 0",
        ),
        ("duration_s = 60.0", "", "s.toml:5:1: segment[0].duration_s is missing in kind Spindle"),
        (
            "duration_s = 60.0",
            "duration_s = 6.0\ntargets = 4",
            "s.toml:8:1: segment[0].targets does not belong to kind Spindle",
        ),
        (
            "duration_s = 60.0",
            "duration_s = 1e9",
            "s.toml:1:1: repeat comes to 100000000 rows or ways, more than 5000000",
        ),
        ("kind = \"spindle\"", "kind = \"spin\"", "s.toml:6:8: unknown variant `spin`"),
        ("[spindle]", "[spindel]", "s.toml:3:2: unknown field `spindel`"),
        (
            "[\"elongation\"]",
            "[\"elongation\", \"elongation\"]",
            "s.toml:2:26: measure[1] is elongation a second time",
        ),
        (
            "[spindle]\nlength_m = 0.5\n",
            "",
            "s.toml:2:12: measure[0] is elongation, but there is no [spindle]",
        ),
        ("name = \"s\"", "name = \"s", "s.toml:1:"),
        ("[spindle]", "step_s = 0.0001\n[spindle]", "s.toml:3:1: step_s must be at least 0.001"),
        ("[spindle]", "repeat = 0\n[spindle]", "s.toml:3:1: repeat must be at least 1, not 0"),
        (
            "[spindle]",
            "[thermometer.bed]\nat = \"screw_x\"\n[spindle]",
            "s.toml:4:1: thermometer.bed.at needs [axis.x], which is missing",
        ),
    ] {
        let text = GOOD.replacen(wrong, right, 1);
        let there = complaint(&text);
        assert!(there.starts_with(expected), "{there}\nnot\n{expected}");
    }
}

#[test]
fn what_the_file_shows_is_in_the_run() {
    let scenario = Scenario::parse(GOOD, Path::new("s.toml")).expect("it is good");
    let mut rows = 0;
    let table = simulate(&scenario, 1, || rows += 1);
    assert_eq!((table.row_count(), rows), (7, 7));
    let names: Vec<&str> = table.column_names().collect();
    assert_eq!(names, ["time_s", "run", "spindle_rpm", "load_n", "measured_elongation_um"]);
}

/// In a release build well under 10 s: `cargo test --release -p trueup-twin --test scenarios`.
#[test]
fn a_hundred_thousand_rows_take_seconds() {
    let text = GOOD
        .replace("duration_s = 60.0", "duration_s = 1e6\nspindle_rpm = 12000")
        .replace("[spindle]", "[sensor]\n[thermometer.front]\nat = \"front\"\n[axis.x]\n[spindle]");
    let scenario = Scenario::parse(&text, Path::new("s.toml")).expect("it is good");
    let start = Instant::now();
    let csv = simulate(&scenario, 1, || {}).to_csv();
    let seconds = start.elapsed().as_secs_f64();
    println!("100001 rows in {seconds:.2} s");
    assert_eq!(csv.lines().count(), 100_002);
    assert!(seconds < 60.0);
}
