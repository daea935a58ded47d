//! The answer: the model as it is handed out, what it brings on data not used for the fit, and
//! the verdict.

mod alias_discrimination;
pub(crate) mod applied_factor;
mod board_residuals;
mod chosen_model;
mod detection_power;
pub(crate) mod error_at_tool;
mod error_curve;
pub(crate) mod extended_machine_file;
mod final_model;
mod finding;
mod fit_degradation;
mod full_scale_hint;
mod held_out_errors;
pub(crate) mod hold_out;
mod hold_out_degradation;
mod hold_out_evaluation;
pub(crate) mod html_report;
mod input_ranges;
mod measured_ranges;
mod next_measurement;
mod omission_reason;
mod plot;
pub mod report;
mod report_plots;
mod residuals;
mod shortfall;
mod slow_drift;
mod step_duration;
mod term_selection;
mod unexplained_residual;
mod validation_data;
mod value_range;
mod variance_components;
mod verdict;
pub(crate) mod written_terms;

use std::sync::Arc;

use trueup_machine::{
    InputFileError, RunFile, compile::missing_input_lines, effect::peak_to_peak, machine_file::Term,
};
use trueup_numerics::block_resampling::rms;

use crate::{
    data::DataTable,
    extension_terms::ExtensionTerms,
    fit::FitProblem,
    folds::Folds,
    judgement::TermJudgement,
    model::Model,
    next_run::model_pair::{ModelPair, find_indistinguishable_pairs},
    outliers::{ExcludedRows, OutlierJudgement},
    parameter_estimates::mean_row_interval_s,
    repeats::{self, RepeatStatistics},
    search::{RejectedCandidate, SearchOutcome},
    term_kind::{ModelPart, TermKind},
};
use applied_factor::BridgeOffsets;
use board_residuals::compute_board_residuals;
use chosen_model::{ChosenModel, SearchContext};
use detection_power::{COVERAGE, DetectionPower};
use finding::{build_outlier_finding, describe_unclaimed_outliers};
use held_out_errors::CrossValidatedRecord;
use hold_out::HoldOut;
use report::{
    DiagnosisReport, ErrorsAfterExtension, ErrorsBeforeExtension, OmittedCause, RejectedCause,
    Verdict,
};
use residuals::{Residuals, compute_residuals_by_row, remove_zero_offset};
use shortfall::Shortfall;
use slow_drift::SlowDrift;
use unexplained_residual::UnexplainedResidual;
use validation_data::ValidationData;
use verdict::{VerdictEvidence, VerdictReason, decide_verdict};

/// The answer, with all that is needed to write it down.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// The answer.
    pub report: DiagnosisReport,
    /// The new terms of the extended machine file, in its order.
    pub terms: Vec<Term>,
    /// Terms in the place of those of the machine file that are not right any more, with their numbers
    /// in it, from 0.
    pub corrected: Vec<(usize, Term)>,
    pub(crate) data: Arc<DataTable>,
    /// The current machine file's prediction of each row, in µm.
    pub(crate) before: Vec<f64>,
    /// The extended one's prediction of each row, in µm.
    pub(crate) after: Vec<f64>,
    /// Rows that were excluded as outliers.
    pub(crate) aside: Vec<bool>,
    /// Whether the noise of a reading is known from its repeats.
    pub(crate) noise_is_measured: bool,
    pub(crate) promise: error_at_tool::ErrorPredictor,
    /// The open questions, and the runs as they were read: for the run that comes next.
    pub(crate) questions: Vec<ModelPair>,
    pub(crate) runs: Vec<RunFile>,
}

/// Inputs of the answer next to the result of the search.
pub(crate) struct DiagnosisInputs<'a> {
    /// The runs, as files.
    pub runs: &'a [RunFile],
    pub hold_out: Option<&'a HoldOut<'a>>,
    /// The size of an error that matters: RMS, in µm; by default what is left.
    pub matters_um: Option<f64>,
    /// The offsets that a bridge applied.
    pub bridge: &'a BridgeOffsets,
    /// Notes on the files, a sentence each.
    pub notes: Vec<String>,
}

