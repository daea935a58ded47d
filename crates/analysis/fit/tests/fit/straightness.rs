//! Straightness in closed form: what is known beforehand is found, noise is not fitted, and what is
//! wrong with a run is reported.

use std::{borrow::Cow, f64::consts::TAU, path::Path};

use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng as _};
use rand_distr::{Distribution as _, Normal};
use trueup_fit::{
    bspline::clamped_knots,
    straightness::{
        FitMethod, ReferenceLine, StopReason, StraightnessCurve, StraightnessFit,
        StraightnessFitError, StraightnessFitOptions, fit, fit_straightness_run,
    },
};
use trueup_machine::{
    RunFile, applied_offsets::UncompensatedRun, machine_file::BSpline, model::spline_value_um,
};

fn every(step_mm: f64, travel_mm: f64) -> Vec<f64> {
    (0..=(travel_mm / step_mm).round() as u32).map(|n| f64::from(n) * step_mm).collect()
}

fn noise(count: usize, um: f64, seed: u64) -> Vec<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, um).expect("finite");
    (0..count).map(|_| normal.sample(&mut random)).collect()
}

fn of(
    x: &[f64],
    error_um: impl Fn(f64) -> f64,
    options: &StraightnessFitOptions,
) -> StraightnessFit {
    let y: Vec<f64> = x.iter().map(|&x| error_um(x)).collect();
    fit(x, &y, options).expect("sound data")
}

fn tolerance(um: f64) -> StraightnessFitOptions {
    StraightnessFitOptions { tolerance_um: Some(um), ..StraightnessFitOptions::default() }
}

#[test]
fn a_cubic_is_reproduced_with_4_coefficients() {
    let cubic = |x: f64| 3.0 - 0.02 * x + 5e-5 * x * x - 3e-8 * x * x * x;
    for options in [StraightnessFitOptions::default(), tolerance(1e-6)] {
        let found = of(&every(50.0, 1_000.0), cubic, &options);
        assert_eq!((found.spline.order, found.spline.control_um.len()), (4, 4));
        for x in every(1.0, 1_000.0) {
            assert!((spline_value_um(&found.spline, x) - cubic(x)).abs() < 1e-11);
        }
        assert!(found.is_within_tolerance);
    }
}

#[test]
fn lines_and_parabolas_take_2_and_3_coefficients() {
    let x = every(10.0, 300.0);
    let line = of(&x, |x| 4.0 - 0.1 * x, &StraightnessFitOptions::default());
    assert_eq!((line.spline.order, line.spline.control_um.len()), (2, 2));
    assert!((line.slope_um_per_mm - 0.1).abs() < 1e-12);
    let parabola = of(&x, |x| 1e-3 * x * x, &StraightnessFitOptions::default());
    assert_eq!((parabola.spline.order, parabola.spline.control_um.len()), (3, 3));
    assert!((parabola.curvature_um_per_mm2 - 2e-3).abs() < 1e-12);
}

#[test]
fn a_spline_of_known_knots_is_found_with_its_knots() {
    let known = BSpline {
        order: 4,
        knots_mm: clamped_knots(4, 0.0, &[210.0, 390.0, 740.0], 1_000.0),
        control_um: vec![0.0, 20.0, -15.0, 30.0, -20.0, 10.0, 0.0],
    };
    let found = of(&every(5.0, 1_000.0), |x| spline_value_um(&known, x), &tolerance(0.01));
    println!(
        "knots {:?}, largest residual {:.1e} µm",
        found.spline.knots_mm, found.residual.largest_um
    );
    assert_eq!(found.spline.control_um.len(), 7);
    for (found, known) in found.spline.knots_mm.iter().zip(&known.knots_mm) {
        assert!((found - known).abs() < 2.0, "{found} is not {known}");
    }
}

#[test]
fn noise_alone_is_no_curve() {
    const TRIES: u64 = 200;
    let mut curves = 0;
    for seed in 0..TRIES {
        let count = [20, 60, 150][seed as usize % 3];
        let x = every(10.0, 10.0 * (count - 1) as f64);
        let options = StraightnessFitOptions {
            reference: ReferenceLine::LeastSquares,
            ..StraightnessFitOptions::default()
        };
        let found = fit(&x, &noise(count, 2.0, seed), &options).expect("sound data");
        if found.spline.control_um.len() == 2 {
            // The line was taken away: what is left of it is rounding.
            assert!(found.spline.control_um.iter().all(|um| um.abs() < 1e-9));
            assert_eq!(found.stopped, StopReason::Noise);
        } else {
            curves += 1;
        }
    }
    println!("noise alone was taken for a curve {curves} times in {TRIES}");
    assert!(curves <= 4);
}

