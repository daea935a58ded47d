//! The pitch fit on measured axes: the set `ess_iso230`, five runs of ISO 230-2 each, fitted
//! on some runs and tested on the others as `trueup predict` would correct them.
//!
//! `cargo test -p trueup-fit --test fit pitch_real -- --show-output` prints the figures.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use crate::pitch_support::{left_by_model, rms, unaided};
use trueup_fit::{
    FitVerdict,
    pitch::{PitchFitOptions, TableMode, fit, fit_backlash},
};
use trueup_machine::{
    RunFile,
    applied_offsets::UncompensatedRun,
    machine_file::{LinearAxis, writer::MachineFileEdit},
};

/// Returns the run of this name, `None` (and a line that says so) where the data are not there.
fn measured(name: &str) -> Option<UncompensatedRun<'static>> {
    let path = trueup_measured_data::find_measured_file(&format!("ess_iso230/{name}"))?;
    Some(unaided(RunFile::read(&path).expect("the data are a run file")))
}

fn first_three(ways: TableMode) -> PitchFitOptions {
    PitchFitOptions { ways, runs: Some(vec![1.0, 2.0, 3.0]), ..PitchFitOptions::default() }
}

/// Returns the rms on runs 4 and 5 after a fit on 1 to 3.
fn tested(run: &UncompensatedRun<'_>, name: &str, ways: TableMode) -> f64 {
    let fit = fit(run, LinearAxis::X, &first_three(ways)).expect("the run can be fitted");
    assert!(fit.report.verdict.is_usable(), "{name}: {:?}", fit.report.verdict);
    let left = left_by_model(run, &fit.report.edit, &[4.0, 5.0]);
    let before = left_by_model(run, &MachineFileEdit::default(), &[4.0, 5.0]);
    let largest = left.iter().fold(0.0_f64, |largest, um| largest.max(um.abs()));
    let um = rms(&left);
    println!(
        "{name}, {ways:?}: runs 4-5 from {:.2} to {um:.3} µm rms, {largest:.2} µm at most; left out of 1-3 {:.3}; \
         reverse table {}, width {:?}",
        rms(&before),
        fit.report.held_out.expect("three runs").rms_um,
        fit.pitch.is_some_and(|pitch| pitch.reverse_um.is_some()),
        fit.backlash.map(|backlash| backlash.width_um),
    );
    um
}

#[test]
fn runs_that_were_not_fitted_are_corrected_to_the_repeatability_of_the_axis() {
    for (name, expected_um) in [("x.csv", 5.3), ("z.csv", 1.25)] {
        let Some(run) = measured(name) else { return };
        for ways in [TableMode::Automatic, TableMode::One, TableMode::Both] {
            let um = tested(&run, name, ways);
            assert!(um <= expected_um, "{name} {ways:?}: {um}");
        }
    }
}

#[test]
fn an_axis_that_does_not_repeat_is_refused_with_its_figures() {
    let Some(run) = measured("muts_x.csv") else { return };
    for options in [first_three(TableMode::Automatic), PitchFitOptions::default()] {
        let fit = fit(&run, LinearAxis::X, &options).expect("the run can be read");
        let FitVerdict::DoNotCompensate(reasons) = &fit.report.verdict else {
            panic!("compensated: {:?}", fit.report)
        };
        for reason in reasons {
            println!("muts_x: {reason}");
        }
        assert!(reasons.len() >= 2 && fit.pitch.is_none() && fit.report.edit.is_empty());
        assert!(fit.iso230.is_some());
        let lash = fit_backlash(&run, LinearAxis::X, &options).expect("the run can be read");
        println!("muts_x backlash: {:?}", lash.report.verdict);
        assert!(lash.backlash.is_none());
    }
}

#[test]
fn a_control_that_over_compensates_has_a_negative_backlash() {
    let Some(run) = measured("x.csv") else { return };
    let fit =
        fit_backlash(&run, LinearAxis::X, &PitchFitOptions::default()).expect("it can be read");
    let width_um = fit.backlash.expect("it repeats").width_um;
    let facts: Vec<_> = fit.report.facts.iter().map(|fact| (&fact.name, &fact.value)).collect();
    println!("x: {:?} {:?} {facts:?}", fit.report.parameters, fit.report.held_out);
    println!("{}", fit.report.warnings.join("\n"));
    assert!((width_um + 25.0).abs() < 1.0, "{width_um}");
    assert!(fit.depends_on_position);
    let Some(run) = measured("z.csv") else { return };
    let fit =
        fit_backlash(&run, LinearAxis::X, &PitchFitOptions::default()).expect("it can be read");
    println!("z: {:?} depends on position: {}", fit.report.parameters, fit.depends_on_position);
    assert!(fit.backlash.expect("it repeats").width_um < 0.0);
}

#[test]
fn the_figures_of_the_standard_are_printed() {
    for name in ["x.csv", "z.csv", "muts_x.csv"] {
        let Some(run) = measured(name) else { return };
        let fit = fit(&run, LinearAxis::X, &PitchFitOptions::default()).expect("it can be read");
        let iso230 = fit.iso230.expect("five runs both ways");
        println!(
            "{name}\n{iso230}\n{}\n{}",
            fit.report.warnings.join("\n"),
            fit.report.edit.to_toml()
        );
        let both = iso230.both.expect("both ways");
        assert!(both.accuracy_um >= both.systematic_um && both.systematic_um >= both.mean_error_um);
        assert!(both.repeatability_um >= both.reversal_um);
        assert_eq!(iso230.fewest_runs, 5);
    }
}
