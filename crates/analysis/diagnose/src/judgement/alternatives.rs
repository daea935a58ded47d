//! Other causes in a term's place.

use trueup_numerics::block_resampling::rms;

use crate::{
    fit::{EQUIVALENCE_TOLERANCE, FittedModel, fit},
    judgement::context::JudgementContext,
    model::Model,
    search::{
        extension::{ModelExtension, TermReplacements},
        model_comparison::{
            MAX_EQUIVALENT_RMS_RATIO, STRONG_EVIDENCE_BIC_DIFFERENCE, degrees_of_freedom,
        },
    },
    term_kind::TermKind,
};

/// Most rivals of a term.
const MAX_ALTERNATIVES: usize = 6;

/// Another cause in a term's place, or the same by another column.
pub(crate) struct FittedAlternative {
    pub cause: TermKind,
    pub fitted: FittedModel,
    /// How much worse its BIC is.
    pub bic_gap: f64,
    /// Whether it predicts held-out blocks as well.
    foresees_as_well: bool,
}

impl FittedAlternative {
    /// Returns whether it is another cause or depends on another column. A second path of the heat by which a path
    /// of the machine file goes is that path, changed.
    pub(crate) fn differs_from(&self, cause: &TermKind) -> bool {
        let column = |kind: &TermKind| kind.heat_path().map(|path| path.column.to_owned());
        let own = cause.as_stated_term().and_then(|_| column(cause));
        own.is_none() || own != column(&self.cause)
    }

    /// Returns whether the data cannot distinguish it from `cause`. Of two correlated columns both may predict
    /// what was held out, however narrow the intervals are.
    pub(crate) fn is_indistinguishable_from(&self, cause: &TermKind) -> bool {
        let is_near = self.bic_gap < STRONG_EVIDENCE_BIC_DIFFERENCE;
        self.differs_from(cause)
            && (is_near || self.foresees_as_well && self.cause.name() == cause.name())
    }
}

/// Returns the rivals of a term among what was tried in its place, the best first.
pub(crate) fn find_alternatives(
    case: &JudgementContext<'_>,
    cause: &TermKind,
    places: TermReplacements,
) -> Vec<FittedAlternative> {
    let mut all: Vec<FittedAlternative> = Vec::new();
    for ModelExtension { cause: other, fitted, .. } in places.instead {
        let is_same = |a: &TermKind, b: &TermKind| a.name() == b.name() && a.column() == b.column();
        if is_same(&other, cause) {
            continue;
        }
        let bic_gap = case.bic_gap(&fitted);
        let mut bic_gap = bic_gap;
        let is_near = bic_gap < STRONG_EVIDENCE_BIC_DIFFERENCE;
        let mut foresees_as_well = false;
        if is_near || other.name() == cause.name() {
            let left_out = case.held_out_residuals(&fitted);
            let paired = case.compare_paired(&left_out);
            foresees_as_well = !paired.is_better();
            // What predicts held-out blocks clearly worse does not explain as well, whatever it fits.
            let is_worse = rms(&left_out) > MAX_EQUIVALENT_RMS_RATIO * case.left_out_um;
            if is_near && is_worse && paired.is_significant() {
                bic_gap = STRONG_EVIDENCE_BIC_DIFFERENCE;
            }
        }
        let rival = FittedAlternative { cause: other, fitted, bic_gap, foresees_as_well };
        match all.iter_mut().find(|there| is_same(&there.cause, &rival.cause)) {
            Some(there) if there.bic_gap > bic_gap => *there = rival,
            Some(_) => {}
            None => all.push(rival),
        }
    }
    all.retain(|rival| {
        !rival.is_indistinguishable_from(cause)
            || !can_reproduce_term(case, &places.without, &rival.fitted)
    });
    all.sort_by(|a, b| a.bic_gap.total_cmp(&b.bic_gap));
    all.truncate(MAX_ALTERNATIVES);
    all
}

/// Returns whether `rival` needs more values and can do, but for a twentieth, what the term does that
/// `without` lacks.
pub(super) fn can_reproduce_term(
    case: &JudgementContext<'_>,
    without: &FittedModel,
    rival: &FittedModel,
) -> bool {
    let answer = &case.found.fitted.model;
    if degrees_of_freedom(&rival.model) <= degrees_of_freedom(answer) {
        return false;
    }
    let predicted = case.problem.predict(answer);
    let before = case.problem.predict(&without.model);
    let effect: Vec<f64> =
        predicted.iter().zip(before).map(|(with, without)| with - without).collect();
    let problem = case.problem.with_measured(predicted);
    // A time constant may have to go far.
    let mut quick = rival.model.clone();
    let [low, _] = problem.bounds.time_constant_s;
    for part in quick.parts.iter_mut().filter(|part| part.kind.has_time_constant()) {
        if !answer.contains(&part.kind) {
            part.values[0] = 2.0 * low;
        }
    }
    let is_near =
        |model: &Model| fit(&problem, model, None).rms() < EQUIVALENCE_TOLERANCE * rms(&effect);
    is_near(&rival.model) || quick != rival.model && is_near(&quick)
}

/// Returns whether all open rivals predict the same as the answer, within what is left anyway.
pub(crate) fn have_equal_predictions(
    case: &JudgementContext<'_>,
    open: &[&FittedAlternative],
) -> bool {
    let data = &case.problem.data;
    let here = case.found.fitted.model.predict(data);
    open.iter().all(|rival| {
        let there = rival.fitted.model.predict(data);
        let apart: Vec<f64> = (0..data.rows)
            .filter(|&row| data.used[row])
            .map(|row| here[row] - there[row])
            .filter(|apart| apart.is_finite())
            .collect();
        rms(&apart) < case.found.fitted.rms()
    })
}
