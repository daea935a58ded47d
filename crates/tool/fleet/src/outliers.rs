//! Which machine is unlike the others in one constant.
//!
//! Each machine is compared with what the others predict for it: t = (v_i − μ̂) / √(τ̂² + s_i² + var μ̂), all of it
//! from the others alone, τ̂² by Paule and Mandel (1982), t of Student's distribution with the others' degrees of
//! freedom, so that the error of τ̂ counts. Two odd machines hide each other in that: the most extreme is taken out
//! step by step, as far as a step is certain for the whole series (the generalised test of Rosner 1983), and all are
//! compared with those that remain.
//!
//! | | level |
//! |---|---|
//! | a machine is called odd | 1 % for each healthy machine over all its constants, at most 0.5 % a constant |
//! | it is taken out for the comparison of others | 1 % for the series |
//!
//! `p_series` is corrected for the number of machines and constants (Holm 1979): it says how often a series of
//! healthy machines has one such. With that at 1 % in the place of the first level, 94 % of machines would be found
//! that are exactly five spreads off among 30, and fewer that are so on top of their own spread.

use serde::Serialize;
use trueup_numerics::t_cdf;

use crate::random_effects::Estimate;

/// How often a healthy machine is called odd.
pub(crate) const SIGNIFICANCE_LEVEL: f64 = 0.01;
/// The same at most for one constant.
const MAX_LEVEL_PER_CONSTANT: f64 = 0.005;
/// A step is certain at this level for the series.
const OUTLIER_SIGNIFICANCE_LEVEL: f64 = 0.01;
/// The largest share of machines that are taken out.
const MAX_OUTLIER_FRACTION: f64 = 0.2;

/// A machine compared with the others.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PredictiveTestResult {
    /// Prediction by the others, in the unit of the value.
    pub predicted: f64,
    /// The deviation in predictive standard deviations.
    pub t: f64,
    /// How often a healthy machine deviates as far, either way.
    pub p: f64,
    /// True if it is called odd.
    pub is_odd: bool,
}

/// Compares each machine with the others; none with fewer than four. `constants`: how many are compared on a machine.
#[must_use]
pub fn compare_machines(
    machines: &[Estimate],
    constants: usize,
) -> Option<Vec<PredictiveTestResult>> {
    if machines.len() < crate::random_effects::MIN_POOLED_MACHINES {
        return None;
    }
    let out = find_outliers(machines);
    let level = (SIGNIFICANCE_LEVEL / constants.max(1) as f64).min(MAX_LEVEL_PER_CONSTANT);
    let compared = |index: usize| {
        let others: Vec<Estimate> = (0..machines.len())
            .filter(|other| *other != index && !out.contains(other))
            .map(|other| machines[other])
            .collect();
        let mut compared = run_predictive_test(machines[index], &others);
        compared.is_odd = compared.p < level;
        compared
    };
    Some((0..machines.len()).map(compared).collect())
}

/// Returns the machines that are certainly not of the series.
fn find_outliers(machines: &[Estimate]) -> Vec<usize> {
    let most = (MAX_OUTLIER_FRACTION * machines.len() as f64).ceil() as usize;
    let mut rest: Vec<usize> = (0..machines.len()).collect();
    let (mut out, mut certain) = (Vec::new(), 0);
    while out.len() < most && rest.len() >= crate::random_effects::MIN_POOLED_MACHINES {
        let p = |index: usize| {
            let others = rest.iter().filter(|other| **other != index);
            let others: Vec<Estimate> = others.map(|other| machines[*other]).collect();
            run_predictive_test(machines[index], &others).p
        };
        let least = rest.iter().map(|index| (*index, p(*index)));
        let Some((index, p)) = least.min_by(|a, b| a.1.total_cmp(&b.1)) else { break };
        let tests = rest.len() as f64;
        rest.retain(|there| *there != index);
        out.push(index);
        if p * tests < OUTLIER_SIGNIFICANCE_LEVEL {
            certain = out.len();
        }
    }
    out.truncate(certain);
    out
}

fn run_predictive_test(machine: Estimate, others: &[Estimate]) -> PredictiveTestResult {
    let variance = paule_mandel_variance(others);
    let weight = |estimate: &Estimate| (estimate.se.powi(2) + variance).recip();
    let sum: f64 = others.iter().map(weight).sum();
    let predicted =
        others.iter().map(|estimate| weight(estimate) * estimate.value).sum::<f64>() / sum;
    let sd = (variance + machine.se.powi(2) + sum.recip()).sqrt();
    let t = (machine.value - predicted) / sd;
    let p = 2.0 * t_cdf(-t.abs(), others.len() as f64 - 1.0);
    PredictiveTestResult { predicted, t, p, is_odd: false }
}

/// Returns τ² by Paule and Mandel: with it the weighted squares are as large as their number; 0 where they are smaller
/// without any.
pub(crate) fn paule_mandel_variance(machines: &[Estimate]) -> f64 {
    let freedom = machines.len() as f64 - 1.0;
    let excess = |variance: f64| {
        let weight = |estimate: &Estimate| (estimate.se.powi(2) + variance).recip();
        let sum: f64 = machines.iter().map(weight).sum();
        let mean =
            machines.iter().map(|estimate| weight(estimate) * estimate.value).sum::<f64>() / sum;
        machines
            .iter()
            .map(|estimate| weight(estimate) * (estimate.value - mean).powi(2))
            .sum::<f64>()
            - freedom
    };
    if freedom < 1.0 || excess(0.0) <= 0.0 {
        return 0.0;
    }
    let mean = machines.iter().map(|estimate| estimate.value).sum::<f64>() / machines.len() as f64;
    // Squares over their number are as large as the largest square at most.
    let mut high = machines.iter().map(|estimate| (estimate.value - mean).powi(2)).sum::<f64>();
    let mut low = 0.0;
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if excess(middle) > 0.0 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Returns probabilities corrected for their number (Holm): how often the smallest of as many healthy ones is as small.
#[must_use]
pub(crate) fn holm_adjust(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|a, b| p[*a].total_cmp(&p[*b]));
    let mut adjusted = vec![1.0; p.len()];
    let mut largest: f64 = 0.0;
    for (rank, index) in order.into_iter().enumerate() {
        largest = largest.max(p[index] * (p.len() - rank) as f64).min(1.0);
        adjusted[index] = largest;
    }
    adjusted
}