/// The answer to what was found and `judged`.
///
/// # Errors
/// A column is missing in the hold-out that a term needs.
pub(crate) fn build_diagnosis(
    data: Arc<DataTable>,
    problem: &FitProblem,
    found: SearchOutcome,
    judged: &[TermJudgement],
    ExcludedRows { rows: aside, known }: ExcludedRows,
    asked: DiagnosisInputs<'_>,
) -> Result<Diagnosis, InputFileError> {
    let runs = asked.runs;
    let search = SearchContext { data: &data, problem, found: &found, judged, runs, aside: &aside };
    let mut chosen = ChosenModel::select(&search, asked.hold_out)?;
    let residuals = Residuals::new(&data, problem, &chosen.model, &aside);
    let within = residuals.within;
    let open = asked.bridge.factor_caveat(problem, &found, judged);
    if open.forbids_writing() {
        chosen.written.clear_terms();
    }
    let ChosenModel { model, written, choice, transfer } = &chosen;
    let dropped: &[TermKind] = transfer.as_ref().map_or(&[], |transfer| &transfer.dropped);
    let compensated = compensated_model(&written.board);
    let test = asked.hold_out.map(|hold_out| &hold_out.data);
    let unseen = ValidationData { problem, folds: &found.folds, within, test };
    let [unseen_um, extended_unseen_um @ ..] = validation_rms_um(&unseen, &chosen, &compensated);
    let machine = extended_machine_file::extend_machine(&data, &written.board);
    // The zero of an axis's measurement counts neither before nor after.
    let on_board = compute_board_residuals(&data, runs, &machine, &compensated, &aside);
    let on_board = remove_zero_offset(&data, on_board);
    let own = written.board_problem(problem);
    let not_run = written.uncompensated_mean_square(&data, model);
    let promise = error_at_tool::ErrorPredictor::new(own, &found, &compensated, not_run);
    let is_corrected = !compensated.parts.is_empty();
    let folds = Folds::for_prediction(own);
    let (board, foreseen) = (&written.board, choice.foreseen.as_ref());
    let parts =
        CrossValidatedRecord { problem: own, folds: &folds, model: board, foreseen, within };
    let held_out = is_corrected.then(|| parts.held_out_errors());
    let floor = held_out.as_ref().map(|held_out| held_out.figures.reduction_floor95);
    let shortfall = asked.hold_out.and_then(|hold_out| {
        chosen.find_shortfall(&search, hold_out, &compensated, floor, &folds, within)
    });
    let questions = find_indistinguishable_pairs(problem, &found, judged);
    let has_outliers = known == OutlierJudgement::Wrong;
    let notes = append_warnings(asked.notes, &aside, known, shortfall.as_ref());
    let left = ResidualSummary::new(&search, &residuals, asked.matters_um);
    let (verdict, reasons) =
        left.decide_verdict(&search, &chosen, shortfall.as_ref(), has_outliers);
    let (verdict, reasons) = open.adjust_verdict(verdict, reasons);
    let Residuals { before, after, before_rows, after_rows, .. } = residuals;
    let is_most_unknown = left.unknown_rest.is_some_and(|rest| rest.is_most);
    let mut findings = chosen.build_findings(&search, &open, &after, within, is_most_unknown);
    findings.splice(0..0, open.to_finding(asked.bridge, &data, &after));
    findings.extend(has_outliers.then(|| build_outlier_finding(&data, &after, &aside)));
    let ResidualSummary { noise_um, repeats, power, wandering, .. } = left;
    let gauge_um = estimate_gauge_noise_um(&data, problem, noise_um, repeats.is_some());
    let of_parts = is_corrected.then(|| parts.error_reduction_at_tool(gauge_um));
    let at_tool = promise.predict_error_on_table(&data, runs, of_parts)?;
    let law = &data.predicted.law;
    let hints = full_scale_hint::full_scale_hints(&data.setting.machine, &findings, law);
    let report = DiagnosisReport {
        schema: 1,
        rows: data.rows,
        rows_used: after_rows.len(),
        quantity: data.setting.quantity.name().into(),
        noise_um,
        noise_memory: found.noise.memory
            * problem.groups.size as f64
            * mean_row_interval_s(problem),
        detectable_um: power.found_um,
        wandering: wandering.as_ref().map(SlowDrift::to_report),
        before: ErrorsBeforeExtension::from_residuals(&before_rows, unseen_um),
        after: ErrorsAfterExtension::from_residuals(&after_rows, &on_board, extended_unseen_um),
        verdict,
        reasons: deduplicate(reasons.iter().map(ToString::to_string)),
        notes,
        holdout_used: !dropped.is_empty(),
        left_out: dropped.iter().map(to_omitted_cause).collect(),
        hints,
        findings,
        missing_inputs: Vec::new(),
        at_tool,
        held_out,
        rejected: found.rejected.into_iter().map(to_rejected_cause).collect(),
    };
    let ExtensionTerms { replaced: corrected, new: terms } = written.to_extension_terms(&data);
    let diagnosis = Diagnosis {
        report,
        terms,
        corrected,
        data,
        before,
        after,
        aside,
        noise_is_measured: repeats.is_some(),
        promise,
        questions,
        runs: runs.to_vec(),
    };
    Ok(record_missing_inputs(diagnosis))
}

