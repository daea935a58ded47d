//! The residual of a model on data that nothing was fitted to: a hold-out, else the left-out blocks.
//!
//! A hold-out is compared as its file stands, before and after alike: a model keeps the zero that it was
//! fitted with, and never takes a new one to look better. Where blocks of the runs themselves are left
//! out, the arbitrary zero of an axis's measurement counts neither before nor after.

use trueup_numerics::blocks::rms;

use crate::{
    answer::errors::errors, blocks::Folds, data::Data, fit::Problem, model::Model, search::start,
};

/// Data that nothing was fitted to.
pub(super) struct Unseen<'u> {
    pub problem: &'u Problem,
    pub folds: &'u Folds,
    /// Mean square that the groups of the problem average away, in µm².
    pub within: f64,
    pub test: Option<&'u Data>,
}

impl Unseen<'_> {
    /// Returns what the machine file as it is leaves: RMS, in µm.
    pub(super) fn before_um(&self) -> f64 {
        let on_blocks = || {
            let zero = start(&self.problem.data);
            if zero.constant_um.is_none() {
                return self.by_row(&self.problem.residual(&zero));
            }
            self.by_row(&self.folds.held_out(self.problem, &zero))
        };
        self.test.map_or_else(on_blocks, |test| on_hold_out(test, &Model::default()))
    }

    /// Returns what `model` leaves; without terms it is the machine file as it is.
    pub(super) fn after_um(&self, model: &Model) -> f64 {
        if model.parts.is_empty() {
            return self.before_um();
        }
        let on_blocks = || self.by_row(&self.folds.held_out(self.problem, model));
        self.test.map_or_else(on_blocks, |test| on_hold_out(test, model))
    }

    fn by_row(&self, groups: &[f64]) -> f64 {
        (rms(groups).powi(2) + self.within).sqrt()
    }
}

/// Returns what `model` leaves on a hold-out: RMS, in µm.
pub(super) fn on_hold_out(test: &Data, model: &Model) -> f64 {
    rms(&errors(test, &model.predict(test), None))
}
