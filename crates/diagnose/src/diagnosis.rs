//! From the search to the answer: intervals, rivals, the gain on data that nothing was fitted to, and
//! the verdict.

use std::sync::Arc;

use trueup_machine::{BadInput, Machine, RunFile, machine_file::Quantity};
use trueup_numerics::{noise::Chance, parallel::on_all_cores};

use crate::{
    blocks::rms,
    candidates::structure,
    data::{Data, Groups, first_of, quantity_of},
    fit::{Fitted, Problem, fit},
    judge::{Judged, Own, doubt_what_stands_beside_another_law, judge, outlier_finding},
    model::Model,
    outliers,
    parameters::step_s,
    repeats,
    report::{After, Before, Rejected, Report, Verdict},
    search::{self, Found},
    terms,
};

/// Groups that the search works on where there is time alone; rows beyond are averaged.
const MOST_GROUPS: usize = 1000;
/// Rows that the search works on where an axis moves: an average would blur its errors, so that of
/// more rows so many are drawn by chance. The last fit is to all of them.
const MOST_ROWS_MOVING: usize = 3000;

/// A machine whose readings at one position scatter by more (standard deviation, in µm) is no machine
/// to be corrected but one to be mended: its repeatability by ISO 230-2, 4·s, is beyond 20 µm, about
/// the most that ISO 10791-4 lets a machining centre of 2 m have. Less than that may be the noise of
/// the instrument.
const REPEATABLE_UM: f64 = 5.0;

/// What is being tried, and how far the search has come, 0…1 (NaN: as before).
pub type Progress<'p> = dyn FnMut(&str, f64) + 'p;

/// The answer, with all that is needed to write it down.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// The answer.
    pub report: Report,
    /// The terms of the extended machine file, in its order.
    pub terms: Vec<trueup_machine::machine_file::Term>,
    pub(crate) data: Arc<Data>,
    pub(crate) before: Vec<f64>,
    pub(crate) after: Vec<f64>,
    pub(crate) aside: Vec<bool>,
}

/// Compares `machine` with what was measured in `runs`, names the causes of what it gets wrong, and
/// measures what their terms bring on `holdout` (which chooses nothing).
///
/// # Errors
/// There is no such quantity in a run, or several and none is asked for; a column is missing without
/// which nothing can be predicted; no row is both measured and predicted.
pub fn diagnose(
    machine: &Machine,
    runs: &[RunFile],
    holdout: &[RunFile],
    quantity: Option<Quantity>,
    progress: &mut Progress<'_>,
) -> Result<Diagnosis, BadInput> {
    let quantity = quantity_of(runs, quantity)?;
    quantity_of(if holdout.is_empty() { runs } else { holdout }, Some(quantity))?;
    let data = Arc::new(Data::new(machine, runs, quantity)?);
    let test = if holdout.is_empty() {
        None
    } else {
        let mut test = Data::new(machine, holdout, quantity)?;
        test.refer_to(&data);
        Some(test)
    };
    let none_aside = vec![false; data.rows];
    let mut aside = none_aside.clone();
    let (mut problem, mut found) = searched(&data, &aside, progress);
    // Gross errors are seen once the rest is explained; then the rest is searched without them.
    // A law that no cause has is no gross error either.
    let gross_of = |problem: &Problem, found: &Found| {
        let rest = search::with_structure(problem, &structure(problem), &found.fitted);
        outliers::gross(&data, &rest.model.predict(&data))
    };
    let gross = gross_of(&problem, &found);
    if gross.contains(&true) {
        aside = gross;
        (problem, found) = searched(&data, &aside, progress);
        let again = gross_of(&problem, &found);
        if again != aside && again.contains(&true) {
            aside = again;
            (problem, found) = searched(&data, &aside, progress);
        }
    }
    progress("comparing with rivals", 0.92);
    Ok(conclude(data, problem, found, &aside, test.as_ref()))
}

