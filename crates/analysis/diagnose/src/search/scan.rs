//! Which candidates explain more than noise would let them.
//!
//! Every candidate at every setting is projected out of the residual, next to what the model's own
//! values could absorb. Two statistics are kept for each:
//!
//! ```text
//! T = D₀ − D₁ − k·ln n              D = min over the noises of −2 ln(likelihood)
//! U = −m·ln(1 − R²) − k·ln m        m = independent rows of the residual
//! ```
//!
//! T lets the memory of the noise be another with the candidate than without: the memory that is
//! fitted without it may be the effect itself, and the one fitted with it is not biased by it. It
//! sees quick effects under slow noise, and smooth ones that leave white noise. U sees slow misfits
//! that the likelihood would leave to the noise.
//!
//! How large they get by chance is found by trying the same candidates, all of them, on noise that
//! is drawn with the memory of the residual: the largest value of each draw follows a Gumbel
//! distribution, whose upper quantile is the limit. So the false alarm rate is that of the whole
//! search, not of one test, whatever the columns are and however they resemble each other.

use trueup_numerics::{
    least_squares::normal_equations::dot,
    noise::{self, NoiseModel},
    parallel::parallel_map,
    random::RandomGenerator,
};

use crate::{
    candidates::CandidateTerm,
    fit::{FitProblem, FittedModel, jacobian, part_derivatives},
    model::Model,
    outliers::FALSE_POSITIVE_PROBABILITY,
    search::{
        model_comparison::{estimate_noise, max_autocorrelation_time},
        scan_statistics::{CandidateTrial, compute_scan_statistics},
    },
    term_kind::ModelPart,
};

/// Chance that noise passes the limit of one of the two statistics in one search: together that of a claim.
pub(crate) const FALSE_ALARM_PROBABILITY: f64 = FALSE_POSITIVE_PROBABILITY / 2.0;
/// Draws of noise: the scale of a Gumbel distribution from as many is known to 14 % (0.78/√n).
const NOISE_SIMULATION_COUNT: usize = 32;

/// A candidate at its best setting.
#[derive(Clone, Debug)]
pub(crate) struct ScanHit {
    /// Its number among the candidates.
    pub candidate: usize,
    pub part: ModelPart,
    /// Whether a constant comes with it.
    pub with_constant: bool,
    /// T and U.
    pub by_likelihood: f64,
    pub by_squares: f64,
    /// Whether either is above its limit.
    pub is_significant: bool,
    /// Whether T is.
    pub is_likely: bool,
    /// The share of the squares that it explains.
    pub explained: f64,
}

/// The outcome of a search.
pub(crate) struct ScanResult {
    /// The best setting of each candidate, with and without a constant.
    pub hits: Vec<ScanHit>,
    /// The limit of T, where noise had to be drawn.
    pub likelihood_limit: Option<f64>,
}

/// Returns what a part at these nonlinear values would add, in groups; whether its size is fixed.
fn effect_columns(
    problem: &FitProblem,
    model: &Model,
    here: &[f64],
    candidate: &CandidateTerm,
    setting: &[f64],
) -> (Vec<Vec<f64>>, bool) {
    let kind = &candidate.kind;
    if kind.as_stated_term().is_some() {
        // It is there already: what it may add is how it changes with its values.
        let mut with = model.clone();
        with.parts.push(ModelPart { kind: kind.clone(), values: setting.to_vec() });
        let columns = part_derivatives(problem, &with, model.parts.len());
        return (columns.into_iter().map(|(_, column)| column).collect(), false);
    }
    if kind.is_additive() {
        return (problem.basis_columns(kind, setting, true).to_vec(), false);
    }
    let is_fixed = kind.amplitude_count() == 0 && !kind.nonlinear_parameters().is_empty();
    let step = if is_fixed { 1.0 } else { 1e-4 };
    let mut values = setting.to_vec();
    values.resize(kind.nonlinear_parameters().len() + kind.amplitude_count(), step);
    let mut with = model.clone();
    with.parts.push(ModelPart { kind: kind.clone(), values });
    with.sort_parts();
    let there = problem.predict(&with);
    (vec![there.iter().zip(here).map(|(t, h)| (t - h) / step).collect()], is_fixed)
}

