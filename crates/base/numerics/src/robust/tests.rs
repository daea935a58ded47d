//! Gross errors are found, and what a machine does is none.

use super::{statistics::median, *};
use crate::random::RandomGenerator;

fn noise(random: &mut RandomGenerator) -> f64 {
    random.normal()
}

/// Heavier tails than normal, of the same standard deviation.
fn laplace(random: &mut RandomGenerator) -> f64 {
    let u = random.uniform() - 0.5;
    -u.signum() * (1.0 - 2.0 * u.abs()).ln() / 2.0_f64.sqrt()
}

fn warmup(row: usize) -> f64 {
    60.0 * (1.0 - (-(row as f64) / 40.0).exp())
}

fn rows_of(found: &[Outlier]) -> Vec<usize> {
    found.iter().map(|outlier| outlier.row).collect()
}

#[test]
fn the_median_is_the_middle_or_between_the_two_middles() {
    assert_eq!(median(&mut [3.0, 1.0, 2.0]), 2.0);
    assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), 2.5);
    assert!(median(&mut []).is_nan());
}

#[test]
fn gross_errors_of_a_warm_up_are_found_alone_and_in_bursts_and_nothing_else() {
    let mut random = RandomGenerator::new(1);
    let time: Vec<f64> = (0..300).map(|row| row as f64 * 60.0).collect();
    let mut y: Vec<f64> = (0..300).map(|row| warmup(row) + 0.5 * noise(&mut random)).collect();
    let wrong = [0, 4, 90, 91, 92, 180, 299];
    for (index, &row) in wrong.iter().enumerate() {
        y[row] += if index % 2 == 0 { 40.0 } else { -25.0 };
    }
    y[50] = f64::NAN;
    assert_eq!(rows_of(&find_series_outliers(&time, &y)), wrong);
}

#[test]
fn a_step_that_stays_is_no_gross_error() {
    let mut random = RandomGenerator::new(2);
    let time: Vec<f64> = (0..200).map(f64::from).collect();
    let step = |row: usize| if row >= 77 { 30.0 } else { 0.0 };
    let y: Vec<f64> = (0..200).map(|row| step(row) + 0.3 * noise(&mut random)).collect();
    assert_eq!(find_series_outliers(&time, &y), []);
}

#[test]
fn the_quick_start_of_a_cold_machine_is_no_gross_error() {
    let time: Vec<f64> = (0..200)
        .map(|row| if row < 3 { 4.0 * f64::from(row) } else { 60.0 * f64::from(row) })
        .collect();
    let growth = |t: &f64| 90.0 * (1.0 - (-t / 35.0).exp()) - 0.01 * t;
    let y: Vec<f64> = time.iter().map(growth).collect();
    assert_eq!(find_series_outliers(&time, &y), []);
}

#[test]
fn values_in_coarse_steps_are_not_taken_for_exact_ones() {
    let time: Vec<f64> = (0..200).map(f64::from).collect();
    let y: Vec<f64> = (0..200).map(|row| (warmup(row) / 2.5).round() * 2.5).collect();
    assert_eq!(find_series_outliers(&time, &y), []);
    let level = vec![7.5; 200];
    assert_eq!(find_series_outliers(&time, &level), []);
}

#[test]
fn a_relation_is_found_though_a_third_of_the_rows_is_wrong() {
    let mut random = RandomGenerator::new(3);
    let ones = vec![1.0; 90];
    let x: Vec<f64> = (0..90).map(|row| f64::from(row) * 100.0).collect();
    let mut y: Vec<f64> = x.iter().map(|x| 0.02 * x - 4.0 + 0.4 * noise(&mut random)).collect();
    let wrong: Vec<usize> = (0..90).filter(|row| row % 3 == 0).collect();
    wrong.iter().for_each(|&row| y[row] += 15.0 + row as f64);
    assert_eq!(rows_of(&find_regression_outliers(&[&ones, &x], &y)), wrong);
}

/// The rate is measured, printed, and bounded.
#[test]
fn clean_data_seldom_loses_a_row() {
    let trials = 200;
    for (name, sample) in
        [("normal", noise as fn(&mut RandomGenerator) -> f64), ("Laplace", laplace)]
    {
        for rows in [15_usize, 60, 400] {
            let mut random = RandomGenerator::new(rows as u64);
            let time: Vec<f64> = (0..rows).map(|row| row as f64).collect();
            let ones = vec![1.0; rows];
            let (mut series, mut relation, mut lost) = (0, 0, 0);
            for _ in 0..trials {
                let y: Vec<f64> = (0..rows).map(|row| warmup(row) + sample(&mut random)).collect();
                let found = find_series_outliers(&time, &y);
                series += usize::from(!found.is_empty());
                lost += found.len();
                let y: Vec<f64> = time.iter().map(|x| 3.0 * x + sample(&mut random)).collect();
                let found = find_regression_outliers(&[&ones, &time], &y);
                relation += usize::from(!found.is_empty());
                lost += found.len();
            }
            let rate = lost as f64 / (2 * trials * rows) as f64;
            println!(
                "{name} noise, {rows} rows: of {trials} clean runs {series} series and \
                 {relation} relations lose a row; {:.4} % of the rows",
                100.0 * rate
            );
            if name == "normal" {
                assert!(series <= trials / 20 && relation <= trials / 20, "{rows} rows");
            }
            assert!(rate < 0.005, "{name}, {rows} rows: {rate}");
        }
    }
}
