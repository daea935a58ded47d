//! The residual of a model on data not used for the fit: a hold-out, else the held-out blocks.
//!
//! A hold-out is compared as its file stands, before and after alike: a model keeps the zero that it was
//! fitted with, and never takes a new one to look better. Where blocks of the runs themselves are held
//! out, the arbitrary zero of an axis's measurement counts neither before nor after.

use trueup_numerics::block_resampling::rms;

use crate::{
    data::DataTable, diagnosis::residuals::compute_residuals, fit::FitProblem, folds::Folds,
    model::Model, search::initial_model,
};

/// Data not used for the fit.
pub(super) struct ValidationData<'u> {
    pub problem: &'u FitProblem,
    pub folds: &'u Folds,
    /// Mean square that the groups of the problem average away, in µm².
    pub within: f64,
    pub test: Option<&'u DataTable>,
}

impl ValidationData<'_> {
    /// Returns what the current machine file leaves: RMS, in µm.
    pub(super) fn current_file_residual_rms_um(&self) -> f64 {
        let on_blocks = || {
            let zero = initial_model(&self.problem.data);
            if zero.constant_um.is_none() {
                return self.rms_over_rows(&self.problem.residual(&zero));
            }
            self.rms_over_rows(&self.folds.held_out_residuals(self.problem, &zero))
        };
        self.test.map_or_else(on_blocks, |test| hold_out_residual_rms_um(test, &Model::default()))
    }

    /// Returns what `model` leaves; without terms it is the current machine file.
    pub(super) fn model_residual_rms_um(&self, model: &Model) -> f64 {
        if model.parts.is_empty() {
            return self.current_file_residual_rms_um();
        }
        let on_blocks = || self.rms_over_rows(&self.folds.held_out_residuals(self.problem, model));
        self.test.map_or_else(on_blocks, |test| hold_out_residual_rms_um(test, model))
    }

    fn rms_over_rows(&self, groups: &[f64]) -> f64 {
        (rms(groups).powi(2) + self.within).sqrt()
    }
}

/// Returns what `model` leaves on a hold-out: RMS, in µm.
pub(super) fn hold_out_residual_rms_um(test: &DataTable, model: &Model) -> f64 {
    rms(&compute_residuals(test, &model.predict(test), None))
}
