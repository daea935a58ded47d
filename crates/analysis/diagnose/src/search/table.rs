//! A table that was measured several times is judged by its repeats, not by what noise would show: the
//! decision of [`trueup_numerics::repeats`], the same that `trueup fit pitch` takes.

use trueup_numerics::{
    blocks::rms,
    repeats::{self, Reading},
};

use crate::{
    fit::{Fitted, Problem, fit},
    gain::Gain,
    kind::{Kind, Part},
    model::Model,
    repeats::Targets,
    search::{
        criterion::degrees,
        state::{Added, Search},
    },
};

impl Search<'_> {
    /// Puts the table that the repeats call for in the place of all that goes with the axis's own position
    /// and direction, if it foresees what is left out better than that, or as well with fewer values.
    /// Whether it did.
    pub(crate) fn table_by_repeats(&mut self) -> bool {
        let problem = self.problem;
        if problem.groups.size != 1 {
            return false;
        }
        let rows = &problem.groups.first_row;
        let Some(targets) = Targets::of(&problem.data, rows.iter().copied()) else { return false };
        let base = without_own_axis(&self.fitted.model);
        let without = fit(problem, &base, None);
        let Some(terms) = decided(&targets, self, &without) else { return false };
        let mut model = base;
        model.parts.extend(terms.iter().cloned());
        model.sort();
        let with = fit(problem, &model, None);
        let [before, own, there] =
            [&without, &self.fitted, &with].map(|it| self.folds.held_out(problem, &it.model));
        let is_bare = without.model == self.fitted.model;
        let is_simpler = degrees(&with.model) < degrees(&self.fitted.model);
        let is_better = repeats::is_worse(&own, &there)
            || !is_bare && is_simpler && !repeats::is_worse(&there, &own);
        if !is_better || rms(&there) >= rms(&before) {
            return false;
        }
        let reduction = self.folds.reduction(&before, &there);
        let gain = Gain::new([without.rms(), with.rms()], [&before, &there], &reduction);
        self.fitted = with;
        self.added.retain(|it| !is_of_own_axis(&it.cause));
        let added = |term: Part| Added { cause: term.kind, gain, tried: Vec::new() };
        self.added.extend(terms.into_iter().map(added));
        true
    }
}

/// Returns whether a cause goes with the axis's own position and direction alone; what the machine file has is
/// its own.
pub(crate) fn is_of_own_axis(kind: &Kind) -> bool {
    kind.stated().is_none() && kind.cause().is_some_and(|it| it.is_along_own_axis())
}

/// Returns the model without what goes with the axis's own position and direction alone.
pub(crate) fn without_own_axis(model: &Model) -> Model {
    let mut without = model.clone();
    without.parts.retain(|part| !is_of_own_axis(&part.kind));
    without
}

/// Returns the terms that the repeats call for next to what `without` has.
fn decided(targets: &Targets, search: &Search<'_>, without: &Fitted) -> Option<Vec<Part>> {
    let problem = search.problem;
    let readings = beside_own_axis(targets, problem, &without.model);
    let none = vec![false; readings.len()];
    let laws = targets.laws(&problem.data);
    let decision = repeats::decide(&readings, &none, targets.at_mm.len(), &laws);
    targets.terms(decision.taken.ok()?)
}

/// Returns the readings with what `model` leaves of each group, which are rows here.
pub(crate) fn beside_own_axis(targets: &Targets, problem: &Problem, model: &Model) -> Vec<Reading> {
    let mut residual = vec![f64::NAN; problem.data.rows];
    let rows = problem.groups.first_row.iter();
    rows.zip(problem.residual(model)).for_each(|(&row, um)| residual[row] = um);
    targets.readings(|row| residual[row])
}
