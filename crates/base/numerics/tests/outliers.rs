//! Why there are two tests for gross errors among rows in order: each finds what the other does not.
//!
//! `cargo test --release -p trueup-numerics --test outliers -- --show-output` prints, for clean rows and for
//! rows with gross errors, what either test sets aside and how long it takes.

use std::{f64::consts::TAU, time::Instant};

use trueup_numerics::{
    random::RandomGenerator,
    robust::{find_series_outliers, flag_residual_outliers},
};

const RUNS: usize = 20;
const ROWS: usize = 400;

/// Returns the residual of a cause that is not named yet, at scatter 1.
fn left(kind: &str, row: usize) -> f64 {
    let level = |is_there: bool, um: f64| if is_there { um } else { 0.0 };
    match kind {
        // A screw's pitch of ten readings.
        "wave" => 6.0 * (TAU * row as f64 / 10.0).sin(),
        // An axis that turns every 25 readings, with backlash.
        "backlash" => level(row / 25 % 2 == 1, 12.0),
        // A load of three readings, every forty.
        "load" => level(row % 40 < 3, 15.0),
        _ => 0.0,
    }
}

/// Of RUNS residuals: rows that the test of a series and that of a residual exclude as outliers though they are
/// sound, and of a hundred gross errors those that they find.
fn compare(kind: &str) -> [[usize; 2]; 2] {
    let mut generator = RandomGenerator::new(1);
    let time: Vec<f64> = (0..ROWS).map(|row| row as f64).collect();
    let series = vec![0; ROWS];
    let mut sum = [[0; 2]; 2];
    for _ in 0..RUNS {
        let mut y: Vec<f64> = (0..ROWS).map(|row| left(kind, row) + generator.normal()).collect();
        let wrong: Vec<usize> = (0..5).map(|n| 80 * n + 30).collect();
        wrong.iter().for_each(|&row| y[row] += 40.0);
        let by_series: Vec<usize> =
            find_series_outliers(&time, &y).iter().map(|outlier| outlier.row).collect();
        let by_residual: Vec<usize> = flag_residual_outliers(&y, &series, 0.0)
            .into_iter()
            .enumerate()
            .filter(|(_, is_gross)| *is_gross)
            .map(|(row, _)| row)
            .collect();
        for (sum, found) in sum.iter_mut().zip([by_series, by_residual]) {
            let right = found.iter().filter(|row| wrong.contains(row)).count();
            sum[0] += found.len() - right;
            sum[1] += right;
        }
    }
    sum
}

#[test]
fn neither_test_does_for_the_other() {
    for kind in ["noise", "wave", "backlash", "load"] {
        let [series, residual] = compare(kind);
        println!(
            "{kind}: of {} sound rows the test of a series takes {}, that of a residual {}; of 100 gross \
             errors they find {} and {}",
            RUNS * (ROWS - 5),
            series[0],
            residual[0],
            series[1],
            residual[1]
        );
        match kind {
            "wave" => assert!(residual[1] > 90 && series[1] < 10),
            "backlash" => assert!(residual[1] < 10 && series[1] > 90),
            "load" => assert!(residual[0] < series[0]),
            _ => assert!(residual == [0, 100] && series == [0, 100]),
        }
    }
    let rows = 20_000;
    let mut generator = RandomGenerator::new(2);
    let time: Vec<f64> = (0..rows).map(|row| row as f64).collect();
    let y: Vec<f64> = (0..rows).map(|_| generator.normal()).collect();
    let start = Instant::now();
    assert!(find_series_outliers(&time, &y).len() < 3);
    let series = start.elapsed();
    let start = Instant::now();
    assert!(
        flag_residual_outliers(&y, &vec![0; rows], 0.0)
            .iter()
            .filter(|is_gross| **is_gross)
            .count()
            < 3
    );
    let residual = start.elapsed();
    println!("{rows} rows: {series:.2?} and {residual:.2?}");
}
