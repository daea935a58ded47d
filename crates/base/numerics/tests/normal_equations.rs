//! The gain of the normal equations over the triangle in time, and their loss in digits.
//!
//! `cargo test --release -p trueup-numerics --test normal_equations -- --show-output` prints the figures
//! that stand in the page.

use std::time::{Duration, Instant};

use trueup_numerics::{
    least_squares::{GivensQr, normal_equations},
    random::RandomGenerator,
};

/// Returns the shorter of three tries.
fn timed<R>(mut of: impl FnMut() -> R) -> (Duration, R) {
    let mut tries = (0..3).map(|_| {
        let start = Instant::now();
        let result = of();
        (start.elapsed(), result)
    });
    let first = tries.next().expect("three tries");
    tries.fold(first, |best, there| if there.0 < best.0 { there } else { best })
}

fn by_triangle(columns: &[Vec<f64>], y: &[f64]) -> Vec<f64> {
    let mut triangle = GivensQr::new(columns.len());
    let mut x = vec![0.0; columns.len()];
    for (row, &y) in y.iter().enumerate() {
        x.iter_mut().zip(columns).for_each(|(x, column)| *x = column[row]);
        triangle.add_row(&x, y);
    }
    triangle.solve().expect("the columns are independent").coefficients
}

#[test]
fn both_give_the_same_coefficients_and_the_normal_equations_sooner() {
    let rows = 100_000;
    for count in [3, 12, 40] {
        let mut generator = RandomGenerator::new(count as u64);
        let columns: Vec<Vec<f64>> =
            (0..count).map(|_| (0..rows).map(|_| generator.normal()).collect()).collect();
        let y: Vec<f64> = (0..rows)
            .map(|row| columns.iter().map(|column| column[row]).sum::<f64>() + generator.normal())
            .collect();
        let (triangle_time, triangle) = timed(|| by_triangle(&columns, &y));
        let (normal_time, normal) =
            timed(|| normal_equations::solve(&columns, &y, None, 0.0).coefficients);
        let apart =
            triangle.iter().zip(&normal).map(|(t, n)| (t / n - 1.0).abs()).fold(0.0, f64::max);
        println!(
            "{rows} rows, {count} columns: triangle {triangle_time:.1?}, normal equations \
             {normal_time:.1?}; coefficients {apart:.0e} apart"
        );
        assert!(apart < 1e-12, "{count} columns: {apart:e}");
    }
}

/// y = x^degree over 0…1 in all powers up to it: columns that resemble each other more and more.
#[test]
fn columns_that_resemble_each_other_cost_the_normal_equations_twice_the_digits() {
    for degree in [3, 5, 7, 9] {
        let x: Vec<f64> = (0..1000).map(|row| f64::from(row) / 999.0).collect();
        let columns: Vec<Vec<f64>> =
            (0..=degree).map(|power| x.iter().map(|x| x.powi(power)).collect()).collect();
        let y = columns.iter().fold(vec![0.0; x.len()], |mut y, column| {
            y.iter_mut().zip(column).for_each(|(y, c)| *y += c);
            y
        });
        let worst = |found: Vec<f64>| found.iter().map(|c| (c - 1.0).abs()).fold(0.0, f64::max);
        let triangle = worst(by_triangle(&columns, &y));
        let normal = worst(normal_equations::solve(&columns, &y, None, 0.0).coefficients);
        println!(
            "powers up to {degree}: triangle off by {triangle:.0e}, normal equations by {normal:.0e}"
        );
        assert!(triangle < 1e-5);
        assert!(normal > triangle, "{normal:e} {triangle:e}");
    }
}
