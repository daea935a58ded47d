//! The common part of the tests for gross errors: a scale that outliers do not move, and the limit in scales.

use crate::t_quantile;

/// A row within this many scales is never excluded.
pub const MIN_CUTOFF_SCALES: f64 = 5.0;
/// The median magnitude of a normal distribution is the standard deviation divided by this.
pub(super) const MAD_SCALE: f64 = 1.482_602_218_505_602;

/// A row that does not belong to the rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outlier {
    /// The row, from 0.
    pub row: usize,
    /// How far it is from the others, in y's unit.
    pub distance: f64,
    /// The same in scales.
    pub scales: f64,
}

impl Outlier {
    /// Returns the reason for a list of rows that were excluded as outliers, y in µm.
    #[must_use]
    pub fn exclusion_reason(&self) -> String {
        let Self { distance, scales, .. } = self;
        format!("{distance:.3} um away from the other rows, {scales:.0} times their scatter")
    }
}

/// Returns how many scales away a row of `rows` is excluded.
#[must_use]
pub(crate) fn outlier_cutoff(rows: usize, fitted: usize) -> f64 {
    let known = 0.37 * rows.saturating_sub(fitted).max(1) as f64;
    t_quantile(1.0 - 0.005 / rows.max(1) as f64, known).max(MIN_CUTOFF_SCALES)
}

/// Returns the smallest difference of two of `values` that differ by more than rounding; 0 if none do.
pub(super) fn smallest_nonzero_difference(values: impl Iterator<Item = f64>) -> f64 {
    let mut rising: Vec<f64> = values.collect();
    rising.sort_unstable_by(f64::total_cmp);
    let least = rising.last().map_or(0.0, |last| last.abs().max(1.0) * 1e-12);
    let steps = rising.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > least);
    steps.min_by(f64::total_cmp).unwrap_or(0.0)
}

/// Returns the step in which a series moves: the median difference of two values that follow each other
/// and differ; 0 if all are equal. Of values in fine steps it is about the scatter, or less.
pub(super) fn median_step(values: impl Iterator<Item = f64>) -> f64 {
    let mut steps = Vec::new();
    let mut before = f64::NAN;
    for value in values {
        // Two ways to write one number differ by rounding, which is not a step.
        if (value - before).abs() > value.abs().max(1.0) * 1e-12 {
            steps.push((value - before).abs());
        }
        before = value;
    }
    if steps.is_empty() { 0.0 } else { median(&mut steps) }
}

/// Returns the median; NaN of nothing. Reorders `values`.
pub fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() {
        return f64::NAN;
    }
    let (below, &mut upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    if below.len() < middle || values.len() % 2 == 1 {
        return upper;
    }
    let lower = values[..middle].iter().copied().fold(f64::NEG_INFINITY, f64::max);
    lower + (upper - lower) / 2.0
}

/// Returns the scale of residuals about their model: 1.4826 times the median magnitude.
pub(super) fn robust_scale(residuals: impl Iterator<Item = f64>) -> f64 {
    let mut magnitudes: Vec<f64> =
        residuals.filter(|residual| !residual.is_nan()).map(f64::abs).collect();
    MAD_SCALE * median(&mut magnitudes)
}
