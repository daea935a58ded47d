//! The judgement of one term of the answer: its rivals, whether its name is claimed, its gain.
//!
//! A name is claimed where
//!
//! ```text
//! no other cause in its place scores within 6 (BIC) and         else: the two cannot be distinguished
//! predicts held-out blocks as well, nor does the same cause
//! by another column do either
//! whole records that were held out are predicted as if fitted   else: not yet identified
//! to; or its time constant is known or short, what is held
//! out is predicted, and a slow path was seen more than once
//! the interval of its size excludes zero, and no                else: not certain
//! value of it is where its search ends
//! its time constant is no longer than the record                else: where it ends was not seen
//! it is not as fast from the start on as a lagged law with it   else: it may be where that law stood
//! it does more than a lagged law with it may miss, and is       else: it may make up for the form of
//! needed without the start                                      that law
//! it gains on held-out blocks, also without the one on which    else: seen once
//! it gains most
//! the interval of that gain excludes zero                       else: it may gain nothing
//! a drift or a jump predicts the end of the record              else: it does not go on
//! a lag predicts better than smoothing that is not late         else: it smooths a thermometer
//! it gains without each other term, and no other term takes     else: only certain together
//! back what it does
//! it is needed whichever rival of another term is right         else: it depends on that question
//! of a path of heat: no other path is open                      else: with other rows another one is
//! it has an input of its own (a jump, a drift, an offset and a     else: it may be what an open term lacks
//! curvature have none), or no other term is open
//! the position came back, of a line or a wave over it          else: it may be a drift, or depend on time
//! a wave of the instrument's own is resolved, and turns more    else: the machine may be so between
//! often than a table next to it over the position has points    the table's points
//! its values are the same in both halves of the record          else: both are reported
//! no other period or time constant of its own does as well      else: aliases
//! no curve in its place explains clearly more, nor does         else: something depends on its inputs,
//! another scale of the model from a speed on do as well         but by another law
//! it is still needed with a curve in the place of such a term   else: it makes up for that term
//! ```
//!
//! A table that was measured several times is judged by its repeats in the place of the last three.
//!
//! A rival that can imitate the term and needs more values for it is no rival: it says the same and
//! more, and the search has found the rest of it to be noise. A curve (over a column, over a position
//! and growing with another one, over the way since a reversal) explains clearly more if its score is
//! better, the term explains less than nine tenths of the squares that it does (R² below 0.9), next to
//! it less than half of what the term explains is left to it, and it predicts held-out blocks better.
//! Where it is shown that what the answer leaves depends on the same inputs, the score and the half are enough.
//!
//! Of causes that cannot be distinguished a term is kept if all give the same correction, within the
//! error that remains anyway.

mod aliases;
mod alternatives;
mod caveat;
mod context;
mod held_out_gain;
mod identifiability;
mod instrument_error;
mod lagged_law;
pub(crate) mod repeat_evidence;
mod substitute_curves;

use serde_json::{Map, Value};
use trueup_numerics::parallel::parallel_map;

use crate::search::smoothing::is_only_smoothing;
use crate::{
    fit::{FitProblem, FittedModel, find_largest_half_difference, fit},
    model::Model,
    parameter_estimates::{ParameterEstimates, estimate_parameters},
    search::{
        AddedTerm, SearchOutcome,
        extension::{fit_replacements, without_term},
        interaction::fit_interaction_replacements,
        lack_of_fit::CurveInputs,
        model_comparison::{STRONG_EVIDENCE_BIC_DIFFERENCE, bic},
        range_bound,
    },
    term_gain::TermGain,
    term_kind::{ModelPart, TermKind},
};
use aliases::find_aliases;
use alternatives::{FittedAlternative, find_alternatives, have_equal_predictions};
pub(crate) use caveat::Caveat;
use context::JudgementContext;
use held_out_gain::{
    TermResiduals, find_coupled_terms, has_gain_at_record_end, has_gain_without_best_block,
    is_zero_gain_within_interval,
};
use identifiability::is_identified;
use instrument_error::find_insufficient_table;
use lagged_law::{find_confounding_law, find_initial_state_law};
use repeat_evidence::{InterpolationAccuracy, evaluate_repeats};
use substitute_curves::SubstituteCurves;

/// A profile interval of 95 %: the quantile of χ² with one degree of freedom.
const CHI_SQUARED_QUANTILE_95: f64 = 3.84;

