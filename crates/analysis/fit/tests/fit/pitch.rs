//! The pitch and backlash fits on axes whose true errors are known.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use crate::pitch_support::{machine_of, rms, run_of, sweeps};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Normal};
use trueup_fit::{
    FitVerdict,
    pitch::{BacklashWidthRule, PitchFit, PitchFitOptions, TableMode, fit, fit_backlash},
    report::FitDetailValue,
};
use trueup_machine::{
    applied_offsets::UncompensatedRun,
    machine_file::{Feedback, LinearAxis},
    predict::RunPredictor,
};

const X: LinearAxis = LinearAxis::X;

/// At uneven distances, as ISO 230-2 asks.
const UNEVEN: [f64; 9] = [0.0, 47.3, 103.9, 148.1, 205.2, 246.7, 301.8, 352.4, 400.0];

fn shape(x: f64) -> f64 {
    15.0 * (x / 90.0).sin() + 0.02 * x
}

fn fitted(run: &UncompensatedRun<'_>, options: &PitchFitOptions) -> PitchFit {
    fit(run, X, options).expect("the test's own run keeps the rules")
}

/// Noise of this standard deviation in µm.
fn noise(seed: u64, um: f64) -> impl FnMut() -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, um).expect("a positive width");
    move || normal.sample(&mut rng)
}

#[test]
fn one_table_and_the_backlash_are_found_from_uneven_targets() {
    let mut noise = noise(1, 0.5);
    let run = run_of(&sweeps(5, &UNEVEN, |_, x, dir| {
        shape(x) + if dir < 0.0 { -6.0 } else { 0.0 } + noise()
    }));
    let fit = fitted(&run, &PitchFitOptions::default());
    let width = fit.report.parameter("width_um").expect("a backlash was fitted").clone();
    let [low, high] = width.ci95.expect("from five runs");
    println!("{width}; {:?}; facts {:?}", fit.pitch, fit.report.facts);
    assert!(low < -6.0 && -6.0 < high && high - low < 1.0);
    assert!(fit.pitch.as_ref().is_some_and(|pitch| pitch.reverse_um.is_none()));
    // What is predicted is the truth to about the standard error of a mean, 0.5/√10 µm.
    let machine = machine_of(&fit.report.edit);
    let predictor = RunPredictor::new(&machine, &run).expect("the run has what it needs");
    let column = |name| run.column(name).expect("written above");
    let truth = column("x_mm").iter().zip(column("dir_x"));
    let off: Vec<f64> = predictor
        .predictions()
        .zip(truth)
        .map(|(prediction, (&x, &dir))| {
            prediction.model.error_um[0] - shape(x) - if dir < 0.0 { -6.0 } else { 0.0 }
        })
        .collect();
    println!("predicted minus true {:.3} µm rms", rms(&off));
    assert!(rms(&off) < 0.25);
    assert!(fit.report.warnings.is_empty(), "{:?}", fit.report.warnings);
}

#[test]
fn a_table_for_each_direction_is_taken_only_where_it_gains() {
    let mut both = 0;
    for seed in 0..40 {
        let mut noise = noise(seed, 0.5);
        let run = run_of(&sweeps(5, &UNEVEN, |_, x, dir| {
            shape(x) + if dir < 0.0 { -6.0 } else { 0.0 } + noise()
        }));
        let fit = fitted(&run, &PitchFitOptions::default());
        both += usize::from(fit.pitch.expect("it repeats").reverse_um.is_some());
    }
    println!("two tables where one and a backlash are true: {both} of 40");
    assert!(both <= 5);
    let mut noise = noise(99, 0.5);
    let run = run_of(&sweeps(5, &UNEVEN, |_, x, dir| {
        shape(x) + if dir < 0.0 { 0.02 * x } else { 0.0 } + noise()
    }));
    let fit = fitted(&run, &PitchFitOptions::default());
    assert!(fit.pitch.expect("it repeats").reverse_um.is_some());
    assert!(fit.backlash.is_none());
    assert_eq!(fit.report.edit.removed, ["axis.x.backlash"]);
}

#[test]
fn a_scale_on_the_axis_gets_no_backlash() {
    let run =
        run_of(&sweeps(5, &UNEVEN, |run, x, dir| shape(x) + 3.0 * dir + (run % 2) as f64 * 0.1));
    let options = PitchFitOptions { feedback: Feedback::Scale, ..PitchFitOptions::default() };
    let fit = fitted(&run, &options);
    assert!(fit.backlash.is_none() && fit.pitch.expect("it repeats").reverse_um.is_some());
    let lash = fit_backlash(&run, X, &options).expect("it can be read");
    assert!(!lash.report.verdict.is_usable());
}

