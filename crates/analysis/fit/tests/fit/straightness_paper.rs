//! The paper's machine (`docs/physics.md` section 4): six curves with its travels and amplitudes, and the
//! two-axis diagonal cut.
//!
//! The paper prints no data, so the curves are seeded (`support/guideway.rs`). Figures: `cargo test -p trueup-fit --test fit straightness_paper -- --show-output`.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use crate::support::guideway::{CURVES, Guideway};
use trueup_fit::straightness::{
    FitMethod, MethodPerformance, StopReason, StraightnessFit, StraightnessFitOptions, fit,
};
use trueup_machine::model::spline_value_um;

fn print(table: &[MethodPerformance]) {
    println!(
        "  {:<31}{:>6}{:>8}{:>7}{:>8}{:>9}{:>10}{:>12}{:>10}",
        "", "coeff", "range", "mean", "msq", "largest", "left-out", "slope", "curv"
    );
    for row in table {
        println!(
            "  {:<31}{:>6}{:>8.2}{:>7.2}{:>8.2}{:>9.2}{:>10.2}{:>12.4}{:>10.6}",
            row.way,
            row.coefficients,
            row.residual.range_um,
            row.residual.mean_um,
            row.residual.mean_square_um2,
            row.residual.largest_um,
            row.held_out.map_or(f64::NAN, |left| left.rms_um),
            row.slope_um_per_mm,
            row.curvature_um_per_mm2,
        );
    }
}

fn within(tolerance_um: f64, x: &[f64], y: &[f64]) -> StraightnessFit {
    let options = StraightnessFitOptions {
        tolerance_um: Some(tolerance_um),
        ..StraightnessFitOptions::default()
    };
    fit(x, y, &options).expect("sound data")
}

/// Sets of six curves; a set is a number.
const SETS: std::ops::Range<u64> = 0..8;

fn guideway(set: u64, curve: usize) -> (Guideway, Vec<f64>, Vec<f64>) {
    let (_, travel_mm, step_mm, range_um, _) = CURVES[curve];
    let seed = 100 * set + curve as u64;
    let way = Guideway::new(seed, travel_mm, range_um);
    let (x, y) = way.measured(seed, step_mm);
    (way, x, y)
}

#[test]
fn each_of_the_six_curves_is_within_the_papers_residual_with_fewer_coefficients() {
    let (mut fewer, mut all) = (0, 0);
    for set in SETS {
        for (curve, (name, _, _, range_um, tolerance_um)) in CURVES.into_iter().enumerate() {
            let (_, x, y) = guideway(set, curve);
            let fit = within(tolerance_um, &x, &y);
            let table = fit.compare_methods();
            let [paper, points, own] = [0, 1, 2].map(|row| table[row].coefficients);
            println!(
                "set {set} {name}: {range_um} µm at {} positions -> {:.2} µm (allowed \
                 {tolerance_um}) in {own} coefficients",
                x.len(),
                fit.residual.largest_um
            );
            // One set in full.
            if set == 0 {
                print(&table);
            }
            assert_eq!(fit.stopped, StopReason::Tolerance);
            assert!(fit.residual.largest_um <= tolerance_um);
            assert!(fit.residual.largest_um < 0.1 * range_um, "90 % of the error is predicted");
            assert_eq!(fit.spline.validate(), Ok(()));
            assert!(own <= paper, "the paper's way takes {paper}");
            // Its points with control values by least squares: where they are within as well.
            if table[1].residual.largest_um <= tolerance_um {
                assert!(own <= points, "the paper's points by least squares take {points}");
            }
            fewer += usize::from(own < paper);
            all += 1;
        }
    }
    assert_eq!(fewer, all, "fewer coefficients than the paper's way, on every curve");
}

#[test]
fn the_papers_way_says_whether_it_has_reached_its_tolerance() {
    let (mut reached, mut all) = (0, 0);
    for set in SETS {
        for (curve, (name, .., tolerance_um)) in CURVES.into_iter().enumerate() {
            let (_, x, y) = guideway(set, curve);
            let options = StraightnessFitOptions {
                method: FitMethod::Paper,
                tolerance_um: Some(tolerance_um),
                ..StraightnessFitOptions::default()
            };
            let fit = fit(&x, &y, &options).expect("sound data");
            let is_within = fit.residual.largest_um <= tolerance_um;
            assert_eq!(fit.is_within_tolerance, is_within);
            assert_eq!(fit.stopped == StopReason::Tolerance, is_within);
            if !is_within {
                // A curve that does not pass through its control points cuts corners, even with all
                // of them.
                println!("set {set} {name}: {:?}", fit.warnings);
                assert_eq!(fit.spline.control_um.len(), x.len());
            }
            reached += usize::from(is_within);
            all += 1;
        }
    }
    println!("the paper's way is within its tolerance in {reached} of {all} curves");
    assert!(2 * reached > all);
}

