//! Whether a curve over some inputs is a better law than a term, so that the term stands for a law that
//! no cause has.

use trueup_numerics::repeats::MIN_R_SQUARED;

use crate::{
    candidates::{Candidate, structure},
    columns::{SAID, named},
    data::{Data, is_same},
    fit::{Fitted, fit},
    judge::{case::Case, caveat::Caveat, rivals::imitates},
    kind::{Curve, Kind},
    model::Model,
    search::{
        criterion::{MAJORITY, STRONG_EVIDENCE, bic},
        extend::Extension,
        lack_of_fit::{Inputs, with_curves, with_each_curve},
    },
};

/// The curves that would be another law than a term's.
pub(crate) struct Curves {
    candidates: Vec<Candidate>,
}

impl Curves {
    /// All, but for a term of the instrument those over what it reads: these are only a finer
    /// description of the instrument's own error.
    pub(crate) fn new(case: &Case<'_>, cause: &Kind) -> Self {
        let mut candidates = structure(case.problem);
        if cause.is_of_instrument() {
            let data = &case.problem.data;
            candidates.retain(|curve| match &curve.kind {
                Kind::Curve(Curve { column, times: None, .. }) => !is_reading(data, column),
                _ => true,
            });
        }
        Self { candidates }
    }

    /// Returns the BIC of a model next to which up to two curves take what they can.
    pub(crate) fn bic_beside(&self, case: &Case<'_>, fitted: &Fitted) -> f64 {
        bic(case.problem, &with_curves(case.problem, fitted, &self.candidates))
    }

    /// Returns whether a term is needed also where curves explain what they can: `without` lacks it.
    pub(crate) fn leave_a_need(&self, case: &Case<'_>, without: &Fitted) -> bool {
        let [with, in_place] =
            [&case.found.fitted, without].map(|fitted| self.bic_beside(case, fitted));
        in_place > with + STRONG_EVIDENCE
    }

    /// Returns a curve that explains clearly more in the place of a term, or, of two values, as well; `without` lacks
    /// the term.
    pub(crate) fn another_law(
        &self,
        case: &Case<'_>,
        cause: &Kind,
        without: &Fitted,
    ) -> Option<Caveat> {
        let curves = with_each_curve(case.problem, without, &self.candidates);
        curves.into_iter().find_map(|curve| {
            let inputs = Inputs::of(&curve.cause)?;
            // That what is left goes with them is shown. Blocks that have a speed alone foretell nothing of it.
            let is_shown = case.found.lack_of_fit.iter().any(|it| it.goes_with(&inputs));
            let doubt = doubt_by(case, &curve, inputs, without, is_shown)?;
            let beside = beside(&curve.fitted.model, &case.found.fitted.model, cause);
            let is_left = curve.fitted.sum - fit(case.problem, &beside, None).sum;
            let explained = without.sum - case.found.fitted.sum;
            // The larger part of what the term explains is the law's.
            (is_left < MAJORITY * explained
                && (is_shown || case.left_out_um_of(&curve.fitted) < case.left_out_um))
                .then_some(doubt)
        })
    }
}

/// Returns what the score of `curve` in the place of the term that `without` lacks says against that term.
fn doubt_by(
    case: &Case<'_>,
    curve: &Extension,
    inputs: Inputs,
    without: &Fitted,
    is_shown: bool,
) -> Option<Caveat> {
    let answer = &case.found.fitted;
    let is_better = curve.bic < case.bic() - STRONG_EVIDENCE;
    let explained = without.sum - answer.sum;
    let by_curve = without.sum - curve.fitted.sum;
    // Many values take a little of whatever there is; two scales of the model are a rival like any cause.
    let is_rival = is_of_two_scales(&curve.cause);
    if is_better && (is_rival || is_shown || explained <= MIN_R_SQUARED * by_curve) {
        return Some(Caveat::OtherLaw(inputs));
    }
    let is_near = curve.bic < case.bic() + STRONG_EVIDENCE;
    (is_rival && is_near && !imitates(case, without, &curve.fitted))
        .then_some(Caveat::LawAsWell(inputs))
}

/// Returns whether it is another scale of what the model says from somewhere on.
fn is_of_two_scales(kind: &Kind) -> bool {
    matches!(kind, Kind::Curve(curve) if curve.knots.len() == 2 && curve.times.as_deref() == Some(SAID))
}

/// `curve` with the term of `answer` next to it.
fn beside(curve: &Model, answer: &Model, cause: &Kind) -> Model {
    let mut beside = curve.clone();
    beside.parts.extend(answer.parts.iter().filter(|part| part.kind == *cause).cloned());
    beside.constant_um = beside.constant_um.or(answer.constant_um);
    beside.sort();
    beside
}

/// Returns whether a column is what the instrument reads.
fn is_reading(data: &Data, column: &str) -> bool {
    let reading = data.own_position().unwrap_or(&data.elongation);
    named(data, column).is_some_and(|column| is_same(column, reading))
}