/// The judgement of one term.
pub(crate) struct TermJudgement {
    pub part: ModelPart,
    /// Its values with their intervals, by name.
    pub parameters: Map<String, Value>,
    /// Its gain next to all other terms.
    pub gain: TermGain,
    /// Its gain when it was added.
    pub first_gain: TermGain,
    /// The best first.
    pub rivals: Vec<FittedAlternative>,
    /// Of what acts in a range alone: where its bound may be, at 95 %.
    pub bound: Option<[f64; 2]>,
    /// Why its name is not claimed; empty: it is.
    pub doubts: Vec<Caveat>,
    /// Whether its correction is right whichever name is: it goes into the extended machine file.
    pub is_kept: bool,
    /// Of a table that was measured several times: what is known between its points.
    pub between: Option<InterpolationAccuracy>,
    /// The residual of the answer without it on held-out blocks, in each group, in µm.
    left_out_without: Vec<f64>,
}

impl TermJudgement {
    pub(crate) fn cause(&self) -> &TermKind {
        &self.part.kind
    }

    /// Returns the inputs of another law that does better, if there is one.
    pub(crate) fn better_law_inputs(&self) -> Option<&CurveInputs> {
        self.doubts.iter().find_map(|doubt| match doubt {
            Caveat::BetterLaw(inputs) => Some(inputs),
            _ => None,
        })
    }

    /// Returns whether another record would show it otherwise.
    pub(crate) fn is_record_specific(&self) -> bool {
        self.doubts.iter().any(Caveat::is_record_specific)
    }

    /// Returns whether it may be where a lagged law stood when the record began.
    pub(crate) fn may_be_initial_state(&self) -> bool {
        self.doubts.iter().any(|doubt| matches!(doubt, Caveat::InitialTransientOf(_)))
    }

    /// Of the cause against the best rival, 0…1.
    pub(crate) fn confidence(&self) -> f64 {
        let others = self.rivals.iter().filter(|rival| rival.differs_from(self.cause()));
        let gap = others.map(|rival| rival.bic_gap).fold(f64::INFINITY, f64::min);
        let confidence = 1.0 / (1.0 + (-0.5 * gap.min(40.0)).exp());
        let is_of_law =
            |doubt: &Caveat| matches!(doubt, Caveat::BetterLaw(_) | Caveat::OnlyNextToOtherLaw);
        if self.doubts.iter().any(is_of_law) { confidence.min(0.5) } else { confidence }
    }
}

/// Judges each term of an answer.
pub(crate) fn judge_terms(problem: &FitProblem, found: &SearchOutcome) -> Vec<TermJudgement> {
    let case = JudgementContext::new(problem, found);
    let judged = parallel_map(&found.added, problem.is_parallel_worthwhile(), |added| {
        judge_term(&case, added)
    });
    let mut judged: Vec<TermJudgement> = judged.into_iter().flatten().collect();
    withdraw_coupled_term_claims(&case, &mut judged);
    withdraw_alternative_dependent_claims(&case, &mut judged);
    withdraw_constant_claims_near_bounds(&mut judged);
    withdraw_substitute_law_dependent_claims(&case, &mut judged);
    withdraw_open_term_part_claims(&mut judged);
    drop_terms_of_uncertain_size(&mut judged);
    judged
}

/// Returns another law that, alone in the place of all terms that read the column of `cause`, does as well; of what
/// takes two inputs together.
fn find_equivalent_interaction(case: &JudgementContext<'_>, cause: &TermKind) -> Option<TermKind> {
    if !cause.is_flexible() {
        return None;
    }
    // Several terms over one column make up a law that has no form here.
    let mut others = case.found.added.iter().map(|term| &term.cause);
    if let Some(other) = others.find(|other| *other != cause && other.column() == cause.column()) {
        return Some(other.clone());
    }
    let alone = fit_interaction_replacements(case.problem, &case.found.fitted, [cause]);
    let other =
        alone.into_iter().filter(|extension| !case.found.fitted.model.contains(&extension.cause));
    let near = other.filter(|extension| {
        extension.cause.name() != cause.name()
            && case.bic_gap(&extension.fitted) < STRONG_EVIDENCE_BIC_DIFFERENCE
    });
    near.min_by(|a, b| a.bic.total_cmp(&b.bic)).map(|extension| extension.cause)
}