/// Whether noise is drawn for the limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NoiseSimulation {
    /// Nothing is decided by them.
    Skipped,
    /// Noises on a coarse grid: between its points any candidate seems to help, the limits are high,
    /// and what passes them does so whatever the noise is.
    Robust,
    /// The estimated noise is among them, and what it would be without its slow part: the
    /// limits are low, and right if the noise is as it is modelled.
    Sharp,
}

/// Tries `candidates` on what `base` leaves. Noise is drawn only if something may pass the limits.
pub(crate) fn scan(
    problem: &FitProblem,
    base: &FittedModel,
    candidates: &[CandidateTerm],
    draw: NoiseSimulation,
) -> ScanResult {
    let trials = build_trials(problem, &base.model, candidates);
    let (steps, residual) = (&problem.groups.steps, &base.residual);
    let rows = problem.groups.len();
    let (_, nuisance) = jacobian(problem, &base.model);
    let own = estimate_noise(problem, residual, nuisance.len());
    let independent = noise::effective_sample_size(own, steps).max(3.0);
    let noises = candidate_noise_models(problem, own, draw);
    let price: Vec<f64> =
        trials.iter().map(|trial| 2.0 * candidates[trial.candidate].searched).collect();
    let mut of_trials = Vec::new();
    let mut of = |lists: &[Vec<f64>]| {
        let mut all = compute_scan_statistics(
            &trials,
            &nuisance,
            lists,
            problem,
            &noises,
            independent,
            &mut of_trials,
        );
        for (values, price) in all.iter_mut().zip(&price) {
            values.iter_mut().flatten().for_each(|value| *value -= price);
        }
        all
    };
    let best = |all: &[Vec<[f64; 2]>], list: usize| {
        all.iter().fold([f64::NEG_INFINITY; 2], |best, values| {
            [0, 1].map(|which| best[which].max(values[list][which]))
        })
    };
    let real = of(std::slice::from_ref(residual));
    let may_pass = best(&real, 0).iter().any(|value| *value > 0.0);
    let limits = (draw != NoiseSimulation::Skipped && may_pass).then(|| {
        let sigma = (dot(residual, residual) / rows as f64).sqrt();
        let mut generator = RandomGenerator::new(0x7472_7565_7570 ^ rows as u64);
        let drawn: Vec<Vec<f64>> = (0..NOISE_SIMULATION_COUNT)
            .map(|_| {
                let mut e = noise::draw_noise(own, steps, &mut generator);
                e.iter_mut().for_each(|e| *e *= sigma);
                e
            })
            .collect();
        let all = of(&drawn);
        let most: Vec<[f64; 2]> =
            (0..NOISE_SIMULATION_COUNT).map(|draw| best(&all, draw)).collect();
        [0, 1].map(|which| gumbel_threshold(most.iter().map(|most| most[which])))
    });
    let mut hits: Vec<ScanHit> = Vec::new();
    for (number, trial) in trials.iter().enumerate() {
        let [by_likelihood, by_squares] = real[number][0];
        let candidate = &candidates[trial.candidate];
        let is_likely = limits.is_some_and(|[t, _]| by_likelihood > t);
        let is_significant = is_likely || limits.is_some_and(|[_, u]| by_squares > u);
        let mut values = trial.setting.clone();
        values.resize(candidate.kind.degrees_of_freedom(), 0.0);
        let gain = by_squares + price[number] + trial.degrees * independent.ln();
        let hit = ScanHit {
            candidate: trial.candidate,
            part: ModelPart { kind: candidate.kind.clone(), values },
            with_constant: trial.with_constant,
            by_likelihood,
            by_squares,
            is_significant,
            is_likely,
            explained: 1.0 - (-gain / independent).exp(),
        };
        let there = hits.iter_mut().find(|there| {
            there.candidate == hit.candidate && there.with_constant == hit.with_constant
        });
        match there {
            Some(there) => there.merge(hit),
            None => hits.push(hit),
        }
    }
    ScanResult { hits, likelihood_limit: limits.map(|[t, _]| t) }
}

