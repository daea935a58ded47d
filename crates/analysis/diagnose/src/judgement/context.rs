//! The common data for judging the terms of an answer.

use trueup_numerics::block_resampling::{PairedComparison, rms};

use crate::{
    fit::{FitProblem, FittedModel},
    folds::Folds,
    model::Model,
    search::{
        SearchOutcome,
        model_comparison::{bic, bic_gap},
    },
    term_gain::TermGain,
};

/// An answer of the search, with what it leaves where that was held out.
pub(crate) struct JudgementContext<'c> {
    pub problem: &'c FitProblem,
    pub found: &'c SearchOutcome,
    /// The answer's residual in each group where that was held out of the fit, in µm.
    pub left_out: Vec<f64>,
    /// RMS of it.
    pub left_out_um: f64,
    /// The fits without each fold.
    pub folded: Vec<Model>,
}

impl<'c> JudgementContext<'c> {
    pub(crate) fn new(problem: &'c FitProblem, found: &'c SearchOutcome) -> Self {
        let (left_out, folded) =
            found.folds.held_out_residuals_and_models(problem, &found.fitted.model);
        Self { problem, found, left_out_um: rms(&left_out), left_out, folded }
    }

    /// Returns the answer's BIC.
    pub(crate) fn bic(&self) -> f64 {
        bic(self.problem, &self.found.fitted)
    }

    /// By how much the BIC of `other` is worse than the answer's.
    pub(crate) fn bic_gap(&self, other: &FittedModel) -> f64 {
        bic_gap(self.problem, &self.found.fitted, other)
    }

    /// By how much the BIC of `other` is worse than that of `own`; both with as many values.
    pub(crate) fn bic_gap_between(&self, own: &FittedModel, other: &FittedModel) -> f64 {
        bic_gap(self.problem, own, other)
    }

    /// Returns what is held out in turn.
    pub(crate) fn folds(&self) -> &Folds {
        &self.found.folds
    }

    /// Returns what `other` leaves on held-out blocks, in each group, in µm.
    pub(crate) fn held_out_residuals(&self, other: &FittedModel) -> Vec<f64> {
        self.folds().held_out_residuals(self.problem, &other.model)
    }

    /// Returns what `other` leaves on held-out blocks: RMS, in µm.
    pub(crate) fn held_out_rms_um(&self, other: &FittedModel) -> f64 {
        rms(&self.held_out_residuals(other))
    }

    /// Returns what the answer leaves less than `before` on held-out blocks.
    pub(crate) fn compare_paired(&self, before: &[f64]) -> PairedComparison {
        self.folds().compare_paired(before, &self.left_out)
    }

    /// Returns what the answer brings against `without`, which lacks a term and leaves `before` on held-out
    /// blocks.
    pub(crate) fn term_gain(&self, without: &FittedModel, before: &[f64]) -> TermGain {
        let reduction = self.folds().rms_reduction(before, &self.left_out);
        let rms_um = [without.rms(), self.found.fitted.rms()];
        TermGain::new(rms_um, [before, &self.left_out], &reduction)
    }
}