/// None where the term is no part of the answer any more.
fn judge_term(case: &JudgementContext<'_>, added: &AddedTerm) -> Option<TermJudgement> {
    let JudgementContext { problem, found, .. } = *case;
    let cause = &added.cause;
    let part = found.fitted.model.parts.iter().find(|part| part.kind == *cause)?;
    let places = fit_replacements(problem, &found.fitted, cause, 8);
    let without = places.without.clone();
    let rivals = find_alternatives(case, cause, places);
    let estimates = estimate_parameters(problem, &found.fitted, part, found.noise);
    let left_out_without = case.held_out_residuals(&without);
    let gain = case.term_gain(&without, &left_out_without);
    let open: Vec<&FittedAlternative> =
        rivals.iter().filter(|rival| rival.is_indistinguishable_from(cause)).collect();
    let mut doubts = Vec::new();
    doubts.extend(open.first().map(|rival| Caveat::AlternativeCause(rival.cause.clone())));
    if doubts.is_empty() {
        doubts.extend(find_equivalent_interaction(case, cause).map(Caveat::AlternativeCause));
    }
    doubts.extend(find_insufficient_table(case, part).map(Caveat::AbsorbedByFinerTable));
    let setting = &problem.data.setting;
    let rival = cause.cause().and_then(|effect| {
        effect.rival_in_one_pass(setting.quantity.axis(), &setting.passed_columns)
    });
    doubts.extend(rival.map(Caveat::SinglePass));
    let repeat_evidence = evaluate_repeats(case, cause);
    match &repeat_evidence {
        // Its repeats are the judge of a table, not what it leaves.
        Some(repeat_evidence) if repeat_evidence.is_confirmed => {}
        Some(_) => doubts.push(Caveat::NotRepeatable),
        None => {
            doubts.extend(find_value_caveats(case, part, &without, &estimates, &left_out_without));
            doubts
                .extend(is_zero_gain_within_interval(part, &gain).then_some(Caveat::GainMayBeZero));
            let is_known = estimates.is_determined;
            doubts.extend(find_identification_caveats(case, cause, &without, is_known));
        }
    }
    // What may be nothing, or another wave between the places, is corrected only if it is predicted.
    let is_predicted = case.compare_paired(&left_out_without).is_better();
    let is_alias_of_wave =
        cause.has_spatial_period() && doubts.iter().any(|doubt| matches!(doubt, Caveat::Alias(_)));
    let is_kept = have_equal_predictions(case, &open)
        && !is_alias_of_wave
        && !doubts.contains(&Caveat::NotRepeatable)
        && (is_predicted || !doubts.iter().any(Caveat::is_size_caveat))
        && (case.folds().has_record_folds() || !doubts.iter().any(Caveat::is_record_specific));
    Some(TermJudgement {
        part: part.clone(),
        parameters: estimates.named,
        gain,
        first_gain: added.gain,
        is_kept,
        rivals,
        doubts,
        between: repeat_evidence.and_then(|repeat_evidence| repeat_evidence.between),
        bound: range_bound::profile_interval(problem, &found.fitted, cause, |with| {
            case.bic_gap(with) < CHI_SQUARED_QUANTILE_95
        }),
        left_out_without,
    })
}

/// Why it is doubted how much a term does, by its values and by what the answer leaves `without` it on
/// held-out blocks.
fn find_value_caveats(
    case: &JudgementContext<'_>,
    part: &ModelPart,
    without: &FittedModel,
    estimates: &ParameterEstimates,
    left_out_without: &[f64],
) -> Vec<Caveat> {
    let mut doubts = Vec::new();
    if estimates.reaches_nothing {
        doubts.push(Caveat::SizeMayBeZero);
    }
    if case.problem.is_at_bound(part) {
        doubts.push(Caveat::AtSearchBound);
    }
    if part.kind.has_time_constant() && part.values[0] > case.problem.bounds.longest_s {
        doubts.push(Caveat::SlowerThanRecord);
    }
    doubts.extend(find_initial_state_law(case, part).map(Caveat::InitialTransientOf));
    if !has_gain_without_best_block(case, &part.kind, left_out_without) {
        doubts.push(Caveat::GainsInOneBlock);
    }
    if !has_gain_at_record_end(case, &part.kind, left_out_without) {
        doubts.push(Caveat::DoesNotPersist);
    }
    if is_only_smoothing(case.problem, case.folds(), part, &without.model, &case.left_out) {
        doubts.push(Caveat::OnlySmoothsNoise);
    }
    doubts.extend(find_differing_half_estimates(case, part).map(Caveat::HalvesDiffer));
    doubts.extend(find_confounding_law(case, part, without).map(Caveat::ModelFormErrorOf));
    let aliases = find_aliases(case, part, without, estimates);
    if !aliases.is_empty() {
        doubts.push(Caveat::Alias(aliases));
    }
    doubts
}

