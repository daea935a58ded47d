//! Which terms of an elongation a tick has to walk through.
//!
//! | terms of the elongation | computed |
//! |---|---|
//! | no category | in every tick, in their order |
//! | by category, times 1 or n² | once for each message or step that changes them ([`TermStates`](super::TermStates)); a tick adds their sum |
//! | by category, times the growth | the same, and a product each in a tick |
//!
//! Terms by category add to what all others have made, wherever they stand in the blob.

use crate::term::{
    category::CategoryFactor,
    effect::{Effect, Target, Terms},
};

/// Returns how many terms there are up to the last of the elongation that is no category.
#[must_use]
pub fn elongation_term_prefix_length(terms: &Terms<'_>) -> usize {
    let is_walked = |term: &Option<super::Term<'_>>| {
        let of_elongation = term.as_ref().filter(|term| term.target == Target::Elongation);
        of_elongation.is_some_and(|term| category_factor(&term.effect).is_none())
    };
    terms.iter().rposition(is_walked).map_or(0, |last| last.saturating_add(1))
}

/// Returns what a term by category is multiplied by; none of another term.
#[must_use]
pub const fn category_factor(effect: &Effect<'_>) -> Option<CategoryFactor> {
    match effect {
        Effect::Tool(tools) => Some(tools.times),
        Effect::Condition(it) => Some(it.times),
        _ => None,
    }
}
