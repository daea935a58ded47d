//! The written terms: those that the board runs, fitted as it runs them.
//!
//! A diagnosis explains a record with all that helps: a drift, a jump, an error of the instrument. The board
//! runs none of these, so a term next to them may be anything that they take back. The written terms are therefore
//! compared with what was measured:
//!
//! ```text
//! joint fit ─► without a term whose size is not known next to the others, or that gains nothing on held-out blocks
//!           ─► without a term larger than twice what was measured, or which leaves its range in another state
//!           ─► without what the board does not run; that is fitted to the rest
//!           ─► nothing, where the same rows or held-out blocks gain nothing by it
//! ```
//!
//! Terms that the board does not run stay in the fit: a gauge that drifts would otherwise be written as growth, which
//! another day does not have (up to seven times the error on simulated spindles). The promise is what the board does on
//! the same rows without them.
//!
use std::sync::Arc;

use trueup_machine::RunFile;
use trueup_numerics::{
    block_resampling::rms,
    robust::{MAX_OUTLIER_FRACTION, MIN_CUTOFF_SCALES, median},
};

use crate::{
    data::DataTable,
    diagnosis::{
        final_model::{without_causes, without_record_specific_terms},
        fit_degradation::is_fit_degraded,
        hold_out::HoldOut,
        hold_out_evaluation::HoldOutEvaluation,
        measured_ranges::MeasuredRanges,
        omission_reason::OmissionReason,
        residuals::remove_zero_offset,
        validation_data::ValidationData,
    },
    extension_terms::ExtensionTerms,
    fit::{FitProblem, FittedModel, fit},
    judgement::TermJudgement,
    model::Model,
    parameter_estimates::{ParameterEstimates, estimate_parameters},
    search::{SearchOutcome, initial_model, model_comparison::estimate_noise},
    term_kind::TermKind,
};

/// The written terms of an answer, and those that are not.
pub(crate) struct WrittenTerms {
    /// The terms that the board runs.
    pub board: Model,
    /// The terms that only explain, fitted next to them; with a constant of their own.
    pub explains: Model,
    /// The problem without what the file has and the board does not run, where there is such.
    own: Option<FitProblem>,
    /// Causes that are not written though the board could run them, and why.
    pub left: Vec<(TermKind, OmissionReason)>,
}

impl WrittenTerms {
    /// Returns the terms of both in the machine file.
    pub(super) fn to_extension_terms(&self, data: &DataTable) -> ExtensionTerms {
        let mut both = ExtensionTerms::from_model(data, &self.board);
        let explains = ExtensionTerms::from_model(data, &self.explains);
        both.replaced.extend(explains.replaced);
        both.new.extend(explains.new);
        both
    }

    /// Returns whether a term is omitted that cannot be separated from another.
    pub(super) fn has_withheld_term(&self) -> bool {
        self.left.iter().any(|(_, why)| why.is_inseparable())
    }

    /// Of the answer `found`, `judged`, of which `joint` is handed out; measured in `runs`.
    pub(crate) fn new(
        problem: &FitProblem,
        found: &SearchOutcome,
        judged: &[TermJudgement],
        joint: &Model,
        runs: &[RunFile],
    ) -> Self {
        let own = without_unsupported_terms(problem);
        let mut written =
            Self { board: joint.clone(), explains: Model::default(), own, left: Vec::new() };
        let only_explains: Vec<TermKind> = filter_term_kinds(joint, |kind| !kind.is_compensable());
        if !only_explains.is_empty() || written.own.is_some() {
            written.board = written.refit_board_terms(problem, found, judged, joint);
            written.drop_dependent_terms(problem, found, judged);
        }
        written.drop_extrapolating_terms(problem, found, runs);
        written.board = board_model(&written.board);
        written.drop_terms_without_gain(problem, found, judged);
        written.explains = written.fit_uncompensated_terms(problem, joint);
        written
    }

    /// Writes nothing: the machine file stays.
    pub(super) fn clear_terms(&mut self) {
        (self.board, self.explains) = (Model::default(), Model::default());
    }

