//! Gross errors: single readings that have nothing to do with their neighbours.
//!
//! A row is set aside if what is left there differs from the median of its seven neighbours by more
//! than 6 robust standard deviations of that difference (1.4826 times the median of its absolute
//! value; more where there are many rows), and its neighbours on both sides do not. Judged on what
//! the terms leave, so that a cause with quick changes is named before its rows are suspected.

use crate::data::Data;

/// Half of the window.
const HALF: usize = 3;
/// More than that is not a few readings.
const MOST: f64 = 0.08;

/// Rows that are to be set aside, by what `predicted` leaves.
pub(crate) fn gross(data: &Data, predicted: &[f64]) -> Vec<bool> {
    let mut aside = vec![false; data.rows];
    let rows: Vec<usize> = (0..data.rows).filter(|&row| data.used[row]).collect();
    let residual: Vec<f64> = rows.iter().map(|&row| data.measured[row] - predicted[row]).collect();
    let count = rows.len();
    if count < 12 {
        return aside;
    }
    let mut differences = Vec::with_capacity(count);
    for at in 0..count {
        let low = at.saturating_sub(HALF);
        let high = (at + HALF + 1).min(count);
        let mut around: Vec<f64> = (low..high)
            .filter(|&other| data.series[rows[other]] == data.series[rows[at]])
            .map(|other| residual[other])
            .collect();
        around.sort_by(f64::total_cmp);
        differences.push(residual[at] - around[around.len() / 2]);
    }
    let mut sizes: Vec<f64> = differences.iter().map(|d| d.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let robust = 1.4826 * sizes[count / 2];
    // Readings in whole steps of an instrument may all be alike: then what is not alike sets the
    // scale, as the mean of the inner nine tenths.
    let inner = &sizes[..count * 9 / 10];
    let mean = inner.iter().sum::<f64>() / inner.len().max(1) as f64;
    let scale = robust.max(1.2533 * mean).max(0.6 * quantum(data, &rows));
    if scale <= 0.0 {
        return aside;
    }
    // Far from the neighbours, and far from everything.
    let mut sorted = residual.clone();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted[count / 2];
    let mut spread: Vec<f64> = residual.iter().map(|r| (r - middle).abs()).collect();
    spread.sort_by(f64::total_cmp);
    let overall = 1.4826 * spread[count / 2];
    // One in a thousand clean runs has a row beyond it.
    let limit = scale * (2.0 * (500.0 * count as f64).ln()).sqrt().max(6.0);
    let is_far =
        |at: usize| differences[at].abs() > limit && (residual[at] - middle).abs() > 5.0 * overall;
    let far: Vec<usize> = (0..count).filter(|&at| is_far(at)).collect();
    if far.len() as f64 > MOST * count as f64 {
        return aside;
    }
    for at in far {
        let before = at.checked_sub(1).is_some_and(is_far);
        let after = at + 1 < count && is_far(at + 1);
        if !(before && after) {
            aside[rows[at]] = true;
        }
    }
    aside
}

/// The instrument's last digit: the smallest step between readings, but for the rarest.
fn quantum(data: &Data, rows: &[usize]) -> f64 {
    let mut values: Vec<f64> = rows.iter().map(|&row| data.measured[row]).collect();
    values.sort_by(f64::total_cmp);
    let mut steps: Vec<f64> =
        values.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 1e-9).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 50).copied().unwrap_or(0.0)
}
