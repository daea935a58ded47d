//! B-splines against SciPy: values and fits are the same; and the number of coefficients and the
//! time for one tolerance, next to FITPACK's, on seeded guideways.
//!
//! The figures that the documentation states are printed here
//! (`cargo test -p trueup-host-tests --features emulator --test scipy_splines -- --show-output`).

#[path = "../../crates/analysis/fit/tests/fit/support/guideway.rs"]
mod guideway;

use std::{
    io::Write as _,
    process::{Command, Stdio},
    time::Instant,
};

use anyhow::{Context as _, Result, ensure};
use guideway::{CURVES, Guideway};
use rand::Rng as _;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng as _};
use serde_json::{Value, json};
use trueup_emulator::setup;
use trueup_fit::{
    bspline::{
        clamped_knots, evaluate_with_derivatives, fit_least_squares_spline,
        satisfies_schoenberg_whitney,
    },
    straightness::{StraightnessFitOptions, fit},
};
use trueup_machine::machine_file::BSpline;

/// Returns what `host-tests/python/splines.py` answers.
fn scipy(request: &Value) -> Result<Value> {
    let mut python = Command::new(setup::ensure_python()?)
        .arg(setup::project_root().join("host-tests/python/splines.py"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    // It reads all before it writes.
    python.stdin.take().context("piped")?.write_all(request.to_string().as_bytes())?;
    let output = python.wait_with_output()?;
    ensure!(output.status.success(), "splines.py failed");
    Ok(serde_json::from_slice(&output.stdout)?)
}

fn numbers(value: &Value) -> Result<Vec<f64>> {
    let all = value.as_array().context("a list")?.iter();
    all.map(|number| number.as_f64().context("a number")).collect()
}

/// Returns the largest difference, as a share of the largest value.
fn difference(ours: &[f64], theirs: &[f64]) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    assert!(ours.iter().all(|value| value.is_finite()));
    let largest = theirs.iter().map(|value| value.abs()).fold(f64::MIN_POSITIVE, f64::max);
    ours.iter().zip(theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / largest
}

/// Returns a spline of random order, knots (some of them double) and control points.
fn random_spline(random: &mut ChaCha8Rng) -> BSpline {
    let order = random.random_range(2..=4);
    let (first, travel) = (random.random_range(-5e3..5e3), random.random_range(10.0..15e3));
    let mut inner: Vec<f64> = (0..random.random_range(0..30))
        .map(|_| first + travel * random.random_range(0.001..0.999))
        .collect();
    if order > 2 && random.random() {
        inner.extend(inner.first().copied());
    }
    inner.sort_by(f64::total_cmp);
    let count = inner.len() + order;
    let control_um = (0..count).map(|_| random.random_range(-100.0..100.0)).collect();
    BSpline { order, knots_mm: clamped_knots(order, first, &inner, first + travel), control_um }
}

#[test]
fn values_slopes_and_curvatures_are_scipys() -> Result<()> {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let splines: Vec<(BSpline, Vec<f64>)> = (0..300)
        .map(|_| {
            let spline = random_spline(&mut random);
            let (first, last) = (spline.knots_mm[0], spline.knots_mm[spline.knots_mm.len() - 1]);
            (spline, (0..50).map(|_| random.random_range(first..last)).collect())
        })
        .collect();
    let request: Vec<Value> = splines
        .iter()
        .map(|(spline, x)| {
            json!({"order": spline.order, "knots": spline.knots_mm, "control": spline.control_um, "x": x})
        })
        .collect();
    let theirs = scipy(&json!({"splines": request, "fits": [], "curves": []}))?;
    let mut worst = [0.0_f64; 3];
    for ((spline, x), theirs) in splines.iter().zip(theirs["splines"].as_array().context("list")?) {
        for (n, worst) in worst.iter_mut().enumerate() {
            let ours: Vec<f64> =
                x.iter().map(|&x| evaluate_with_derivatives(spline, x)[n]).collect();
            *worst = worst.max(difference(&ours, &numbers(&theirs[n])?));
        }
    }
    println!(
        "values, slopes, curvatures, as a share of the largest: {:.1e} {:.1e} {:.1e}",
        worst[0], worst[1], worst[2]
    );
    assert!(worst.iter().all(|&worst| worst < 1e-9), "{worst:?}");
    Ok(())
}

#[test]
fn least_squares_in_random_knots_is_scipys() -> Result<()> {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let (mut requested, mut ours) = (Vec::new(), Vec::new());
    while ours.len() < 300 {
        let BSpline { order, knots_mm, control_um } = random_spline(&mut random);
        let (first, last) = (knots_mm[0], knots_mm[knots_mm.len() - 1]);
        let count = control_um.len() * random.random_range(2..8);
        let mut x: Vec<f64> = (0..count).map(|_| random.random_range(first..last)).collect();
        x.sort_by(f64::total_cmp);
        x.dedup();
        let y: Vec<f64> = x.iter().map(|_| random.random_range(-50.0..50.0)).collect();
        let weight: Vec<f64> = x.iter().map(|_| random.random_range(0.2..5.0)).collect();
        let determined = satisfies_schoenberg_whitney(&knots_mm, order, x.iter().copied());
        let points = x.iter().zip(&y).zip(&weight).map(|((&x, &y), &weight)| (x, y, weight));
        let fit = fit_least_squares_spline(knots_mm.clone(), order, points).filter(|_| determined);
        // Where a coefficient hangs on a hair, both are right and differ.
        let Some(fit) = fit.filter(|fit| fit.triangle.min_column_angle_sine() > 1e-3) else {
            continue;
        };
        requested
            .push(json!({"order": order, "knots": knots_mm, "x": x, "y": y, "weight": weight}));
        ours.push(fit.spline.control_um);
    }
    let theirs = scipy(&json!({"splines": [], "fits": requested, "curves": []}))?;
    let mut worst: f64 = 0.0;
    for (ours, theirs) in ours.iter().zip(theirs["fits"].as_array().context("a list")?) {
        worst = worst.max(difference(ours, &numbers(theirs)?));
    }
    println!("control points of 300 fits, as a share of the largest: {worst:.1e}");
    assert!(worst < 1e-9, "{worst:e}");
    Ok(())
}

#[test]
fn one_tolerance_takes_fewer_coefficients_than_fitpack() -> Result<()> {
    const GUIDEWAYS: u64 = 60;
    let mut curves = Vec::new();
    for number in 0..GUIDEWAYS {
        let (_, travel_mm, step_mm, range_um, tolerance_um) = CURVES[number as usize % 6];
        let (x, y) = Guideway::new(1_000 + number, travel_mm, range_um).measured(number, step_mm);
        curves.push((x, y, tolerance_um));
    }
    let request: Vec<Value> =
        curves.iter().map(|(x, y, um)| json!({"x": x, "y": y, "tolerance": um})).collect();
    let theirs = scipy(&json!({"splines": [], "fits": [], "curves": request}))?;

    let mut ratios: Vec<[f64; 3]> = Vec::new();
    let (mut ours_s, mut splrep_s, mut even_s) = (0.0, 0.0, 0.0);
    println!("curve  tolerance  ours  splrep  in its knots  in even knots");
    for ((x, y, tolerance_um), theirs) in
        curves.iter().zip(theirs["curves"].as_array().context("a list")?)
    {
        let options = StraightnessFitOptions {
            tolerance_um: Some(*tolerance_um),
            ..StraightnessFitOptions::default()
        };
        let started = Instant::now();
        let fit = fit(x, y, &options)?;
        ours_s += started.elapsed().as_secs_f64();
        splrep_s += theirs["seconds"]["splrep"].as_f64().context("seconds")?;
        even_s += theirs["seconds"]["even"].as_f64().context("seconds")?;
        assert!(fit.is_within_tolerance, "{:?}", fit.warnings);
        let ours = fit.spline.control_um.len() as f64;
        let of = |way: &str| theirs["fewest"][way].as_f64().unwrap_or(f64::INFINITY);
        let alternatives = ["splrep", "its_knots", "even"].map(of);
        println!(
            "{:>5}  {tolerance_um:>9}  {ours:>4}  {:>6}  {:>12}  {:>13}",
            ratios.len(),
            alternatives[0],
            alternatives[1],
            alternatives[2]
        );
        ratios.push(alternatives.map(|alternative| ours / alternative));
    }
    let median = |n: usize| {
        let mut all: Vec<f64> = ratios.iter().map(|ratio| ratio[n]).collect();
        all.sort_by(f64::total_cmp);
        (all[all.len() / 2], all.iter().filter(|&&ratio| ratio > 1.0).count())
    };
    for (n, alternative) in
        ["splrep", "least squares in its knots", "even knots"].iter().enumerate()
    {
        let (median, more) = median(n);
        println!("coefficients against {alternative}: median ratio {median:.2}; more in {more}");
    }
    let per = |seconds: f64| 1e3 * seconds / GUIDEWAYS as f64;
    println!(
        "a curve: ours {:.1} ms; splrep over 60 values of s {:.1} ms; even knots {:.1} ms",
        per(ours_s),
        per(splrep_s),
        per(even_s)
    );
    assert!(median(0).0 < 1.0 && median(1).0 < 1.0);
    Ok(())
}
