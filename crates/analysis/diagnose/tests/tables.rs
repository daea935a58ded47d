//! Tables that were measured several times: what `diagnose` says of axes that strangers have measured.
//! Where the data are missing a test says so and does nothing.
//!
//! `cargo test -p trueup-diagnose --test tables -- --show-output` prints the figures.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{borrow::Cow, path::Path};

use trueup_diagnose::{Diagnosis, Verdict, diagnose};
use trueup_fit::pitch;
use trueup_machine::{
    MachineFile, RunFile, applied_offsets::UncompensatedRun, machine_file::LinearAxis,
};
use trueup_measured_data::find_measured_file as data;
use trueup_numerics::random::RandomGenerator;

const MACHINE: &str = "[machine]\nname = \"stage\"\nkind = \"3-axis\"\n";

fn run(name: &str) -> Option<RunFile> {
    data(name).map(|path| RunFile::read(&path).expect("a run file"))
}

/// Returns the answer to a run of the data, and to a hold-out of them if one is named.
fn diagnosed(name: &str, holdout: Option<&str>) -> Option<Diagnosis> {
    let runs = [run(name)?];
    let holdout: Vec<RunFile> = match holdout {
        Some(name) => vec![run(name)?],
        None => Vec::new(),
    };
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("the test's own file");
    let diagnosis = diagnose(&machine, &runs, &holdout, None, &mut |_, _| {}).expect("comparable");
    let report = &diagnosis.report;
    println!(
        "{name}: {}, not fitted to {:.2} -> {:.2} µm, handed out {:.2}",
        report.verdict.name(),
        report.before.holdout_rms_um,
        report.after.holdout_rms_um,
        report.after.compensated_holdout_rms_um
    );
    for finding in &report.findings {
        println!("  {} claimed {}: {:?}", finding.cause, finding.claimed, finding.evidence);
        println!("    {}", finding.next_test);
    }
    println!("  {:?}", report.reasons);
    Some(diagnosis)
}

/// A table is claimed and handed out, and leaves at most this much.
fn has_table(diagnosis: &Diagnosis, most_um: f64) {
    let report = &diagnosis.report;
    let table = report.findings.iter().find(|finding| finding.cause == "pitch-error");
    assert!(table.is_some_and(|table| table.claimed && table.compensated), "{:?}", report.findings);
    let left_um = report.after.compensated_holdout_rms_um;
    assert!(left_um <= most_um, "{left_um}");
    assert!(report.findings.iter().all(|finding| finding.cause != "pitch-periodic"));
}

#[test]
fn a_gross_reading_in_three_cycles_does_not_stand_in_the_way_of_a_table() {
    let mcu = ["strangers/mcu1025/train.csv", "strangers/mcu1025/test.csv"];
    let Some(diagnosis) = diagnosed(mcu[0], Some(mcu[1])) else { return };
    has_table(&diagnosis, 5.0);
    let report = &diagnosis.report;
    assert!(matches!(report.verdict, Verdict::Explained | Verdict::PartlyExplained));
    assert!(report.findings.iter().any(|finding| finding.cause == "outliers"));
}

#[test]
fn a_table_each_way_is_found_though_it_has_a_value_for_three_rows() {
    let muts = ["strangers/muts_z/train.csv", "strangers/muts_z/test.csv"];
    let Some(diagnosis) = diagnosed(muts[0], Some(muts[1])) else { return };
    has_table(&diagnosis, 7.6);
    assert_eq!(diagnosis.report.verdict, Verdict::Explained);
}

#[test]
fn there_and_back_once_is_a_table_for_both_ways_and_one_way_alone_is_none() {
    for name in ["11358", "11359"] {
        let name = format!("strangers/slits/{name}_axis1_both.csv");
        let Some(diagnosis) = diagnosed(&name, None) else { return };
        has_table(&diagnosis, 7.0);
    }
    let Some(diagnosis) = diagnosed("strangers/slits/11358_axis1_fwd.csv", None) else { return };
    assert!(diagnosis.report.findings.is_empty());
}

#[test]
fn between_nine_targets_a_table_is_doubted_and_the_positions_that_decide_are_listed() {
    let (train, test) = ("strangers/b02_x/train.csv", "strangers/b02_x/test.csv");
    let Some(diagnosis) = diagnosed(train, Some(test)) else { return };
    has_table(&diagnosis, 5.5);
    let report = &diagnosis.report;
    assert_eq!(report.verdict, Verdict::PartlyExplained);
    let table =
        report.findings.iter().find(|finding| finding.cause == "pitch-error").expect("has_table");
    assert!(table.evidence.iter().any(|sentence| sentence.contains("between them it is doubted")));
    assert!(table.next_test.contains("x_mm = -"), "{}", table.next_test);
    let Some(diagnosis) = diagnosed(train, Some("strangers/b02_x/continuous.csv")) else { return };
    let report = &diagnosis.report;
    assert!(report.after.compensated_holdout_rms_um <= report.before.holdout_rms_um);
}

