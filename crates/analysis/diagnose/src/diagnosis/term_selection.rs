//! Whether the named terms are written, or a correction that was chosen for what it predicts.
//!
//! | what is written | where |
//! |---|---|
//! | the named terms | all are claimed, and leave only noise |
//! | the correction of [`crate::predict`] | else, where it predicts held-out parts better than the current file, and than the named terms, each beyond doubt (two standard errors), and the rest from the beginning |
//! | the named terms | else |
//!
//! Named terms are only fitted again without a part, so that they seem to predict more than they do: they stay where
//! the two are alike. An open path of heat that settles more slowly than the record
//! shows is no rival.

use trueup_machine::RunFile;
use trueup_numerics::block_resampling::rms;

use crate::{
    diagnosis::{
        fit_degradation::is_fit_degraded, measured_ranges::MeasuredRanges,
        omission_reason::OmissionReason, report::CoupledCause, report::Finding,
        written_terms::WrittenTerms,
    },
    fit::FitProblem,
    folds::Folds,
    judgement::TermJudgement,
    model::Model,
    predict::{HeldOutResiduals, select_correction},
    search::{SearchOutcome, initial_model, model_comparison::MAX_EQUIVALENT_RMS_RATIO},
    term_gain::TermGain,
    term_kind::TermKind,
};

/// The most terms of a board.
const MAX_BOARD_TERMS: usize = 16;

/// The result of the choice of the written terms.
#[derive(Default)]
pub(super) struct TermSelection {
    /// Residuals of the written terms on parts that took no part in their choice, where those were computed.
    pub foreseen: Option<HeldOutResiduals>,
    /// Whether they were chosen for prediction.
    pub is_predicted: bool,
}

/// Returns whether the claimed terms are all there is: nothing that is left is correlated with an input, or wanders.
pub(super) fn is_fully_explained(
    found: &SearchOutcome,
    judged: &[TermJudgement],
    wanders: bool,
) -> bool {
    found.lack_of_fit.is_empty()
        && judged.iter().all(|judgement| judgement.doubts.is_empty())
        && !wanders
}

