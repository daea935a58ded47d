//! The judgement of one term of the answer: its rivals, whether its name is claimed, its gain.
//!
//! A name is claimed where
//!
//! ```text
//! no other cause in its place scores within 6 (BIC) and         else: the two cannot be told apart
//! foresees left-out blocks as well, nor does the same cause
//! by another column do either
//! whole records that were left out are foreseen as if fitted    else: not yet identified
//! to; or its time constant is known or short, what is left
//! out is foreseen, and a slow path was seen more than once
//! the interval of its size does not hold nothing, and no        else: not certain
//! value of it is where its search ends
//! its time constant is no longer than the record                else: where it ends was not seen
//! it is not as fast from the start on as a lagged law beside it else: it may be where that law stood
//! it does more than a lagged law beside it may miss, and is     else: it may make up for the form of
//! needed with a second lag there, and without the start         that law
//! it gains on left-out blocks, also without the one on which    else: seen once
//! it gains most
//! the interval of that gain does not hold nothing               else: it may gain nothing
//! a drift or a jump foresees the end of the record              else: it does not go on
//! a lag foresees better than smoothing that is not late         else: it smooths a thermometer
//! it gains without each other term, and no other term takes     else: only certain together
//! back what it does
//! it is needed whichever rival of another term is right         else: it hangs on that question
//! of a path of heat: no other path is open                      else: with other rows another one is
//! it has an input of its own (a jump, a drift, an offset and a     else: it may be what an open term lacks
//! curvature have none), or no other term is open
//! the position came back, of a line or a wave over it          else: it may be a drift, or go with the clock
//! a wave of the instrument's own is resolved, and turns more    else: the machine may be so between
//! often than a table over the position beside it has points     the table's points
//! its values are the same in both halves of the record          else: both are told
//! no other period or time constant of its own does as well      else: aliases
//! no curve in its place explains clearly more, nor does         else: something goes with its inputs,
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
//! it less than half of what the term explains is left to it, and it predicts left-out blocks better.
//! Where it is shown that what the answer leaves goes with the same inputs, the score and the half are enough.
//!
//! Of causes that cannot be distinguished a term is kept if all give the same correction, within the
//! error that remains anyway.

mod aliases;
mod case;
mod caveat;
mod form;
mod identified;
mod instrument;
mod needed;
mod other_law;
mod rivals;
pub(crate) mod table;

use serde_json::{Map, Value};
use trueup_numerics::parallel::on_all_cores;

use crate::search::smoothing::only_smooths;
use crate::{
    fit::{Fitted, Problem, differs_between_halves, fit},
    gain::Gain,
    kind::{Kind, Part},
    model::Model,
    parameters::{Estimates, estimates},
    search::{
        Added, Found, bound,
        composed::alone_over_a_column,
        criterion::{STRONG_EVIDENCE, bic},
        extend::{replacements, without},
        lack_of_fit::Inputs,
    },
};
use aliases::aliases;
use case::Case;
pub(crate) use caveat::Caveat;
use form::{form_of, start_of};
use identified::is_identified;
use instrument::table_beside;
use needed::{Alone, gains_again, goes_on, may_gain_nothing, only_together};
use other_law::Curves;
pub(crate) use rivals::IMITATION;
use rivals::{Rival, predict_alike, rivals};
use table::{BetweenPoints, repeated};

/// A profile interval of 95 %: the quantile of χ² with one degree of freedom.
const PROFILE: f64 = 3.84;

/// The judgement of one term.
pub(crate) struct Judgement {
    pub part: Part,
    /// Its values with their intervals, by name.
    pub parameters: Map<String, Value>,
    /// Its gain next to all other terms.
    pub gain: Gain,
    /// Its gain when it was added.
    pub first_gain: Gain,
    /// The best first.
    pub rivals: Vec<Rival>,
    /// Of what acts in a range alone: where its bound may be, at 95 %.
    pub bound: Option<[f64; 2]>,
    /// Why its name is not claimed; empty: it is.
    pub doubts: Vec<Caveat>,
    /// Whether its correction is right whichever name is: it goes into the extended machine file.
    pub is_kept: bool,
    /// Of a table that was measured several times: what is known between its points.
    pub between: Option<BetweenPoints>,
    /// The residual of the answer without it on left-out blocks, in each group, in µm.
    left_out_without: Vec<f64>,
}

impl Judgement {
    pub(crate) fn cause(&self) -> &Kind {
        &self.part.kind
    }

    /// Returns what it goes with, where another law does.
    pub(crate) fn other_law(&self) -> Option<&Inputs> {
        self.doubts.iter().find_map(|doubt| match doubt {
            Caveat::OtherLaw(inputs) => Some(inputs),
            _ => None,
        })
    }

