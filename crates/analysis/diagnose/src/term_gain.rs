//! The gain of a term.

use serde::Serialize;

use trueup_numerics::block_resampling::{RmsReduction, rms};

/// The gain of a term: errors before and after, RMS in µm, and their reduction on held-out blocks.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct TermGain {
    /// On the rows that were fitted.
    pub rms_before_um: f64,
    /// On the rows that were fitted.
    pub rms_after_um: f64,
    /// On blocks that were held out of the fit.
    pub left_out_before_um: f64,
    /// On blocks that were held out of the fit.
    pub left_out_after_um: f64,
    /// 1 − after/before, held out.
    pub reduction: f64,
    /// Its 95 % interval.
    pub ci95: [f64; 2],
}

impl TermGain {
    /// Of a model against the one before, from what both leave (in µm RMS) and what both leave in each
    /// group where that was held out.
    pub(crate) fn new(rms_um: [f64; 2], left_out: [&[f64]; 2], reduction: &RmsReduction) -> Self {
        let [rms_before_um, rms_after_um] = rms_um;
        let [left_out_before_um, left_out_after_um] = left_out.map(rms);
        Self {
            rms_before_um,
            rms_after_um,
            left_out_before_um,
            left_out_after_um,
            reduction: reduction.value,
            ci95: reduction.ci95,
        }
    }

    /// From means of rows to rows: `within` is the mean square that the means have lost.
    pub(crate) fn add_within_group_mean_square(&mut self, within: f64) {
        let group = (self.left_out_before_um, self.left_out_after_um);
        let row = |um: f64| (um * um + within).sqrt();
        let before = row(group.0);
        let reduction = |share: f64| {
            if before > 0.0 { 1.0 - row((1.0 - share) * group.0) / before } else { 0.0 }
        };
        self.ci95 = self.ci95.map(reduction);
        self.reduction = reduction(self.reduction);
        self.rms_before_um = row(self.rms_before_um);
        self.rms_after_um = row(self.rms_after_um);
        (self.left_out_before_um, self.left_out_after_um) = (before, row(group.1));
    }
}