/// Why the name of a term is not claimed, by what the answer leaves with it, and `without` it.
fn find_identification_caveats(
    case: &JudgementContext<'_>,
    cause: &TermKind,
    without: &FittedModel,
    is_known: bool,
) -> Vec<Caveat> {
    let mut doubts = Vec::new();
    let curves = SubstituteCurves::new(case, cause);
    if !is_identified(case, cause, is_known) {
        doubts.push(Caveat::NotIdentified);
    }
    doubts.extend(curves.find_substitute_curve_caveat(case, cause, without));
    // Where a law without a name is left, it may be what the term stands for.
    if !case.found.lack_of_fit.is_empty() && !curves.is_needed_with_curves(case, without) {
        doubts.push(Caveat::NotNeeded);
    }
    doubts
}

/// Returns the value of a part that differs most between the halves of the record, in each.
fn find_differing_half_estimates(
    case: &JudgementContext<'_>,
    part: &ModelPart,
) -> Option<[f64; 2]> {
    let kind = &part.kind;
    if kind.list_length().is_some() || kind.has_instant() || kind.is_instrument_error() {
        return None;
    }
    let SearchOutcome { fitted, noise, folds, .. } = case.found;
    let index = fitted.model.parts.iter().position(|there| there == part)?;
    let is_second = folds.second_half_mask();
    find_largest_half_difference(case.problem, fitted, index, *noise, &is_second)
}

/// Takes back the claims of terms that are only certain together; the two are kept if together they
/// predict better what was held out.
fn withdraw_coupled_term_claims(case: &JudgementContext<'_>, judged: &mut [TermJudgement]) {
    let terms: Vec<TermResiduals<'_>> = judged
        .iter()
        .map(|judgement| TermResiduals {
            cause: judgement.cause(),
            left_out_without: &judgement.left_out_without,
        })
        .collect();
    for pair in find_coupled_terms(case, &terms) {
        let [first, second] = pair.terms;
        let names = [judged[second].cause().clone(), judged[first].cause().clone()];
        for (index, other) in pair.terms.into_iter().zip(names) {
            judged[index].doubts.push(Caveat::OnlyTogether(other));
            judged[index].is_kept &= pair.is_gain;
        }
    }
}

/// Takes back the claims of the machine's own constants next to one whose search ended before its best: the law
/// that it belongs to is not the machine's, and what else is read into that law is not either.
fn withdraw_constant_claims_near_bounds(judged: &mut [TermJudgement]) {
    let is_own = |judgement: &TermJudgement| judgement.cause().tier() == 0;
    let open = judged
        .iter()
        .find(|judgement| is_own(judgement) && judgement.doubts.contains(&Caveat::AtSearchBound));
    let Some(open) = open.map(|judgement| judgement.cause().clone()) else { return };
    let claimed = |judgement: &&mut TermJudgement| is_own(judgement) && judgement.doubts.is_empty();
    for it in judged.iter_mut().filter(claimed) {
        it.doubts.push(Caveat::DependsOnTerm(open.clone()));
    }
}

/// Takes back the claims of what may be a part of an open term ([`TermKind::may_be_part_of`]).
fn withdraw_open_term_part_claims(judged: &mut [TermJudgement]) {
    let open = judged
        .iter()
        .filter(|judgement| !judgement.doubts.is_empty())
        .map(|judgement| judgement.cause().clone());
    let open: Vec<TermKind> = open.collect();
    for it in judged.iter_mut().filter(|judgement| judgement.doubts.is_empty()) {
        let other = open.iter().find(|open| it.cause().may_be_part_of(open)).cloned();
        it.doubts.extend(other.map(Caveat::DependsOnTerm));
    }
}

