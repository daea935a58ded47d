//! How high a sum must rise before it is an alarm, by the lengths of its runs.
//!
//! ```text
//! S ← max(0, S + ψ(e) − k)      ψ(e) e held to ±c; 0 where it is gross, unless the one before it is so on the same side
//! e   normal, its mean off by b and its scatter s times as large; of [`UNREJECTED_OUTLIER_FRACTION`] of the readings ±c, half to each side
//! ```
//!
//! b and s are the 95 % bounds of what the record of the calibration leaves open: forty readings know a mean to a sixth of the
//! scatter. The mean length of a run follows from the steps of S between [`MARKOV_STATES`] levels (Brook and Evans 1972):
//! L = 1 + P·L. c is the bound by which a change is found soonest among those at which false alarms are as rare as requested.

use std::f64::consts::FRAC_1_SQRT_2;

/// The share of bad readings that count, of the one in twenty that a false alarm rate is stated for: a tenth is not gross
/// (they lie up to forty standard deviations away), and one in forty follows another one on its side.
const UNREJECTED_OUTLIER_FRACTION: f64 = 0.05 * (0.1 + 0.025);
/// Levels of a sum.
const MARKOV_STATES: usize = 30;
/// The bounds c that are tried, in parts of k, and in standard deviations.
const CLIPPING_BOUND_RATIOS: [f64; 4] = [1.75, 2.0, 2.5, 3.5];
const CLIPPING_BOUND_SIGMAS: [f64; 2] = [2.5, 3.5];
/// Halvings until h is known to a thousandth.
const BISECTION_STEPS: usize = 18;

/// The uncertainty that the record of the calibration leaves: both in standard deviations of e.
#[derive(Clone, Copy, Debug)]
pub(super) struct BaselineUncertainty {
    /// b.
    pub mean: f64,
    /// s.
    pub scatter: f64,
}

/// The bound of a reading, and the height of an alarm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CusumDesign {
    pub bound: f64,
    pub height: f64,
}

/// Returns the plan by which a change of 2·`k` is found soonest, where two sums run for `rows` on average without one. With a
/// memory a change shows most in its `first` sound reading.
pub(super) fn design_cusum(
    k: f64,
    first: f64,
    rows: f64,
    open: BaselineUncertainty,
) -> CusumDesign {
    let bounds = CLIPPING_BOUND_RATIOS.into_iter().map(|parts| parts * k);
    let bounds = bounds.chain(CLIPPING_BOUND_SIGMAS.into_iter().filter(|bound| *bound > 1.5 * k));
    let plans = bounds.map(|bound| {
        let height = decision_interval(k, bound, 2.0 * rows, open);
        let from = (first.min(bound) - k).max(0.0);
        let delay = average_run_length(
            k,
            bound,
            height,
            ErrorDistribution { mean: 2.0 * k, scatter: 1.0 },
            from,
        );
        (CusumDesign { bound, height }, delay)
    });
    let best = plans.min_by(|a, b| a.1.total_cmp(&b.1));
    best.map_or(CusumDesign { bound: 2.0 * k, height: 10.0 * k }, |best| best.0)
}

/// Returns h of one sum that runs for this many rows on average. No two readings reach it.
fn decision_interval(k: f64, bound: f64, rows: f64, open: BaselineUncertainty) -> f64 {
    let law = ErrorDistribution { mean: open.mean, scatter: open.scatter };
    let (mut low, mut high) = (2.0 * bound, 120.0 * bound);
    for _ in 0..BISECTION_STEPS {
        let middle = f64::midpoint(low, high);
        if average_run_length(k, bound, middle, law, 0.0) < rows {
            low = middle
        } else {
            high = middle
        }
    }
    high
}

/// The law of e.
#[derive(Clone, Copy)]
struct ErrorDistribution {
    mean: f64,
    scatter: f64,
}

impl ErrorDistribution {
    /// Returns the probability that ψ(e) is at most `x`.
    fn cumulative_probability(&self, x: f64, bound: f64) -> f64 {
        if x >= bound {
            return 1.0;
        }
        if x < -bound {
            return 0.0;
        }
        (1.0 - UNREJECTED_OUTLIER_FRACTION) * normal_cdf((x - self.mean) / self.scatter)
            + UNREJECTED_OUTLIER_FRACTION / 2.0
    }
}

/// Returns the mean length of a run of one sum from the level `from` to above `decision_interval`.
fn average_run_length(k: f64, bound: f64, height: f64, law: ErrorDistribution, from: f64) -> f64 {
    let n = MARKOV_STATES;
    let width = 2.0 * height / (2 * n - 1) as f64;
    let cumulative_probability = |x: f64| law.cumulative_probability(x + k, bound);
    // (1 − P)·L = 1 by elimination: P has a dominant diagonal, so no pivot is needed.
    let mut rows: Vec<Vec<f64>> = (0..n)
        .map(|from| {
            let level = from as f64 * width;
            let mut row: Vec<f64> = (0..n)
                .map(|to| {
                    let step = to as f64 * width - level;
                    let reached = cumulative_probability(step + width / 2.0);
                    let less =
                        if to == 0 { 0.0 } else { cumulative_probability(step - width / 2.0) };
                    f64::from(u8::from(from == to)) - (reached - less)
                })
                .collect();
            row.push(1.0);
            row
        })
        .collect();
    for column in 0..n {
        let (done, rest) = rows.split_at_mut(column + 1);
        let pivot = &done[column];
        if pivot[column].abs() < 1e-15 {
            return f64::INFINITY;
        }
        for row in rest {
            let factor = row[column] / pivot[column];
            (column..=n).for_each(|place| row[place] -= factor * pivot[place]);
        }
    }
    let mut lengths = vec![0.0; n];
    for row in (0..n).rev() {
        let known: f64 = (row + 1..n).map(|place| rows[row][place] * lengths[place]).sum();
        lengths[row] = (rows[row][n] - known) / rows[row][row];
    }
    let begun = lengths[((from / width).round() as usize).min(n - 1)];
    if begun > 0.0 { begun } else { f64::INFINITY }
}

/// Returns the normal distribution function, to 10⁻⁷ (Abramowitz and Stegun 7.1.26).
fn normal_cdf(x: f64) -> f64 {
    let z = (x * FRAC_1_SQRT_2).abs();
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let poly = t
        * (0.254_829_592
            + t * (-0.284_496_736
                + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let half = poly * (-z * z).exp() / 2.0;
    if x < 0.0 { half } else { 1.0 - half }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The end-to-end rates are in `tests/trust.rs`.
    #[test]
    fn runs_are_as_long_as_asked_for_and_no_two_readings_reach_the_height() {
        let law = ErrorDistribution { mean: 0.0, scatter: 1.0 };
        let plan = design_cusum(0.5, 1.0, 1000.0, BaselineUncertainty { mean: 0.0, scatter: 1.0 });
        let found = average_run_length(0.5, plan.bound, plan.height, law, 0.0);
        assert!((found / 2000.0 - 1.0).abs() < 0.05, "{found}");
        assert!(plan.height >= 2.0 * plan.bound);
    }
}
