//! A table that was measured several times is judged by its repeats, not by what noise would show: the
//! decision of [`trueup_numerics::repeats`], the same that `trueup fit pitch` takes.

use trueup_numerics::{
    block_resampling::rms,
    repeats::{self, RepeatReading},
};

use crate::{
    fit::{FitProblem, FittedModel, fit},
    model::Model,
    repeats::TargetPositions,
    search::{
        model_comparison::degrees_of_freedom,
        search_state::{AddedTerm, Search},
    },
    term_gain::TermGain,
    term_kind::{ModelPart, TermKind},
};

impl Search<'_> {
    /// Puts the table that the repeats call for in the place of all that depends on the axis's own position
    /// and direction, if it predicts what is held out better than that, or as well with fewer values.
    /// Whether it did.
    pub(crate) fn apply_table_from_repeats(&mut self) -> bool {
        let problem = self.problem;
        if problem.groups.size != 1 {
            return false;
        }
        let rows = &problem.groups.first_row;
        let Some(targets) = TargetPositions::from_rows(&problem.data, rows.iter().copied()) else {
            return false;
        };
        let base = without_own_axis_terms(&self.fitted.model);
        let without = fit(problem, &base, None);
        let Some(terms) = terms_from_repeats(&targets, self, &without) else { return false };
        let mut model = base;
        model.parts.extend(terms.iter().cloned());
        model.sort_parts();
        let with = fit(problem, &model, None);
        let [before, own, there] = [&without, &self.fitted, &with]
            .map(|fitted| self.folds.held_out_residuals(problem, &fitted.model));
        let is_bare = without.model == self.fitted.model;
        let is_simpler = degrees_of_freedom(&with.model) < degrees_of_freedom(&self.fitted.model);
        let is_better = repeats::is_worse(&own, &there)
            || !is_bare && is_simpler && !repeats::is_worse(&there, &own);
        if !is_better || rms(&there) >= rms(&before) {
            return false;
        }
        let reduction = self.folds.rms_reduction(&before, &there);
        let gain = TermGain::new([without.rms(), with.rms()], [&before, &there], &reduction);
        self.fitted = with;
        self.added.retain(|term| !is_own_axis_term(&term.cause));
        let added = |term: ModelPart| AddedTerm { cause: term.kind, gain, tried: Vec::new() };
        self.added.extend(terms.into_iter().map(added));
        true
    }
}

/// Returns whether a cause depends on the axis's own position and direction alone; what the machine file has is
/// its own.
pub(crate) fn is_own_axis_term(kind: &TermKind) -> bool {
    kind.as_stated_term().is_none()
        && kind.cause().is_some_and(|cause| cause.depends_on_own_axis_only())
}

/// Returns the model without what depends on the axis's own position and direction alone.
pub(crate) fn without_own_axis_terms(model: &Model) -> Model {
    let mut without = model.clone();
    without.parts.retain(|part| !is_own_axis_term(&part.kind));
    without
}

/// Returns the terms that the repeats call for next to what `without` has.
fn terms_from_repeats(
    targets: &TargetPositions,
    search: &Search<'_>,
    without: &FittedModel,
) -> Option<Vec<ModelPart>> {
    let problem = search.problem;
    let readings = residual_readings(targets, problem, &without.model);
    let none = vec![false; readings.len()];
    let laws = targets.candidate_table_laws(&problem.data);
    let decision = repeats::select_table(&readings, &none, targets.at_mm.len(), &laws);
    targets.table_law_terms(decision.taken.ok()?)
}

/// Returns the readings with what `model` leaves of each group, which are rows here.
pub(crate) fn residual_readings(
    targets: &TargetPositions,
    problem: &FitProblem,
    model: &Model,
) -> Vec<RepeatReading> {
    let mut residual = vec![f64::NAN; problem.data.rows];
    let rows = problem.groups.first_row.iter();
    rows.zip(problem.residual(model)).for_each(|(&row, um)| residual[row] = um);
    targets.to_repeat_readings(|row| residual[row])
}
