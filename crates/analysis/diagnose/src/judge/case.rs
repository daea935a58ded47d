//! The common data for judging the terms of an answer.

use trueup_numerics::blocks::{Paired, rms};

use crate::{
    blocks::Folds,
    fit::{Fitted, Problem},
    gain::Gain,
    model::Model,
    search::{
        Found,
        criterion::{bic, bic_gap},
    },
};

/// An answer of the search, with what it leaves where that was left out.
pub(crate) struct Case<'c> {
    pub problem: &'c Problem,
    pub found: &'c Found,
    /// The answer's residual in each group where that was left out of the fit, in µm.
    pub left_out: Vec<f64>,
    /// RMS of it.
    pub left_out_um: f64,
    /// The fits without each fold.
    pub folded: Vec<Model>,
}

impl<'c> Case<'c> {
    pub(crate) fn new(problem: &'c Problem, found: &'c Found) -> Self {
        let (left_out, folded) = found.folds.left_out_with_models(problem, &found.fitted.model);
        Self { problem, found, left_out_um: rms(&left_out), left_out, folded }
    }

    /// Returns the answer's BIC.
    pub(crate) fn bic(&self) -> f64 {
        bic(self.problem, &self.found.fitted)
    }

    /// By how much the BIC of `other` is worse than the answer's.
    pub(crate) fn bic_gap(&self, other: &Fitted) -> f64 {
        bic_gap(self.problem, &self.found.fitted, other)
    }

    /// By how much the BIC of `other` is worse than that of `own`; both with as many values.
    pub(crate) fn gap_between(&self, own: &Fitted, other: &Fitted) -> f64 {
        bic_gap(self.problem, own, other)
    }

    /// Returns what is left out in turn.
    pub(crate) fn folds(&self) -> &Folds {
        &self.found.folds
    }

    /// Returns what `other` leaves on left-out blocks, in each group, in µm.
    pub(crate) fn left_out_of(&self, other: &Fitted) -> Vec<f64> {
        self.folds().held_out(self.problem, &other.model)
    }

    /// Returns what `other` leaves on left-out blocks: RMS, in µm.
    pub(crate) fn left_out_um_of(&self, other: &Fitted) -> f64 {
        rms(&self.left_out_of(other))
    }

    /// Returns what the answer leaves less than `before` on left-out blocks.
    pub(crate) fn paired(&self, before: &[f64]) -> Paired {
        self.folds().paired(before, &self.left_out)
    }

    /// Returns what the answer brings against `without`, which lacks a term and leaves `before` on left-out
    /// blocks.
    pub(crate) fn gain(&self, without: &Fitted, before: &[f64]) -> Gain {
        let reduction = self.folds().reduction(before, &self.left_out);
        let rms_um = [without.rms(), self.found.fitted.rms()];
        Gain::new(rms_um, [before, &self.left_out], &reduction)
    }
}
