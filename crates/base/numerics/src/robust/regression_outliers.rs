//! Rows that are off a linear relation which the others follow.

use super::statistics::{
    Outlier, median, outlier_cutoff, robust_scale, smallest_nonzero_difference,
};
use crate::{least_squares::GivensQr, random::RandomGenerator};

/// Small samples that are tried.
const SUBSAMPLE_COUNT: usize = 500;
/// The rows that a sample is judged on, at most.
const MAX_EVALUATION_ROWS: usize = 2000;
/// Nothing is found in fewer rows than this many for each column, and two columns' worth at least.
pub const MIN_ROWS_PER_COLUMN: usize = 3;
/// Tukey's constant: 95 % of the efficiency of least squares.
const BIWEIGHT_TUNING_CONSTANT: f64 = 4.685;

/// Rows whose y is far from what a linear relation of the columns of `x` gives for the others.
/// Rows where a value is NaN take no part. Nothing is found in fewer
/// than [`MIN_ROWS_PER_COLUMN`] rows for each column.
#[must_use]
pub fn find_regression_outliers(x: &[&[f64]], y: &[f64]) -> Vec<Outlier> {
    let columns = x.len();
    let present = |row: &usize| !y[*row].is_nan() && x.iter().all(|column| !column[*row].is_nan());
    let rows: Vec<usize> = (0..y.len()).filter(present).collect();
    if columns == 0 || rows.len() < MIN_ROWS_PER_COLUMN * columns.max(2) {
        return Vec::new();
    }
    let Some(start) = least_median_of_squares(x, y, &rows) else { return Vec::new() };
    let at = |row: usize, coefficients: &[f64]| -> f64 {
        y[row] - x.iter().zip(coefficients).map(|(column, c)| c * column[row]).sum::<f64>()
    };
    let floor = smallest_nonzero_difference(rows.iter().map(|&row| y[row]));
    let few = 1.0 + 5.0 / (rows.len() - columns) as f64;
    let mut coefficients = start;
    let mut spread = 0.0;
    let mut row_of = vec![0.0; columns];
    for round in 0..30 {
        // The scale settles with the first rounds, then stays, so that the weights can settle.
        if round < 10 {
            spread =
                (few * robust_scale(rows.iter().map(|&row| at(row, &coefficients)))).max(floor);
        }
        if spread == 0.0 {
            // More than half of the rows lie on it exactly, and nothing was rounded: what is off
            // is off.
            spread = f64::MIN_POSITIVE;
        }
        let mut triangle = GivensQr::new(columns);
        for &row in &rows {
            let share = at(row, &coefficients) / (BIWEIGHT_TUNING_CONSTANT * spread);
            let weight = (1.0 - share * share).max(0.0);
            if weight > 0.0 {
                row_of.iter_mut().zip(x).for_each(|(at, column)| *at = weight * column[row]);
                triangle.add_row(&row_of, weight * y[row]);
            }
        }
        let Ok(solution) = triangle.solve() else { break };
        let moved = solution.coefficients != coefficients;
        coefficients = solution.coefficients;
        if !moved {
            break;
        }
    }
    let magnitude = rows.iter().fold(0.0_f64, |most, &row| most.max(y[row].abs()));
    let spread = spread.max(magnitude * 1e-12);
    let most = outlier_cutoff(rows.len(), columns);
    let outlier = |&row: &usize| {
        let distance = at(row, &coefficients);
        Outlier { row, distance, scales: distance.abs() / spread }
    };
    rows.iter().map(outlier).filter(|outlier| outlier.scales > most).collect()
}

/// Returns the coefficients through the small sample that leaves the smallest median residual.
fn least_median_of_squares(x: &[&[f64]], y: &[f64], rows: &[usize]) -> Option<Vec<f64>> {
    let columns = x.len();
    let every = rows.len().div_ceil(MAX_EVALUATION_ROWS);
    let mut random = RandomGenerator::new(0x7275_6575_7000);
    let mut best: Option<(f64, Vec<f64>)> = None;
    let mut magnitudes = Vec::with_capacity(MAX_EVALUATION_ROWS);
    let mut row_of = vec![0.0; columns];
    for _ in 0..SUBSAMPLE_COUNT {
        let mut triangle = GivensQr::new(columns);
        for _ in 0..columns {
            let row = rows[random.uniform_index(rows.len())];
            row_of.iter_mut().zip(x).for_each(|(at, column)| *at = column[row]);
            triangle.add_row(&row_of, y[row]);
        }
        let Ok(solution) = triangle.solve() else { continue };
        magnitudes.clear();
        magnitudes.extend(rows.iter().step_by(every).map(|&row| {
            let value: f64 =
                x.iter().zip(&solution.coefficients).map(|(column, c)| c * column[row]).sum();
            (y[row] - value).abs()
        }));
        let middle = median(&mut magnitudes);
        if best.as_ref().is_none_or(|(least, _)| middle < *least) {
            best = Some((middle, solution.coefficients));
        }
    }
    best.map(|(_, coefficients)| coefficients)
}
