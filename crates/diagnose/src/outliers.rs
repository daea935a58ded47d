//! Gross errors among the rows that count, by what a model leaves of them: judged so, a cause with
//! quick changes is named before its rows are suspected. Only repeats at one place say so before any
//! cause is known.

use trueup_numerics::robust::in_residual;

use crate::{data::Data, repeats::Targets};

/// Rows that stand alone among the repeats of their place, by what `predicted` leaves.
pub(crate) fn among_repeats(data: &Data, predicted: &[f64]) -> Vec<bool> {
    let used = (0..data.rows).filter(|&row| data.used[row]);
    let residual = |row: usize| data.measured[row] - predicted[row];
    Targets::of(data, used)
        .map_or_else(|| vec![false; data.rows], |targets| targets.gross(data, residual))
}

/// Rows that are to be set aside, by what `predicted` leaves.
pub(crate) fn gross(data: &Data, predicted: &[f64]) -> Vec<bool> {
    let rows: Vec<usize> = (0..data.rows).filter(|&row| data.used[row]).collect();
    let residual: Vec<f64> = rows.iter().map(|&row| data.measured[row] - predicted[row]).collect();
    let series: Vec<usize> = rows.iter().map(|&row| data.series[row]).collect();
    let found = in_residual(&residual, &series, last_digit(data, &rows));
    let mut aside = vec![false; data.rows];
    rows.into_iter().zip(found).for_each(|(row, found)| aside[row] = found);
    aside
}

/// The instrument's last digit: the smallest step between readings, but for the rarest.
fn last_digit(data: &Data, rows: &[usize]) -> f64 {
    let mut values: Vec<f64> = rows.iter().map(|&row| data.measured[row]).collect();
    values.sort_by(f64::total_cmp);
    let mut steps: Vec<f64> =
        values.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 1e-9).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 50).copied().unwrap_or(0.0)
}