#[test]
fn a_tolerance_below_the_noise_stops_at_the_noise_and_reports_it() {
    const NOISE_UM: f64 = 1.0;
    let truth = |x: f64| 40.0 * (TAU * x / 2_000.0).sin() + 15.0 * (TAU * x / 700.0).cos();
    let x = every(10.0, 2_000.0);
    for seed in 0..5 {
        let y: Vec<f64> =
            x.iter().zip(noise(x.len(), NOISE_UM, seed)).map(|(&x, n)| truth(x) + n).collect();
        let found = fit(&x, &y, &tolerance(0.2)).expect("sound data");
        let off = x.iter().map(|&x| (spline_value_um(&found.spline, x) - truth(x)).powi(2));
        let rms = (off.sum::<f64>() / x.len() as f64).sqrt();
        let noise = found.noise.expect("enough readings");
        println!(
            "{} coefficients, {rms:.2} µm RMS from the truth, noise taken for {:.2} µm",
            found.spline.control_um.len(),
            noise.um
        );
        assert_eq!(found.stopped, StopReason::Noise);
        assert!(!found.is_within_tolerance && found.warnings[0].contains("noise"));
        assert!(rms < 0.45 * NOISE_UM && found.spline.control_um.len() <= 22);
        assert!((0.85..1.15).contains(&noise.um) && !noise.from_repeats);
        assert!(found.standard_error_um.expect("enough readings") < NOISE_UM);
    }
}

#[test]
fn a_wave_of_many_periods_is_no_noise() {
    let x = every(10.0, 2_000.0);
    let found = of(&x, |x| 5.0 * (TAU * x / 200.0).sin(), &tolerance(0.5));
    println!("ten periods: {} coefficients", found.spline.control_um.len());
    assert!(found.is_within_tolerance && found.spline.control_um.len() < 45);
}

#[test]
fn repeats_give_the_noise_and_their_means_the_curve() {
    let one_pass = every(50.0, 1_500.0);
    let mut x = one_pass.clone();
    // There and back, and there again.
    x.extend(one_pass.iter().rev().chain(&one_pass));
    let y: Vec<f64> = x
        .iter()
        .zip(noise(x.len(), 0.5, 7))
        .map(|(&x, n)| 20.0 * (TAU * x / 1_500.0).sin() + n)
        .collect();
    let found = fit(&x, &y, &StraightnessFitOptions::default()).expect("sound data");
    assert_eq!((found.rows, found.positions), (93, 31));
    let noise = found.noise.expect("repeats");
    assert!(noise.from_repeats && noise.freedom == 62);
    assert!((0.35..0.65).contains(&noise.um), "{}", noise.um);
}

#[test]
fn the_reference_line_is_taken_away_and_given() {
    let x = every(10.0, 400.0);
    let bowed = |x: f64| 7.0 + 0.03 * x + 1e-4 * x * (400.0 - x);
    let with = |reference| {
        of(&x, bowed, &StraightnessFitOptions { reference, ..StraightnessFitOptions::default() })
    };
    let ends = with(ReferenceLine::EndPoints);
    assert!(
        (ends.line.evaluate(0.0) - 7.0).abs() < 1e-12
            && (ends.line.evaluate(400.0) - 19.0).abs() < 1e-12
    );
    assert!(spline_value_um(&ends.spline, 0.0).abs() < 1e-9);
    assert!((spline_value_um(&ends.spline, 200.0) - 4.0).abs() < 1e-9);
    let squares = with(ReferenceLine::LeastSquares);
    assert!((squares.line.slope_um_per_mm - 0.03).abs() < 1e-12);
    assert!(squares.line_left.slope_um_per_mm.abs() < 1e-12);
    let measured = with(ReferenceLine::AsMeasured);
    assert!((spline_value_um(&measured.spline, 0.0) - 7.0).abs() < 1e-9);
    assert!((measured.line_left.slope_um_per_mm - 0.03).abs() < 1e-12);
}

