//! A hold-out measures what was found. A term that makes it worse is not handed out, and the answer says so.

use std::{fmt::Write as _, path::Path};

use trueup_diagnose::{Diagnosis, Provenance, Verdict, diagnose};
use trueup_machine::{InputFileError, MachineFile, RunFile};
use trueup_numerics::random::RandomGenerator;

const MACHINE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";

/// 300 rows: the load comes and goes and always bends the tool; `temp_a_c` rises, and moves it by
/// `um_per_c`.
fn run(um_per_c: f64, seed: u64, name: &str) -> RunFile {
    let mut noise = RandomGenerator::new(seed);
    let mut text = String::from("time_s,load_n,temp_a_c,measured_elongation_um\n");
    for row in 0..300 {
        let time_s = 10.0 * f64::from(row);
        let load_n = if (row / 17) % 2 == 0 { -400.0 } else { 400.0 };
        let warmer_c = 8.0 * (1.0 - (-time_s / 900.0).exp());
        let um = um_per_c * warmer_c - 0.02 * load_n + 0.3 * noise.normal();
        let _ = writeln!(text, "{time_s},{load_n},{:.3},{um:.4}", 20.0 + warmer_c);
    }
    read(&text, name)
}

fn read(text: &str, name: &str) -> RunFile {
    RunFile::from_reader(text.as_bytes(), Path::new(name)).expect("the test's own run")
}

/// `text` of a run without a column.
fn without(um_per_c: f64, column: &str) -> RunFile {
    let whole = run(um_per_c, 2, "h.csv");
    let kept: Vec<_> = whole.columns().iter().filter(|there| there.name != column).collect();
    let line = |cells: Vec<String>| cells.join(",") + "\n";
    let mut text = line(kept.iter().map(|column| column.name.clone()).collect());
    for row in 0..whole.row_count() {
        text += &line(kept.iter().map(|column| column.values[row].to_string()).collect());
    }
    read(&text, "h.csv")
}

fn diagnosed(runs: &[RunFile], holdout: &[RunFile]) -> Result<Diagnosis, InputFileError> {
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("the test's own file");
    diagnose(&machine, runs, holdout, None, &mut |_, _| {})
}

fn causes(diagnosis: &Diagnosis) -> Vec<&str> {
    diagnosis.terms.iter().map(|term| term.effect.name()).collect()
}

#[test]
fn what_makes_a_hold_out_worse_is_not_handed_out_and_what_does_not_is() {
    let holdout = [run(0.0, 2, "h.csv")];
    let diagnosis = diagnosed(&[run(1.5, 1, "r.csv")], &holdout).expect("comparable");
    let report = &diagnosis.report;
    println!("{:?}: {:?}", report.verdict, report.reasons);
    assert_eq!(report.verdict, Verdict::DoesNotTransfer);
    assert!(!report.verdict.is_resolved() && report.holdout_used);
    assert_eq!(causes(&diagnosis), ["cutting-load"]);
    assert_eq!(report.left_out.len(), 1);
    assert!(report.findings.iter().all(|finding| !finding.claimed), "judged beside what is not so");
    assert!(
        report
            .findings
            .iter()
            .any(|finding| finding.cause == "cutting-load" && finding.compensated)
    );
    let html = diagnosis.render_html("m", &Provenance::default(), &[]);
    assert!(html.contains("verdict bad\"") && html.contains("The hold-out has chosen"));
    assert!(html.contains("extra-heat-path temp_a_c: the hold-out becomes worse by it"));
    // The file that is handed out is predicted as any other, and is better than what was believed.
    let extended =
        diagnosis.render_extended_toml(MACHINE, Path::new("m.toml")).expect("a machine file");
    let extended = MachineFile::parse(&extended, Path::new("x.toml")).expect("it can be loaded");
    assert_eq!(extended.terms.len(), 1);
    assert!(report.after.compensated_holdout_rms_um < 0.5 * report.before.holdout_rms_um);
}

#[test]
fn the_zero_of_an_axis_is_no_error_of_the_runs_and_stands_in_a_hold_out() {
    let axis = |seed: u64, cycles: u32, um_per_m: f64| {
        let mut noise = RandomGenerator::new(seed);
        let mut text = String::from("run,x_mm,dir_x,measured_dx_um\n");
        for run in 0..cycles {
            for place in 0..10 {
                let x_mm = 50.0 * f64::from(place);
                let um = -193.0 + um_per_m * x_mm / 1000.0 + 0.3 * noise.normal();
                let _ = writeln!(text, "{run},{x_mm},1,{um:.3}");
            }
        }
        read(&text, "r.csv")
    };
    let clean = diagnosed(&[axis(1, 5, 0.0)], &[axis(2, 2, 0.0)]).expect("comparable").report;
    assert_eq!(clean.verdict, Verdict::Clean, "{:?}", clean.reasons);
    assert!(clean.before.rms_um < 0.5 && clean.after.rms_um < 0.5, "{:?}", clean.before);
    assert!((clean.before.holdout_rms_um - 193.0).abs() < 1.0);
    let found = diagnosed(&[axis(1, 5, 40.0)], &[]).expect("comparable").report;
    // A slope of 40 µm/m over 450 mm: 5.7 µm about its middle.
    assert!((found.before.rms_um - 5.75).abs() < 0.3, "{:?}", found.before);
    assert!(found.before.holdout_rms_um < 8.0 && found.after.holdout_rms_um < 0.6);
}

