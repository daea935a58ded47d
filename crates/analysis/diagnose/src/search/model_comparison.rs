//! How two models are compared: by the Bayesian information criterion,
//!
//! ```text
//! BIC = −2 ln(likelihood) + k·ln n          k fitted values, n groups of rows
//! ```
//!
//! with the memory of the noise estimated for each model from what it leaves; and by the RMS that they
//! leave on blocks that were held out of the fit.

use trueup_numerics::{
    block_resampling::rms,
    noise::{self, NoiseModel},
};

use crate::{
    fit::{EQUIVALENCE_TOLERANCE, FitProblem, FittedModel},
    folds::Folds,
    model::Model,
};
/// Models whose BIC differs by less cannot be distinguished (from 6 on Kass and Raftery, 1995, speak of
/// strong evidence).
pub(crate) const STRONG_EVIDENCE_BIC_DIFFERENCE: f64 = 6.0;

/// A model that leaves more than this times as much on held-out blocks or a hold-out (RMS) does not predict as well.
pub(crate) const MAX_EQUIVALENT_RMS_RATIO: f64 = 1.0 + EQUIVALENCE_TOLERANCE;

/// A term is identified if held-out data leave at most this many times the mean square of the fitted data: a law that is right
/// leaves (n + k)/(n − k) times as much, twice at three independent rows for a value.
pub(crate) const MAX_HELD_OUT_SQUARES_RATIO: f64 = 2.0;

/// The share beyond which something is the larger part: of an error, of a distance, of what is explained or taken back.
pub(crate) const MAJORITY_FRACTION: f64 = 0.5;

/// Returns the price of a term for the choice among `count` causes: −2·ln of the chance 1/`count` of each, in units of BIC
/// (the extended BIC of Chen and Chen 2008, γ = 1).
pub(crate) fn extended_bic_penalty(count: usize) -> f64 {
    2.0 * (count.max(1) as f64).ln()
}

/// Returns how many values of `model` are fitted.
pub(crate) fn degrees_of_freedom(model: &Model) -> usize {
    let parts: usize = model.parts.iter().map(|part| part.kind.degrees_of_freedom()).sum();
    parts + usize::from(model.constant_um.is_some())
}

/// Returns the noise of a residual (in groups) that this many values were fitted to.
pub(crate) fn estimate_noise(problem: &FitProblem, residual: &[f64], degrees: usize) -> NoiseModel {
    noise::estimate(residual, &problem.groups.steps, max_autocorrelation_time(problem), degrees)
}

/// Returns the longest memory that noise is believed to have, in steps of the groups.
pub(crate) fn max_autocorrelation_time(problem: &FitProblem) -> f64 {
    let groups = &problem.groups;
    (noise::max_autocorrelation_time(groups.row_count() as usize) / groups.size as f64).max(1.0)
}

/// Returns the BIC; smaller is better.
pub(crate) fn bic(problem: &FitProblem, fitted: &FittedModel) -> f64 {
    // What is left may be another fit's than the model's.
    let what = format!("BIC of {:x}", fitted.sum.to_bits());
    *problem.memoise(&what, &fitted.model, || compute_bic(problem, fitted))
}

fn compute_bic(problem: &FitProblem, fitted: &FittedModel) -> f64 {
    let noise = estimate_noise(problem, &fitted.residual, 0);
    let memory = if noise == NoiseModel::WHITE { 0.0 } else { 2.0 };
    let rows = fitted.residual.len() as f64;
    noise::deviance(noise, &problem.groups.steps, &fitted.residual)
        + (degrees_of_freedom(&fitted.model) as f64 + memory) * rows.ln()
}

/// By how much the BIC of `other` is worse than that of `own`: by the likelihood, or by the squares
/// over the independent rows, whichever distinguishes them better. The likelihood is right where the
/// noise is as it is modelled; where a model is not quite right its quick part weighs too much.
pub(crate) fn bic_gap(problem: &FitProblem, own: &FittedModel, other: &FittedModel) -> f64 {
    let noise = estimate_noise(problem, &own.residual, degrees_of_freedom(&own.model));
    let independent = noise::effective_sample_size(noise, &problem.groups.steps).max(3.0);
    let by_squares = |fitted: &FittedModel| {
        independent * fitted.sum.max(f64::MIN_POSITIVE).ln()
            + degrees_of_freedom(&fitted.model) as f64 * independent.ln()
    };
    let by_likelihood = bic(problem, other) - bic(problem, own);
    by_likelihood.max(by_squares(other) - by_squares(own))
}

/// Returns what `model` leaves on blocks that were held out of the fit in turn: RMS, in µm.
pub(crate) fn held_out_rms_um(problem: &FitProblem, folds: &Folds, model: &Model) -> f64 {
    rms(&folds.held_out_residuals(problem, model))
}
