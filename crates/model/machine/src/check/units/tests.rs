use std::path::Path;

use super::*;
use crate::MachineFile;

const MACHINE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"temperature\"\n\
                       [spindle.temperature]\nsensor = \"temp_nose_c\"\nreference_c = 20.0\nk_um_per_c = 2.0\n";

/// Returns a spindle that is driven for two hours in each three, a row each `every_s`: time, temperature, speed,
/// growth.
fn spindle(every_s: f64, rows: usize) -> Vec<[f64; 4]> {
    let (mut nose, mut growth) = (0.0, 0.0);
    let row = |number: usize| {
        let time_s = every_s * number as f64;
        let rpm = if time_s % 10_800.0 < 7_200.0 { 9000.0 } else { 0.0 };
        nose += (rpm / 600.0 - nose) * (1.0 - (-every_s / 1_500.0).exp());
        growth += (2.2 * nose - growth) * (1.0 - (-every_s / 700.0).exp());
        [time_s, 19.0 + nose, rpm, growth]
    };
    (0..rows).map(row).collect()
}

/// Returns what is found in these rows once `change` has written them in another unit.
fn found(
    rows: &[[f64; 4]],
    change: impl Fn([f64; 4]) -> [f64; 4],
) -> Vec<(String, Plausibility, String)> {
    let mut text = String::from("time_s,temp_nose_c,spindle_rpm,measured_elongation_um\n");
    for row in rows {
        let [time_s, nose, rpm, um] = change(*row);
        text += &format!("{time_s:.4},{nose:.2},{rpm},{um:.7}\n");
    }
    let run =
        RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own run");
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("the test's own file");
    let findings = findings(&run, Some(&machine), &[]).into_iter();
    findings.map(|finding| (finding.key, finding.grade, finding.warning.what)).collect()
}

#[test]
fn each_wrong_unit_is_reported_with_the_unit() {
    use Plausibility::{Impossible, Unlikely};
    let rows = spindle(30.0, 400);
    assert_eq!(found(&rows, |row| row), []);
    type Slip = fn([f64; 4]) -> [f64; 4];
    let slips: [(&str, Plausibility, &str, Slip); 9] = [
        ("temp_nose_c", Unlikely, "°F", |[s, c, n, um]| [s, 32.0 + 1.8 * c, n, um]),
        ("temp_nose_c", Impossible, "kelvin", |[s, c, n, um]| [s, c + 273.15, n, um]),
        ("temp_nose_c", Impossible, "tenths", |[s, c, n, um]| [s, (10.0 * c).round(), n, um]),
        ("temp_nose_c", Impossible, "no thermometer", |[s, c, n, um]| [s, 100.0 * c, n, um]),
        ("time_s", Unlikely, "ms, not s", |[s, c, n, um]| [1e3 * s, c, n, um]),
        ("time_s", Impossible, "milliseconds of Unix", |[s, c, n, um]| {
            [1.78e12 + 1e3 * s, c, n, um]
        }),
        ("time_s", Unlikely, "minutes", |[s, c, n, um]| [s / 60.0, c, n, um]),
        ("measured_elongation_um", Unlikely, "mm or inches", |[s, c, n, um]| [s, c, n, um / 1e3]),
        ("spindle_rpm", Unlikely, "1000 r/min", |[s, c, n, um]| [s, c, n / 1e3, um]),
    ];
    for (column, grade, unit, typo) in slips {
        let found = found(&rows, typo);
        let is_it = |entry: &&(String, Plausibility, String)| {
            entry.0 == column && entry.1 == grade && entry.2.contains(unit)
        };
        assert_eq!(found.iter().filter(is_it).count(), 1, "{column} {unit}: {found:?}");
        assert_eq!(found.len(), 1, "and nothing else: {found:?}");
    }
}

