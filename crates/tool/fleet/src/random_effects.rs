//! One constant on many machines: its mean over the series, its spread, and each machine's value with the others' help.
//!
//! ```text
//! v_i = μ + u_i + e_i        u_i ~ N(0, τ²): how machines differ; e_i ~ N(0, s_i²): the error of one fit
//! B_i = s_i² / (s_i² + τ²)   the weight of the mean
//! value of machine i = Σ p(τ | v) · (B_i·μ̂(τ) + (1 − B_i)·v_i)
//! ```
//!
//! The spread is estimated, and its error must not be ignored: with one estimate in the place of τ a machine's error is
//! larger than the model says. Here every τ counts with its restricted likelihood (REML: Patterson and Thompson 1971)
//! times the uniform shrinkage prior: beforehand every weight B of the mean from 0 to 1 is as likely (Daniels 1999), so
//! that p(τ) ∝ τ / (1 + τ²/s²)², s the typical error of a fit. The RMS error of the values, relative to the single fits', is
//! measured by `tests/series.rs`. Of ten priors, tried on the same drawn series, this one had the least error where τ is half of
//! s; 95 % intervals hold the true value in 92.6 % where τ is as large as s, and in more elsewhere.
//!
//! Few machines say too little of τ: below four nothing is shrunk, from four to six a part of it.

use serde::Serialize;

/// Fewer machines than this are left as they are (James and Stein 1961: towards an estimated mean no rule of this kind
/// is never worse below four).
pub(crate) const MIN_POOLED_MACHINES: usize = 4;

/// This many machines beyond three have the full weight of the mean.
const FULL_WEIGHT_EXTRA_MACHINES: f64 = 4.0;

/// Half of an interval of 95 % in standard errors.
pub(crate) const NORMAL_QUANTILE_975: f64 = 1.96;

/// Points of the grid in a decade of τ.
const GRID_POINTS_PER_DECADE: f64 = 40.0;

/// A value and its standard error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard error, above 0.
    pub se: f64,
}

impl Estimate {
    /// Returns the interval of 95 %.
    #[must_use]
    pub fn ci95(&self) -> [f64; 2] {
        [self.value - NORMAL_QUANTILE_975 * self.se, self.value + NORMAL_QUANTILE_975 * self.se]
    }
}

/// A constant over a series.
#[derive(Clone, Debug, PartialEq)]
pub struct PooledEstimate {
    /// The mean over machines.
    pub mean: Estimate,
    /// The standard deviation between machines, and its standard error.
    pub spread: Estimate,
    /// Each machine's value with the others' help, in their order.
    pub shrunk: Vec<Estimate>,
    /// The weight of the mean in each, 0…1.
    pub weight: Vec<f64>,
}

/// Returns what machines say together.
#[must_use]
pub fn pool_estimates(machines: &[Estimate]) -> Option<PooledEstimate> {
    let count = machines.len();
    if count == 0 {
        return None;
    }
    let typical =
        (count as f64 / machines.iter().map(|estimate| estimate.se.powi(-2)).sum::<f64>()).sqrt();
    let ends = machines.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], estimate| {
        [low.min(estimate.value), high.max(estimate.value)]
    });
    let widest = 30.0 * (1.0 + (ends[1] - ends[0]) / typical);
    let decades = (widest / MIN_TAU_RATIO).log10();
    let points = (decades * GRID_POINTS_PER_DECADE).ceil() as usize;
    let taus =
        (0..=points).map(|n| MIN_TAU_RATIO * 10_f64.powf(decades * n as f64 / points as f64));
    let grid: Vec<TauGridPoint> =
        taus.map(|ratio| TauGridPoint::new(machines, ratio, typical)).collect();
    let best = grid.iter().map(|at| at.log_weight).fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = grid.iter().map(|at| (at.log_weight - best).exp()).collect();
    let total: f64 = weights.iter().sum();
    let mean_of = |of: &dyn Fn(&TauGridPoint) -> f64| -> f64 {
        grid.iter().zip(&weights).map(|(at, weight)| weight * of(at)).sum::<f64>() / total
    };
    // Of a mixture: the mean variance within, and the variance of the means.
    let mixed = |value: &dyn Fn(&TauGridPoint) -> f64, variance: &dyn Fn(&TauGridPoint) -> f64| {
        let mean = mean_of(value);
        let within = mean_of(variance);
        let between = mean_of(&|at| (value(at) - mean).powi(2));
        Estimate { value: mean, se: (within + between).sqrt() }
    };
    let mean = mixed(&|at| at.mean, &|at| at.mean_variance);
    let spread = mixed(&|at| at.tau, &|_| 0.0);
    if count < MIN_POOLED_MACHINES {
        return Some(PooledEstimate {
            mean,
            spread,
            shrunk: machines.to_vec(),
            weight: vec![0.0; count],
        });
    }
    let caution = ((count as f64 - 3.0) / FULL_WEIGHT_EXTRA_MACHINES).min(1.0);
    let part = |estimate: &Estimate, at: &TauGridPoint| {
        caution * estimate.se.powi(2) / (estimate.se.powi(2) + at.tau.powi(2))
    };
    let shrunk = |estimate: &Estimate| {
        mixed(
            &|at| part(estimate, at) * at.mean + (1.0 - part(estimate, at)) * estimate.value,
            &|at| {
                let b = part(estimate, at);
                let of_mean = at.tau.powi(2) + at.mean_variance;
                (1.0 - b).powi(2) * estimate.se.powi(2) + b.powi(2) * of_mean
            },
        )
    };
    Some(PooledEstimate {
        mean,
        spread,
        shrunk: machines.iter().map(shrunk).collect(),
        weight: machines.iter().map(|estimate| mean_of(&|at| part(estimate, at))).collect(),
    })
}

/// The lowest τ of the grid, in typical errors of a fit: what is below does the same.
const MIN_TAU_RATIO: f64 = 1e-2;

/// Estimate if the spread is `tau`.
struct TauGridPoint {
    tau: f64,
    mean: f64,
    mean_variance: f64,
    /// Logarithm of restricted likelihood, prior, and the width of the step on the grid.
    log_weight: f64,
}

impl TauGridPoint {
    fn new(machines: &[Estimate], ratio: f64, typical: f64) -> Self {
        let tau = ratio * typical;
        let variance = |estimate: &Estimate| estimate.se.powi(2) + tau.powi(2);
        let sum: f64 = machines.iter().map(|estimate| variance(estimate).recip()).sum();
        let mean =
            machines.iter().map(|estimate| estimate.value / variance(estimate)).sum::<f64>() / sum;
        let of_machine = |estimate: &Estimate| {
            variance(estimate).ln() + (estimate.value - mean).powi(2) / variance(estimate)
        };
        let restricted = -0.5 * (machines.iter().map(of_machine).sum::<f64>() + sum.ln());
        let prior = ratio.ln() - 2.0 * (1.0 + ratio * ratio).ln();
        Self { tau, mean, mean_variance: sum.recip(), log_weight: restricted + prior + ratio.ln() }
    }
}
