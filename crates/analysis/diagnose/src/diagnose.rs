//! The pipeline: runs → table → problem → search → judgement → answer.

use std::sync::Arc;

use trueup_machine::{
    InputFileError, Machine, RunFile,
    effect::{DelayKind, ThermometerDelay},
    machine_file::Quantity,
};
use trueup_numerics::{block_resampling::MAX_BLOCKS, random::RandomGenerator};

use crate::{
    candidates::propose_curve_candidates,
    data::{DataTable, RowGroups, first_finite_or_zero, resolve_quantity},
    diagnosis::{
        Diagnosis, DiagnosisInputs,
        applied_factor::BridgeOffsets,
        build_diagnosis,
        hold_out::{HoldOut, describe_duplicate_hold_outs},
    },
    fit::{FitProblem, FittedModel, fit},
    judgement::{TermJudgement, judge_terms},
    model::Model,
    outliers::{self, ExcludedRows},
    search::{SearchOutcome, SearchScope, initial_model, lack_of_fit::add_best_curves, search},
    term_kind::ModelPart,
};

/// Groups that the search works on where there is time alone; rows beyond are averaged.
const MAX_ROW_GROUPS: usize = 1000;
/// Rows that the search works on where an axis moves: an average would blur its errors, so that of
/// more rows this many are drawn by chance. The last fit is to all of them.
const MOVING_AXIS_SAMPLE_ROWS: usize = 3000;

/// Callback for what is being tried, and how far the search has come, 0…1 (NaN: as before).
pub type ProgressCallback<'p> = dyn FnMut(&str, f64) + 'p;

/// Options of a diagnosis.
#[derive(Clone, Copy, Debug, Default)]
pub struct DiagnosisOptions {
    /// The quantity to compare, where the runs measure several.
    pub quantity: Option<Quantity>,
    /// The size of an error that matters: RMS, in µm, above 0; by default what is left.
    pub matters_um: Option<f64>,
    /// The CNC is known to apply the offsets of a bridge once; else that is judged by the runs.
    pub is_applied_once: bool,
}

/// Compares `machine` with what was measured in `runs`, names the causes of what it gets wrong, and
/// measures what their terms bring on `holdout`: it chooses nothing, but that what makes it worse is not
/// handed out.
///
/// # Errors
/// There is no such quantity in a run, or several and none is requested; a column is missing without
/// which nothing can be predicted, or in a hold-out one that a term needs; no row is both measured and
/// predicted.
pub fn diagnose(
    machine: &Machine,
    runs: &[RunFile],
    holdout: &[RunFile],
    quantity: Option<Quantity>,
    progress: &mut ProgressCallback<'_>,
) -> Result<Diagnosis, InputFileError> {
    diagnose_with_options(
        machine,
        runs,
        holdout,
        DiagnosisOptions { quantity, ..DiagnosisOptions::default() },
        progress,
    )
}

/// The same with more to say.
///
/// # Errors
/// As those of [`diagnose`].
pub fn diagnose_with_options(
    machine: &Machine,
    runs: &[RunFile],
    holdout: &[RunFile],
    DiagnosisOptions { quantity, matters_um, is_applied_once }: DiagnosisOptions,
    progress: &mut ProgressCallback<'_>,
) -> Result<Diagnosis, InputFileError> {
    let quantity = resolve_quantity(runs, quantity)?;
    resolve_quantity(if holdout.is_empty() { runs } else { holdout }, Some(quantity))?;
    let bridge = BridgeOffsets::from_runs(machine, [runs, holdout], quantity, is_applied_once)?;
    let factor = bridge.offset_factor();
    let data = Arc::new(
        DataTable::with_offset_factor(machine, runs, quantity, factor)?.without_untrusted_columns(),
    );
    let test = if holdout.is_empty() {
        None
    } else {
        let mut test = DataTable::with_offset_factor(machine, holdout, quantity, factor)?;
        test.copy_origin_from(&data);
        Some(HoldOut { files: holdout, data: test })
    };
    let mut notes = data.notes.clone();
    notes.extend(test.iter().flat_map(|test| test.data.notes.iter().cloned()));
    notes.extend(describe_duplicate_hold_outs(runs, holdout));
    // Repeats say before any cause is known which readings stand alone.
    let mut answer = search_and_judge_terms(&data, SearchScope::Composed, progress);
    // What takes two inputs together is one of very many: it is the answer where it is claimed, else a simpler one is.
    if answer
        .judged
        .iter()
        .any(|judgement| judgement.cause().is_flexible() && !judgement.doubts.is_empty())
    {
        answer = search_and_judge_terms(&data, SearchScope::Simple, progress);
    }
    let JudgedSearchOutcome { problem, found, aside, judged } = answer;
    let known = outliers::classify_outliers(&data, &aside, || {
        predict_with_and_without_curves(&data, &problem, &found)
    });
    let mut concluded = build_diagnosis(
        data,
        &problem,
        found,
        &judged,
        ExcludedRows { rows: aside, known },
        DiagnosisInputs { runs, hold_out: test.as_ref(), matters_um, bridge: &bridge, notes },
    )?;
    concluded.apply_tool_labels(machine);
    Ok(concluded)
}

/// The answer of a search, judged.
struct JudgedSearchOutcome {
    problem: FitProblem,
    found: SearchOutcome,
    /// Rows that stand alone.
    aside: Vec<bool>,
    judged: Vec<TermJudgement>,
}