/// Returns `notes` with the notes about rows that were excluded as outliers, and of a hold-out.
fn append_warnings(
    notes: Vec<String>,
    aside: &[bool],
    known: OutlierJudgement,
    shortfall: Option<&Shortfall>,
) -> Vec<String> {
    let of_rows = describe_unclaimed_outliers(aside, known);
    let of_hold_out = shortfall.and_then(Shortfall::warning);
    notes.into_iter().chain(of_rows).chain(of_hold_out).collect()
}

/// Fills in which inputs the machine of a diagnosis that corrects needs.
fn record_missing_inputs(mut diagnosis: Diagnosis) -> Diagnosis {
    if diagnosis.has_corrections() {
        diagnosis.report.missing_inputs =
            missing_input_lines(&extended_machine_file::build_extended_machine(&diagnosis));
    }
    diagnosis
}

/// The residual of the model.
struct ResidualSummary {
    repeats: Option<RepeatStatistics>,
    /// The noise of a reading.
    noise_um: f64,
    between_neighbours_um: f64,
    power: DetectionPower,
    wandering: Option<SlowDrift>,
    unknown_rest: Option<UnexplainedResidual>,
}

impl ResidualSummary {
    fn new(search: &SearchContext<'_>, residuals: &Residuals, matters_um: Option<f64>) -> Self {
        let SearchContext { data, problem, found, aside, .. } = *search;
        let Residuals { after, before_rows, after_rows, .. } = residuals;
        let repeats = repeats::analyse_repeats(data, after, aside);
        let left_um = rms(after_rows);
        let by_row = compute_residuals_by_row(data, after, Some(aside));
        let spread_um = [rms(before_rows), left_um];
        Self {
            noise_um: estimate_noise_um(problem, found, after_rows, repeats.as_ref()),
            between_neighbours_um: estimate_neighbour_noise_um(after_rows),
            power: DetectionPower::new(problem, found, left_um, after_rows.len(), matters_um),
            wandering: SlowDrift::detect(problem, found),
            unknown_rest: UnexplainedResidual::detect(data, repeats.as_ref(), spread_um, &by_row),
            repeats,
        }
    }

    /// Returns the verdict on the answer, and why.
    fn decide_verdict(
        &self,
        search: &SearchContext<'_>,
        chosen: &ChosenModel,
        shortfall: Option<&Shortfall>,
        has_outliers: bool,
    ) -> (Verdict, Vec<VerdictReason>) {
        decide_verdict(&VerdictEvidence {
            found: search.found,
            judged: search.judged,
            has_outliers,
            repeats: self.repeats.as_ref(),
            power: &self.power,
            wandering: self.wandering.as_ref(),
            unknown_rest: self.unknown_rest,
            between_neighbours_um: self.between_neighbours_um,
            instrument_um: search.data.setting.machine.instrument_um,
            transfer: chosen.transfer.as_ref(),
            shortfall,
            is_predicted: chosen.choice.is_predicted,
            is_withheld: chosen.written.has_withheld_term(),
        })
    }
}