#[test]
fn scatter_alone_is_not_compensated() {
    let mut accepted = 0;
    for seed in 0..100 {
        let mut noise = noise(seed, 10.0);
        let run = run_of(&sweeps(5, &UNEVEN, |_, _, _| noise()));
        accepted +=
            usize::from(fitted(&run, &PitchFitOptions::default()).report.verdict.is_usable());
    }
    println!("noise alone compensated: {accepted} of 100");
    assert!(accepted <= 3);
}

#[test]
fn a_constant_alone_is_no_position_error() {
    let mut noise = noise(3, 0.5);
    let run = run_of(&sweeps(5, &UNEVEN, |_, _, _| 12.0 + noise()));
    let FitVerdict::DoNotCompensate(reasons) =
        fitted(&run, &PitchFitOptions::default()).report.verdict
    else {
        panic!("a constant was compensated")
    };
    println!("{}", reasons.join("\n"));
    assert!(reasons.iter().any(|reason| reason.contains("constant")));
}

#[test]
fn a_shape_that_repeats_under_shifts_from_run_to_run_is_reported() {
    let shifts = [-60.0, 45.0, 10.0, -25.0, 70.0];
    let run = run_of(&sweeps(5, &UNEVEN, |run, x, _| shape(x) + shifts[run - 1]));
    let FitVerdict::DoNotCompensate(reasons) =
        fitted(&run, &PitchFitOptions::default()).report.verdict
    else {
        panic!("the shifts are larger than the shape")
    };
    println!("{}", reasons.join("\n"));
    assert!(reasons.iter().any(|reason| reason.contains("mean of each run taken out")));
}

#[test]
fn without_a_run_column_the_order_of_rows_gives_the_same_fit() {
    let mut noise = noise(5, 0.3);
    let text = sweeps(4, &UNEVEN, |_, x, dir| shape(x) - 2.0 * dir + noise());
    let bare: String = text
        .lines()
        .map(|line| format!("{}\n", line.split_once(',').expect("4 columns").1))
        .collect();
    for options in [
        PitchFitOptions::default(),
        PitchFitOptions { runs: Some(vec![2.0, 3.0]), ..PitchFitOptions::default() },
    ] {
        let (with, without) = (fitted(&run_of(&text), &options), fitted(&run_of(&bare), &options));
        assert_eq!(with.pitch, without.pitch);
        assert_eq!(with.report.held_out, without.report.held_out);
    }
}

#[test]
fn what_other_sections_say_is_taken_off_first() {
    let text = sweeps(3, &UNEVEN, |run, x, _| shape(x) + 0.01 * run as f64);
    let run = run_of(&text);
    let known = run.column("x_mm").expect("written above").iter().map(|x| 0.05 * x).collect();
    let fit =
        fitted(&run, &PitchFitOptions { known_um: Some(known), ..PitchFitOptions::default() });
    let pitch = fit.pitch.expect("it repeats");
    let last = pitch.forward_um[pitch.forward_um.len() - 1];
    assert!((last - (shape(400.0) + 0.02 - 20.0)).abs() < 0.1, "{last}");
}

#[test]
fn a_step_that_loses_more_than_the_scatter_is_warned_of() {
    let run = run_of(&sweeps(5, &UNEVEN, |run, x, _| shape(x) + 0.05 * (run % 3) as f64));
    let fine = fitted(&run, &PitchFitOptions::default());
    let coarse =
        fitted(&run, &PitchFitOptions { step_mm: Some(200.0), ..PitchFitOptions::default() });
    let loss = |fit: &PitchFit| {
        let fact = fit.report.facts.iter().find(|fact| fact.name == "resampling_loss_um");
        match fact.expect("uneven targets are resampled").value {
            FitDetailValue::Number(um) => um,
            _ => panic!("a number"),
        }
    };
    println!("loss {:.3} µm, with a step of 200 mm {:.3} µm", loss(&fine), loss(&coarse));
    // A hundredth of the measured shape may be lost, about its mean.
    let mean = UNEVEN.map(shape).iter().sum::<f64>() / UNEVEN.len() as f64;
    let allowed = 0.01 * rms(&UNEVEN.map(|x| shape(x) - mean));
    assert!(loss(&fine) <= 1.05 * allowed && loss(&coarse) > 1.0, "allowed {allowed}");
    assert!(coarse.report.warnings.iter().any(|warning| warning.contains("equal distances")));
    assert!(!fine.report.warnings.iter().any(|warning| warning.contains("equal distances")));
}