/// Returns the answer of a search of this breadth, without the rows that stand alone.
fn search_and_judge_terms(
    data: &Arc<DataTable>,
    breadth: SearchScope,
    progress: &mut ProgressCallback<'_>,
) -> JudgedSearchOutcome {
    let mut aside = outliers::find_repeat_outliers(data, &Model::default().predict(data));
    let (mut problem, mut found) = run_search(data, &aside, None, breadth, progress);
    // Gross errors are seen once the rest is explained; then the rest is searched without them. Once
    // more, where fewer or others are seen then.
    for _ in 0..2 {
        let gross = find_gross_errors(data, &problem, &found);
        if gross == aside {
            break;
        }
        aside = gross;
        let known = found.fitted.model;
        (problem, found) = run_search(data, &aside, Some(&known), breadth, progress);
    }
    progress("comparing with alternatives", 0.92);
    let judged = judge_terms(&problem, &found);
    JudgedSearchOutcome { problem, found, aside, judged }
}

/// Returns what the answer predicts of each row, with curves over what it leaves and without: a law that no cause
/// has is no gross error.
fn predict_with_and_without_curves(
    data: &DataTable,
    problem: &FitProblem,
    found: &SearchOutcome,
) -> [Vec<f64>; 2] {
    let rest = add_best_curves(problem, &found.fitted, &propose_curve_candidates(problem));
    [rest.model.predict(data), found.fitted.model.predict(data)]
}

/// Rows that stand alone, far from what is predicted.
fn find_gross_errors(data: &DataTable, problem: &FitProblem, found: &SearchOutcome) -> Vec<bool> {
    let [with_curves, plain] = predict_with_and_without_curves(data, problem, found);
    let alone = outliers::find_gross_errors(data, &with_curves);
    let among_repeats = outliers::find_repeat_outliers(data, &plain);
    alone.iter().zip(among_repeats).map(|(alone, there)| *alone || there).collect()
}

/// Returns the search on the rows that count and are not excluded as outliers: on all of them, on means of neighbours, or
/// on as many as suffice. The last fit is to all of them.
fn run_search(
    data: &Arc<DataTable>,
    aside: &[bool],
    known: Option<&Model>,
    breadth: SearchScope,
    progress: &mut ProgressCallback<'_>,
) -> (FitProblem, SearchOutcome) {
    let used: Vec<bool> =
        data.used.iter().zip(aside).map(|(used, aside)| *used && !aside).collect();
    let rows = used.iter().filter(|used| **used).count();
    let moves = data.setting.quantity.axis().is_some()
        && data.positions_mm().into_iter().flatten().any(|mm| {
            let first = first_finite_or_zero(mm);
            mm.iter().any(|mm| !mm.is_nan() && *mm != first)
        });
    let size = if moves { 1 } else { rows.div_ceil(MAX_ROW_GROUPS).max(1) };
    // Made when they are needed: of a million rows one by one they take 40 MB.
    let groups = || RowGroups::new(data, &used, size);
    let fewer = if moves && rows > MOVING_AXIS_SAMPLE_ROWS {
        let mut generator = RandomGenerator::new(rows as u64);
        let is_drawn =
            |used: &bool| *used && generator.uniform_index(rows) < MOVING_AXIS_SAMPLE_ROWS;
        let drawn: Vec<bool> = used.iter().map(is_drawn).collect();
        let few = data.subset(&drawn);
        let groups = RowGroups::new(&few, &few.used.clone(), 1);
        Some((few, groups))
    } else {
        data.average_within_groups(&groups())
    };
    let Some((few, of_few)) = fewer else {
        let problem = FitProblem::new(data.clone(), groups());
        let found = search(&problem, &initial_model(data), known, breadth, progress);
        let wider = slope_window_rows(&problem, &found).filter(|_| !moves).and_then(|size| {
            let problem = FitProblem::new(data.clone(), RowGroups::new(data, &used, size));
            let found = search(
                &problem,
                &initial_model(data),
                Some(&found.fitted.model),
                breadth,
                progress,
            );
            found.fitted.model.parts.iter().any(has_thermometer_lag).then_some((problem, found))
        });
        return wider.unwrap_or((problem, found));
    };
    let problem = FitProblem::new(few, of_few);
    let mut found = search(&problem, &initial_model(data), known, breadth, progress);
    problem.clear_caches();
    let whole = FitProblem::new(data.clone(), groups());
    let model = fit(&whole, &found.fitted.model, None).model;
    let residual = problem.residual(&model);
    let sum = residual.iter().map(|r| r * r).sum();
    found.fitted = FittedModel { model, residual, sum, degrees: found.fitted.degrees };
    (problem, found)
}

/// Rows over which the slope of a late thermometer was taken, where they are more than are together already.
///
/// The growth of a mean of rows is the mean of their slopes, noise and bends and all: in groups of this many rows the
/// lag is undone from row to row, exactly, with as little noise as by a slope over all of them, which blurs what
/// happens in that time.
fn slope_window_rows(problem: &FitProblem, found: &SearchOutcome) -> Option<usize> {
    let late = found.fitted.model.parts.iter().find(|part| has_thermometer_lag(part))?;
    let Some(ThermometerDelay { form: DelayKind::Lag { slope_over }, .. }) =
        late.kind.cause()?.thermometer_delay()
    else {
        return None;
    };
    let rows = slope_over * late.values[0] / problem.bounds.step_s;
    // Two groups are left in each block of an interval.
    let most = problem.groups.row_count() as usize / (2 * MAX_BLOCKS);
    let size = (rows.ceil() as usize).min(most);
    (size > problem.groups.size).then_some(size)
}

fn has_thermometer_lag(part: &ModelPart) -> bool {
    part.kind.cause().is_some_and(|cause| cause.thermometer_delay().is_some())
}
