//! The figures that the series promises, on drawn numbers: pooling helps and never harms, an odd machine is found, a
//! healthy one is left alone.

use trueup_fleet::{
    outliers::compare_machines,
    random_effects::{Estimate, pool_estimates},
};
use trueup_numerics::random::RandomGenerator;

/// A drawn series: what is true of each machine, and what was measured.
struct Drawn {
    truth: Vec<f64>,
    measured: Vec<Estimate>,
}

/// Draws machines around 7 with this spread; the errors of the fits differ by a factor up to three, 1 in the mean square
/// where they are equal.
fn drawn(generator: &mut RandomGenerator, machines: usize, spread: f64, are_equal: bool) -> Drawn {
    let truth: Vec<f64> = (0..machines).map(|_| 7.0 + spread * generator.normal()).collect();
    let measured = truth.iter().map(|truth| {
        let se = if are_equal { 1.0 } else { 0.6 + 1.2 * generator.uniform() };
        Estimate { value: truth + se * generator.normal(), se }
    });
    let measured = measured.collect();
    Drawn { truth, measured }
}

/// Returns the RMS error of the shrunk values relative to that of the single fits, and the share of intervals that hold
/// the truth.
fn relative_error(machines: usize, spread: f64, are_equal: bool, series: usize) -> (f64, f64) {
    let mut generator = RandomGenerator::new(machines as u64 * 1000 + (spread * 10.0) as u64);
    let (mut shrunk_sum, mut own_sum, mut held) = (0.0, 0.0, 0);
    for _ in 0..series {
        let Drawn { truth, measured } = drawn(&mut generator, machines, spread, are_equal);
        let pooled = pool_estimates(&measured).expect("there are machines");
        for ((truth, own), shrunk) in truth.iter().zip(&measured).zip(&pooled.shrunk) {
            shrunk_sum += (shrunk.value - truth).powi(2);
            own_sum += (own.value - truth).powi(2);
            let [low, high] = shrunk.ci95();
            held += usize::from(low <= *truth && *truth <= high);
        }
    }
    ((shrunk_sum / own_sum).sqrt(), held as f64 / (series * machines) as f64)
}

#[test]
fn thirty_machines_halve_the_error_where_they_differ_by_half_of_it() {
    let mut missed = Vec::new();
    for (spread, most) in [(0.0, 0.35), (0.25, 0.40), (0.5, 0.50), (1.0, 0.75), (2.0, 0.95)] {
        let (ratio, held) = relative_error(30, spread, true, 500);
        println!("spread {spread}: error {ratio:.3}, intervals {held:.3}");
        if ratio > most || held < 0.92 {
            missed.push((spread, ratio, held));
        }
    }
    assert!(missed.is_empty(), "{missed:?}");
}

#[test]
fn pooling_is_never_worse_for_few_machines_or_large_spreads() {
    let mut missed = Vec::new();
    for machines in [3, 4, 5, 6, 8, 12, 30] {
        for are_equal in [true, false] {
            let spreads = [0.0, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0];
            let ratios = spreads.map(|spread| {
                let (ratio, _) = relative_error(machines, spread, are_equal, 2500 / machines);
                if ratio > 1.01 {
                    missed.push((machines, spread, ratio));
                }
                format!("{ratio:.3}")
            });
            println!("{machines} machines, equal {are_equal}: {ratios:?}");
        }
    }
    assert!(missed.is_empty(), "{missed:?}");
}

/// Returns how often the machine that is off is found, how often a healthy one is accused, and how often a series has one
/// that is accused.
fn found_and_accused(
    machines: usize,
    error: f64,
    off: &dyn Fn(&mut RandomGenerator) -> f64,
) -> [f64; 3] {
    const SERIES: usize = 250;
    let mut generator = RandomGenerator::new(machines as u64);
    let (mut found, mut accused, mut series) = (0, 0, 0);
    for _ in 0..SERIES {
        let mut measured: Vec<Estimate> = (0..machines)
            .map(|_| Estimate { value: generator.normal() + error * generator.normal(), se: error })
            .collect();
        measured[0].value = off(&mut generator) + error * generator.normal();
        let compared = compare_machines(&measured, 1).expect("there are four");
        found += usize::from(compared[0].is_odd);
        let wrong = compared[1..].iter().filter(|result| result.is_odd).count();
        accused += wrong;
        series += usize::from(wrong > 0);
    }
    let of = |count: usize, all: usize| count as f64 / all as f64;
    [of(found, SERIES), of(accused, SERIES * (machines - 1)), of(series, SERIES)]
}

#[test]
fn a_machine_five_spreads_off_is_found_and_a_healthy_one_is_left_alone() {
    for error in [0.02, 0.2] {
        let [found, accused, series] = found_and_accused(30, error, &|_| 5.0);
        println!("error {error}: found {found:.3}, accused {accused:.4}, series {series:.3}");
        assert!(found >= 0.95 && accused <= 0.01, "error {error}: {found} {accused}");
        let [found, accused, _] = found_and_accused(30, error, &|random| 5.0 + random.normal());
        println!("error {error}, on top of its own: found {found:.3}, accused {accused:.4}");
        assert!(found >= 0.94 && accused <= 0.01, "error {error}: {found} {accused}");
    }
}

#[test]
fn without_an_odd_machine_a_healthy_one_is_accused_in_one_of_a_hundred_at_most() {
    for machines in [4, 6, 10, 30] {
        for error in [0.02, 1.0, 3.0] {
            let [first, others, series] =
                found_and_accused(machines, error, &RandomGenerator::normal);
            println!("{machines} machines, error {error}: {first:.4} {others:.4} {series:.3}");
            assert!(others <= 0.01, "{machines} machines, error {error}: {others}");
        }
    }
}

#[test]
fn three_odd_machines_do_not_hide_each_other() {
    let mut generator = RandomGenerator::new(3);
    let mut found = 0;
    for _ in 0..100 {
        let mut measured: Vec<Estimate> =
            (0..30).map(|_| Estimate { value: generator.normal(), se: 0.1 }).collect();
        measured[..3].iter_mut().for_each(|estimate| estimate.value = 6.0 + 0.3 * estimate.value);
        let compared = compare_machines(&measured, 1).expect("there are four");
        found += compared[..3].iter().filter(|result| result.is_odd).count();
    }
    println!("{found} of 300");
    assert!(found >= 285, "{found}");
}
