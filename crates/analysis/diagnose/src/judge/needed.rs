//! The gain of a term where it was left out of the fit, alone and next to another one.

use crate::{
    fit::fit,
    gain::Gain,
    judge::case::Case,
    kind::{Kind, Part},
    search::{
        extend::{centred_effect, take_back, without},
        simplify::hangs_on_one_reading,
    },
};
use trueup_machine::effect::Effect;

/// Returns whether a term still gains without the block on which it gains most. Tables and curves answer for
/// themselves, cycle by cycle.
pub(crate) fn gains_again(case: &Case<'_>, cause: &Kind, left_out_without: &[f64]) -> bool {
    cause.list_length().is_some()
        || case.paired(left_out_without).without_best > 0.0
            && !(cause.is_from_the_start()
                && hangs_on_one_reading(left_out_without, &case.left_out))
}

/// Returns whether the interval of what a term gains on left-out blocks holds nothing, as that of its size must not.
/// Tables and curves answer for themselves.
pub(crate) fn may_gain_nothing(part: &Part, gain: &Gain) -> bool {
    part.kind.list_length().is_none() && gain.ci95[0] <= 0.0
}

/// Returns whether a term of the clock alone, a drift or a jump, also foresees the end of the record, where
/// whatever is not distinguished from it goes another way.
pub(crate) fn goes_on(case: &Case<'_>, cause: &Kind, left_out_without: &[f64]) -> bool {
    let is_of_clock = cause.cause().is_some_and(Effect::is_in_time) && !cause.has_time_constant();
    !is_of_clock
        || case
            .folds()
            .gain_at_the_end(left_out_without, &case.left_out)
            .is_none_or(|gain| gain > 0.0)
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

/// Returns the pairs of terms that are only certain together: neither alone foresees better what was left out,
/// or the one takes back more of the other than it leaves.
pub(crate) fn only_together(case: &Case<'_>, terms: &[Alone<'_>]) -> Vec<Together> {
    let mut all = Vec::new();
    let fitted = &case.found.fitted;
    let effect = |it: &Alone<'_>| centred_effect(case.problem, fitted, it.cause);
    let effects: Vec<Vec<f64>> = terms.iter().map(effect).collect();
    for first in 0..terms.len() {
        for second in first + 1..terms.len() {
            let pair = [&terms[first], &terms[second]];
            if pair.iter().any(|it| it.cause.list_length().is_some()) {
                continue;
            }
            let is_taken_back = take_back(&effects[first], &effects[second]);
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

/// Returns what is left on left-out blocks without either of two terms.
fn neither(case: &Case<'_>, one: &Kind, other: &Kind) -> Vec<f64> {
    let problem = case.problem;
    let model = without(problem, &case.found.fitted.model, one);
    let model = without(problem, &model, other);
    let model = fit(problem, &model, None).model;
    case.folds().held_out(problem, &model)
}