impl WrittenTerms {
    /// Writes what predicts held-out parts best; `judged` are the named terms, of which `joint` is handed out, measured
    /// in
    /// `runs`.
    pub(super) fn select_terms(
        &mut self,
        problem: &FitProblem,
        found: &SearchOutcome,
        judged: &[TermJudgement],
        joint: &Model,
        runs: &[RunFile],
    ) -> TermSelection {
        let on = self.board_problem(problem);
        let parts = joint.parts.iter();
        // A step is seen by the blocks; a drift goes as what is slow does.
        let is_drift =
            |kind: &TermKind| !kind.is_compensable() && kind.is_additive() && !kind.has_instant();
        let parts = parts.filter(|part| is_drift(&part.kind)).cloned();
        let drift = Model { parts: parts.collect(), constant_um: None };
        let [with_drift, believed] = [&drift, &Model::default()].map(|model| on.predict(model));
        let drift_um: Vec<f64> =
            with_drift.iter().zip(believed).map(|(um, of_file)| um - of_file).collect();
        let folds = Folds::for_prediction(on);
        let is_better = |before: &[f64], after: &[f64]| {
            found.folds.compare_paired(before, after).is_significant()
        };
        // A machine changes with the days: what the beginning says has to hold for the rest.
        let left_by_file = on.residual(&Model::default());
        let goes_on = |foreseen: &HeldOutResiduals| {
            foreseen.later.iter().all(|(first, left)| {
                let [before, after] = [&left_by_file[*first..], &left[..]].map(rms);
                after <= MAX_EQUIVALENT_RMS_RATIO * before
            })
        };
        let original = found.folds.held_out_residuals(on, &initial_model(&on.data));
        let is_claimed = |kind: &TermKind| {
            judged.iter().any(|judgement| judgement.cause() == kind && judgement.doubts.is_empty())
        };
        // An open path of heat is worth no more than another one: it stays where it predicts better, and not at all where
        // it settles more slowly than the record shows. What has a name, or is of the machine's own model, is.
        let is_open_path =
            |kind: &TermKind| !is_claimed(kind) && kind.tier() > 0 && kind.heat_path().is_some();
        let parts = &self.board.parts;
        let has_names = parts.iter().any(|part| !is_open_path(&part.kind));
        let is_shown = parts.iter().all(|part| {
            !part.kind.has_time_constant() || on.is_time_constant_short(part.values[0])
        });
        let named = folds.signed_fold_residuals(on, &self.board, Clone::clone);
        let is_rival = |predicted: &[f64]| {
            if has_names {
                !is_better(&named, predicted)
            } else {
                is_shown && found.folds.compare_paired(predicted, &named).is_better()
            }
        };
        let room = MAX_BOARD_TERMS.saturating_sub(problem.data.setting.machine.terms.len());
        let prediction = select_correction(on, &folds, &drift_um).filter(|correction| {
            correction.model.parts.len() <= room
                && is_better(&original, &correction.foreseen.left)
                && goes_on(&correction.foreseen)
                && !is_rival(&correction.foreseen.left)
                && MeasuredRanges::new(on, runs)
                    .find_first_violation(on, &correction.model)
                    .is_none()
                && !is_fit_degraded(on, &correction.model)
        });
        if let Some(prediction) = prediction {
            let named = std::mem::replace(&mut self.board, prediction.model).parts;
            let others = named.into_iter().filter(|part| !self.board.contains(&part.kind));
            let others: Vec<_> =
                others.map(|part| (part.kind, OmissionReason::PredictsWorse)).collect();
            self.left.extend(others);
            return TermSelection { foreseen: Some(prediction.foreseen), is_predicted: true };
        }
        TermSelection::default()
    }
}

/// Returns the findings of terms that were chosen for prediction and are not among the named ones.
pub(super) fn build_prediction_findings(
    problem: &FitProblem,
    written: &WrittenTerms,
    foreseen: &HeldOutResiduals,
    judged: &[TermJudgement],
    folds: &Folds,
) -> Vec<Finding> {
    let on = written.board_problem(problem);
    let is_named = |kind: &TermKind| judged.iter().any(|judgement| judgement.cause() == kind);
    let original = on.residual(&Model::default());
    let after = on.residual(&written.board);
    let gain = TermGain::new(
        [rms(&original), rms(&after)],
        [&original, &foreseen.left],
        &folds.rms_reduction(&original, &foreseen.left),
    );
    let partners: Vec<(&TermKind, CoupledCause)> = written
        .board
        .parts
        .iter()
        .map(|part| {
            let estimates = written.parameter_estimates(problem, &part.kind);
            let partner = CoupledCause {
                cause: part.kind.name().into(),
                column: part.kind.column(),
                parameters: estimates.map(|estimate| estimate.named).unwrap_or_default(),
                sentence: part.sentence(),
            };
            (&part.kind, partner)
        })
        .collect();
    let new = partners.iter().filter(|(kind, _)| !is_named(kind));
    new.map(|(kind, own)| {
        let others = partners.iter().filter(|(there, _)| there != kind);
        Finding {
            cause: own.cause.clone(),
            column: own.column.clone(),
            form: None,
            times: None,
            within: None,
            columns: None,
            claimed: false,
            compensated: true,
            confidence: 0.0,
            parameters: own.parameters.clone(),
            gain,
            sentence: own.sentence.clone(),
            evidence: vec![
                own.sentence.clone(),
                "Chosen for prediction; the name is open: with the other terms it predicts held-out parts, and other terms may do so as well."
                    .into(),
            ],
            together_with: others.map(|(_, partner)| partner.clone()).collect(),
            rivals: Vec::new(),
            next_test: kind.append_repair_advice(kind.next_test(None).to_string()),
        }
    })
    .collect()
}