#[test]
fn one_pass_is_taken_over_with_its_repeatability_unknown() {
    let targets: Vec<f64> = (0..6).map(|n| 17.0 * f64::from(n)).collect();
    let run = run_of(&sweeps(1, &targets, |_, x, dir| shape(x) - 2.0 + 2.0 * dir));
    let fit = fitted(&run, &PitchFitOptions::default());
    assert_eq!(fit.backlash.expect("both directions").width_um, -4.0);
    let pitch = fit.pitch.expect("fitted");
    assert!((pitch.forward_um[3] - shape(51.0)).abs() < 1e-3);
    assert!(fit.report.warnings[0].contains("only one run"));
    assert!(fit.iso230.is_none() && fit.report.held_out.is_none());
    let one_way = sweeps(1, &targets, |_, x, _| shape(x));
    let forward: Vec<&str> = one_way.lines().filter(|line| !line.contains(",-1,")).collect();
    let fit = fitted(&run_of(&(forward.join("\n") + "\n")), &PitchFitOptions::default());
    let pitch = fit.pitch.expect("taken over");
    assert!(pitch.reverse_um.is_none() && fit.backlash.is_none());
    for (value, x) in pitch.forward_um.iter().zip(&targets) {
        assert!((value - shape(*x)).abs() < 1e-3, "{value} at {x} mm");
    }
    assert!(
        fit.report.warnings[0].contains("the repeatability and the gain of the table are unknown"),
        "{:?}",
        fit.report.warnings
    );
    assert!(fit.report.held_out.is_none() && fit.report.in_sample.is_none());
    assert!(!fit.report.edit.is_empty());
    // The order of one pass says its direction; of positions that come back it must be stated.
    let no_way = |rows: &str| run_of(&format!("x_mm,measured_dx_um\n{rows}"));
    for (rows, way) in [("0,3\n10,1\n20,-2\n", "positive"), ("20,3\n10,1\n0,-2\n", "negative")] {
        let fit = fitted(&no_way(rows), &PitchFitOptions::default());
        assert!(fit.pitch.is_some(), "{:?}", fit.report.verdict);
        let only = format!("only the {way} direction was measured");
        assert!(
            fit.report.warnings.iter().any(|warning| warning.contains(&only)),
            "{:?}",
            fit.report.warnings
        );
    }
    let back = no_way("0,3\n10,1\n20,-2\n10,2\n0,3\n");
    let refused = trueup_fit::pitch::fit(&back, LinearAxis::X, &PitchFitOptions::default())
        .expect_err("dir_x is missing");
    assert!(refused.rule.contains("the side from which"), "{refused}");
    // Two places always lie on a line.
    let two = "x_mm,dir_x,measured_dx_um\n0,1,3\n100,1,-2\n";
    let fit = fitted(&run_of(two), &PitchFitOptions::default());
    let FitVerdict::DoNotCompensate(reasons) = fit.report.verdict else { panic!("it was fitted") };
    assert!(reasons[0].contains("too few targets"), "{reasons:?}");
    assert!(fit.report.edit.is_empty());
}

#[test]
fn two_bad_readings_of_thirty_are_excluded_with_their_places() {
    let mut noise = noise(9, 0.5);
    let targets: Vec<f64> = (0..5).map(|n| 10.0 * f64::from(n)).collect();
    let run = run_of(&sweeps(3, &targets, |run, x, dir| {
        let bad = if run == 1 && dir < 0.0 && x < 15.0 { 60.0 + 3.0 * x } else { 0.0 };
        shape(9.0 * x) * dir + bad + noise()
    }));
    let fit = fitted(&run, &PitchFitOptions::default());
    assert_eq!(fit.report.excluded.len(), 2);
    println!("{}", fit.report.excluded[0]);
    assert!(fit.report.excluded[0].place.to_string().starts_with("r.csv:10:"));
    let pitch = fit.pitch.expect("it repeats");
    let reverse_um = pitch.reverse_um.expect("the directions differ");
    for (n, x) in targets.iter().enumerate() {
        assert!((reverse_um[n] + shape(9.0 * x)).abs() < 1.5, "{reverse_um:?}");
    }
}

#[test]
fn one_direction_gives_one_table_and_reports_it() {
    let text = sweeps(3, &UNEVEN, |run, x, _| shape(x) + 0.1 * run as f64);
    let forward: String = text
        .lines()
        .filter(|line| !line.contains(",-1,"))
        .map(|line| format!("{line}\n"))
        .collect();
    let fit = fitted(&run_of(&forward), &PitchFitOptions::default());
    assert!(fit.pitch.is_some_and(|pitch| pitch.reverse_um.is_none()));
    assert!(fit.report.warnings.iter().any(|warning| warning.contains("positive direction")));
}