#[test]
fn what_is_rare_and_right_is_not_refused() {
    let is_refused = |text: &str| {
        let run =
            RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own run");
        let machine =
            MachineFile::parse(MACHINE, Path::new("m.toml")).expect("the test's own file");
        findings(&run, Some(&machine), &[])
            .iter()
            .any(|finding| finding.grade == Plausibility::Impossible)
    };
    let rows = |row: &dyn Fn(usize) -> String| (0..300).map(row).collect::<String>();
    // A furnace next to the machine.
    let furnace =
        rows(&|row| format!("{},{},{}\n", 20 * row, 21.0 + row as f64 * 0.01, 640 + row % 3));
    assert!(!is_refused(&format!("time_s,temp_nose_c,temp_furnace_c\n{furnace}")));
    // A spindle that was hot already, and a record of 300 days.
    let hot = rows(&|row| format!("{},{}\n", 86_400 * row, 74.0 + (row % 7) as f64));
    assert!(!is_refused(&format!("time_s,temp_nose_c\n{hot}")));
    // A gauge that was not set to zero.
    let gauge = rows(&|row| format!("{},21.5,{}\n", 20 * row, 45_000 + row % 9));
    assert!(!is_refused(&format!("time_s,temp_nose_c,measured_elongation_um\n{gauge}")));
    // The same day after day for weeks, a row an hour: nothing is even doubted.
    let day = |hour: usize| (hour as f64 / 24.0 * std::f64::consts::TAU).sin();
    let weeks =
        rows(&|row| format!("{},{:.2},{:.2}\n", 3600 * row, 22.0 + 3.0 * day(row), 6.0 * day(row)));
    let text = format!("time_s,temp_nose_c,measured_elongation_um\n{weeks}");
    let run =
        RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own run");
    assert_eq!(findings(&run, None, &[]), []);
}

/// A bearing that is at 52 °C from the first row on, next to a bed at 22 °C: in °F it would be at 11 °C.
#[test]
fn what_is_warm_from_the_start_next_to_others_is_no_fahrenheit() {
    let finding_at = |bed_c: f64| {
        let rows = (0..60)
            .map(|row| format!("{},{:.2},{bed_c}\n", 60 * row, 52.0 + 0.01 * f64::from(row)));
        let text = format!("time_s,temp_nose_c,temp_bed_c\n{}", rows.collect::<String>());
        let run =
            RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own run");
        let machine =
            MachineFile::parse(MACHINE, Path::new("m.toml")).expect("the test's own file");
        findings(&run, Some(&machine), &[])
            .iter()
            .any(|finding| finding.warning.what.contains("°F"))
    };
    assert!(!finding_at(22.0));
    assert!(finding_at(12.0), "as cold as it would be in °C");
    assert!(finding_at(55.0), "all of them may be in °F");
}

/// The hot end of a rod, next to the record of its cold end; alone, and next to a record that may be in °F as well, it
/// is asked.
#[test]
fn a_run_that_goes_on_where_another_ends_is_in_its_unit() {
    let record_by = |from_c: f64, step_c: f64| {
        let at = |row| from_c + step_c * f64::from(row);
        let rows = (0..60).map(|row| format!("{},{:.2},0\n", 60 * row, at(row)));
        let text =
            format!("time_s,temp_nose_c,measured_elongation_um\n{}", rows.collect::<String>());
        RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own run")
    };
    let record = |from_c: f64| record_by(from_c, 0.2);
    let hot = record(52.0);
    let is_requested = |others: &[RunFile]| {
        findings(&hot, None, others).iter().any(|finding| finding.warning.what.contains("°F"))
    };
    assert!(is_requested(&[]) && is_requested(&[record(52.0)]));
    assert!(!is_requested(&[record(52.0), record(38.0)]), "38 to 49.8 °C, then 52");
    assert!(is_requested(&[record(20.0)]), "20 to 31.8 °C does not reach 52");
    let wide = |from_c: f64| record_by(from_c, 1.0);
    assert!(is_requested(&[wide(11.0)]), "52 °F are 11.1 °C, where a run to 70 °C began");
    assert!(!is_requested(&[wide(20.0)]), "52 °F are 11.1 °C, and the other began at 20");
}