    /// Returns the problem that the board's terms are fitted to.
    pub(crate) fn board_problem<'p>(&'p self, problem: &'p FitProblem) -> &'p FitProblem {
        self.own.as_ref().unwrap_or(problem)
    }

    /// `joint` on the problem of the board's terms, fitted again.
    fn refit_board_terms(
        &self,
        problem: &FitProblem,
        found: &SearchOutcome,
        judged: &[TermJudgement],
        joint: &Model,
    ) -> Model {
        let problem = self.board_problem(problem);
        let is_handed_out = |kind: &TermKind| joint.contains(kind);
        // What is of this record alone is fitted next to the others, and omitted then.
        let is_of_record = |kind: &TermKind| {
            judged.iter().any(|judgement| {
                judgement.cause() == kind && !judgement.is_kept && judgement.is_record_specific()
            })
        };
        let leave = filter_term_kinds(&found.fitted.model, |kind| {
            !is_handed_out(kind) && !is_of_record(kind)
        });
        let model = without_causes(problem, &found.fitted.model, leave.iter());
        if model.parts.is_empty() {
            return Model::default();
        }
        without_record_specific_terms(problem, fit(problem, &model, None).model, judged)
    }

    /// Leaves out what only held up a term that the board does not run, the one that gains least first.
    fn drop_dependent_terms(
        &mut self,
        problem: &FitProblem,
        found: &SearchOutcome,
        judged: &[TermJudgement],
    ) {
        let is_claimed = |kind: &TermKind| {
            judged.iter().any(|judgement| judgement.cause() == kind && judgement.doubts.is_empty())
        };
        loop {
            let on = self.board_problem(problem);
            let fitted = evaluate_model(on, &self.board);
            let noise = estimate_noise(on, &fitted.residual, fitted.degrees);
            let with = found.folds.held_out_residuals(on, &self.board);
            let run = self.board.parts.iter().filter(|part| part.kind.is_compensable());
            let held_up = run.filter_map(|part| {
                let without = self.refit_without_term(on, &part.kind);
                let paired = found
                    .folds
                    .compare_paired(&found.folds.held_out_residuals(on, &without), &with);
                let is_unsettled = || estimate_parameters(on, &fitted, part, noise).reaches_nothing;
                let is_held_up = paired.gain <= 0.0
                    || is_unsettled() && !(is_claimed(&part.kind) && paired.is_better());
                is_held_up.then(|| (paired.gain, part.kind.clone(), without))
            });
            let least = held_up.min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((_, kind, without)) = least else { return };
            self.left.push((kind, OmissionReason::DependsOnUncompensatedTerm));
            self.board = without;
        }
    }

    /// Returns the board's terms without one, fitted again.
    fn refit_without_term(&self, on: &FitProblem, kind: &TermKind) -> Model {
        let rest = without_causes(on, &self.board, std::iter::once(kind));
        if rest.parts.is_empty() { rest } else { fit(on, &rest, None).model }
    }

    /// Leaves out terms until each, and their sum in every state, is what a machine can do that was measured so.
    fn drop_extrapolating_terms(
        &mut self,
        problem: &FitProblem,
        found: &SearchOutcome,
        runs: &[RunFile],
    ) {
        let on = self.board_problem(problem);
        let bounds = MeasuredRanges::new(on, runs);
        let (mut board, mut left) = (self.board.clone(), Vec::new());
        while let Some((_, why)) = bounds.find_first_violation(on, &board_model(&board)) {
            // Tables and curves answer for themselves, by their repeats and point by point.
            let is_single = |kind: &TermKind| kind.is_compensable() && kind.list_length().is_none();
            let single = board.parts.iter().filter(|part| is_single(&part.kind));
            let tried = single.map(|part| {
                let rest = without_causes(on, &board, std::iter::once(&part.kind));
                let rest = if rest.parts.is_empty() { rest } else { fit_trimmed(on, &rest) };
                let left_um = robust_residual_std(&found.folds.held_out_residuals(on, &rest));
                (
                    bounds.find_first_violation(on, &board_model(&rest)).is_some(),
                    left_um,
                    part.kind.clone(),
                    rest,
                )
            });
            let best = tried.min_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
            let Some((_, _, dropped, rest)) = best else { break };
            left.push((dropped, why));
            board = rest;
        }
        self.board = board;
        self.left.extend(left);
    }

