//! How two models are compared: by the Bayesian information criterion,
//!
//! ```text
//! BIC = −2 ln(likelihood) + k·ln n          k fitted values, n groups of rows
//! ```
//!
//! with the memory of the noise estimated for each model from what it leaves; and by the RMS that they
//! leave on blocks that were left out of the fit.

use trueup_numerics::{
    blocks::rms,
    noise::{self, Noise},
};

use crate::{
    blocks::Folds,
    fit::{Fitted, Problem},
    model::Model,
};
/// The price of a term for the choice among n causes, in ln n: EBIC with γ = 1.
pub(crate) const CHOICE: f64 = 2.0;
/// Models whose BIC differs by less cannot be distinguished (from 6 on Kass and Raftery, 1995, speak of
/// strong evidence).
pub(crate) const STRONG_EVIDENCE: f64 = 6.0;

/// A model that leaves more than this times as much on left-out blocks or a hold-out (RMS) does not predict as well; the
/// fixed form of the answer says 5 % (`docs/reference.md`, Diagnosis).
pub(crate) const EQUAL_PREDICTION: f64 = 1.05;

/// The share beyond which something is the larger part: of an error, of a distance, of what is explained or taken back.
pub(crate) const MAJORITY: f64 = 0.5;

/// Returns how many values of `model` are fitted.
pub(crate) fn degrees(model: &Model) -> usize {
    let parts: usize = model.parts.iter().map(|part| part.kind.degrees()).sum();
    parts + usize::from(model.constant_um.is_some())
}

/// Returns the noise of a residual (in groups) that this many values were fitted to.
pub(crate) fn noise_of(problem: &Problem, residual: &[f64], degrees: usize) -> Noise {
    noise::estimate(residual, &problem.groups.steps, longest_memory(problem), degrees)
}

/// Returns the longest memory that noise is believed to have, in steps of the groups.
pub(crate) fn longest_memory(problem: &Problem) -> f64 {
    let groups = &problem.groups;
    (noise::longest_memory(groups.rows() as usize) / groups.size as f64).max(1.0)
}

/// Returns the BIC; smaller is better.
pub(crate) fn bic(problem: &Problem, fitted: &Fitted) -> f64 {
    // What is left may be another fit's than the model's.
    let what = format!("BIC of {:x}", fitted.sum.to_bits());
    *problem.known(&what, &fitted.model, || bic_of(problem, fitted))
}

fn bic_of(problem: &Problem, fitted: &Fitted) -> f64 {
    let noise = noise_of(problem, &fitted.residual, 0);
    let memory = if noise == Noise::WHITE { 0.0 } else { 2.0 };
    let rows = fitted.residual.len() as f64;
    noise::deviance(noise, &problem.groups.steps, &fitted.residual)
        + (degrees(&fitted.model) as f64 + memory) * rows.ln()
}

/// By how much the BIC of `other` is worse than that of `own`: by the likelihood, or by the squares
/// over the independent rows, whichever distinguishes them better. The likelihood is right where the
/// noise is as it is modelled; where a model is not quite right its quick part weighs too much.
pub(crate) fn bic_gap(problem: &Problem, own: &Fitted, other: &Fitted) -> f64 {
    let noise = noise_of(problem, &own.residual, degrees(&own.model));
    let independent = noise::effective_rows(noise, &problem.groups.steps).max(3.0);
    let by_squares = |fitted: &Fitted| {
        independent * fitted.sum.max(f64::MIN_POSITIVE).ln()
            + degrees(&fitted.model) as f64 * independent.ln()
    };
    let by_likelihood = bic(problem, other) - bic(problem, own);
    by_likelihood.max(by_squares(other) - by_squares(own))
}

/// Returns what `model` leaves on blocks that were left out of the fit in turn: RMS, in µm.
pub(crate) fn left_out_um(problem: &Problem, folds: &Folds, model: &Model) -> f64 {
    rms(&folds.held_out(problem, model))
}