/// Returns what the machine file, the model and what is compensated of it leave on data not used for the fit: RMS,
/// in µm.
fn validation_rms_um(
    unseen: &ValidationData<'_>,
    chosen: &ChosenModel,
    compensated: &Model,
) -> [f64; 3] {
    let after_um = unseen.model_residual_rms_um(&chosen.model);
    let compensated_um = if *compensated == chosen.model {
        after_um
    } else {
        chosen.written.validation_rms_um(unseen, unseen.problem, compensated)
    };
    [unseen.current_file_residual_rms_um(), after_um, compensated_um]
}

/// Returns the sentences in their order, none of them twice: forms of one cause say the same.
fn deduplicate(sentences: impl Iterator<Item = String>) -> Vec<String> {
    let mut all: Vec<String> = Vec::new();
    for sentence in sentences {
        if !all.contains(&sentence) {
            all.push(sentence);
        }
    }
    all
}

/// Returns the model as the board runs it: without what only happened once, and what is not the machine's; and in the
/// form that needs no feed.
fn compensated_model(model: &Model) -> Model {
    let mut compensated = model.clone();
    compensated.parts.retain(|part| part.kind.is_compensable());
    compensated.parts.iter_mut().for_each(ModelPart::remove_feed_dependence);
    if compensated.parts.is_empty() { Model::default() } else { compensated }
}

/// Returns the noise of one reading, in µm: from repeats where there are any, else from what differs between
/// neighbours in `errors`, with the memory of the noise taken into account.
fn estimate_noise_um(
    problem: &FitProblem,
    found: &SearchOutcome,
    errors: &[f64],
    repeats: Option<&RepeatStatistics>,
) -> f64 {
    if let Some(repeats) = repeats {
        return repeats.scatter_um;
    }
    let differences: Vec<f64> = errors.windows(2).map(|pair| pair[1] - pair[0]).collect();
    if differences.is_empty() {
        return 0.0;
    }
    let memory = found.noise.memory * problem.groups.size as f64;
    let next = if memory > 0.0 { (1.0 - found.noise.white) * (-1.0 / memory).exp() } else { 0.0 };
    (rms(&differences) / (2.0 * (1.0 - next)).sqrt()).min(rms(errors))
}

/// Returns the part of `estimate_noise_um` that is surely the gauge's: it was seen at repeats, or from reading to reading while
/// next to nothing changed. Where an axis moves from reading to reading and none comes again, nothing of it is known.
fn estimate_gauge_noise_um(
    data: &DataTable,
    problem: &FitProblem,
    noise_um: f64,
    is_repeated: bool,
) -> f64 {
    let moves = data.own_position_mm().is_some_and(|mm| peak_to_peak(mm) > 0.0);
    let stated_um = data.setting.machine.instrument_um.map(|um| um / COVERAGE);
    if is_repeated || !moves && problem.data.time_s().is_some() {
        noise_um
    } else {
        stated_um.unwrap_or(0.0).min(noise_um)
    }
}

/// Returns the noise of neighbouring `errors`: the standard deviation of each by their differences, in µm.
fn estimate_neighbour_noise_um(errors: &[f64]) -> f64 {
    let differences: Vec<f64> = errors.windows(2).map(|pair| pair[1] - pair[0]).collect();
    rms(&differences) / 2.0_f64.sqrt()
}

fn to_omitted_cause(cause: &TermKind) -> OmittedCause {
    OmittedCause { cause: cause.name().into(), column: cause.column() }
}

fn to_rejected_cause(tried: RejectedCandidate) -> RejectedCause {
    RejectedCause {
        cause: tried.cause.name().into(),
        column: tried.cause.column(),
        reason: tried.why_not.to_string(),
        rms_um: tried.rms_um,
        left_out_um: tried.left_out_um,
    }
}