    /// Returns whether another record would show it otherwise.
    pub(crate) fn is_of_this_record(&self) -> bool {
        self.doubts.iter().any(Caveat::is_of_this_record)
    }

    /// Returns whether it may be where a lagged law stood when the record began.
    pub(crate) fn is_of_the_start(&self) -> bool {
        self.doubts.iter().any(|doubt| matches!(doubt, Caveat::StartOf(_)))
    }

    /// Of the cause against the best rival, 0…1.
    pub(crate) fn confidence(&self) -> f64 {
        let others = self.rivals.iter().filter(|rival| rival.differs_from(self.cause()));
        let gap = others.map(|rival| rival.bic_gap).fold(f64::INFINITY, f64::min);
        let confidence = 1.0 / (1.0 + (-0.5 * gap.min(40.0)).exp());
        let is_of_law =
            |doubt: &Caveat| matches!(doubt, Caveat::OtherLaw(_) | Caveat::BesideOtherLaw);
        if self.doubts.iter().any(is_of_law) { confidence.min(0.5) } else { confidence }
    }
}

/// Judges each term of an answer.
pub(crate) fn judge(problem: &Problem, found: &Found) -> Vec<Judgement> {
    let case = Case::new(problem, found);
    let judged = on_all_cores(&found.added, problem.is_large(), |added| judge_term(&case, added));
    let mut judged: Vec<Judgement> = judged.into_iter().flatten().collect();
    doubt_what_is_only_certain_together(&case, &mut judged);
    doubt_what_hangs_on_an_open_question(&case, &mut judged);
    doubt_what_stands_beside_an_open_end(&mut judged);
    doubt_what_stands_beside_another_law(&case, &mut judged);
    doubt_what_may_be_the_rest_of_an_open_term(&mut judged);
    leave_what_only_this_record_holds_up(&mut judged);
    judged
}

/// Returns another law that, alone in the place of all terms that read the column of `cause`, does as well; of what
/// takes two inputs together.
fn alone_does_as_well(case: &Case<'_>, cause: &Kind) -> Option<Kind> {
    if !cause.is_composed() {
        return None;
    }
    // Several terms over one column make up a law that has no form here.
    let mut others = case.found.added.iter().map(|it| &it.cause);
    if let Some(other) = others.find(|it| *it != cause && it.column() == cause.column()) {
        return Some(other.clone());
    }
    let alone = alone_over_a_column(case.problem, &case.found.fitted, [cause]);
    let other = alone.into_iter().filter(|it| !case.found.fitted.model.has(&it.cause));
    let near = other
        .filter(|it| it.cause.name() != cause.name() && case.bic_gap(&it.fitted) < STRONG_EVIDENCE);
    near.min_by(|a, b| a.bic.total_cmp(&b.bic)).map(|it| it.cause)
}

/// None where the term is no part of the answer any more.
fn judge_term(case: &Case<'_>, added: &Added) -> Option<Judgement> {
    let Case { problem, found, .. } = *case;
    let cause = &added.cause;
    let part = found.fitted.model.parts.iter().find(|part| part.kind == *cause)?;
    let places = replacements(problem, &found.fitted, cause, 8);
    let without = places.without.clone();
    let rivals = rivals(case, cause, places);
    let estimates = estimates(problem, &found.fitted, part, found.noise);
    let left_out_without = case.left_out_of(&without);
    let gain = case.gain(&without, &left_out_without);
    let open: Vec<&Rival> = rivals.iter().filter(|rival| rival.is_open(cause)).collect();
    let mut doubts = Vec::new();
    doubts.extend(open.first().map(|rival| Caveat::Rival(rival.cause.clone())));
    if doubts.is_empty() {
        doubts.extend(alone_does_as_well(case, cause).map(Caveat::Rival));
    }
    doubts.extend(table_beside(case, part).map(Caveat::BesideTable));
    let same = part.kind.cause().filter(|_| problem.data.is_one_pass);
    doubts.extend(same.and_then(|cause| cause.same_in_one_pass()).map(Caveat::OnePass));
    let repeated = repeated(case, cause);
    match &repeated {
        // Its repeats are the judge of a table, not what it leaves.
        Some(repeated) if repeated.is_confirmed => {}
        Some(_) => doubts.push(Caveat::NotRepeated),
        None => {
            doubts.extend(doubts_of_values(case, part, &without, &estimates, &left_out_without));
            doubts.extend(may_gain_nothing(part, &gain).then_some(Caveat::MayGainNothing));
            let is_known = estimates.is_determined;
            doubts.extend(doubts_by_residual(case, cause, &without, is_known));
        }
    }
    // What may be nothing, or another wave between the places, is corrected only if it is foreseen.
    let is_predicted = case.paired(&left_out_without).is_better();
    let is_alias_of_wave =
        cause.is_wave() && doubts.iter().any(|it| matches!(it, Caveat::Alias(_)));
    let is_kept = predict_alike(case, &open)
        && !is_alias_of_wave
        && !doubts.contains(&Caveat::NotRepeated)
        && (is_predicted || !doubts.iter().any(Caveat::is_of_size))
        && (case.folds().are_records() || !doubts.iter().any(Caveat::is_of_this_record));
    Some(Judgement {
        part: part.clone(),
        parameters: estimates.named,
        gain,
        first_gain: added.gain,
        is_kept,
        rivals,
        doubts,
        between: repeated.and_then(|repeated| repeated.between),
        bound: bound::interval(problem, &found.fitted, cause, |with| case.bic_gap(with) < PROFILE),
        left_out_without,
    })
}