#[test]
fn what_does_not_repeat_is_still_refused() {
    let Some(diagnosis) = diagnosed("ess_iso230/muts_x.csv", None) else { return };
    assert_eq!(diagnosis.report.verdict, Verdict::DoNotCompensate);
    assert!(diagnosis.terms.iter().all(|term| !term.effect.is_compensable()));
    for (name, most_um) in [("x", 4.8), ("z", 1.2)] {
        let Some(diagnosis) = diagnosed(&format!("ess_iso230/{name}.csv"), None) else { return };
        has_table(&diagnosis, most_um);
    }
}

/// Of one pass `fit pitch` takes over the table that it is asked for, with its repeatability unknown; `diagnose`, which is
/// asked what is wrong, does not believe it.
#[test]
fn one_pass_is_taken_over_and_not_believed() {
    for name in ["fwd", "bwd"] {
        let Some(run) = run(&format!("strangers/slits/11358_axis1_{name}.csv")) else { return };
        assert_eq!(answers(&run, LinearAxis::X), [true, false], "{name}");
    }
}

/// Returns whether `trueup fit pitch` writes a table, and whether `diagnose` hands out something that goes with
/// the axis's own position.
fn answers(run: &RunFile, axis: LinearAxis) -> [bool; 2] {
    let (unaided, _) =
        UncompensatedRun::from_run(Cow::Borrowed(run), None, None).expect("no bridge");
    let fit = pitch::fit(&unaided, axis, &pitch::PitchFitOptions::default())
        .expect("a table of readings");
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("the test's own file");
    let runs = std::slice::from_ref(run);
    let diagnosis = diagnose(&machine, runs, &[], None, &mut |_, _| {}).expect("comparable");
    let mut terms = diagnosis.terms.iter();
    [fit.report.verdict.is_usable(), terms.any(|term| term.effect.depends_on_own_axis_only())]
}

#[test]
fn fit_pitch_and_diagnose_correct_the_same_measured_axes() {
    for (name, axis, corrected) in [
        ("ess_iso230/x.csv", LinearAxis::X, true),
        ("ess_iso230/z.csv", LinearAxis::X, true),
        ("ess_iso230/muts_x.csv", LinearAxis::X, false),
        ("ess_slits/accuracy_axis1.csv", LinearAxis::X, true),
        ("ess_slits/repeatability_axis1.csv", LinearAxis::X, true),
        ("strangers/b02_x/train.csv", LinearAxis::X, true),
        ("strangers/mcu1025/train.csv", LinearAxis::X, true),
        ("strangers/muts_z/train.csv", LinearAxis::Z, true),
        ("strangers/slits/11358_axis1_both.csv", LinearAxis::X, true),
        ("strangers/slits/11359_axis1_both.csv", LinearAxis::X, true),
    ] {
        let Some(run) = run(name) else { return };
        let answers = answers(&run, axis);
        println!("{name}: fit pitch {}, diagnose {}", answers[0], answers[1]);
        assert_eq!(answers, [corrected; 2], "{name}");
    }
}

#[test]
fn fit_pitch_and_diagnose_correct_the_same_drawn_axes() {
    let mut dice = RandomGenerator::new(14);
    let (mut corrected, mut apart) = (0, Vec::new());
    for draw in 0..120 {
        let (targets, cycles) = (5 + dice.uniform_index(6), 2 + dice.uniform_index(4));
        let has_both_ways = dice.uniform_index(3) > 0;
        // Next to a noise of 1 µm.
        let size_um = [0.0, 0.3, 1.0, 3.0, 10.0][dice.uniform_index(5)];
        let error: Vec<[f64; 2]> =
            (0..targets).map(|_| [0, 1].map(|_| size_um * dice.normal())).collect();
        let is_each_way = dice.uniform_index(2) == 0;
        let mut text = String::from("run,x_mm,dir_x,measured_dx_um\n");
        for cycle in 1..=cycles {
            for way in 0..1 + usize::from(has_both_ways) {
                for n in 0..targets {
                    let (at, sign) = if way == 0 { (n, 1) } else { (targets - 1 - n, -1) };
                    let um = error[at][if is_each_way { way } else { 0 }] + dice.normal();
                    text += &format!("{cycle},{},{sign},{um:.3}\n", 12 * at);
                }
            }
        }
        let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file");
        let [fit, diagnosed] = answers(&run, LinearAxis::X);
        corrected += usize::from(fit);
        if fit != diagnosed {
            apart.push((draw, size_um, targets, cycles, has_both_ways, fit, diagnosed));
        }
    }
    println!("{corrected} of 120 corrected; apart: {apart:?}");
    assert!(corrected > 40 && apart.is_empty(), "{apart:?}");
}
