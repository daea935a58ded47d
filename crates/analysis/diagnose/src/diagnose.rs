//! The pipeline: runs → table → problem → search → judgement → answer.

use std::sync::Arc;

use trueup_machine::{
    BadInput, Machine, RunFile,
    effect::{Late, LateForm},
    file::Quantity,
};
use trueup_numerics::random::Generator;

use crate::{
    answer::{
        Asked, Diagnosis,
        applied::Bridge,
        conclude,
        hold_out::{HoldOut, seen_before},
    },
    candidates::structure,
    data::{Data, Groups, first_of, quantity_of},
    fit::{Fitted, Problem, fit},
    judge::{Judgement, judge},
    kind::Part,
    model::Model,
    outliers::{self, SetAside},
    search::{Breadth, Found, lack_of_fit::with_curves, search, start},
};

/// Groups that the search works on where there is time alone; rows beyond are averaged.
const MAX_GROUPS: usize = 1000;
/// Groups that are left where rows are put together for a late thermometer.
const MIN_GROUPS: usize = 100;
/// Rows that the search works on where an axis moves: an average would blur its errors, so that of
/// more rows this many are drawn by chance. The last fit is to all of them.
const MAX_ROWS_MOVING: usize = 3000;

/// Callback for what is being tried, and how far the search has come, 0…1 (NaN: as before).
pub type Progress<'p> = dyn FnMut(&str, f64) + 'p;

/// Options of a diagnosis.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
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
/// There is no such quantity in a run, or several and none is asked for; a column is missing without
/// which nothing can be predicted, or in a hold-out one that a term needs; no row is both measured and
/// predicted.
pub fn diagnose(
    machine: &Machine,
    runs: &[RunFile],
    holdout: &[RunFile],
    quantity: Option<Quantity>,
    progress: &mut Progress<'_>,
) -> Result<Diagnosis, BadInput> {
    diagnose_for(machine, runs, holdout, Options { quantity, ..Options::default() }, progress)
}

/// The same with more to say.
///
/// # Errors
/// As those of [`diagnose`].
pub fn diagnose_for(
    machine: &Machine,
    runs: &[RunFile],
    holdout: &[RunFile],
    Options { quantity, matters_um, is_applied_once }: Options,
    progress: &mut Progress<'_>,
) -> Result<Diagnosis, BadInput> {
    let quantity = quantity_of(runs, quantity)?;
    quantity_of(if holdout.is_empty() { runs } else { holdout }, Some(quantity))?;
    let bridge = Bridge::of(machine, [runs, holdout], quantity, is_applied_once)?;
    let factor = bridge.factor();
    let data = Arc::new(Data::applied(machine, runs, quantity, factor)?.trusted());
    let test = if holdout.is_empty() {
        None
    } else {
        let mut test = Data::applied(machine, holdout, quantity, factor)?;
        test.refer_to(&data);
        Some(HoldOut { files: holdout, data: test })
    };
    let mut notes = data.notes.clone();
    notes.extend(test.iter().flat_map(|test| test.data.notes.iter().cloned()));
    notes.extend(seen_before(runs, holdout));
    // Repeats say before any cause is known which readings stand alone.
    let mut answer = answered(&data, Breadth::Composed, progress);
    // What takes two inputs together is one of very many: it is the answer where it is claimed, else a simpler one is.
    if answer.judged.iter().any(|it| it.cause().is_composed() && !it.doubts.is_empty()) {
        answer = answered(&data, Breadth::Simple, progress);
    }
    let Answered { problem, found, aside, judged } = answer;
    let known = outliers::judged(&data, &aside, || predictions(&data, &problem, &found));
    let mut concluded = conclude(
        data,
        &problem,
        found,
        &judged,
        SetAside { rows: aside, known },
        Asked { runs, hold_out: test.as_ref(), matters_um, bridge: &bridge, notes },
    )?;
    concluded.name_tools(machine);
    Ok(concluded)
}

/// The answer of a search, judged.
struct Answered {
    problem: Problem,
    found: Found,
    /// Rows that stand alone.
    aside: Vec<bool>,
    judged: Vec<Judgement>,
}

/// Returns the answer of a search of this breadth, without the rows that stand alone.
fn answered(data: &Arc<Data>, breadth: Breadth, progress: &mut Progress<'_>) -> Answered {
    let mut aside = outliers::among_repeats(data, &Model::default().predict(data));
    let (mut problem, mut found) = searched(data, &aside, None, breadth, progress);
    // Gross errors are seen once the rest is explained; then the rest is searched without them. Once
    // more, where fewer or others are seen then.
    for _ in 0..2 {
        let gross = gross_errors(data, &problem, &found);
        if gross == aside {
            break;
        }
        aside = gross;
        let known = found.fitted.model;
        (problem, found) = searched(data, &aside, Some(&known), breadth, progress);
    }
    progress("comparing with rivals", 0.92);
    let judged = judge(&problem, &found);
    Answered { problem, found, aside, judged }
}