/// Why it is doubted how much a term does, by its values and by what the answer leaves `without` it on
/// left-out blocks.
fn doubts_of_values(
    case: &Case<'_>,
    part: &Part,
    without: &Fitted,
    estimates: &Estimates,
    left_out_without: &[f64],
) -> Vec<Caveat> {
    let mut doubts = Vec::new();
    if estimates.reaches_nothing {
        doubts.push(Caveat::MayBeNothing);
    }
    if case.problem.is_at_the_end(part) {
        doubts.push(Caveat::AtTheEnd);
    }
    if part.kind.has_time_constant() && part.values[0] > case.problem.bounds.longest_s {
        doubts.push(Caveat::SlowerThanRecord);
    }
    doubts.extend(start_of(case, part).map(Caveat::StartOf));
    if !gains_again(case, &part.kind, left_out_without) {
        doubts.push(Caveat::GainsOnce);
    }
    if !goes_on(case, &part.kind, left_out_without) {
        doubts.push(Caveat::DoesNotGoOn);
    }
    if only_smooths(case.problem, case.folds(), part, &without.model, &case.left_out) {
        doubts.push(Caveat::OnlySmooths);
    }
    doubts.extend(halves(case, part).map(Caveat::HalvesDiffer));
    doubts.extend(form_of(case, part, without).map(Caveat::FormOf));
    let aliases = aliases(case, part, without, estimates);
    if !aliases.is_empty() {
        doubts.push(Caveat::Alias(aliases));
    }
    doubts
}

/// Why the name of a term is not claimed, by what the answer leaves with it, and `without` it.
fn doubts_by_residual(
    case: &Case<'_>,
    cause: &Kind,
    without: &Fitted,
    is_known: bool,
) -> Vec<Caveat> {
    let mut doubts = Vec::new();
    let curves = Curves::new(case, cause);
    if !is_identified(case, cause, is_known) {
        doubts.push(Caveat::NotIdentified);
    }
    doubts.extend(curves.another_law(case, cause, without));
    // Where a law without a name is left, it may be what the term stands for.
    if !case.found.lack_of_fit.is_empty() && !curves.leave_a_need(case, without) {
        doubts.push(Caveat::NotNeeded);
    }
    doubts
}

/// Returns the value of a part that differs most between the halves of the record, in each.
fn halves(case: &Case<'_>, part: &Part) -> Option<[f64; 2]> {
    let kind = &part.kind;
    if kind.list_length().is_some() || kind.has_instant() || kind.is_of_instrument() {
        return None;
    }
    let Found { fitted, noise, folds, .. } = case.found;
    let index = fitted.model.parts.iter().position(|there| there == part)?;
    let is_second = folds.second_half();
    differs_between_halves(case.problem, fitted, index, *noise, &is_second)
}

