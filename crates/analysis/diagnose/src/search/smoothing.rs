//! Whether a lag stands for a part of the machine, or only takes the noise of a thermometer away. A part
//! comes late; what smooths as much and is not late, which no part can, does as well for the noise.

use trueup_machine::effect::Effect;
use trueup_numerics::{blocks::Paired, parallel::on_all_cores};

use crate::{
    blocks::Folds,
    fit::{Fitted, Problem, fit},
    kind::Part,
    laws::Laws,
    model::Model,
    parameters::step_s,
    search::{
        criterion::{STRONG_EVIDENCE, bic},
        state::Search,
    },
};

/// Smoothed over this many of its time constants: as much as the lag does, and as much as several of them do
/// that were found for the same noise.
const WIDTHS: [f64; 3] = [1.0, 2.0, 4.0];

/// Returns whether the model `without` a lag foresees as well as the one with it, which leaves `left_out` there, if
/// its thermometers are smoothed as much.
pub(crate) fn only_smooths(
    problem: &Problem,
    folds: &Folds,
    part: &Part,
    without: &Model,
    left_out: &[f64],
) -> bool {
    smoothed_for(problem, part, |smooth| !against(folds, smooth, without, left_out).is_better())
}

/// Returns whether it holds for the data with thermometers that are smoothed as much as `part` does it, at any width;
/// not where it has no lag.
fn smoothed_for(problem: &Problem, part: &Part, holds: impl Fn(&Problem) -> bool + Sync) -> bool {
    // A lag within a step smooths neighbours.
    let lag_s = part.values.first().map_or(0.0, |lag_s| lag_s.max(step_s(problem)));
    let column = part.kind.column();
    let of = |times: &f64| {
        let smooth = Laws::smoothed(&problem.data, column.as_deref(), times * lag_s);
        holds(&Problem::new(smooth, problem.groups.clone()))
    };
    has_memory(part) && on_all_cores(&WIDTHS, problem.is_large(), of).contains(&true)
}

/// Returns what the lag leaves less than the model `without` it, where the thermometers are smooth.
fn against(folds: &Folds, smooth: &Problem, without: &Model, left_out: &[f64]) -> Paired {
    folds.paired(&folds.held_out(smooth, without), left_out)
}

/// Returns whether the first value of a term is how late a thermometer, or what it shows, is.
fn has_memory(part: &Part) -> bool {
    let is_of_heat = |effect: &Effect| {
        effect.late().is_some() || effect.has_time_constant() && !effect.is_in_time()
    };
    part.kind.cause().is_some_and(is_of_heat)
}

impl Search<'_> {
    /// A lag that only smooths leaves: next to it the other terms have the wrong sizes.
    pub(super) fn drop_what_only_smooths(&mut self) {
        while let Some((index, without)) = self.smoothing() {
            self.given_up.push(self.added[index].cause.clone());
            self.remove(index, without);
        }
    }

    /// Returns the first term that only smooths, also by all that is known of these rows, and the model without it.
    /// A term that these rows do not distinguish from smoothing must foresee better beyond doubt: noise that is
    /// smoothed in one way or in another makes a small difference by chance.
    fn smoothing(&self) -> Option<(usize, Fitted)> {
        let parts = &self.fitted.model.parts;
        let own = self.bic();
        let mut left_out = None;
        self.added.iter().enumerate().find_map(|(index, it)| {
            let part = parts.iter().find(|part| part.kind == it.cause && has_memory(part))?;
            let without = self.without(&it.cause);
            let left_out = left_out.get_or_insert_with(|| self.foresight(&self.fitted));
            let is_as_good = |smooth: &Problem| {
                let fitted = fit(smooth, &without.model, None);
                bic(smooth, &fitted) < own + STRONG_EVIDENCE
                    && !against(&self.folds, smooth, &without.model, left_out).is_certain()
            };
            let only_smooths = smoothed_for(self.problem, part, is_as_good);
            only_smooths.then_some((index, without))
        })
    }
}
