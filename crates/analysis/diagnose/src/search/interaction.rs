//! Causes that take two recorded inputs together: alone in the place of simpler terms, or a difference for two paths of
//! heat.

use trueup_machine::effect::LawInput;

use crate::{
    candidates::all_candidates,
    fit::{FitProblem, FittedModel, fit},
    search::{
        SearchScope,
        extension::{ModelExtension, centred_effect, effects_cancel, fit_extensions},
        model_comparison::{MAX_EQUIVALENT_RMS_RATIO, extended_bic_penalty},
        search_state::Search,
    },
    term_kind::{ModelPart, TermKind},
};

/// Those that are fitted in the place of all terms over a column.
const MAX_INTERACTION_REPLACEMENTS: usize = 10;

/// Returns what takes two inputs together comes last, next to simpler terms that have stood for it. Returns models with
/// one alone in the place of all terms of `fitted` that read the column of one of `causes`.
pub(crate) fn fit_interaction_replacements<'k>(
    problem: &FitProblem,
    fitted: &FittedModel,
    causes: impl IntoIterator<Item = &'k TermKind>,
) -> Vec<ModelExtension> {
    let mut columns: Vec<String> = causes.into_iter().filter_map(TermKind::column).collect();
    columns.sort_unstable();
    columns.dedup();
    let alone = columns.iter().flat_map(|column| {
        let is_of_it = |kind: &TermKind| {
            kind.as_stated_term().is_none() && kind.column().as_ref() == Some(column)
        };
        let mut model = fitted.model.clone();
        model.parts.retain(|part| !is_of_it(&part.kind));
        let base = fit(problem, &model, None);
        let mut candidates = all_candidates(problem, &base.model, &base.residual);
        candidates.retain(|candidate| candidate.kind.is_flexible() && is_of_it(&candidate.kind));
        fit_extensions(problem, &base, &candidates, MAX_INTERACTION_REPLACEMENTS)
    });
    alone.collect()
}

impl Search<'_> {
    /// Returns what a term that takes two inputs together pays for the choice among all of them.
    pub(super) fn interaction_penalty(&self) -> f64 {
        let fitted = &self.fitted;
        let all = all_candidates(self.problem, &fitted.model, &fitted.residual);
        extended_bic_penalty(all.len())
    }

    /// Returns whether a cause takes two inputs together and a term of the model that does so reads its column: several
    /// on one column make up a law that has no form here.
    pub(super) fn has_interaction_on_column(&self, cause: &TermKind) -> bool {
        let is_of_it = |there: &TermKind| there.is_flexible() && there.column() == cause.column();
        cause.is_flexible() && self.added.iter().any(|term| is_of_it(&term.cause))
    }

    /// Returns whether an extension takes two inputs together and takes back what another term adds: two that are
    /// wrong.
    pub(super) fn is_interaction_cancelling_other_term(&self, extension: &ModelExtension) -> bool {
        let effect = |kind: &TermKind| centred_effect(self.problem, &extension.fitted, kind);
        let others = extension.fitted.model.parts.iter().map(|part| &part.kind);
        let mut others = others.filter(|kind| **kind != extension.cause && kind.is_additive());
        extension.cause.is_flexible() && {
            let own = effect(&extension.cause);
            others.any(|other| effects_cancel(&own, &effect(other)))
        }
    }

    /// Two paths of heat may be the difference of two temperatures. Tries that in their place.
    pub(super) fn replace_heat_paths_by_difference(&mut self) {
        if self.breadth == SearchScope::Simple {
            return;
        }
        let paths: Vec<(TermKind, String)> = self
            .added
            .iter()
            .filter_map(|term| {
                Some((term.cause.clone(), term.cause.heat_path()?.column.to_owned()))
            })
            .filter(|(kind, _)| self.fitted.model.contains(kind) && kind.as_stated_term().is_none())
            .collect();
        for (number, (first, one)) in paths.iter().enumerate() {
            for (second, other) in &paths[number + 1..] {
                let Some(with) = self.fit_with_column_difference([first, second], [one, other])
                else {
                    continue;
                };
                let is_predicted = || {
                    self.held_out_rms_um(&with.fitted)
                        < MAX_EQUIVALENT_RMS_RATIO * self.held_out_rms_um(&self.fitted)
                };
                if with.bic < self.bic() && is_predicted() {
                    let Some(index) = self.added.iter().position(|term| term.cause == *first)
                    else {
                        return;
                    };
                    self.replace_term(index, with);
                    self.added.retain(|term| term.cause != *second);
                    return;
                }
            }
        }
    }

    /// Returns the model with the difference of two columns in the place of two paths.
    fn fit_with_column_difference(
        &self,
        paths: [&TermKind; 2],
        columns: [&str; 2],
    ) -> Option<ModelExtension> {
        let mut model = self.fitted.model.clone();
        let lags_s: Vec<f64> = model
            .parts
            .iter()
            .filter(|part| paths.contains(&&part.kind) && part.kind.has_time_constant())
            .map(|part| part.values[0])
            .collect();
        model.parts.retain(|part| !paths.contains(&&part.kind));
        let reads = |kind: &TermKind, column: &str| {
            kind.cause().is_some_and(|cause| {
                let of = |input: &LawInput<'_>| {
                    matches!(input, LawInput::Temperature { column: there, .. } if *there == column)
                };
                cause.required_inputs().iter().any(of)
            })
        };
        let all = all_candidates(self.problem, &model, &self.fitted.residual);
        let of_both = all.into_iter().filter(|candidate| {
            candidate.kind.is_flexible()
                && columns.iter().all(|column| reads(&candidate.kind, column))
        });
        let fitted = of_both.map(|candidate| {
            let kind = candidate.kind;
            let mut values = vec![0.0; kind.degrees_of_freedom()];
            if kind.has_time_constant() {
                let longest = |a: f64, b: f64| if a > 0.0 { (a * b).sqrt() } else { b };
                values[0] = lags_s.iter().copied().fold(0.0, longest);
                if values[0] == 0.0 {
                    values[0] = self.problem.bounds.step_s;
                }
            }
            let mut with = model.clone();
            with.parts.push(ModelPart { kind: kind.clone(), values });
            with.constant_um = with.constant_um.or(Some(0.0));
            with.sort_parts();
            ModelExtension::new(self.problem, kind, fit(self.problem, &with, None))
        });
        ModelExtension::best_by_bic(fitted)
    }
}