#[test]
fn targets_on_multiples_of_a_pitch_hide_its_error_and_are_warned_of() {
    let even: Vec<f64> = (0..11).map(|n| 20.0 * f64::from(n)).collect();
    let run = run_of(&sweeps(5, &even, |run, x, _| shape(x) + 0.1 * (run % 2) as f64));
    let warnings = fitted(&run, &PitchFitOptions::default()).report.warnings.join("\n");
    assert!(warnings.contains("1, 2, 2.5, 4, 5, 10, 20 mm"), "{warnings}");
}

#[test]
fn seven_readings_at_the_middle_and_the_ends_give_the_largest_mean_with_its_sign() {
    for sign in [1.0, -1.0] {
        let mut noise = noise(8, 0.2);
        let mut text = String::from("x_mm,dir_x,measured_dx_um\n");
        for (x, width) in [(200.0, 4.0), (10.0, 4.2), (390.0, 5.0)] {
            for _ in 0..7 {
                let (up, down) = (30.0 + noise(), 30.0 + sign * width + noise());
                text += &format!("{x},1,{up}\n{x},-1,{down}\n");
            }
        }
        let run = run_of(&text);
        let fit = fit_backlash(&run, X, &PitchFitOptions::default()).expect("it keeps the rules");
        println!("{} {:?}", fit.report.parameters[0], fit.by_position);
        let width_um = fit.backlash.expect("it repeats").width_um;
        assert!((width_um - sign * 5.0).abs() < 0.3, "{width_um}");
        assert!(fit.depends_on_position);
        let mean = PitchFitOptions { width: BacklashWidthRule::Mean, ..PitchFitOptions::default() };
        let fit = fit_backlash(&run, X, &mean).expect("it keeps the rules");
        assert!((fit.backlash.expect("it repeats").width_um - sign * 4.4).abs() < 0.3);
    }
}

#[test]
fn an_even_backlash_is_not_called_dependent_on_position() {
    let mut called = 0;
    for seed in 0..100 {
        let mut noise = noise(seed, 0.5);
        let run = run_of(&sweeps(5, &UNEVEN, |_, x, dir| shape(x) - 2.0 * dir + noise()));
        let fit = fit_backlash(&run, X, &PitchFitOptions::default()).expect("it keeps the rules");
        called += usize::from(fit.depends_on_position);
    }
    println!("called dependent on position: {called} of 100 (5 expected)");
    assert!(called <= 12);
}

/// Returns a record while the axis moves: `count` rows of position, direction, error, each sweep of 1000.
fn record(count: usize) -> UncompensatedRun<'static> {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut noise = noise(12, 1.0);
    let mut text = String::from("x_mm,dir_x,measured_dx_um\n");
    for row in 0..count {
        let (sweep, at) = (row / 1000, row % 1000);
        let way = if sweep % 2 == 0 { 1.0 } else { -1.0 };
        let at = if way > 0.0 { at } else { 999 - at };
        let x = 0.4 * (at as f64 + rng.random::<f64>());
        let um = shape(x) + if way < 0.0 { 5.0 } else { 0.0 } + noise();
        text += &format!("{x:.4},{way},{um:.3}\n");
    }
    run_of(&text)
}

fn check_record(run: &UncompensatedRun<'_>) {
    let fit = fitted(run, &PitchFitOptions::default());
    let pitch = fit.pitch.expect("it repeats");
    let width_um = fit.backlash.expect("a backlash is in it").width_um;
    let off: Vec<f64> = pitch
        .forward_um
        .iter()
        .enumerate()
        .map(|(n, um)| um - shape(pitch.start_mm + pitch.step_mm * n as f64))
        .collect();
    println!(
        "{} rows: {} points, {:.3} µm rms from the truth, width {width_um}, left out {:?} by {}",
        run.row_count(),
        off.len(),
        rms(&off),
        fit.report.held_out,
        fit.report.held_out_by
    );
    assert!(rms(&off) < 0.3 && (width_um - 5.0).abs() < 0.1);
}

#[test]
fn a_record_of_a_moving_axis_is_fitted_in_cells() {
    check_record(&record(20_000));
}

/// `cargo test --release -p trueup-fit --test fit pitch -- --ignored --show-output`
#[test]
#[ignore = "campaign: cargo test -p trueup-fit --release --test fit pitch -- --ignored --show-output"]
fn campaign_a_million_rows_are_fitted() {
    check_record(&record(1_000_000));
    let targets: Vec<f64> = (0..500).map(|n| f64::from(n) * 0.8).collect();
    let run = run_of(&sweeps(1000, &targets, |run, x, dir| shape(x) - dir + (run % 7) as f64));
    let fit =
        fitted(&run, &PitchFitOptions { ways: TableMode::Automatic, ..PitchFitOptions::default() });
    println!("{} rows of {} targets: {:?}", run.row_count(), targets.len(), fit.report.held_out);
    assert!((fit.backlash.expect("it repeats").width_um - 2.0).abs() < 1e-3);
}