impl ScanHit {
    /// Together with another setting of the same candidate: the values of the one that explains more
    /// of the squares, the best of the rest.
    fn merge(&mut self, other: Self) {
        let is_significant = self.is_significant || other.is_significant;
        let is_likely = self.is_likely || other.is_likely;
        let by_likelihood = self.by_likelihood.max(other.by_likelihood);
        if self.by_squares < other.by_squares {
            *self = other;
        }
        (self.is_significant, self.is_likely) = (is_significant, is_likely);
        self.by_likelihood = by_likelihood;
    }
}

/// Returns every candidate at every setting, with and without a constant.
fn build_trials(
    problem: &FitProblem,
    model: &Model,
    candidates: &[CandidateTerm],
) -> Vec<CandidateTrial> {
    let rows = problem.groups.len();
    let here = problem.predict(model);
    let mut trials = Vec::new();
    for (number, candidate) in candidates.iter().enumerate() {
        let effects =
            parallel_map(&candidate.settings, problem.is_parallel_worthwhile(), |setting| {
                effect_columns(problem, model, &here, candidate, setting)
            });
        for (setting, (columns, is_fixed)) in candidate.settings.iter().zip(effects) {
            if columns.iter().flatten().any(|value| !value.is_finite()) {
                continue;
            }
            let may_have = model.constant_um.is_none() && candidate.kind.has_reference();
            // As many values as can be distinguished from this many rows.
            let degrees = candidate.kind.degrees_of_freedom();
            if 3 * (degrees + 1) > rows {
                continue;
            }
            if may_have {
                let mut columns = columns.clone();
                columns.push(vec![1.0; rows]);
                trials.push(CandidateTrial {
                    candidate: number,
                    setting: setting.clone(),
                    with_constant: true,
                    is_fixed,
                    columns,
                    degrees: degrees as f64 + 1.0,
                });
            }
            trials.push(CandidateTrial {
                candidate: number,
                setting: setting.clone(),
                with_constant: false,
                is_fixed,
                columns,
                degrees: degrees as f64,
            });
        }
    }
    trials
}

/// Returns the noises that a candidate may choose from. Where nothing is decided by it, the estimated noise and
/// its extremes are enough.
fn candidate_noise_models(
    problem: &FitProblem,
    own: NoiseModel,
    draw: NoiseSimulation,
) -> Vec<NoiseModel> {
    if draw == NoiseSimulation::Skipped {
        let quick = NoiseModel { memory: (own.memory / 4.0).max(0.5), white: 0.3 };
        return vec![NoiseModel::WHITE, quick, own];
    }
    let mut noises = noise::noise_grid(max_autocorrelation_time(problem));
    if draw == NoiseSimulation::Sharp && own != NoiseModel::WHITE {
        let more = (2.0 * own.white + 0.1).min(0.9);
        for (memory, white) in [
            (own.memory, own.white),
            (own.memory, more),
            (own.memory / 3.0, own.white),
            (own.memory / 3.0, more),
        ] {
            noises.push(NoiseModel { memory, white });
        }
    }
    noises
}

/// Returns the value that the largest of a search on noise passes with the chance [`FALSE_ALARM_PROBABILITY`], by the
/// moments of a Gumbel distribution.
fn gumbel_threshold(values: impl Iterator<Item = f64>) -> f64 {
    const EULER_MASCHERONI: f64 = 0.577_215_664_901_532_9;
    let values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
    let scale = variance.sqrt() * 6.0_f64.sqrt() / std::f64::consts::PI;
    mean - EULER_MASCHERONI * scale - scale * (-(-FALSE_ALARM_PROBABILITY).ln_1p()).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_is_the_quantile_of_the_distribution_that_the_largest_follow() {
        // The quantiles of 8 + 2·G, G of the standard Gumbel distribution.
        let values = (0..2000).map(|n| 8.0 - 2.0 * (-((f64::from(n) + 0.5) / 2000.0).ln()).ln());
        let exact = 8.0 - 2.0 * (-(1.0 - FALSE_ALARM_PROBABILITY).ln()).ln();
        let limit = gumbel_threshold(values);
        assert!((limit - exact).abs() < 0.02 * exact, "{limit} {exact}");
    }
}
