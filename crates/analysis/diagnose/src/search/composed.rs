//! Causes that take two recorded inputs together: alone in the place of simpler terms, or a difference for two paths of
//! heat.

use trueup_machine::effect::Input;

use crate::{
    candidates::with_composed,
    fit::{Fitted, Problem, fit},
    kind::{Kind, Part},
    search::{
        Breadth,
        criterion::{CHOICE, EQUAL_PREDICTION},
        extend::{Extension, centred_effect, extensions, take_back},
        state::Search,
    },
};

/// Those that are fitted in the place of all terms over a column.
const MAX_ALONE: usize = 10;

/// Returns what takes two inputs together comes last, next to simpler terms that have stood for it. Returns models with
/// one alone in the place of all terms of `fitted` that read the column of one of `causes`.
pub(crate) fn alone_over_a_column<'k>(
    problem: &Problem,
    fitted: &Fitted,
    causes: impl IntoIterator<Item = &'k Kind>,
) -> Vec<Extension> {
    let mut columns: Vec<String> = causes.into_iter().filter_map(Kind::column).collect();
    columns.sort_unstable();
    columns.dedup();
    let alone = columns.iter().flat_map(|column| {
        let is_of_it =
            |kind: &Kind| kind.stated().is_none() && kind.column().as_ref() == Some(column);
        let mut model = fitted.model.clone();
        model.parts.retain(|part| !is_of_it(&part.kind));
        let base = fit(problem, &model, None);
        let mut candidates = with_composed(problem, &base.model, &base.residual);
        candidates.retain(|it| it.kind.is_composed() && is_of_it(&it.kind));
        extensions(problem, &base, &candidates, MAX_ALONE)
    });
    alone.collect()
}

impl Search<'_> {
    /// Returns what a term that takes two inputs together pays for the choice among all of them.
    pub(super) fn price_of_composed(&self) -> f64 {
        let fitted = &self.fitted;
        let all = with_composed(self.problem, &fitted.model, &fitted.residual);
        CHOICE * (all.len().max(1) as f64).ln()
    }

    /// Returns whether a cause takes two inputs together and a term of the model that does so reads its column: several
    /// on one column make up a law that has no form here.
    pub(super) fn has_composed_over_its_column(&self, cause: &Kind) -> bool {
        let is_of_it = |there: &Kind| there.is_composed() && there.column() == cause.column();
        cause.is_composed() && self.added.iter().any(|it| is_of_it(&it.cause))
    }

    /// Returns whether an extension takes two inputs together and takes back what another term adds: two that are
    /// wrong.
    pub(super) fn takes_back(&self, extension: &Extension) -> bool {
        let effect = |kind: &Kind| centred_effect(self.problem, &extension.fitted, kind);
        let others = extension.fitted.model.parts.iter().map(|part| &part.kind);
        let mut others = others.filter(|kind| **kind != extension.cause && kind.is_added());
        extension.cause.is_composed() && {
            let own = effect(&extension.cause);
            others.any(|other| take_back(&own, &effect(other)))
        }
    }

    /// Two paths of heat may be the difference of two temperatures. Tries that in their place.
    pub(super) fn difference_for_two_paths(&mut self) {
        if self.breadth == Breadth::Simple {
            return;
        }
        let paths: Vec<(Kind, String)> = self
            .added
            .iter()
            .filter_map(|it| Some((it.cause.clone(), it.cause.heat_path()?.column.to_owned())))
            .filter(|(kind, _)| self.fitted.model.has(kind) && kind.stated().is_none())
            .collect();
        for (number, (first, one)) in paths.iter().enumerate() {
            for (second, other) in &paths[number + 1..] {
                let Some(with) = self.with_difference([first, second], [one, other]) else {
                    continue;
                };
                let is_predicted = || {
                    self.left_out_um(&with.fitted)
                        < EQUAL_PREDICTION * self.left_out_um(&self.fitted)
                };
                if with.bic < self.bic() && is_predicted() {
                    let Some(index) = self.added.iter().position(|it| it.cause == *first) else {
                        return;
                    };
                    self.replace(index, with);
                    self.added.retain(|it| it.cause != *second);
                    return;
                }
            }
        }
    }

    /// Returns the model with the difference of two columns in the place of two paths.
    fn with_difference(&self, paths: [&Kind; 2], columns: [&str; 2]) -> Option<Extension> {
        let mut model = self.fitted.model.clone();
        let lags_s: Vec<f64> = model
            .parts
            .iter()
            .filter(|part| paths.contains(&&part.kind) && part.kind.has_time_constant())
            .map(|part| part.values[0])
            .collect();
        model.parts.retain(|part| !paths.contains(&&part.kind));
        let reads = |kind: &Kind, column: &str| {
            kind.cause().is_some_and(|cause| {
                let of = |input: &Input<'_>| {
                    matches!(input, Input::Temperature { column: there, .. } if *there == column)
                };
                cause.reads().iter().any(of)
            })
        };
        let all = with_composed(self.problem, &model, &self.fitted.residual);
        let of_both = all.into_iter().filter(|it| {
            it.kind.is_composed() && columns.iter().all(|column| reads(&it.kind, column))
        });
        let fitted = of_both.map(|candidate| {
            let kind = candidate.kind;
            let mut values = vec![0.0; kind.degrees()];
            if kind.has_time_constant() {
                let longest = |a: f64, b: f64| if a > 0.0 { (a * b).sqrt() } else { b };
                values[0] = lags_s.iter().copied().fold(0.0, longest);
                if values[0] == 0.0 {
                    values[0] = self.problem.bounds.step_s;
                }
            }
            let mut with = model.clone();
            with.parts.push(Part { kind: kind.clone(), values });
            with.constant_um = with.constant_um.or(Some(0.0));
            with.sort();
            Extension::new(self.problem, kind, fit(self.problem, &with, None))
        });
        Extension::best(fitted)
    }
}