#[test]
fn the_machine_file_stays_where_nothing_that_was_found_holds() {
    // Nothing but noise, but for what the runs had.
    let mut text = String::from("time_s,load_n,temp_a_c,measured_elongation_um\n");
    let mut noise = RandomGenerator::new(7);
    for row in 0..300 {
        let load_n = if (row / 17) % 2 == 0 { -400.0 } else { 400.0 };
        let warm_c = 28.0 - 0.02 * f64::from(row);
        let _ = writeln!(text, "{},{load_n},{warm_c:.3},{:.4}", 10 * row, 0.3 * noise.normal());
    }
    let holdout = [read(&text, "h.csv")];
    let diagnosis = diagnosed(&[run(1.5, 1, "r.csv")], &holdout).expect("comparable");
    let report = &diagnosis.report;
    assert_eq!(report.verdict, Verdict::DoesNotTransfer);
    assert!(diagnosis.terms.is_empty() && diagnosis.corrected.is_empty());
    assert_eq!(report.after.holdout_rms_um, report.before.holdout_rms_um);
    // The cool-down is what the runs never had.
    assert!(
        report.reasons.iter().any(|why| why.contains("temp_a_c falls")),
        "{:?}",
        report.reasons
    );
}

#[test]
fn what_holds_is_explained_and_the_hold_out_has_chosen_nothing() {
    let diagnosis =
        diagnosed(&[run(1.5, 1, "r.csv")], &[run(1.5, 2, "h.csv")]).expect("comparable");
    let report = &diagnosis.report;
    assert_eq!(report.verdict, Verdict::Explained, "{:?}", report.reasons);
    assert!(!report.holdout_used && report.left_out.is_empty() && report.notes.is_empty());
}

#[test]
fn a_hold_out_without_a_column_that_a_term_needs_is_an_error_with_its_place() {
    let wrong =
        diagnosed(&[run(1.5, 1, "r.csv")], &[without(1.5, "temp_a_c")]).expect_err("no column");
    let text = wrong.to_string();
    println!("{text}");
    assert!(text.starts_with("h.csv:1:1: column temp_a_c is missing"), "{text}");
    assert!(text.ends_with("the term extra-heat-path needs it"), "{text}");
    // What no term needs may be missing.
    let runs = [run(0.0, 1, "r.csv")];
    assert!(diagnosed(&runs, &[without(0.0, "temp_a_c")]).is_ok());
}

#[test]
fn a_hold_out_that_is_one_of_the_runs_is_told_whatever_its_name() {
    let runs = [run(1.5, 1, "r.csv"), run(1.5, 3, "s.csv")];
    let diagnosis = diagnosed(&runs, &[run(1.5, 3, "copy.csv")]).expect("comparable");
    let notes = &diagnosis.report.notes;
    assert!(notes.len() == 1 && notes[0].starts_with("copy.csv: every row"), "{notes:?}");
}

/// One reading of sixty that is a hundred times the noise off says nothing of the others: they are named, and the promise stays.
#[test]
fn a_gross_reading_of_a_hold_out_that_gains_less_than_promised_is_named() {
    let axis = |seed: u64, cycles: u32, gross_um: f64| {
        let mut noise = RandomGenerator::new(seed);
        let mut text = String::from("run,x_mm,dir_x,measured_dx_um\n");
        for run in 0..cycles {
            for place in 0..20 {
                let x_mm = 25.0 * f64::from(place);
                let off_um = if (run, place) == (1, 7) { gross_um } else { 0.0 };
                // The place of the gross reading, or one that the runs do not have.
                let x_mm = if off_um < 0.0 { 900.0 } else { x_mm };
                let um = 12.0 * (x_mm / 90.0).sin() + 0.3 * noise.normal() + off_um;
                let _ = writeln!(text, "{run},{x_mm},1,{um:.3}");
            }
        }
        read(&text, if cycles > 3 { "r.csv" } else { "h.csv" })
    };
    let notes = |gross_um: f64| {
        let answer = diagnosed(&[axis(1, 5, 0.0)], &[axis(2, 3, gross_um)]).expect("comparable");
        let report = answer.report;
        println!("{:?} {:?} {:?}", report.verdict, report.after, report.notes);
        assert_eq!(report.verdict, Verdict::Explained);
        report.notes.into_iter().filter(|note| note.contains("promised")).collect::<Vec<_>>()
    };
    assert_eq!(notes(0.0), Vec::<String>::new());
    let gross = notes(60.0);
    assert_eq!(gross.len(), 1);
    assert!(gross[0].contains("Without row 28 of h.csv (+"), "{gross:?}");
    assert!(gross[0].contains("Measure there again"), "{gross:?}");
    let outside = notes(-60.0);
    assert!(
        outside[0].contains("x_mm reaches 900.00; in the runs 475.00 was the most"),
        "{outside:?}"
    );
    assert!(!outside[0].contains("Measure there again"), "{outside:?}");
}