fn searched(data: &Arc<Data>, aside: &[bool], progress: &mut Progress<'_>) -> (Problem, Found) {
    let used: Vec<bool> =
        data.used.iter().zip(aside).map(|(used, aside)| *used && !aside).collect();
    let rows = used.iter().filter(|used| **used).count();
    let moves = data.quantity.axis().is_some()
        && data.position_mm.iter().flatten().any(|mm| {
            let first = first_of(mm);
            mm.iter().any(|mm| !mm.is_nan() && *mm != first)
        });
    if !moves || rows <= MOST_ROWS_MOVING {
        let size = if moves { 1 } else { rows.div_ceil(MOST_GROUPS).max(1) };
        let groups = Groups::new(data, &used, size);
        let problem = Problem::new((**data).clone(), groups);
        let found = search::search(&problem, search::start(data), progress);
        return (problem, found);
    }
    let mut chance = Chance::new(rows as u64);
    let drawn: Vec<bool> =
        used.iter().map(|used| *used && chance.below(rows) < MOST_ROWS_MOVING).collect();
    let few = data.subset(&drawn);
    let groups = Groups::new(&few, &few.used.clone(), 1);
    let problem = Problem::new(few, groups);
    let mut found = search::search(&problem, search::start(data), progress);
    let whole = Problem::new((**data).clone(), Groups::new(data, &used, 1));
    let model = fit(&whole, &found.fitted.model, None).model;
    let residual = problem.residual(&model);
    let sum = residual.iter().map(|r| r * r).sum();
    found.fitted = Fitted { model, residual, sum, degrees: found.fitted.degrees };
    (problem, found)
}

/// Errors of the rows that count.
pub(crate) fn errors(data: &Data, predicted: &[f64], aside: Option<&[bool]>) -> Vec<f64> {
    (0..data.rows)
        .filter(|&row| data.used[row] && aside.is_none_or(|aside| !aside[row]))
        .map(|row| data.measured[row] - predicted[row])
        .filter(|error| error.is_finite())
        .collect()
}

fn most(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |most: f64, value| most.max(value.abs()))
}

fn conclude(
    data: Arc<Data>,
    problem: Problem,
    found: Found,
    aside: &[bool],
    test: Option<&Data>,
) -> Diagnosis {
    let believed = Model::default().predict(&data);
    let own = Own::of(&problem, &found);
    let is_large = problem.is_large();
    let judged = on_all_cores(&found.added, is_large, |added| judge(&problem, &found, &own, added));
    let mut judged: Vec<Judged> = judged.into_iter().flatten().collect();
    doubt_what_stands_beside_another_law(&problem, &found, &mut judged);
    // Terms that are not kept leave, and the others are fitted again without them.
    let mut kept = found.fitted.clone();
    if judged.iter().any(|it| !it.is_kept) {
        let mut model = found.fitted.model.clone();
        model.parts.retain(|part| {
            judged.iter().all(|it| it.is_kept || it.kind.as_ref() != Some(&part.kind))
        });
        kept = fit(&problem, &model, None);
    }
    let has_terms = !kept.model.parts.is_empty();
    // Without a term the machine file stays, and with it its zero.
    let model = if has_terms { kept.model.clone() } else { Model::default() };
    let after = model.predict(&data);
    let compensated = compensated(&model);

    let before_rows = errors(&data, &believed, None);
    let after_rows = errors(&data, &after, Some(aside));
    let aside_count = aside.iter().filter(|aside| **aside).count();
    let folds = &found.folds;
    // Groups are means of rows: what they average away is in each row again.
    let within = within(&data, &problem, &after, aside);
    let by_row = |group_rms: f64| (group_rms * group_rms + within).sqrt();
    let left_out = |model: &Model, is_believed: bool| {
        if is_believed {
            by_row(rms(&problem.residual(model)))
        } else {
            by_row(rms(&folds.left_out(&problem, model)))
        }
    };
    let holdout = |model: &Model, is_believed: bool| match test {
        Some(test) => rms(&errors(test, &model.predict(test), None)),
        None => left_out(model, is_believed),
    };
    let before_holdout = holdout(&Model::default(), true);
    let after_holdout = if has_terms { holdout(&model, false) } else { before_holdout };
    let compensated_holdout = if compensated.parts.is_empty() {
        before_holdout
    } else if compensated == model {
        after_holdout
    } else {
        holdout(&compensated, false)
    };
    for it in &mut judged {
        it.finding.gain.by_row(within);
    }
    if aside_count > 0 {
        judged.push(outlier_finding(&data, &after, aside, aside_count));
    }

    let repeats = repeats::analyse(&data, &model.predict(&data));
    let noise_um = noise_um(&data, &problem, &found, &after, aside, repeats.as_ref());
    let (verdict, reasons) = verdict(&found, &judged, repeats.as_ref());
    let rejected = found
        .rejected
        .iter()
        .map(|tried| Rejected {
            cause: tried.kind.name().into(),
            column: tried.kind.column(),
            reason: tried.why_not.clone(),
            rms_um: tried.rms_um,
            left_out_um: (tried.left_out_um > 0.0).then_some(tried.left_out_um),
        })
        .collect();
    let report = Report {
        schema: 1,
        rows: data.rows,
        rows_used: after_rows.len(),
        quantity: data.quantity.name().into(),
        noise_um,
        noise_memory: found.noise.memory * problem.groups.size as f64 * step_s(&problem),
        before: Before {
            rms_um: rms(&before_rows),
            max_um: most(&before_rows),
            holdout_rms_um: before_holdout,
        },
        after: After {
            rms_um: rms(&after_rows),
            max_um: most(&after_rows),
            holdout_rms_um: after_holdout,
            compensated_holdout_rms_um: compensated_holdout,
        },
        verdict,
        reasons,
        findings: judged.into_iter().map(|it| it.finding).collect(),
        rejected,
    };
    let terms = terms::terms(&data, &model);
    Diagnosis { report, terms, data, before: believed, after, aside: aside.to_vec() }
}

