//! The rules that a run must keep to be fitted: every broken rule is named with its line and column.

use crate::pitch_support::run_of;
use trueup_fit::pitch::{PitchFitOptions, TableMode, fit, fit_backlash};
use trueup_machine::machine_file::LinearAxis;

fn error(text: &str, ways: TableMode) -> String {
    let options = PitchFitOptions { ways, ..PitchFitOptions::default() };
    fit(&run_of(text), LinearAxis::X, &options).expect_err("a rule is broken").to_string()
}

#[test]
fn a_broken_rule_is_named_with_its_place() {
    const HEAD: &str = "run,x_mm,dir_x,measured_dx_um\n";
    for (rows, place, rule) in [
        ("1,0,1,2\n1,5,1,3\n1,5,1,3\n", "r.csv:4:3:", "5 is measured twice in run 1"),
        ("1,0,1,2\n1,10,1,3\n1,5,1,3\n", "r.csv:4:3:", "5 follows 10 though dir_x is 1"),
        ("1,10,-1,2\n1,0,-1,3\n1,5,-1,3\n", "r.csv:4:3:", "5 follows 0 though dir_x is -1"),
        ("1,5,1,2\n2,5,1,3\n", "r.csv:2:3:", "5 is the only position"),
    ] {
        let error = error(&format!("{HEAD}{rows}"), TableMode::Automatic);
        assert!(error.starts_with(place) && error.contains(rule), "{rows:?}: {error}");
    }
}

#[test]
fn a_missing_or_foreign_column_is_named() {
    for (text, rule) in [
        ("x_mm,measured_dx_um\n0,1\n5,2\n0,1\n", "column dir_x is missing"),
        ("dir_x,measured_dx_um\n1,1\n", "column x_mm is missing"),
        ("x_mm,dir_x\n0,1\n", "column measured_dx_um is missing"),
        ("x_um,dir_x,measured_dx_um\n0,1,1\n", "x_um is in another unit: it must be given in mm"),
        ("x_mm,dir_x,measured_dx_mm\n0,1,1\n", "measured_dx_mm is in another unit"),
        ("x_mm,x_in,dir_x,measured_dx_um\n0,0,1,1\n", "mixed units: there are both x_mm and x_in"),
    ] {
        let error = error(text, TableMode::Automatic);
        assert!(error.starts_with("r.csv:1:1:") && error.contains(rule), "{text:?}: {error}");
    }
}

#[test]
fn a_direction_that_is_asked_for_must_be_measured() {
    let text = "x_mm,dir_x,measured_dx_um\n0,1,1\n5,1,2\n0,1,1\n5,1,2\n";
    let error = error(text, TableMode::Both);
    assert!(error.starts_with("r.csv:2:3:") && error.contains("dir_x is never -1"), "{error}");
    let error = fit_backlash(&run_of(text), LinearAxis::X, &PitchFitOptions::default())
        .expect_err("one side only")
        .to_string();
    assert!(error.contains("dir_x is never -1: backlash needs"), "{error}");
}

#[test]
fn swapped_rows_without_run_numbers_are_found() {
    let error = error(
        "x_mm,dir_x,measured_dx_um\n0,1,1\n15,1,2\n10,1,2\n20,1,1\n30,1,1\n",
        TableMode::Automatic,
    );
    assert!(error.starts_with("r.csv:4:1:") && error.contains("10 follows 15"), "{error}");
}

#[test]
fn rows_of_another_axis_are_passed_over() {
    let text = "run,x_mm,y_mm,dir_x,measured_dx_um,measured_dy_um\n\
                1,0,0,1,1,\n1,5,0,1,2,\n1,,7,,,3\n2,0,0,1,1,\n2,5,0,1,2,\n2,,7,,,3\n";
    let report =
        fit(&run_of(text), LinearAxis::X, &PitchFitOptions::default()).expect("x is whole").report;
    assert_eq!((report.rows_used, report.rows_incomplete), (4, 2));
}

#[test]
fn a_list_that_is_sorted_by_position_is_read() {
    let text = "x_mm,dir_x,measured_dx_um\n0,1,1\n5,1,9\n9,1,-4\n0,-1,1.1\n5,-1,9.1\n9,-1,-4.2\n";
    let fit = fit(&run_of(text), LinearAxis::X, &PitchFitOptions::default()).expect("readable");
    assert!(fit.pitch.is_some());
}

#[test]
fn a_row_with_an_empty_cell_is_omitted_and_counted() {
    let text = "run,x_mm,dir_x,measured_dx_um\n1,0,1,1\n1,5,1,\n1,,1,2\n1,10,1,2\n1,15,nan,2\n,20,1,2\n\
                2,0,1,1\n2,5,1,4\n2,10,1,2\n";
    let report =
        fit(&run_of(text), LinearAxis::X, &PitchFitOptions::default()).expect("readable").report;
    assert_eq!((report.rows_used, report.rows_incomplete), (5, 4));
}

#[test]
fn runs_that_are_not_there_cannot_be_selected() {
    let text = "run,x_mm,dir_x,measured_dx_um\n1,0,1,1\n1,5,1,2\n";
    let options = PitchFitOptions { runs: Some(vec![7.0]), ..PitchFitOptions::default() };
    let error = fit(&run_of(text), LinearAxis::X, &options).expect_err("no run 7").to_string();
    assert!(error.contains("no row of the selected runs"), "{error}");
}