/// Takes back the claims of terms that are only certain together; the two are kept if together they
/// foresee better what was left out.
fn doubt_what_is_only_certain_together(case: &Case<'_>, judged: &mut [Judgement]) {
    let terms: Vec<Alone<'_>> = judged
        .iter()
        .map(|it| Alone { cause: it.cause(), left_out_without: &it.left_out_without })
        .collect();
    for pair in only_together(case, &terms) {
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
fn doubt_what_stands_beside_an_open_end(judged: &mut [Judgement]) {
    let is_own = |it: &Judgement| it.cause().tier() == 0;
    let open = judged.iter().find(|it| is_own(it) && it.doubts.contains(&Caveat::AtTheEnd));
    let Some(open) = open.map(|it| it.cause().clone()) else { return };
    let claimed = |it: &&mut Judgement| is_own(it) && it.doubts.is_empty();
    for it in judged.iter_mut().filter(claimed) {
        it.doubts.push(Caveat::HangsOn(open.clone()));
    }
}

/// Takes back the claims of what may be a part of an open term ([`Kind::may_be_of`]).
fn doubt_what_may_be_the_rest_of_an_open_term(judged: &mut [Judgement]) {
    let open = judged.iter().filter(|it| !it.doubts.is_empty()).map(|it| it.cause().clone());
    let open: Vec<Kind> = open.collect();
    for it in judged.iter_mut().filter(|it| it.doubts.is_empty()) {
        let other = open.iter().find(|open| it.cause().may_be_of(open)).cloned();
        it.doubts.extend(other.map(Caveat::HangsOn));
    }
}

/// Next to what is of this record alone, and is left out, the others are right as they are; but of one whose
/// interval holds nothing the size is not known there either. The two may be large and take each other back, so
/// that what is left of them on another day is neither: it is not handed out alone.
fn leave_what_only_this_record_holds_up(judged: &mut [Judgement]) {
    if judged.iter().any(|it| !it.is_kept && it.is_of_this_record()) {
        let is_unsure = |it: &&mut Judgement| {
            it.cause().is_compensated() && it.doubts.contains(&Caveat::MayBeNothing)
        };
        judged.iter_mut().filter(is_unsure).for_each(|it| it.is_kept = false);
    }
}

/// Takes back the claims that hold only if an open question is answered one way: each must still be needed
/// with each of the rivals in the place of a term that cannot be distinguished from them.
fn doubt_what_hangs_on_an_open_question(case: &Case<'_>, judged: &mut [Judgement]) {
    let problem = case.problem;
    let is_needed = |cause: &Kind, rival: &Rival| {
        let model = without(problem, &rival.fitted.model, cause);
        let without = fit(problem, &model, None);
        bic(problem, &without) > bic(problem, &rival.fitted) + STRONG_EVIDENCE
    };
    let mut doubts: Vec<(usize, Kind)> = Vec::new();
    for (index, it) in judged.iter().enumerate().filter(|(_, it)| it.doubts.is_empty()) {
        let open = judged.iter().flat_map(|there| {
            let rivals = there.rivals.iter().filter(|rival| rival.is_open(there.cause()));
            rivals.map(move |rival| (there.cause(), rival))
        });
        let mut open = open.filter(|(cause, _)| *cause != it.cause());
        if let Some((cause, _)) = open.find(|(_, rival)| !is_needed(it.cause(), rival)) {
            doubts.push((index, cause.clone()));
        }
    }
    for (index, cause) in doubts {
        judged[index].doubts.push(Caveat::HangsOn(cause));
    }
}

/// Takes back the claims that only hold next to a term which stands for another law: what makes up for
/// the difference between the two is no cause either. Each must still be needed with whatever law there
/// is in the place of those terms.
fn doubt_what_stands_beside_another_law(case: &Case<'_>, judged: &mut [Judgement]) {
    let mut sound = case.found.fitted.model.clone();
    sound.parts.retain(|part| {
        judged.iter().all(|it| it.other_law().is_none() || *it.cause() != part.kind)
    });
    if sound.parts.len() == case.found.fitted.model.parts.len() {
        return;
    }
    for it in judged.iter_mut().filter(|it| it.doubts.is_empty()) {
        let curves = Curves::new(case, it.cause());
        let bic = |model: &Model| curves.bic_beside(case, &fit(case.problem, model, None));
        let mut without = sound.clone();
        without.parts.retain(|part| part.kind != *it.cause());
        if bic(&without) <= bic(&sound) + STRONG_EVIDENCE {
            it.doubts.push(Caveat::BesideOtherLaw);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judgement(doubts: Vec<Caveat>, is_kept: bool) -> Judgement {
        let gain = Gain {
            rms_before_um: 2.0,
            rms_after_um: 1.0,
            left_out_before_um: 2.0,
            left_out_after_um: 1.0,
            reduction: 0.5,
            ci95: [0.4, 0.6],
        };
        Judgement {
            part: Part { kind: Kind::heat_of("temp_a_c", true), values: vec![600.0, 1.0] },
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
            let unsure = judgement(vec![Caveat::MayBeNothing, Caveat::NotIdentified], true);
            let mut all = vec![slow, unsure, judgement(Vec::new(), true)];
            leave_what_only_this_record_holds_up(&mut all);
            all.iter().map(|it| it.is_kept).collect::<Vec<_>>()
        };
        assert_eq!(kept(false), [false, false, true]);
        assert_eq!(kept(true), [true, true, true]);
    }
}