/// Returns what the answer predicts of each row, with curves over what it leaves and without: a law that no cause
/// has is no gross error.
fn predictions(data: &Data, problem: &Problem, found: &Found) -> [Vec<f64>; 2] {
    let rest = with_curves(problem, &found.fitted, &structure(problem));
    [rest.model.predict(data), found.fitted.model.predict(data)]
}

/// Rows that stand alone, far from what is predicted.
fn gross_errors(data: &Data, problem: &Problem, found: &Found) -> Vec<bool> {
    let [with_curves, plain] = predictions(data, problem, found);
    let alone = outliers::gross(data, &with_curves);
    let among_repeats = outliers::among_repeats(data, &plain);
    alone.iter().zip(among_repeats).map(|(alone, there)| *alone || there).collect()
}

/// Returns the search on the rows that count and are not set aside: on all of them, on means of neighbours, or
/// on as many as suffice. The last fit is to all of them.
fn searched(
    data: &Arc<Data>,
    aside: &[bool],
    known: Option<&Model>,
    breadth: Breadth,
    progress: &mut Progress<'_>,
) -> (Problem, Found) {
    let used: Vec<bool> =
        data.used.iter().zip(aside).map(|(used, aside)| *used && !aside).collect();
    let rows = used.iter().filter(|used| **used).count();
    let moves = data.quantity.axis().is_some()
        && data.position_mm.iter().flatten().any(|mm| {
            let first = first_of(mm);
            mm.iter().any(|mm| !mm.is_nan() && *mm != first)
        });
    let size = if moves { 1 } else { rows.div_ceil(MAX_GROUPS).max(1) };
    // Made when they are needed: of a million rows one by one they take 40 MB.
    let groups = || Groups::new(data, &used, size);
    let fewer = if moves && rows > MAX_ROWS_MOVING {
        let mut generator = Generator::new(rows as u64);
        let is_drawn = |used: &bool| *used && generator.below(rows) < MAX_ROWS_MOVING;
        let drawn: Vec<bool> = used.iter().map(is_drawn).collect();
        let few = data.subset(&drawn);
        let groups = Groups::new(&few, &few.used.clone(), 1);
        Some((few, groups))
    } else {
        data.condensed(&groups())
    };
    let Some((few, of_few)) = fewer else {
        let problem = Problem::new(data.clone(), groups());
        let found = search(&problem, &start(data), known, breadth, progress);
        let wider = rows_of_a_slope(&problem, &found).filter(|_| !moves).and_then(|size| {
            let problem = Problem::new(data.clone(), Groups::new(data, &used, size));
            let found =
                search(&problem, &start(data), Some(&found.fitted.model), breadth, progress);
            found.fitted.model.parts.iter().any(is_late).then_some((problem, found))
        });
        return wider.unwrap_or((problem, found));
    };
    let problem = Problem::new(few, of_few);
    let mut found = search(&problem, &start(data), known, breadth, progress);
    problem.forget();
    let whole = Problem::new(data.clone(), groups());
    let model = fit(&whole, &found.fitted.model, None).model;
    let residual = problem.residual(&model);
    let sum = residual.iter().map(|r| r * r).sum();
    found.fitted = Fitted { model, residual, sum, degrees: found.fitted.degrees };
    (problem, found)
}

/// Rows over which the slope of a late thermometer was taken, where they are more than are together already.
///
/// The growth of a mean of rows is the mean of their slopes, noise and bends and all: in groups of this many rows the
/// lag is undone from row to row, exactly, with as little noise as by a slope over all of them, which blurs what
/// happens in that time.
fn rows_of_a_slope(problem: &Problem, found: &Found) -> Option<usize> {
    let late = found.fitted.model.parts.iter().find(|part| is_late(part))?;
    let Some(Late { form: LateForm::Lag { slope_over }, .. }) = late.kind.cause()?.late() else {
        return None;
    };
    let rows = slope_over * late.values[0] / problem.bounds.step_s;
    let most = problem.groups.rows() as usize / MIN_GROUPS;
    let size = (rows.ceil() as usize).min(most);
    (size > problem.groups.size).then_some(size)
}

fn is_late(part: &Part) -> bool {
    part.kind.cause().is_some_and(|cause| cause.late().is_some())
}
