//! Whether a lag stands for a part of the machine, or only takes the noise of a thermometer away. A part
//! comes late; what smooths as much and is not late, which no part can, does as well for the noise.

use trueup_machine::effect::Effect;
use trueup_numerics::{block_resampling::PairedComparison, parallel::parallel_map};

use crate::{
    fit::{FitProblem, FittedModel, fit},
    folds::Folds,
    machine_laws::MachineLaws,
    model::Model,
    parameter_estimates::mean_row_interval_s,
    search::{
        model_comparison::{STRONG_EVIDENCE_BIC_DIFFERENCE, bic},
        search_state::Search,
    },
    term_kind::ModelPart,
};

/// Smoothed over this many of its time constants: as much as the lag does, and as much as several of them do
/// that were found for the same noise.
const SMOOTHING_WIDTH_TIME_CONSTANTS: [f64; 3] = [1.0, 2.0, 4.0];

/// Returns whether the model `without` a lag predicts as well as the one with it, which leaves `left_out` there, if
/// its thermometers are smoothed as much.
pub(crate) fn is_only_smoothing(
    problem: &FitProblem,
    folds: &Folds,
    part: &ModelPart,
    without: &Model,
    left_out: &[f64],
) -> bool {
    holds_with_smoothing(problem, part, |smooth| {
        !gain_over_smoothing(folds, smooth, without, left_out).is_better()
    })
}

/// Returns whether it holds for the data with thermometers that are smoothed as much as `part` does it, at any width;
/// not where it has no lag.
fn holds_with_smoothing(
    problem: &FitProblem,
    part: &ModelPart,
    holds: impl Fn(&FitProblem) -> bool + Sync,
) -> bool {
    // A lag within a step smooths neighbours.
    let lag_s = part.values.first().map_or(0.0, |lag_s| lag_s.max(mean_row_interval_s(problem)));
    let column = part.kind.column();
    let of = |times: &f64| {
        let smooth = MachineLaws::table_with_smooth_temperatures(
            &problem.data,
            column.as_deref(),
            times * lag_s,
        );
        holds(&FitProblem::new(smooth, problem.groups.clone()))
    };
    is_lagged_term(part)
        && parallel_map(&SMOOTHING_WIDTH_TIME_CONSTANTS, problem.is_parallel_worthwhile(), of)
            .contains(&true)
}

/// Returns what the lag leaves less than the model `without` it, where the thermometers are smooth.
fn gain_over_smoothing(
    folds: &Folds,
    smooth: &FitProblem,
    without: &Model,
    left_out: &[f64],
) -> PairedComparison {
    folds.compare_paired(&folds.held_out_residuals(smooth, without), left_out)
}

/// Returns whether the first value of a term is how late a thermometer, or what it shows, is.
fn is_lagged_term(part: &ModelPart) -> bool {
    let is_of_heat = |effect: &Effect| {
        effect.thermometer_delay().is_some()
            || effect.has_time_constant() && !effect.depends_on_time()
    };
    part.kind.cause().is_some_and(is_of_heat)
}

impl Search<'_> {
    /// A lag that only smooths leaves: next to it the other terms have the wrong sizes.
    pub(super) fn drop_smoothing_lags(&mut self) {
        while let Some((index, without)) = self.find_smoothing_term() {
            self.given_up.push(self.added[index].cause.clone());
            self.remove_term(index, without);
        }
    }

    /// Returns the first term that only smooths, also by all that is known of these rows, and the model without it.
    /// A term that these rows do not distinguish from smoothing must predict better beyond doubt: noise that is
    /// smoothed in one way or in another makes a small difference by chance.
    fn find_smoothing_term(&self) -> Option<(usize, FittedModel)> {
        let parts = &self.fitted.model.parts;
        let own = self.bic();
        let mut left_out = None;
        self.added.iter().enumerate().find_map(|(index, term)| {
            let part = parts.iter().find(|part| part.kind == term.cause && is_lagged_term(part))?;
            let without = self.refit_without(&term.cause);
            let left_out = left_out.get_or_insert_with(|| self.held_out_residuals(&self.fitted));
            let is_as_good = |smooth: &FitProblem| {
                let fitted = fit(smooth, &without.model, None);
                bic(smooth, &fitted) < own + STRONG_EVIDENCE_BIC_DIFFERENCE
                    && !gain_over_smoothing(&self.folds, smooth, &without.model, left_out)
                        .is_significant()
            };
            let is_only_smoothing = holds_with_smoothing(self.problem, part, is_as_good);
            is_only_smoothing.then_some((index, without))
        })
    }
}
