//! Whether a curve over some inputs is a better law than a term, so that the term stands for a law that
//! no cause has.

use trueup_numerics::repeats::MIN_R_SQUARED;

use crate::{
    candidates::{CandidateTerm, propose_curve_candidates},
    columns::{PREDICTED_ELONGATION_COLUMN, column_by_name},
    data::{DataTable, is_linearly_equivalent},
    fit::{FittedModel, fit},
    judgement::{alternatives::can_reproduce_term, caveat::Caveat, context::JudgementContext},
    model::Model,
    search::{
        extension::ModelExtension,
        lack_of_fit::{CurveInputs, add_best_curves, fit_single_curve_extensions},
        model_comparison::{MAJORITY_FRACTION, STRONG_EVIDENCE_BIC_DIFFERENCE, bic},
    },
    term_kind::{LackOfFitCurve, TermKind},
};

/// The curves that would be another law than a term's.
pub(crate) struct SubstituteCurves {
    candidates: Vec<CandidateTerm>,
}

impl SubstituteCurves {
    /// All, but for a term of the instrument those over what it reads: these are only a finer
    /// description of the instrument's own error.
    pub(crate) fn new(case: &JudgementContext<'_>, cause: &TermKind) -> Self {
        let mut candidates = propose_curve_candidates(case.problem);
        if cause.is_instrument_error() {
            let data = &case.problem.data;
            candidates.retain(|curve| match &curve.kind {
                TermKind::Curve(LackOfFitCurve { column, times: None, .. }) => {
                    !is_instrument_reading(data, column)
                }
                _ => true,
            });
        }
        Self { candidates }
    }

    /// Returns the BIC of a model next to which up to two curves take what they can.
    pub(crate) fn bic_with_curves(&self, case: &JudgementContext<'_>, fitted: &FittedModel) -> f64 {
        bic(case.problem, &add_best_curves(case.problem, fitted, &self.candidates))
    }

    /// Returns whether a term is needed also where curves explain what they can: `without` lacks it.
    pub(crate) fn is_needed_with_curves(
        &self,
        case: &JudgementContext<'_>,
        without: &FittedModel,
    ) -> bool {
        let [with, in_place] =
            [&case.found.fitted, without].map(|fitted| self.bic_with_curves(case, fitted));
        in_place > with + STRONG_EVIDENCE_BIC_DIFFERENCE
    }

    /// Returns a curve that explains clearly more in the place of a term, or, of two values, as well; `without` lacks
    /// the term.
    pub(crate) fn find_substitute_curve_caveat(
        &self,
        case: &JudgementContext<'_>,
        cause: &TermKind,
        without: &FittedModel,
    ) -> Option<Caveat> {
        let curves = fit_single_curve_extensions(case.problem, without, &self.candidates);
        curves.into_iter().find_map(|curve| {
            let inputs = CurveInputs::from_kind(&curve.cause)?;
            // It is shown that what is left depends on them. Blocks that have a speed alone predict nothing of it.
            let is_shown = case.found.lack_of_fit.iter().any(|fit| fit.depends_on(&inputs));
            let doubt = caveat_from_curve(case, &curve, inputs, without, is_shown)?;
            let combined = with_term(&curve.fitted.model, &case.found.fitted.model, cause);
            let is_left = curve.fitted.sum - fit(case.problem, &combined, None).sum;
            let explained = without.sum - case.found.fitted.sum;
            // The larger part of what the term explains is the law's.
            (is_left < MAJORITY_FRACTION * explained
                && (is_shown || case.held_out_rms_um(&curve.fitted) < case.left_out_um))
                .then_some(doubt)
        })
    }
}

/// Returns what the score of `curve` in the place of the term that `without` lacks says against that term.
fn caveat_from_curve(
    case: &JudgementContext<'_>,
    curve: &ModelExtension,
    inputs: CurveInputs,
    without: &FittedModel,
    is_shown: bool,
) -> Option<Caveat> {
    let answer = &case.found.fitted;
    let is_better = curve.bic < case.bic() - STRONG_EVIDENCE_BIC_DIFFERENCE;
    let explained = without.sum - answer.sum;
    let by_curve = without.sum - curve.fitted.sum;
    // Many values take a little of whatever there is; two scales of the model are a rival like any cause.
    let is_rival = is_scale_change(&curve.cause);
    if is_better && (is_rival || is_shown || explained <= MIN_R_SQUARED * by_curve) {
        return Some(Caveat::BetterLaw(inputs));
    }
    let is_near = curve.bic < case.bic() + STRONG_EVIDENCE_BIC_DIFFERENCE;
    (is_rival && is_near && !can_reproduce_term(case, without, &curve.fitted))
        .then_some(Caveat::EquivalentLaw(inputs))
}

/// Returns whether it is another scale of what the model says from somewhere on.
fn is_scale_change(kind: &TermKind) -> bool {
    matches!(kind, TermKind::Curve(curve) if curve.knots.len() == 2 && curve.times.as_deref() == Some(PREDICTED_ELONGATION_COLUMN))
}

/// `curve` with the term of `answer` next to it.
fn with_term(curve: &Model, answer: &Model, cause: &TermKind) -> Model {
    let mut combined = curve.clone();
    combined.parts.extend(answer.parts.iter().filter(|part| part.kind == *cause).cloned());
    combined.constant_um = combined.constant_um.or(answer.constant_um);
    combined.sort_parts();
    combined
}

/// Returns whether a column is what the instrument reads.
fn is_instrument_reading(data: &DataTable, column: &str) -> bool {
    let reading = data.own_position_mm().unwrap_or(&data.predicted.elongation);
    column_by_name(data, column).is_some_and(|column| is_linearly_equivalent(column, reading))
}
