//! The gain of a term on held-out blocks, alone and next to another one.

use crate::{
    fit::fit,
    judgement::context::JudgementContext,
    search::{
        extension::{centred_effect, effects_cancel, without_term},
        simplification::is_single_reading_gain,
    },
    term_gain::TermGain,
    term_kind::{ModelPart, TermKind},
};
use trueup_machine::effect::Effect;

/// Returns whether a term still gains without the block on which it gains most. Tables and curves answer for
/// themselves, cycle by cycle.
pub(crate) fn has_gain_without_best_block(
    case: &JudgementContext<'_>,
    cause: &TermKind,
    left_out_without: &[f64],
) -> bool {
    cause.list_length().is_some()
        || case.compare_paired(left_out_without).without_best > 0.0
            && !(cause.is_settling_from_start()
                && is_single_reading_gain(left_out_without, &case.left_out))
}

/// Returns whether the interval of what a term gains on held-out blocks includes zero, as that of its size must not.
/// Tables and curves answer for themselves.
pub(crate) fn is_zero_gain_within_interval(part: &ModelPart, gain: &TermGain) -> bool {
    part.kind.list_length().is_none() && gain.ci95[0] <= 0.0
}

/// Returns whether a term of the clock alone, a drift or a jump, also predicts the end of the record, where
/// whatever is not distinguished from it goes another way.
pub(crate) fn has_gain_at_record_end(
    case: &JudgementContext<'_>,
    cause: &TermKind,
    left_out_without: &[f64],
) -> bool {
    let is_of_clock =
        cause.cause().is_some_and(Effect::depends_on_time) && !cause.has_time_constant();
    !is_of_clock
        || case
            .folds()
            .gain_in_last_block(left_out_without, &case.left_out)
            .is_none_or(|gain| gain > 0.0)
}

/// A term with what the answer leaves without it where that was held out.
pub(crate) struct TermResiduals<'a> {
    pub cause: &'a TermKind,
    pub left_out_without: &'a [f64],
}

/// Two terms of the answer that only hold each other up.
pub(crate) struct CoupledTerms {
    /// Their numbers.
    pub terms: [usize; 2],
    /// Whether the two gain on held-out blocks.
    pub is_gain: bool,
}

/// Returns the pairs of terms that are only certain together: neither alone predicts better what was held out,
/// or the one takes back more of the other than it leaves.
pub(crate) fn find_coupled_terms(
    case: &JudgementContext<'_>,
    terms: &[TermResiduals<'_>],
) -> Vec<CoupledTerms> {
    let mut all = Vec::new();
    let fitted = &case.found.fitted;
    let effect =
        |residuals: &TermResiduals<'_>| centred_effect(case.problem, fitted, residuals.cause);
    let effects: Vec<Vec<f64>> = terms.iter().map(effect).collect();
    for first in 0..terms.len() {
        for second in first + 1..terms.len() {
            let pair = [&terms[first], &terms[second]];
            if pair.iter().any(|residuals| residuals.cause.list_length().is_some()) {
                continue;
            }
            let is_taken_back = effects_cancel(&effects[first], &effects[second]);
            let neither = held_out_residuals_without_both(case, pair[0].cause, pair[1].cause);
            let is_better =
                |after: &[f64]| case.folds().compare_paired(&neither, after).is_better();
            let neither_gains = !pair.iter().any(|residuals| is_better(residuals.left_out_without));
            if is_taken_back || neither_gains {
                let is_gain = is_better(&case.left_out);
                all.push(CoupledTerms { terms: [first, second], is_gain });
            }
        }
    }
    all
}

/// Returns what is left on held-out blocks without either of two terms.
fn held_out_residuals_without_both(
    case: &JudgementContext<'_>,
    one: &TermKind,
    other: &TermKind,
) -> Vec<f64> {
    let problem = case.problem;
    let model = without_term(problem, &case.found.fitted.model, one);
    let model = without_term(problem, &model, other);
    let model = fit(problem, &model, None).model;
    case.folds().held_out_residuals(problem, &model)
}
