//! Which of the terms that were found are handed out, which of them are written, and how they stand on the hold-out.

use std::sync::Arc;

use trueup_machine::{InputFileError, RunFile};

use super::{
    applied_factor::AppliedFactorCaveat,
    final_model::{fit_final_model, without_causes, without_clock_and_instrument},
    finding::{build_finding, merge_coupled_findings},
    held_out_errors::CrossValidatedRecord,
    hold_out::HoldOut,
    hold_out_evaluation::HoldOutEvaluation,
    report::Finding,
    shortfall::{ReductionBounds, Shortfall},
    slow_drift::SlowDrift,
    step_duration,
    term_selection::{self, TermSelection, is_fully_explained},
    written_terms::WrittenTerms,
};
use crate::{
    data::DataTable,
    fit::{FitProblem, fit},
    folds::Folds,
    judgement::TermJudgement,
    model::Model,
    repeats,
    search::{SearchOutcome, model_comparison::MAX_HELD_OUT_SQUARES_RATIO},
    term_kind::TermKind,
};

/// The result of the search, with what it was made from.
pub(super) struct SearchContext<'a> {
    pub data: &'a Arc<DataTable>,
    pub problem: &'a FitProblem,
    pub found: &'a SearchOutcome,
    pub judged: &'a [TermJudgement],
    /// The runs, as files.
    pub runs: &'a [RunFile],
    /// Rows that were excluded as outliers.
    pub aside: &'a [bool],
}

/// The model as it is handed out.
pub(super) struct ChosenModel {
    /// With what only explains.
    pub model: Model,
    /// The terms that are written, and those that are omitted.
    pub written: WrittenTerms,
    /// Whether it is for prediction alone.
    pub choice: TermSelection,
    /// How it stands on the hold-out; `None` without one.
    pub transfer: Option<HoldOutEvaluation>,
}

impl ChosenModel {
    /// Returns the choice from what was found and judged.
    ///
    /// # Errors
    /// A column is missing in the hold-out that a term needs.
    pub(super) fn select(
        search: &SearchContext<'_>,
        hold_out: Option<&HoldOut<'_>>,
    ) -> Result<Self, InputFileError> {
        let SearchContext { data, problem, found, judged, runs, aside } = *search;
        let mut model = fit_final_model(problem, found, judged);
        let mut written = WrittenTerms::new(problem, found, judged, &model, runs);
        // What was measured several times at the same positions is judged by its repeats.
        let repeats_itself = data.setting.quantity.axis().is_some()
            && repeats::analyse_repeats(data, &Model::default().predict(data), aside).is_some();
        let wanders = SlowDrift::detect(problem, found).is_some();
        let is_fully_explained =
            is_fully_explained(found, judged, wanders) && written.left.is_empty();
        let choice = if is_fully_explained || repeats_itself {
            TermSelection::default()
        } else {
            written.select_terms(problem, found, judged, &model, runs)
        };
        if choice.is_predicted {
            model.parts.retain(|part| !part.kind.is_compensable());
            model.parts.extend(written.board.parts.iter().cloned());
            model.constant_um = written.board.constant_um;
            model.sort_parts();
        }
        let mut transfer = None;
        if let Some(hold_out) = hold_out {
            hold_out.check_required_columns(data, &model)?;
            let on_hold_out = HoldOutEvaluation::new(problem, model, hold_out);
            model = on_hold_out.model.clone();
            if !on_hold_out.dropped.is_empty() && !choice.is_predicted {
                written = WrittenTerms::new(problem, found, judged, &model, runs);
            }
            transfer = Some(on_hold_out);
            written.drop_terms_failing_hold_out(problem, hold_out);
        }
        // What no machine can do explains nothing either.
        let impossible = written.left.iter().filter(|(_, why)| why.is_inseparable());
        let impossible: Vec<TermKind> = impossible.map(|(kind, _)| kind.clone()).collect();
        if !impossible.is_empty() {
            model = without_causes(problem, &model, impossible.iter());
            model = if model.parts.iter().all(|part| part.kind.is_compensable()) {
                written.board.clone()
            } else {
                fit(problem, &model, None).model
            };
        }
        Ok(Self { model, written, choice, transfer })
    }

