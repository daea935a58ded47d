//! `fit warmup`: known truth, the way through a machine file, bad input.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use crate::support::{
    MACHINE, Noise, applied, assert_holds, assert_round_trip, machine, parse, predicted_rms, run,
};
use trueup_fit::{FitReport, FitVerdict, warmup};
use trueup_machine::{
    applied_offsets::UncompensatedRun,
    machine_file::{ElongationSource, Warmup},
    model::{WarmupState, warmup_elongation_um},
};

const TRUTH: Warmup = Warmup {
    lag_s: 60.0,
    warm_s: 5400.0,
    max_um: 80.0,
    exponent: 4.0,
    cool_s: None,
    rated_rpm: None,
    speed_exponent: 0.0,
};

/// Returns a recorded warm-up of `truth`: a row every `interval_s`, at the speeds of `rpm` by time.
fn recorded(
    truth: &Warmup,
    interval_s: f64,
    rows: usize,
    rpm: impl Fn(f64) -> f64,
    noise_um: f64,
    seed: u64,
) -> UncompensatedRun<'static> {
    let mut noise = Noise::seeded(seed);
    let mut state = WarmupState::default();
    let time: Vec<f64> = (0..rows).map(|row| interval_s * row as f64).collect();
    let speed: Vec<f64> = time.iter().map(|time| rpm(*time)).collect();
    let y: Vec<f64> = time
        .iter()
        .zip(&speed)
        .map(|(time, rpm)| state.step(truth, *time, *rpm) + noise_um * noise.next())
        .collect();
    run(&[("time_s", &time), ("spindle_rpm", &speed), ("measured_elongation_um", &y)])
}

