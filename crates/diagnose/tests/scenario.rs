//! The shipped scenario of an axis that warms up, with a machine file that says nothing of its heat.

use std::{fmt::Write as _, path::Path};

use trueup_diagnose::diagnose;
use trueup_machine::{MachineFile, RunFile, file::Quantity};
use trueup_twin::{Scenario, simulate};

const SCENARIO: &str = include_str!("../../../data/scenario-axis.toml");
const MACHINE: &str = "[machine]\nname = \"an axis\"\nkind = \"3-axis\"\n";

#[test]
fn an_axis_that_warms_up_is_named_and_nothing_false_beside_it() {
    let scenario = Scenario::parse(SCENARIO, Path::new("axis.toml")).expect("it is shipped");
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("a machine file");
    let mut text = Vec::new();
    simulate(&scenario, 1, || {}).write_csv(&mut text).expect("a Vec takes all");
    let run = RunFile::from_reader(&text[..], Path::new("run.csv")).expect("a run file");
    let diagnosis = diagnose(&machine, &[run], &[], Some(Quantity::Dx), &mut |_, _| {})
        .expect("it can be compared");
    let report = &diagnosis.report;
    let mut said = String::new();
    for finding in &report.findings {
        writeln!(said, "{} claimed: {}", finding.cause, finding.claimed).expect("a String");
    }
    println!("{said}{}: {:.3} µm", report.verdict.name(), report.after.rms_um);
    // Also in truth there are a scale, an uneven screw and a backlash; the wave of 10 mm cannot be told
    // at 15 targets. What is set aside are the first readings after a start, when the thermometer
    // trails the screw: no cause says that.
    let is_true = |cause: &str| {
        ["axis-expansion", "pitch-scale", "pitch-error", "backlash", "outliers"].contains(&cause)
    };
    let claimed = report.findings.iter().filter(|finding| finding.claimed);
    assert!(claimed.clone().any(|finding| finding.cause == "axis-expansion"), "{said}");
    assert!(claimed.clone().all(|finding| is_true(&finding.cause)), "{said}");
    assert!(report.before.rms_um > 40.0 && report.after.rms_um < 0.6, "{:?}", report.after);
    let aside = report.findings.iter().find(|finding| finding.cause == "outliers");
    let aside = aside.and_then(|it| it.parameters["fraction"]["value"].as_f64()).unwrap_or(0.0);
    assert!(aside < 0.03, "{aside}");
}