/// Next to what is of this record alone, and is omitted, the others are right as they are; but of one whose
/// interval includes zero the size is not known there either. The two may be large and take each other back, so
/// that what is left of them on another day is neither: it is not handed out alone.
fn drop_terms_of_uncertain_size(judged: &mut [TermJudgement]) {
    if judged.iter().any(|judgement| !judgement.is_kept && judgement.is_record_specific()) {
        let is_unsure = |judgement: &&mut TermJudgement| {
            judgement.cause().is_compensable() && judgement.doubts.contains(&Caveat::SizeMayBeZero)
        };
        judged.iter_mut().filter(is_unsure).for_each(|judgement| judgement.is_kept = false);
    }
}

/// Takes back the claims that hold only if an open question is answered one way: each must still be needed
/// with each of the rivals in the place of a term that cannot be distinguished from them.
fn withdraw_alternative_dependent_claims(
    case: &JudgementContext<'_>,
    judged: &mut [TermJudgement],
) {
    let problem = case.problem;
    let is_needed = |cause: &TermKind, rival: &FittedAlternative| {
        let model = without_term(problem, &rival.fitted.model, cause);
        let without = fit(problem, &model, None);
        bic(problem, &without) > bic(problem, &rival.fitted) + STRONG_EVIDENCE_BIC_DIFFERENCE
    };
    let mut doubts: Vec<(usize, TermKind)> = Vec::new();
    for (index, it) in
        judged.iter().enumerate().filter(|(_, judgement)| judgement.doubts.is_empty())
    {
        let open = judged.iter().flat_map(|there| {
            let rivals =
                there.rivals.iter().filter(|rival| rival.is_indistinguishable_from(there.cause()));
            rivals.map(move |rival| (there.cause(), rival))
        });
        let mut open = open.filter(|(cause, _)| *cause != it.cause());
        if let Some((cause, _)) = open.find(|(_, rival)| !is_needed(it.cause(), rival)) {
            doubts.push((index, cause.clone()));
        }
    }
    for (index, cause) in doubts {
        judged[index].doubts.push(Caveat::DependsOnTerm(cause));
    }
}

/// Takes back the claims that only hold next to a term which stands for another law: what makes up for
/// the difference between the two is no cause either. Each must still be needed with whatever law there
/// is in the place of those terms.
fn withdraw_substitute_law_dependent_claims(
    case: &JudgementContext<'_>,
    judged: &mut [TermJudgement],
) {
    let mut sound = case.found.fitted.model.clone();
    sound.parts.retain(|part| {
        judged.iter().all(|judgement| {
            judgement.better_law_inputs().is_none() || *judgement.cause() != part.kind
        })
    });
    if sound.parts.len() == case.found.fitted.model.parts.len() {
        return;
    }
    for it in judged.iter_mut().filter(|judgement| judgement.doubts.is_empty()) {
        let curves = SubstituteCurves::new(case, it.cause());
        let bic = |model: &Model| curves.bic_with_curves(case, &fit(case.problem, model, None));
        let mut without = sound.clone();
        without.parts.retain(|part| part.kind != *it.cause());
        if bic(&without) <= bic(&sound) + STRONG_EVIDENCE_BIC_DIFFERENCE {
            it.doubts.push(Caveat::OnlyNextToOtherLaw);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judgement(doubts: Vec<Caveat>, is_kept: bool) -> TermJudgement {
        let gain = TermGain {
            rms_before_um: 2.0,
            rms_after_um: 1.0,
            left_out_before_um: 2.0,
            left_out_after_um: 1.0,
            reduction: 0.5,
            ci95: [0.4, 0.6],
        };
        TermJudgement {
            part: ModelPart { kind: TermKind::heat_of("temp_a_c", true), values: vec![600.0, 1.0] },
            parameters: Map::new(),
            gain,
            first_gain: gain,
            rivals: Vec::new(),
            doubts,
            is_kept,
            between: None,
            bound: None,
            left_out_without: Vec::new(),
        }
    }

    #[test]
    fn what_may_be_nothing_is_not_handed_out_without_what_held_it_up() {
        let kept = |slow_is_kept: bool| {
            let slow = judgement(vec![Caveat::SlowerThanRecord], slow_is_kept);
            let unsure = judgement(vec![Caveat::SizeMayBeZero, Caveat::NotIdentified], true);
            let mut all = vec![slow, unsure, judgement(Vec::new(), true)];
            drop_terms_of_uncertain_size(&mut all);
            all.iter().map(|judgement| judgement.is_kept).collect::<Vec<_>>()
        };
        assert_eq!(kept(false), [false, false, true]);
        assert_eq!(kept(true), [true, true, true]);
    }
}