    /// Writes nothing where that is worse on the rows that it was fitted to, or, of terms of which none is claimed,
    /// does not predict held-out blocks better. Terms that stood next to dropped ones are fitted once more before.
    fn drop_terms_without_gain(
        &mut self,
        problem: &FitProblem,
        found: &SearchOutcome,
        judged: &[TermJudgement],
    ) {
        if self.board.parts.is_empty() {
            return;
        }
        let on = self.board_problem(problem);
        let foresees = |model: &Model| {
            let [before, after] = [&initial_model(&on.data), model]
                .map(|model| found.folds.held_out_residuals(on, model));
            found.folds.compare_paired(&before, &after).is_better()
        };
        let is_claimed = |judgement: &TermJudgement| {
            judgement.doubts.is_empty() && self.board.contains(judgement.cause())
        };
        let is_certain = judged.iter().any(is_claimed);
        let again = is_fit_degraded(on, &self.board)
            .then(|| board_model(&fit(on, &self.board, None).model));
        let board = again.as_ref().unwrap_or(&self.board);
        if is_fit_degraded(on, board) || !is_certain && !foresees(board) {
            let parts = std::mem::take(&mut self.board).parts;
            self.left.extend(parts.into_iter().map(|part| (part.kind, OmissionReason::NoGain)));
        } else if let Some(again) = again {
            self.board = again;
        }
    }

    /// Returns what of `joint` only explains, fitted to what the board's terms leave.
    fn fit_uncompensated_terms(&self, problem: &FitProblem, joint: &Model) -> Model {
        let mut model = Model {
            parts: joint.parts.iter().filter(|part| !part.kind.is_compensable()).cloned().collect(),
            constant_um: Some(0.0),
        };
        if model.parts.is_empty() {
            return Model::default();
        }
        let (added, others): (Vec<_>, Vec<_>) =
            model.parts.into_iter().partition(|part| part.kind.is_additive());
        model = Model { parts: added, constant_um: Some(0.0) };
        if model.parts.is_empty() {
            model.constant_um = None;
        } else {
            let [own, believed] = [&self.board, &Model::default()]
                .map(|model| self.board_problem(problem).predict(model));
            let rows = problem.measured.iter().zip(own.iter().zip(&believed));
            let rest = rows.map(|(um, (own, believed))| um - own + believed).collect();
            model = fit(&problem.with_measured(rest), &model, None).model;
        }
        model.parts.extend(others);
        model.sort_parts();
        model
    }

    /// Leaves out what makes a hold-out worse now that the terms stand alone.
    pub(super) fn drop_terms_failing_hold_out(
        &mut self,
        problem: &FitProblem,
        hold_out: &HoldOut<'_>,
    ) {
        let data = hold_out.data.without_unsupported_terms();
        let own = data.map(|data| HoldOut { files: hold_out.files, data });
        let hold_out = own.as_ref().unwrap_or(hold_out);
        let HoldOutEvaluation { model, dropped, .. } =
            HoldOutEvaluation::new(self.board_problem(problem), self.board.clone(), hold_out);
        self.board = model;
        self.left.extend(
            dropped.into_iter().map(|kind| (kind, OmissionReason::DependsOnUncompensatedTerm)),
        );
    }

    /// Returns what `compensated`, as the board runs it, leaves on data that were not used for the fit.
    pub(super) fn validation_rms_um(
        &self,
        unseen: &ValidationData<'_>,
        problem: &FitProblem,
        compensated: &Model,
    ) -> f64 {
        let test = unseen.test.and_then(DataTable::without_unsupported_terms);
        let unseen = ValidationData {
            problem: self.board_problem(problem),
            folds: unseen.folds,
            within: unseen.within,
            test: test.as_ref().or(unseen.test),
        };
        unseen.model_residual_rms_um(compensated)
    }