/// Mean square of what the groups average away.
fn within(data: &Data, problem: &Problem, predicted: &[f64], aside: &[bool]) -> f64 {
    if problem.groups.size == 1 {
        // Rows of their own, or a draw of them.
        return 0.0;
    }
    let rows = errors(data, predicted, Some(aside));
    let residual: Vec<f64> =
        (0..data.rows).map(|row| data.measured[row] - predicted[row]).collect();
    let groups = problem.groups.means(&residual);
    (rms(&rows).powi(2) - rms(&groups).powi(2)).max(0.0)
}

/// The model as the board runs it: without what only happened once, and what is not the machine's.
fn compensated(model: &Model) -> Model {
    let mut compensated = model.clone();
    compensated.parts.retain(|part| part.kind.is_compensated());
    if compensated.parts.is_empty() { Model::default() } else { compensated }
}

/// The noise of one reading: from repeats where there are any, else from what differs between
/// neighbours, with the memory of the noise taken into account.
fn noise_um(
    data: &Data,
    problem: &Problem,
    found: &Found,
    after: &[f64],
    aside: &[bool],
    repeats: Option<&repeats::Repeats>,
) -> f64 {
    if let Some(repeats) = repeats {
        return repeats.scatter_um;
    }
    let rows = errors(data, after, Some(aside));
    let differences: Vec<f64> = rows.windows(2).map(|pair| pair[1] - pair[0]).collect();
    if differences.is_empty() {
        return 0.0;
    }
    let memory = found.noise.memory * problem.groups.size as f64;
    let next = if memory > 0.0 { (1.0 - found.noise.white) * (-1.0 / memory).exp() } else { 0.0 };
    (rms(&differences) / (2.0 * (1.0 - next)).sqrt()).min(rms(&rows))
}

fn verdict(
    found: &Found,
    judged: &[Judged],
    repeats: Option<&repeats::Repeats>,
) -> (Verdict, Vec<String>) {
    let mut reasons = found.structure.clone();
    for law in judged.iter().filter_map(|it| it.other_law.as_ref()) {
        let reason = format!("what is wrong goes with {law}, and no cause does so");
        if !reasons.contains(&reason) {
            reasons.push(reason);
        }
    }
    let causes = judged.iter().filter(|it| it.finding.cause != "outliers").count();
    let open = judged.iter().any(|it| !it.finding.claimed && it.other_law.is_none());
    if causes == 0 {
        let does_not_repeat = repeats
            .is_some_and(|it| it.scatter_um > it.systematic_um && it.scatter_um > REPEATABLE_UM);
        if let (Some(repeats), true) = (repeats, does_not_repeat) {
            reasons.push(format!(
                "at equal positions the readings scatter by {:.2} µm, more than the {:.2} µm that \
                 repeat: what is corrected today is wrong tomorrow",
                repeats.scatter_um, repeats.systematic_um
            ));
            return (Verdict::DoNotCompensate, reasons);
        }
        if !reasons.is_empty() {
            return (Verdict::Unexplained, reasons);
        }
        if judged.is_empty() {
            reasons.push("nothing is left but noise: the model stays".into());
            return (Verdict::Clean, reasons);
        }
        return (Verdict::Explained, reasons);
    }
    if open {
        reasons
            .push("two causes cannot be told apart, or a parameter is not yet identified".into());
    }
    if reasons.is_empty() {
        reasons.push("no test of structure fires on what is left".into());
        (Verdict::Explained, reasons)
    } else {
        (Verdict::PartlyExplained, reasons)
    }
}
