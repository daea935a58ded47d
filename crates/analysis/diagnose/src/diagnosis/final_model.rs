//! The rest of a model without terms that are not handed out.

use trueup_machine::effect::Effect;

use crate::{
    fit::{FitProblem, fit},
    judgement::TermJudgement,
    model::Model,
    search::{SearchOutcome, extension::without_term},
    term_kind::{ModelPart, TermKind},
};

/// Returns the model as it is handed out: terms that are not kept leave, and the others are fitted again
/// without them; but what is of this record alone is omitted only then, for next to it the others are right.
pub(super) fn fit_final_model(
    problem: &FitProblem,
    found: &SearchOutcome,
    judged: &[TermJudgement],
) -> Model {
    let model = &found.fitted.model;
    let open =
        judged.iter().filter(|judgement| !judgement.is_kept && !judgement.is_record_specific());
    let mut kept = without_causes(problem, model, open.map(TermJudgement::cause));
    if !kept.parts.is_empty() && kept.parts.len() < model.parts.len() {
        kept = fit(problem, &kept, None).model;
    }
    without_record_specific_terms(problem, kept, judged)
}

/// `model` without what is of this record alone.
pub(super) fn without_record_specific_terms(
    problem: &FitProblem,
    model: Model,
    judged: &[TermJudgement],
) -> Model {
    let of_record =
        judged.iter().filter(|judgement| !judgement.is_kept && judgement.is_record_specific());
    of_record
        .fold(model, |model, judgement| without_record_specific_term(problem, &model, judgement))
}

/// `model` without a term that another record would show otherwise, and with what of it lasts: where a start
/// has settled to, and where something slow stood at first.
fn without_record_specific_term(
    problem: &FitProblem,
    model: &Model,
    term: &TermJudgement,
) -> Model {
    let mut rest = without_causes(problem, model, std::iter::once(term.cause()));
    let parts = model.parts.iter().filter(|part| part.kind != *term.cause()).cloned().collect();
    let less = Model { parts, ..model.clone() };
    let [with, less] = [model, &less].map(|model| problem.predict(model));
    let mut effect = with.iter().zip(&less).map(|(with, less)| with - less);
    let lasting = if term.may_be_initial_state() { effect.next_back() } else { effect.next() };
    // The zero is a constant of its own, or that of the sensor.
    let of_sensor = |part: &&mut ModelPart| part.kind.cause().is_some_and(Effect::is_constant);
    let of_sensor = rest.parts.iter_mut().find(of_sensor).map(|part| &mut part.values[0]);
    if let Some(zero_um) = rest.constant_um.as_mut().or(of_sensor) {
        *zero_um += lasting.unwrap_or(0.0);
    }
    rest
}

/// `model` without the terms of these causes. Without a term the machine file stays, and with it its
/// zero.
pub(super) fn without_causes<'c>(
    problem: &FitProblem,
    model: &Model,
    causes: impl Iterator<Item = &'c TermKind>,
) -> Model {
    let kept = causes.fold(model.clone(), |model, cause| without_term(problem, &model, cause));
    if kept.parts.is_empty() { Model::default() } else { kept }
}

/// Returns the model without what time alone or the instrument explains.
pub(super) fn without_clock_and_instrument(model: &Model) -> Model {
    let parts: Vec<ModelPart> =
        model.parts.iter().filter(|part| part.kind.tier() <= MAX_MACHINE_TIER).cloned().collect();
    if parts.is_empty() { Model::default() } else { Model { parts, ..model.clone() } }
}

/// The highest tier of what is of the machine, or of what else was recorded ([`TermKind::tier`]).
pub(super) const MAX_MACHINE_TIER: u8 = 1;