    /// Returns the mean square of what the machine does that `model` explains and the board does not run, in µm²: a
    /// drift and a jump come again; an error of the instrument or of a clock is not at the tool.
    pub(super) fn uncompensated_mean_square(&self, data: &DataTable, model: &Model) -> f64 {
        let is_of_machine = |kind: &TermKind| !kind.is_instrument_error() && !kind.is_time_shift();
        let of_machine = |kind: &TermKind| kind.is_compensable() || is_of_machine(kind);
        if filter_term_kinds(model, |kind| !kind.is_compensable() && is_of_machine(kind)).is_empty()
        {
            return 0.0;
        }
        let mut whole = model.clone();
        whole.parts.retain(|part| of_machine(&part.kind));
        let [whole, board] = [&whole, &self.board].map(|model| model.predict(data));
        let rows = (0..data.rows).filter(|&row| data.used[row]);
        let apart: Vec<f64> = rows.map(|row| whole[row] - board[row]).collect();
        rms(&remove_zero_offset(data, apart)).powi(2)
    }

    /// Returns the values in the file of a term, by name, with their intervals; `None`: it is not written.
    pub(crate) fn parameter_estimates(
        &self,
        problem: &FitProblem,
        kind: &TermKind,
    ) -> Option<ParameterEstimates> {
        let (on, model) = if self.board.contains(kind) {
            (self.board_problem(problem), &self.board)
        } else {
            (problem, &self.explains)
        };
        let part = model.parts.iter().find(|part| part.kind == *kind)?;
        let fitted = evaluate_model(on, model);
        Some(estimate_parameters(
            on,
            &fitted,
            part,
            estimate_noise(on, &fitted.residual, fitted.degrees),
        ))
    }
}

/// Returns the parts that the board runs. Without one the machine file stays, and with it its zero.
fn board_model(model: &Model) -> Model {
    let parts: Vec<_> =
        model.parts.iter().filter(|part| part.kind.is_compensable()).cloned().collect();
    if parts.is_empty() { Model::default() } else { Model { parts, ..model.clone() } }
}

/// Returns the kinds of the parts that are so.
fn filter_term_kinds(model: &Model, is_so: impl Fn(&TermKind) -> bool) -> Vec<TermKind> {
    model.parts.iter().map(|part| &part.kind).filter(|kind| is_so(kind)).cloned().collect()
}

/// Returns the problem without the terms of the machine file that the board does not run; `None`: there are none.
fn without_unsupported_terms(problem: &FitProblem) -> Option<FitProblem> {
    let data = problem.data.without_unsupported_terms()?;
    Some(FitProblem::new(Arc::new(data), problem.groups.clone()))
}

/// Returns what `model` leaves, as it stands.
fn evaluate_model(problem: &FitProblem, model: &Model) -> FittedModel {
    let residual = problem.residual(model);
    let sum = residual.iter().map(|r| r * r).sum();
    let degrees = crate::search::model_comparison::degrees_of_freedom(model);
    FittedModel { model: model.clone(), residual, sum, degrees }
}

/// Returns the fit of a model to all readings but a few that are far from the rest: what explained them has left.
fn fit_trimmed(problem: &FitProblem, model: &Model) -> Model {
    let first = fit(problem, model, None);
    if problem.groups.size > 1 {
        return first.model;
    }
    let mut sizes: Vec<f64> = first.residual.iter().map(|r| r.abs()).collect();
    let most_um = MIN_CUTOFF_SCALES * mad_std(&mut sizes);
    let mask: Vec<bool> = first.residual.iter().map(|r| r.abs() <= most_um).collect();
    let far = mask.iter().filter(|is_near| !**is_near).count() as f64;
    if far == 0.0 || far > MAX_OUTLIER_FRACTION * mask.len() as f64 {
        return first.model;
    }
    fit(problem, &first.model, Some(&mask)).model
}

/// Returns the standard deviation of sizes whose few largest do not count.
fn mad_std(sizes: &mut [f64]) -> f64 {
    /// A normal distribution's median of sizes, in standard deviations.
    const NORMAL_MAD_PER_STD: f64 = 0.674_489_750_196_082;
    median(sizes) / NORMAL_MAD_PER_STD
}

/// Returns how large residuals mostly are.
fn robust_residual_std(residual: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = residual.iter().map(|r| r.abs()).collect();
    mad_std(&mut sizes).min(rms(residual))
}
