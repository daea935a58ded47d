//! Whether a lag stands for a part of the machine, or only takes the noise of a thermometer away. A part
//! comes late; what smooths as much and is not late, which no part can, does as well for the noise.

use trueup_machine::effect::Effect;

use crate::{
    blocks::Folds, fit::Problem, kind::Part, laws::Laws, model::Model, parameters::step_s,
    search::state::Search,
};

/// Smoothed over so many of its time constants: as much as the lag does, and as much as several of them do
/// that were found for the same noise.
const WIDTHS: [f64; 3] = [1.0, 2.0, 4.0];

/// Whether the model `without` a lag foresees as well as the one with it, which leaves `left_out` there, if
/// its thermometers are smoothed as much.
pub(crate) fn only_smooths(
    problem: &Problem,
    folds: &Folds,
    part: &Part,
    without: &Model,
    left_out: &[f64],
) -> bool {
    if !has_memory(part) {
        return false;
    }
    let column = part.kind.heat_path().map(|path| path.column);
    // A lag within a step smooths neighbours.
    let lag_s = part.values[0].max(step_s(problem));
    WIDTHS.iter().any(|times| {
        let smooth = Laws::smoothed(&problem.data, column, times * lag_s);
        let smooth = Problem::new(smooth, problem.groups.clone());
        let paired = folds.paired(&folds.left_out(&smooth, without), left_out);
        !paired.is_better()
    })
}

/// Whether the first value of a term is how late a thermometer, or what it shows, is.
fn has_memory(part: &Part) -> bool {
    let is_of_heat = |effect: &Effect| {
        effect.late().is_some() || effect.has_time_constant() && !effect.is_in_time()
    };
    part.kind.cause().is_some_and(is_of_heat)
}

impl Search<'_> {
    /// A lag that only smooths leaves: beside it the other terms have the wrong sizes.
    pub(super) fn drop_what_only_smooths(&mut self) {
        let mut index = 0;
        while index < self.added.len() {
            let cause = self.added[index].cause.clone();
            let part = self.fitted.model.parts.iter().find(|part| part.kind == cause).cloned();
            if let Some(part) = part.filter(has_memory) {
                let without = self.without(&cause);
                let left_out = self.foresight(&self.fitted);
                let folds = &self.folds;
                if only_smooths(self.problem, folds, &part, &without.model, &left_out) {
                    self.given_up.push(cause);
                    self.remove(index, without);
                    index = 0;
                    continue;
                }
            }
            index += 1;
        }
    }
}
