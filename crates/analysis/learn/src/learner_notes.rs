//! Sentences for the user about what was learned from a record.

use crate::{
    filter_bank::DECISION_LIKELIHOOD_RATIO, filter_history::FilterHistory,
    learning_limits::LearningLimits,
};

/// Returns which of the two is believed, in a sentence.
pub(crate) fn describe_applied_model(believed: &FilterHistory) -> String {
    let bank = &believed.bank;
    let (count, file_um, own_um) = bank.mean_absolute_errors_um();
    let figures = match count {
        0 => "no reading has been used yet".into(),
        _ => format!(
            "before their use, the last {count} readings differed from the current machine file by {file_um:.2} µm on average, from the learned constants by {own_um:.2} µm"
        ),
    };
    let odds = bank.likelihood_ratio();
    match bank.learned_values_if_applied() {
        Some(_) => format!("What was learned is applied: {figures}."),
        None => format!(
            "The current machine file stays: {figures}; they are {odds:.0} times likelier by what was learned, and \
             {DECISION_LIKELIHOOD_RATIO:.0} times would be enough."
        ),
    }
}

/// Returns the advice to measure again where a bound was reached.
pub(crate) fn describe_reached_bound(limits: &LearningLimits) -> String {
    format!(
        "A bound was reached ({:.0} % of a constant, or {} µm together): the machine is no longer the one \
         that was measured. Measure it again: trueup fit, or trueup diagnose.",
        100.0 * limits.share,
        limits.total_um
    )
}