#[test]
fn a_kink_takes_knots_at_its_place() {
    let found = of(&every(10.0, 1_000.0), |x| 0.1 * (x - 430.0).abs(), &tolerance(0.3));
    println!("a kink: {:?}", found.spline.knots_mm);
    assert!(found.is_within_tolerance && found.spline.control_um.len() <= 9);
    assert!(found.spline.knots_mm.iter().any(|knot| (knot - 430.0).abs() < 10.0));
}

#[test]
fn a_gap_in_the_readings_has_no_wild_curve() {
    let x: Vec<f64> =
        every(10.0, 1_000.0).into_iter().filter(|x| !(400.0..600.0).contains(x)).collect();
    let truth = |x: f64| 10.0 * (TAU * x / 1_000.0).sin() + 3.0 * (TAU * x / 150.0).sin();
    let found = of(&x, truth, &tolerance(0.05));
    for at in every(1.0, 1_000.0) {
        assert!(spline_value_um(&found.spline, at).abs() < 40.0, "at {at}");
    }
}

#[test]
fn a_million_readings_take_seconds() {
    const COUNT: usize = 1_000_000;
    let x: Vec<f64> = (0..COUNT).map(|n| n as f64 * 0.0143).collect();
    let truth = |x: f64| 80.0 * (TAU * x / 14_300.0).sin() + 10.0 * (TAU * x / 4_000.0).cos();
    let y: Vec<f64> = x.iter().zip(noise(COUNT, 1.0, 3)).map(|(&x, n)| truth(x) + n).collect();
    let started = std::time::Instant::now();
    let found = fit(
        &x,
        &y,
        &StraightnessFitOptions { most_coefficients: 10, ..StraightnessFitOptions::default() },
    );
    let found = found.expect("sound data");
    let worst = every(10.0, 14_290.0)
        .into_iter()
        .map(|x| (spline_value_um(&found.spline, x) - truth(x)).abs())
        .fold(0.0, f64::max);
    println!(
        "a million readings of 1 µm noise: {} coefficients, within {worst:.3} µm of the truth, \
         {:.1} s",
        found.spline.control_um.len(),
        started.elapsed().as_secs_f64()
    );
    // What ten coefficients cannot follow of the two waves.
    assert!(worst < 0.5, "{worst} µm");
}

#[test]
fn what_is_no_curve_is_refused_by_name() {
    let options = StraightnessFitOptions::default();
    let x = [0.0, 1.0, 2.0, 3.0];
    let nan = f64::NAN;
    assert!(matches!(
        fit(&x, &[0.0, 1.0, nan, 0.0], &options),
        Err(StraightnessFitError::NotFinite { row: 2, is_position: false, .. })
    ));
    assert_eq!(
        fit(&x[..3], &x[..3], &options).unwrap_err(),
        StraightnessFitError::TooFewPositions { positions: 3 }
    );
    assert_eq!(
        fit(&[5.0; 9], &[1.0; 9], &options).unwrap_err(),
        StraightnessFitError::OnePosition { position_mm: 5.0 }
    );
    assert!(matches!(fit(&x, &x[..3], &options), Err(StraightnessFitError::LengthsDiffer { .. })));
    for um in [0.0, -1.0, nan] {
        assert!(matches!(fit(&x, &x, &tolerance(um)), Err(StraightnessFitError::Tolerance { .. })));
    }
    assert!(fit(&x, &x, &options).is_ok());
}

fn from_csv(text: &str, quantity: Option<&str>) -> Result<StraightnessCurve, String> {
    let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own");
    let (run, _) = UncompensatedRun::from_run(Cow::Owned(run), None, None).expect("no bridge");
    fit_straightness_run(&run, quantity, &tolerance(9.0)).map_err(|bad| bad.to_string())
}

#[test]
fn the_moving_axis_and_the_quantity_are_found() {
    let rows: String = (0..30)
        .map(|n| {
            let x = f64::from(n) * 100.0;
            // Y reads back a little of the travel; one reading is missing.
            let z = if n == 7 { String::new() } else { format!("{}", 50.0 * (x / 500.0).sin()) };
            format!("{x},{},100,{z}\n", 1e-4 * x)
        })
        .collect();
    let curve = from_csv(&format!("x_mm,y_mm,z_mm,measured_dz_um\n{rows}"), None).expect("sound");
    assert_eq!(curve.section_name(), "z_of_x");
    assert_eq!((curve.fit.rows, curve.rows_incomplete), (29, 1));
    assert!(curve.fit.is_within_tolerance && curve.fit.warnings.is_empty());
    assert_eq!(curve.straightness().spline.validate(), Ok(()));
}