    /// Returns how far the terms that the board runs (`compensated`, promised by `floor`), or those that only explain,
    /// fall short on the hold-out; `None` where they do not.
    pub(super) fn find_shortfall(
        &self,
        search: &SearchContext<'_>,
        hold_out: &HoldOut<'_>,
        compensated: &Model,
        floor: Option<f64>,
        folds: &Folds,
        within: f64,
    ) -> Option<Shortfall> {
        let SearchContext { data, problem, found, .. } = *search;
        let memory = found.noise.memory * problem.groups.size as f64;
        let of_board = hold_out.data.without_unsupported_terms();
        let test = of_board.as_ref().unwrap_or(&hold_out.data);
        let on_board = floor.and_then(|floor| {
            let promised = ReductionBounds { floor, most_left_um: 0.0 };
            Shortfall::new(data, hold_out, test, compensated, promised, memory)
        });
        if on_board.as_ref().is_some_and(Shortfall::is_significant) {
            return on_board;
        }
        // What only explains is to hold on another day as well.
        let of_names = || {
            let model = without_clock_and_instrument(&self.model);
            if model.parts.len() <= compensated.parts.len() {
                return None;
            }
            let parts =
                CrossValidatedRecord { problem, folds, model: &model, foreseen: None, within };
            let figures = parts.held_out_errors().figures;
            let most_left_um = MAX_HELD_OUT_SQUARES_RATIO.sqrt() * figures.after_um;
            let promised = ReductionBounds { floor: figures.reduction_floor95, most_left_um };
            Shortfall::new(data, hold_out, &hold_out.data, &model, promised, memory)
        };
        of_names().filter(Shortfall::is_significant).or(on_board)
    }

    /// Returns a finding for each term that was judged, and for those that were chosen for prediction. No name is claimed
    /// where most of the error is left and may be the machine.
    pub(super) fn build_findings(
        &self,
        search: &SearchContext<'_>,
        open: &AppliedFactorCaveat,
        after: &[f64],
        within: f64,
        is_most_unknown: bool,
    ) -> Vec<Finding> {
        let SearchContext { data, problem, found, judged, .. } = *search;
        let Self { written, choice, transfer, .. } = self;
        let is_disproved = transfer.as_ref().is_some_and(|transfer| transfer.is_disproved);
        let is_dropped = |cause: &TermKind| {
            transfer.as_ref().is_some_and(|transfer| transfer.dropped.contains(cause))
        };
        let of_judgement = |judgement: &TermJudgement| {
            let left_out = found.folds.unit_for(judgement.cause());
            let mut finding = build_finding(problem, judgement, left_out);
            finding.gain.add_within_group_mean_square(within);
            step_duration::append_duration_sentence(&mut finding, &judgement.part, data, after);
            if is_dropped(judgement.cause()) {
                finding.mark_excluded_by_hold_out();
            }
            if is_disproved && finding.claimed {
                finding.withdraw_claim();
            }
            match written.left.iter().find(|(kind, _)| kind == judgement.cause()) {
                Some((_, why)) => finding.mark_not_written(why),
                None => {
                    finding.mark_written(written.parameter_estimates(problem, judgement.cause()))
                }
            }
            finding
        };
        let mut findings: Vec<Finding> = judged.iter().map(of_judgement).collect();
        // A term may be open only since it could not be written.
        let open_ones = judged.iter().zip(&findings).filter(|(_, finding)| !finding.claimed);
        let open_ones: Vec<&TermKind> = open_ones.map(|(judgement, _)| judgement.cause()).collect();
        for (it, finding) in judged.iter().zip(&mut findings) {
            if let Some(open) = open_ones.iter().find(|open| it.cause().may_be_part_of(open)) {
                finding.mark_dependent_on(open);
            }
            if is_most_unknown {
                finding.mark_mostly_unexplained();
            }
        }
        open.apply_to_findings(&mut findings);
        findings = merge_coupled_findings(judged, findings);
        if let Some(foreseen) = choice.foreseen.as_ref().filter(|_| choice.is_predicted) {
            findings.extend(term_selection::build_prediction_findings(
                problem,
                written,
                foreseen,
                judged,
                &found.folds,
            ));
        }
        findings
    }
}