fn fit(runs: &[UncompensatedRun<'_>]) -> FitReport {
    let report = warmup::fit(runs, None).expect("a fit");
    report.parameters.iter().for_each(|parameter| println!("{parameter}"));
    report.warnings.iter().for_each(|warning| println!("{warning}"));
    report
}

#[test]
fn the_lag_the_time_constant_and_the_growth_are_found_from_one_record() {
    let run = recorded(&TRUTH, 60.0, 120, |_| 24_000.0, 0.3, 1);
    let report = fit(std::slice::from_ref(&run));
    assert_holds(&report, "lag_s", 60.0);
    assert_holds(&report, "time_constant_s", 1335.0);
    let model = applied(&report, MACHINE).spindle.warmup.expect("written");
    assert!((model.max_um - 80.0).abs() < 1.5, "{model:?}");
    // Without its first fifth a record does not show the lag: blocks cost more than the noise.
    assert!(report.held_out.expect("blocks").rms_um < 1.0, "{report:?}");
    assert_round_trip(&report, MACHINE, &run, 0);
    assert_eq!(applied(&report, MACHINE).spindle.source, Some(ElongationSource::Warmup));
}

#[test]
fn a_clear_end_of_the_growth_gives_the_warm_time_and_the_exponent_themselves() {
    let truth = Warmup { warm_s: 3600.0, exponent: 1.2, ..TRUTH };
    let run = recorded(&truth, 60.0, 120, |_| 24_000.0, 0.3, 2);
    let report = fit(std::slice::from_ref(&run));
    for (name, value) in [("lag_s", 60.0), ("warm_s", 3600.0), ("max_um", 80.0), ("exponent", 1.2)]
    {
        assert_holds(&report, name, value);
    }
    assert_round_trip(&report, MACHINE, &run, 0);
}

/// The record alone does not show it; the closed form must agree with it all the same.
#[test]
fn without_an_end_the_exponent_is_set_and_reported() {
    let truth = Warmup { warm_s: 40_000.0, exponent: 30.0, ..TRUTH };
    let run = recorded(&truth, 60.0, 90, |_| 24_000.0, 0.2, 3);
    let report = fit(std::slice::from_ref(&run));
    assert_eq!(report.parameter("exponent").expect("set").ci95, None);
    assert!(report.warnings.iter().any(|w| w.contains("does not show a kink")), "{report:?}");
    assert_holds(&report, "time_constant_s", truth.time_constant_s());
    let model = applied(&report, MACHINE).spindle.warmup.expect("written");
    for time_s in [600.0, 2000.0, 5000.0] {
        let difference =
            warmup_elongation_um(&model, time_s) - warmup_elongation_um(&truth, time_s);
        assert!(difference.abs() < 0.3, "{time_s} s: {difference}");
    }
}

#[test]
fn speeds_and_stops_give_the_speed_exponent_and_the_cooling() {
    let truth = Warmup {
        cool_s: Some(2500.0),
        rated_rpm: Some(24_000.0),
        speed_exponent: 1.4,
        warm_s: 60.0 + 1200.0 * 8.0,
        exponent: 8.0,
        ..TRUTH
    };
    let cycle = |time: f64| match time {
        t if t <= 6000.0 => 24_000.0,
        t if t <= 9000.0 => 0.0,
        t if t <= 14_000.0 => 12_000.0,
        _ => 0.0,
    };
    let one = recorded(&truth, 60.0, 300, cycle, 0.3, 4);
    let other = recorded(&truth, 60.0, 200, |_| 18_000.0, 0.3, 5);
    let report = fit(&[one.clone(), other.clone()]);
    assert_holds(&report, "speed_exponent", 1.4);
    assert_holds(&report, "cool_s", 2500.0);
    assert_holds(&report, "time_constant_s", 1200.0);
    assert_holds(&report, "lag_s", 60.0);
    assert_eq!(report.held_out_by, "each of 2 files in turn");
    let model = applied(&report, MACHINE);
    for run in [&one, &other] {
        assert!(predicted_rms(&model, run, 0, |_| true) < 0.4);
    }
}

#[test]
fn each_speed_alone_is_reported_where_each_has_its_run() {
    let runs: Vec<UncompensatedRun<'_>> = [12_000.0, 24_000.0]
        .into_iter()
        .map(|rpm| {
            let truth = Warmup { max_um: rpm / 300.0, ..TRUTH };
            recorded(&truth, 60.0, 120, |_| rpm, 0.2, rpm as u64)
        })
        .collect();
    let report = fit(&runs);
    let texts: Vec<String> = report
        .facts
        .iter()
        .filter(|fact| fact.name.starts_with("run_"))
        .map(|fact| format!("{:?}", fact.value))
        .collect();
    println!("{texts:?}");
    assert!(texts[0].contains("12000 r/min") && texts[1].contains("24000 r/min"));
    assert_holds(&report, "speed_exponent", 1.0);
}

#[test]
fn an_instrument_that_was_not_at_zero_is_taken_off_and_reported() {
    let run = recorded(&TRUTH, 30.0, 240, |_| 1.0, 0.2, 6);
    let y: Vec<f64> =
        run.column("measured_elongation_um").expect("there").iter().map(|y| y + 12.0).collect();
    let time = run.column("time_s").expect("there").to_vec();
    let run = crate::support::run(&[("time_s", &time), ("measured_elongation_um", &y)]);
    let report = fit(&[run]);
    assert_holds(&report, "time_constant_s", 1335.0);
    assert!(report.warnings.iter().any(|w| w.contains("does not begin at 0")), "{report:?}");
}

#[test]
fn gross_errors_are_listed_and_do_not_move_the_fit() {
    let run = recorded(&TRUTH, 60.0, 120, |_| 24_000.0, 0.3, 8);
    let mut y = run.column("measured_elongation_um").expect("there").to_vec();
    let time = run.column("time_s").expect("there").to_vec();
    (y[40], y[41], y[90]) = (-300.0, -300.0, 500.0);
    let run = crate::support::run(&[("time_s", &time), ("measured_elongation_um", &y)]);
    let report = fit(std::slice::from_ref(&run));
    let lines: Vec<usize> = report.excluded.iter().map(|row| row.place.line).collect();
    assert_eq!(lines, [42, 43, 92]);
    assert_holds(&report, "time_constant_s", 1335.0);
    assert_round_trip(&report, MACHINE, &run, 0);
}

#[test]
fn noise_alone_is_not_compensated() {
    let truth = Warmup { max_um: 1e-9, ..TRUTH };
    let run = recorded(&truth, 60.0, 100, |_| 24_000.0, 2.0, 9);
    let report = fit(&[run]);
    assert!(matches!(report.verdict, FitVerdict::DoNotCompensate(_)), "{report:?}");
}

#[test]
fn what_one_speed_cannot_say_is_kept_from_the_machine_file() {
    let text = format!(
        "{MACHINE}[spindle]\nsource = \"warmup\"\n[spindle.warmup]\nlag_s = 1.0\nwarm_s = 100.0\n\
         max_um = 5.0\nexponent = 3.0\ncool_s = 777.0 # from a stop\nrated_rpm = 24000.0\n\
         speed_exponent = 1.5\n"
    );
    let truth = Warmup { rated_rpm: Some(24_000.0), speed_exponent: 1.5, ..TRUTH };
    let run = recorded(&truth, 60.0, 120, |_| 20_000.0, 0.2, 10);
    let report = warmup::fit(std::slice::from_ref(&run), Some(&machine(&text))).expect("a fit");
    let model = applied(&report, &text).spindle.warmup.expect("written");
    assert_eq!((model.cool_s, model.speed_exponent), (Some(777.0), 1.5));
    assert_holds(&report, "time_constant_s", 1335.0);
    assert_round_trip(&report, &text, &run, 0);
}

#[test]
fn bad_input_is_named_with_its_place_and_rule() {
    for (text, expected) in [
        (
            "time,measured_elongation_um\n0,1\n",
            "run.csv:1:1: column time_s is missing; time is no column that is known: if it was meant, \
             give it as time_s",
        ),
        (
            "time_s,measured_elongation_um\n0,1\n1,2\n2,nan\n",
            "run.csv:1:1: 2 of 3 rows are complete: the fit needs at least 8",
        ),
        (
            "time_s,spindle_rpm,measured_elongation_um\n0,0,1\n1,0,1\n2,0,1\n3,0,1\n4,0,1\n5,0,1\n\
             6,0,1\n7,0,1\n",
            "run.csv:2:3: spindle_rpm is 0 in every row: a spindle that stands does not warm up",
        ),
        (
            "time_s,measured_elongation_um\n5,1\n5,1\n5,1\n5,1\n5,1\n5,1\n5,1\n5,1\n",
            "run.csv:2:1: time_s is 5 in every row: nothing can be fitted to it",
        ),
    ] {
        let error = warmup::fit(&[parse(text)], None).expect_err(text);
        assert_eq!(error.to_string(), expected);
    }
}