#[test]
fn what_is_wrong_with_a_run_is_reported_with_its_place() {
    let row = |n: u32| f64::from(n) * 100.0;
    let rows = |line: &dyn Fn(f64) -> String| (0..9).map(|n| line(row(n))).collect::<String>();
    for (text, quantity, complaint) in [
        (
            format!("x_mm,y_mm,measured_dz_um\n{}", rows(&|x| format!("{x},{x},1\n"))),
            None,
            "r.csv:1:1: several axes move (x_mm by 800 mm, y_mm by 800 mm)",
        ),
        (
            format!("x_mm,measured_dz_um\n{}", rows(&|_| "5,1\n".into())),
            None,
            "r.csv:1:1: no axis moves: x_mm stays the same where measured_dz_um is measured",
        ),
        (
            format!("x_mm,measured_dx_um\n{}", rows(&|x| format!("{x},1\n"))),
            None,
            "r.csv:1:1: measured_dx_um while x itself moves is a positioning error",
        ),
        (
            format!("x_mm,measured_dz_um,measured_dy_um\n{}", rows(&|x| format!("{x},1,2\n"))),
            None,
            "r.csv:1:1: the run measures dy, dz: choose one with --axis or --quantity",
        ),
        (
            format!("x_mm,measured_dz_um\n{}", rows(&|x| format!("{x},1\n"))),
            Some("dy"),
            "r.csv:1:1: column measured_dy_um is missing",
        ),
        (
            "x_mm,measured_dz_um\n0,1\n100,2\n200,1\n".into(),
            None,
            "r.csv:2:1: x_mm has readings at 3 different positions: a curve needs at least 4",
        ),
        ("temp_a_c,measured_dz_um\n0,1\n".into(), None, "r.csv:1:1: no column has a position"),
        ("x_mm\n0\n".into(), None, "r.csv:1:1: no column has a measured error"),
    ] {
        let error = from_csv(&text, quantity).expect_err(complaint);
        assert!(error.starts_with(complaint), "{error}");
    }
}

#[test]
fn positions_that_look_like_metres_are_reported() {
    let rows: String = (0..20).map(|n| format!("{},{n}\n", f64::from(n) * 0.7)).collect();
    let curve = from_csv(&format!("x_mm,measured_dz_um\n{rows}"), None).expect("sound");
    assert!(curve.fit.warnings[0].contains("metres"), "{:?}", curve.fit.warnings);
}

#[test]
fn the_papers_way_alone_is_a_machine_files_spline_too() {
    let options = StraightnessFitOptions { method: FitMethod::Paper, ..tolerance(2.0) };
    let found = of(&every(50.0, 3_000.0), |x| 30.0 * (x / 400.0).sin(), &options);
    assert_eq!(found.spline.validate(), Ok(()));
    assert!(found.is_within_tolerance && found.residual.largest_um <= 2.0);
}

#[test]
fn a_bad_reading_among_three_passes_is_excluded_by_its_line_and_bends_no_curve() {
    let noise = noise(63, 0.3, 9);
    let mut text = String::from("run,x_mm,measured_dz_um\n");
    for (row, noise) in noise.iter().enumerate() {
        let x = 50.0 * (row % 21) as f64;
        let bad = if row == 30 { 40.0 } else { 0.0 };
        let um = 6.0 * (x / 300.0).sin() + noise + bad;
        text += &format!("{},{x},{um:.3}\n", row / 21);
    }
    let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file");
    let (run, _) = UncompensatedRun::from_run(Cow::Owned(run), None, None).expect("no bridge");
    let report = trueup_fit::straightness_report::fit_curve(
        &run,
        None,
        |_| Ok(None),
        &StraightnessFitOptions::default(),
    );
    let report = report.expect("a curve");
    let [excluded] = &report.excluded[..] else { panic!("{:?}", report.excluded) };
    assert_eq!((excluded.place.line, report.rows_used, report.rows_incomplete), (32, 62, 0));
    assert!(report.in_sample.is_some_and(|statistics| statistics.max_um < 1.5), "{report:?}");
}
