//! Single readings of a residual that have nothing to do with their neighbours.
//!
//! A row is one if it differs from the median of its neighbours, three on each side, and itself by more
//! than 6 robust standard deviations of that difference (1.4826 times the median of its magnitude; more
//! where there are many rows), is far from the middle of the whole residual as well, and its neighbours
//! on both sides are not.

use super::statistics::MAD_SCALE;

/// Neighbours on each side that show the level of a reading.
pub const NEIGHBOURS_PER_SIDE: usize = 3;
/// Fewer rows have no scatter to speak of.
const MIN_ROWS_FOR_SCATTER: usize = 12;
/// A larger share of the rows is not a few readings.
pub const MAX_OUTLIER_FRACTION: f64 = 0.08;

/// Returns whether each row is a gross error. `series` says which rows are neighbours: those of one number;
/// `resolution` is the instrument's last digit, in the unit of `residual`, or 0.
#[must_use]
pub fn flag_residual_outliers(
    residual: &[f64],
    series: &[impl PartialEq],
    resolution: f64,
) -> Vec<bool> {
    let count = residual.len();
    let none = vec![false; count];
    if count < MIN_ROWS_FOR_SCATTER {
        return none;
    }
    let mut around = Vec::with_capacity(2 * NEIGHBOURS_PER_SIDE + 1);
    let differences: Vec<f64> = (0..count)
        .map(|at| {
            let near =
                at.saturating_sub(NEIGHBOURS_PER_SIDE)..(at + NEIGHBOURS_PER_SIDE + 1).min(count);
            around.clear();
            around.extend(near.filter(|&row| series[row] == series[at]).map(|row| residual[row]));
            around.sort_unstable_by(f64::total_cmp);
            residual[at] - around[around.len() / 2]
        })
        .collect();
    let mut work: Vec<f64> = differences.iter().map(|difference| difference.abs()).collect();
    work.sort_unstable_by(f64::total_cmp);
    // Readings in whole steps of an instrument may all be alike: then what is not alike sets the
    // scale, as the mean of the inner nine tenths.
    let inner = &work[..count * 9 / 10];
    let mean = inner.iter().sum::<f64>() / inner.len().max(1) as f64;
    let scale = (MAD_SCALE * work[count / 2]).max(1.2533 * mean).max(0.6 * resolution);
    if scale <= 0.0 {
        return none;
    }
    work.copy_from_slice(residual);
    let middle = upper_median(&mut work);
    work.iter_mut().for_each(|value| *value = (*value - middle).abs());
    let overall = MAD_SCALE * upper_median(&mut work);
    // One in a thousand clean runs has a row beyond it.
    let limit = scale * (2.0 * (500.0 * count as f64).ln()).sqrt().max(6.0);
    let is_far = |row: usize| {
        differences[row].abs() > limit && (residual[row] - middle).abs() > 5.0 * overall
    };
    let far: Vec<usize> = (0..count).filter(|&row| is_far(row)).collect();
    if far.len() as f64 > MAX_OUTLIER_FRACTION * count as f64 {
        return none;
    }
    let mut found = none;
    for row in far {
        let before = row.checked_sub(1).is_some_and(is_far);
        let after = row + 1 < count && is_far(row + 1);
        found[row] = !(before && after);
    }
    found
}

/// Returns the value that half of `values`, at least one, are below; their order changes.
fn upper_median(values: &mut [f64]) -> f64 {
    *values.select_nth_unstable_by(values.len() / 2, f64::total_cmp).1
}
