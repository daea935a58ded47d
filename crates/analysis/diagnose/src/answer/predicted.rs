//! Whether the named terms are written, or a correction that was chosen for what it foresees.
//!
//! | what is written | where |
//! |---|---|
//! | the named terms | all are claimed, and leave only noise |
//! | the correction of [`crate::predict`] | else, where it foresees left-out parts better than the file as it is, and than the named terms, each beyond doubt (two standard errors), and the rest from the beginning |
//! | the named terms | else |
//!
//! Named terms are only fitted again without a part, so that they seem to foresee more than they do: they stay where
//! the two are alike. An open path of heat that settles more slowly than the record
//! shows is no rival.

use trueup_machine::RunFile;
use trueup_numerics::blocks::rms;

use crate::{
    answer::{
        harm::is_worse, measured::Measured, not_written::NotWritten, report::Finding,
        report::Partner, written::Written,
    },
    blocks::Folds,
    fit::Problem,
    gain::Gain,
    judge::Judgement,
    kind::Kind,
    model::Model,
    predict::{Predicted, prediction},
    search::{Found, criterion::EQUAL_PREDICTION, start},
};

/// The most terms of a board.
const MAX_TERMS: usize = 16;

/// The result of the choice of the written terms.
#[derive(Default)]
pub(super) struct Choice {
    /// Residuals of the written terms on parts that took no part in their choice, where those were computed.
    pub foreseen: Option<Predicted>,
    /// Whether they were chosen for prediction.
    pub is_predicted: bool,
}

/// Returns whether the claimed terms are all there is: nothing that is left goes with anything, or wanders.
pub(super) fn is_settled(found: &Found, judged: &[Judgement], wanders: bool) -> bool {
    found.lack_of_fit.is_empty() && judged.iter().all(|it| it.doubts.is_empty()) && !wanders
}

impl Written {
    /// Writes what foresees left-out parts best; `judged` are the named terms, of which `joint` is handed out, measured
    /// in
    /// `runs`.
    pub(super) fn choose(
        &mut self,
        problem: &Problem,
        found: &Found,
        judged: &[Judgement],
        joint: &Model,
        runs: &[RunFile],
    ) -> Choice {
        let on = self.problem(problem);
        let parts = joint.parts.iter();
        // A step is seen by the blocks; a drift goes as what is slow does.
        let is_drift =
            |kind: &Kind| !kind.is_compensated() && kind.is_added() && !kind.has_instant();
        let parts = parts.filter(|it| is_drift(&it.kind)).cloned();
        let beside = Model { parts: parts.collect(), constant_um: None };
        let [beside, believed] = [&beside, &Model::default()].map(|it| on.predicted(it));
        let beside: Vec<f64> =
            beside.iter().zip(believed).map(|(um, of_file)| um - of_file).collect();
        let folds = Folds::of_promise(on);
        let is_better =
            |before: &[f64], after: &[f64]| found.folds.paired(before, after).is_certain();
        // A machine changes with the days: what the beginning says has to hold for the rest.
        let left_by_file = on.residual(&Model::default());
        let goes_on = |foreseen: &Predicted| {
            foreseen.later.iter().all(|(first, left)| {
                let [before, after] = [&left_by_file[*first..], &left[..]].map(rms);
                after <= EQUAL_PREDICTION * before
            })
        };
        let original = found.folds.held_out(on, &start(&on.data));
        let is_claimed =
            |kind: &Kind| judged.iter().any(|it| it.cause() == kind && it.doubts.is_empty());
        // An open path of heat is worth no more than another one: it stays where it foresees better, and not at all where
        // it settles more slowly than the record shows. What has a name, or is of the machine's own model, is.
        let is_open_path =
            |kind: &Kind| !is_claimed(kind) && kind.tier() > 0 && kind.heat_path().is_some();
        let parts = &self.board.parts;
        let has_names = parts.iter().any(|part| !is_open_path(&part.kind));
        let is_shown =
            parts.iter().all(|it| !it.kind.has_time_constant() || on.is_short(it.values[0]));
        let named = folds.left_out_signed(on, &self.board, Clone::clone);
        let is_rival = |predicted: &[f64]| {
            if has_names {
                !is_better(&named, predicted)
            } else {
                is_shown && found.folds.paired(predicted, &named).is_better()
            }
        };
        let room = MAX_TERMS.saturating_sub(problem.data.machine.terms.len());
        let prediction = prediction(on, &folds, &beside).filter(|it| {
            it.model.parts.len() <= room
                && is_better(&original, &it.foreseen.left)
                && goes_on(&it.foreseen)
                && !is_rival(&it.foreseen.left)
                && Measured::new(on, runs).violated(on, &it.model).is_none()
                && !is_worse(on, &it.model)
        });
        if let Some(prediction) = prediction {
            let named = std::mem::replace(&mut self.board, prediction.model).parts;
            let others = named.into_iter().filter(|part| !self.board.has(&part.kind));
            let others: Vec<_> = others.map(|part| (part.kind, NotWritten::ForesawLess)).collect();
            self.left.extend(others);
            return Choice { foreseen: Some(prediction.foreseen), is_predicted: true };
        }
        Choice::default()
    }
}

/// Returns the findings of terms that were chosen for prediction and are not among the named ones.
pub(super) fn findings(
    problem: &Problem,
    written: &Written,
    foreseen: &Predicted,
    judged: &[Judgement],
    folds: &Folds,
) -> Vec<Finding> {
    let on = written.problem(problem);
    let is_named = |kind: &Kind| judged.iter().any(|it| it.cause() == kind);
    let original = on.residual(&Model::default());
    let after = on.residual(&written.board);
    let gain = Gain::new(
        [rms(&original), rms(&after)],
        [&original, &foreseen.left],
        &folds.reduction(&original, &foreseen.left),
    );
    let partners: Vec<(&Kind, Partner)> = written
        .board
        .parts
        .iter()
        .map(|part| {
            let estimates = written.estimates(problem, &part.kind);
            let partner = Partner {
                cause: part.kind.name().into(),
                column: part.kind.column(),
                parameters: estimates.map(|it| it.named).unwrap_or_default(),
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
                "Chosen for prediction; the name is open: with the other terms it foresees left-out parts, and other \
                 terms may do so as well."
                    .into(),
            ],
            together_with: others.map(|(_, partner)| partner.clone()).collect(),
            rivals: Vec::new(),
            next_test: kind.with_repair(kind.next_test(None).to_string()),
        }
    })
    .collect()
}