/// Range of what is left of Δz = δz(x) + δz(y) and so on when both axes of a pair travel together,
/// read every 240 mm of X as the paper's gauge does, or at 60 places where X stands still.
fn diagonal(set: u64, tolerance_um: impl Fn(usize) -> f64) -> Vec<(&'static str, f64, f64)> {
    // The two curves of Δz, Δy, Δx.
    [("Z", [0, 2]), ("Y", [1, 5]), ("X", [3, 4])]
        .into_iter()
        .map(|(name, pair)| {
            let sides = pair.map(|curve| {
                let (way, x, y) = guideway(set, curve);
                let fit = within(tolerance_um(curve), &x, &y);
                (way, fit)
            });
            let travel = sides.iter().map(|(way, _)| way.travel_mm).fold(0.0, f64::max);
            let places = if travel > 10_000.0 { (travel / 240.0) as u32 } else { 60 };
            let left: Vec<f64> = (0..=places)
                .map(|n| {
                    let share = f64::from(n) / f64::from(places);
                    let left = sides.iter().map(|(way, fit)| {
                        let at = share * way.travel_mm;
                        way.at(at) - spline_value_um(&fit.spline, at)
                    });
                    left.sum()
                })
                .collect();
            let high = left.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let low = left.iter().copied().fold(f64::INFINITY, f64::min);
            let sum = sides.iter().map(|(_, fit)| fit.residual.largest_um).sum();
            (name, high - low, sum)
        })
        .collect()
}

/// By diagonal: the paper's range with B-splines, and what its two curves keep to, in µm.
const PAPERS_DIAGONALS: [(&str, f64, [f64; 2]); 3] =
    [("Z", 7.9, [8.3, 2.8]), ("Y", 8.0, [4.8, 2.2]), ("X", 3.6, [2.4, 1.6])];

#[test]
fn a_diagonal_cut_is_within_twice_the_sum_of_its_two_curves() {
    let mut ranges: [Vec<f64>; 3] = Default::default();
    for set in SETS {
        for (n, (name, range_um, sum_um)) in
            diagonal(set, |curve| CURVES[curve].4).into_iter().enumerate()
        {
            println!(
                "set {set} {name}: range {range_um:.2} µm, the two curves' sum {sum_um:.2} µm"
            );
            assert!(range_um <= 2.0 * sum_um);
            ranges[n].push(range_um);
        }
    }
    // As docs/papers.md prints them: least, middle, most.
    let printed = [[5.4, 9.8, 15.0], [2.7, 5.5, 8.0], [1.4, 3.9, 4.6]];
    // The paper's own figures keep that too.
    for (((name, papers_um, curves_um), mut ranges), printed) in
        PAPERS_DIAGONALS.into_iter().zip(ranges).zip(printed)
    {
        let sum_um: f64 = curves_um.iter().sum();
        ranges.sort_by(f64::total_cmp);
        let [least, middle, most] = [0, ranges.len() / 2, ranges.len() - 1].map(|n| ranges[n]);
        println!(
            "{name}: {least:.1} to {most:.1} µm, the middle one {middle:.1}; the paper's {papers_um}, its two curves \
             keep to {sum_um:.1} together"
        );
        assert!(papers_um <= 2.0 * sum_um && middle <= 2.0 * sum_um);
        for (got, printed) in [least, middle, most].into_iter().zip(printed) {
            assert!((got - printed).abs() < 0.06, "{name}: {got} is printed as {printed}");
        }
    }
}

#[test]
fn a_diagonal_cut_is_within_8_um_for_a_tolerance_of_2() {
    let mut worst: f64 = 0.0;
    for set in SETS {
        for (name, range_um, _) in diagonal(set, |_| 2.0) {
            assert!(range_um <= 8.0, "set {set} {name}: {range_um}");
            worst = worst.max(range_um);
        }
    }
    println!("largest range of {} diagonal cuts: {worst:.2} µm", 3 * SETS.count());
}
