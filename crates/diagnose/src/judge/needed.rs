//! What a term gains where it was left out of the fit, alone and beside another one.

use trueup_numerics::blocks::rms;

use crate::{fit::fit, judge::case::Case, kind::Kind, model::Model, search::extend::without};

/// Whether a term still gains without the block on which it gains most. Tables and curves answer for
/// themselves, cycle by cycle.
pub(crate) fn gains_again(case: &Case<'_>, cause: &Kind, left_out_without: &[f64]) -> bool {
    cause.list_length().is_some() || case.paired(left_out_without).without_best > 0.0
}

/// A term with what the answer leaves without it where that was left out.
pub(crate) struct Alone<'a> {
    pub cause: &'a Kind,
    pub left_out_without: &'a [f64],
}

/// Two terms of the answer that only hold each other up.
pub(crate) struct Together {
    /// Their numbers.
    pub terms: [usize; 2],
    /// Whether the two gain on left-out blocks.
    pub is_gain: bool,
}

/// The pairs of terms that are only certain together: neither alone foresees better what was left out,
/// or the one takes back more of the other than it leaves.
pub(crate) fn only_together(case: &Case<'_>, terms: &[Alone<'_>]) -> Vec<Together> {
    let mut all = Vec::new();
    let effects: Vec<Vec<f64>> = terms.iter().map(|it| effect(case, it.cause)).collect();
    for first in 0..terms.len() {
        for second in first + 1..terms.len() {
            let pair = [&terms[first], &terms[second]];
            if pair.iter().any(|it| it.cause.list_length().is_some()) {
                continue;
            }
            let [one, other] = [&effects[first], &effects[second]];
            let sum: Vec<f64> = one.iter().zip(other).map(|(a, b)| a + b).collect();
            let is_taken_back = rms(&sum) < 0.5 * rms(one).min(rms(other));
            let neither = neither(case, pair[0].cause, pair[1].cause);
            let is_better = |after: &[f64]| case.folds().paired(&neither, after).is_better();
            let neither_gains = !pair.iter().any(|it| is_better(it.left_out_without));
            if is_taken_back || neither_gains {
                let is_gain = is_better(&case.left_out);
                all.push(Together { terms: [first, second], is_gain });
            }
        }
    }
    all
}

/// What is left on left-out blocks without either of two terms.
fn neither(case: &Case<'_>, one: &Kind, other: &Kind) -> Vec<f64> {
    let problem = case.problem;
    let model = without(problem, &case.found.fitted.model, one);
    let model = without(problem, &model, other);
    let model = fit(problem, &model, None).model;
    case.folds().left_out(problem, &model)
}

/// What a term of the answer adds to each group, less its mean: a constant is anybody's.
fn effect(case: &Case<'_>, cause: &Kind) -> Vec<f64> {
    let model = &case.found.fitted.model;
    let parts = model.parts.iter().filter(|part| part.kind != *cause).cloned().collect();
    let without = Model { parts, ..model.clone() };
    let [with, without] = [model, &without].map(|model| case.problem.predicted(model));
    let effect: Vec<f64> = with.iter().zip(&without).map(|(a, b)| a - b).collect();
    let mean = effect.iter().sum::<f64>() / effect.len().max(1) as f64;
    effect.into_iter().map(|e| e - mean).collect()
}
