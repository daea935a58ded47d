//! Backlash that goes with the feed is distinguished from backlash that does not, with a width for each feed, and
//! what the feeds cost that are not corrected.

use std::path::Path;

use serde_json::Value;
use trueup_campaigns::hidden_effects::{HiddenCause, TestCase, draw_test_case};
use trueup_diagnose::{Diagnosis, diagnose, report::Finding};
use trueup_machine::{MachineFile, RunFile, machine_file::Quantity, predict::RunPredictor};

const CAUSE: &str = "feed-dependent-backlash";

fn answer(challenge: &TestCase) -> Diagnosis {
    let machine = MachineFile::parse(&challenge.machine, Path::new("m.toml")).expect("the twin's");
    let read = |text: &String| {
        RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the twin's")
    };
    let runs: Vec<RunFile> = challenge.runs.iter().map(read).collect();
    let holdout = [read(&challenge.holdout)];
    diagnose(&machine, &runs, &holdout, None, &mut |_, _| {}).expect("comparable")
}

fn finding<'d>(findings: &'d [Finding], cause: &str) -> Option<&'d Finding> {
    findings.iter().find(|finding| finding.cause == cause && finding.claimed)
}

fn numbers(value: &Value) -> Vec<f64> {
    let list = value.as_array().expect("a list");
    list.iter().map(|number| number.as_f64().expect("a number")).collect()
}

#[test]
fn each_feed_has_its_width_within_its_interval() {
    let (mut inside, mut all) = (0, 0);
    for seed in 0..3 {
        let challenge = draw_test_case(HiddenCause::FeedDependentBacklash, 3.0, seed);
        let diagnosis = answer(&challenge);
        let found = finding(&diagnosis.report.findings, CAUSE).expect("it is claimed");
        assert_eq!(found.column.as_deref(), Some("feed_mm_per_min"));
        let record = &found.parameters["width_um"];
        let hidden = &challenge.truth.effects[0].tables;
        assert_eq!(numbers(&record["value"]["feeds_mm_per_min"]), hidden[0].1);
        let intervals = record["ci95"].as_array().expect("an interval for each width");
        assert_eq!(intervals.len(), hidden[1].1.len());
        for (um, interval) in hidden[1].1.iter().zip(intervals) {
            let ends = numbers(interval);
            inside += usize::from((ends[0]..=ends[1]).contains(um));
            all += 1;
        }
    }
    println!("{inside} of {all} widths inside their 95 % intervals");
    // Of ten honest ones less than eight are inside once in a hundred times.
    assert!(all >= 6 && inside + 2 >= all, "{inside} of {all}");
}

#[test]
fn what_the_bridge_corrects_is_the_width_of_one_feed_and_the_others_cost_is_told() {
    let challenge = draw_test_case(HiddenCause::FeedDependentBacklash, 3.0, 1);
    let diagnosis = answer(&challenge);
    let report = &diagnosis.report;
    let after = &report.after;
    // It does not receive the feed: less is gained than is explained, but more than nothing.
    assert!(after.compensated_holdout_rms_um > 1.5 * after.holdout_rms_um, "{after:?}");
    assert!(after.compensated_holdout_rms_um < report.before.holdout_rms_um, "{after:?}");
    let evidence = finding(&report.findings, CAUSE).expect("it is claimed").evidence.join(" ");
    assert!(evidence.contains("The bridge does not receive the feed"), "{evidence}");
    // What stands in the extended file is what the board runs where the run says no feed.
    let text = diagnosis
        .render_extended_toml(&challenge.machine, Path::new("m.toml"))
        .expect("a machine file");
    assert!(text.contains("at_feed_mm_per_min"), "{text}");
    let extended = MachineFile::parse(&text, Path::new("extended.toml")).expect("a machine file");
    let silent = renamed(&challenge.holdout, "feed_mm_per_min", "note");
    let run = RunFile::from_reader(silent.as_bytes(), Path::new("r.csv")).expect("a run file");
    let index = Quantity::ALL.iter().position(|quantity| quantity.name() == challenge.quantity);
    let index = index.expect("one of all");
    let mut rows = 0;
    for row in RunPredictor::new(&extended, &run).expect("a prediction").predictions() {
        let bridge = row.bridge.expect("the board runs it").to_array()[index];
        let model = row.model.to_array()[index];
        assert!((model - bridge).abs() < 0.05, "{model} and {bridge}");
        rows += 1;
    }
    assert!(rows > 100, "{rows}");
}

#[test]
fn a_backlash_that_is_the_same_at_each_feed_keeps_its_simpler_name() {
    for seed in 0..2 {
        let mut challenge = draw_test_case(HiddenCause::Backlash, 3.0, seed);
        fast_and_slow_by_turns(&mut challenge);
        let report = answer(&challenge).report;
        assert!(finding(&report.findings, "backlash").is_some(), "{seed}: {:?}", report.findings);
        assert!(finding(&report.findings, CAUSE).is_none(), "{seed}: {:?}", report.findings);
    }
}

/// Returns the same run with another name for a column.
fn renamed(csv: &str, column: &str, name: &str) -> String {
    csv.replacen(column, name, 1)
}

/// Writes a feed into each row: 200 and 2000 mm/min, cycle by cycle.
fn fast_and_slow_by_turns(challenge: &mut TestCase) {
    for csv in challenge.runs.iter_mut().chain([&mut challenge.holdout]) {
        let mut lines = csv.lines();
        let header = lines.next().expect("a header");
        let run = header.split(',').position(|name| name == "run").expect("a number of the cycle");
        let mut text = format!("{header},feed_mm_per_min\n");
        for line in lines {
            let cycle = line.split(',').nth(run).and_then(|cell| cell.parse::<u32>().ok());
            let feed = if cycle.is_some_and(|cycle| cycle % 2 == 0) { 200 } else { 2000 };
            text.push_str(&format!("{line},{feed}\n"));
        }
        *csv = text;
    }
}
