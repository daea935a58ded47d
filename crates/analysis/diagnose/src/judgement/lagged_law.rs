//! Whether a term only makes up for the form of a lagged law next to it, or for where that law stood at the start.
//!
//! Heat of a machine is behind its thermometer by a lag of the first order only nearly: it goes through one
//! body into the next, and where a record begins a body may stand anywhere between. The contribution of a small term to
//! such a law may be that. So a term next to a lagged law must
//!
//! ```text
//! do more that only it can do than a lag of the first order misses      if it depends on heat as well
//! be needed where the record's start is held out, in which 95 % of a    if it has no time constant
//! change of the law come
//! ```

use std::f64::consts::PI;

use trueup_numerics::{block_resampling::rms, noise};

use crate::{
    fit::{FittedModel, fit, settling_time_s},
    judgement::context::JudgementContext,
    search::{
        extension::{ModelExtension, centred_effect, fit_single_cause_extensions},
        model_comparison::{MAJORITY_FRACTION, STRONG_EVIDENCE_BIC_DIFFERENCE},
    },
    term_kind::{ModelPart, TermKind},
};

/// Lagged laws that are tried next to what settles from the start on.
const MAX_LAGGED_LAWS: usize = 4;

/// Returns the lagged law whose form may be all that `part` stands for; `without` lacks the part.
pub(crate) fn find_confounding_law(
    case: &JudgementContext<'_>,
    part: &ModelPart,
    without: &FittedModel,
) -> Option<TermKind> {
    let kind = &part.kind;
    let is_plain = kind
        .cause()
        .is_some_and(|cause| cause.is_constant() || kind.is_additive() && cause.depends_on_time());
    if is_plain || kind.list_length().is_some() || kind.is_instrument_error() || kind.has_instant()
    {
        return None;
    }
    let is_of_heat = kind.heat_path().is_some() || !kind.is_additive();
    let laws = case.found.fitted.model.parts.iter();
    let mut laws = laws.filter(|law| {
        law.kind != *kind && law.kind.has_time_constant() && !law.kind.is_settling_from_start()
    });
    let law = laws.find(|law| {
        is_of_heat && is_explained_by_law(case, law, without)
            || !kind.has_time_constant() && is_initial_transient(case, law, without)
    });
    law.map(|law| law.kind.clone())
}

/// Returns the lagged law of which `part`, which settles from the start on, may be where that law stood when the record
/// began: one of the answer, or one that was not found and predicts as well together with it.
pub(crate) fn find_initial_state_law(
    case: &JudgementContext<'_>,
    part: &ModelPart,
) -> Option<TermKind> {
    if !part.kind.is_settling_from_start() {
        return None;
    }
    let answer = &case.found.fitted;
    let begins = |fitted: &FittedModel| match fitted.model.find_initial_transient() {
        Some([start, late]) if start.kind == part.kind => Some(late.kind.clone()),
        _ => None,
    };
    let is_late = |cause: &TermKind| cause.heat_path().is_some_and(|path| path.has_lag);
    let is_rival = |extension: &ModelExtension| {
        case.bic_gap(&extension.fitted) < STRONG_EVIDENCE_BIC_DIFFERENCE
            && !case.compare_paired(&case.held_out_residuals(&extension.fitted)).is_better()
    };
    begins(answer).or_else(|| {
        let mut others =
            fit_single_cause_extensions(case.problem, answer, MAX_LAGGED_LAWS, is_late).into_iter();
        others.find_map(|extension| begins(&extension.fitted).filter(|_| is_rival(&extension)))
    })
}

/// Returns whether what nothing else does than the term that `without` lacks is less than `law` may miss.
fn is_explained_by_law(
    case: &JudgementContext<'_>,
    law: &ModelPart,
    without: &FittedModel,
) -> bool {
    let fitted = &case.found.fitted;
    let rows = fitted.residual.len() as f64;
    let own_um = ((without.sum - fitted.sum).max(0.0) / rows).sqrt();
    // The share of the mean temperature of a body heated from its side that is not of the slowest mode (Carslaw and
    // Jaeger, Conduction of Heat in Solids, 3.3).
    let missed = 1.0 - 8.0 / (PI * PI);
    own_um < missed * rms(&centred_effect(case.problem, fitted, &law.kind))
}

/// Returns whether the term that `without` lacks is not needed once `law` has settled.
fn is_initial_transient(
    case: &JudgementContext<'_>,
    law: &ModelPart,
    without: &FittedModel,
) -> bool {
    let (problem, found) = (case.problem, case.found);
    let Some(times) = problem.data.time_s() else { return false };
    let groups = &problem.groups;
    let mut start_s = f64::NAN;
    let mut series = None;
    let mask: Vec<bool> = (0..groups.len())
        .map(|group| {
            let row = groups.first_row[group];
            if series != Some(problem.data.places.series[row]) {
                (series, start_s) = (Some(problem.data.places.series[row]), times[row]);
            }
            times[row] - start_s > settling_time_s(law.values[0])
        })
        .collect();
    let left = mask.iter().filter(|is_left| **is_left).count() as f64 / mask.len() as f64;
    // Without most of the evidence the question is not fair.
    if left < MAJORITY_FRACTION {
        return false;
    }
    let squares = |fitted: &FittedModel| {
        let there = fit(problem, &fitted.model, Some(&mask));
        let rows = there.residual.iter().zip(&mask).filter(|(_, is_left)| **is_left);
        rows.map(|(residual, _)| residual * residual).sum::<f64>()
    };
    let [with, without_it] = [&found.fitted, without].map(squares);
    let independent = (left * noise::effective_sample_size(found.noise, &groups.steps)).max(3.0);
    let values = found.fitted.degrees.saturating_sub(without.degrees).max(1) as f64;
    independent * (without_it / with).ln() - values * independent.ln()
        < STRONG_EVIDENCE_BIC_DIFFERENCE
}
