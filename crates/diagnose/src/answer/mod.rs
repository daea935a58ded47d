//! The answer: the model as it is handed out, what it brings on data that nothing was fitted to, and
//! the verdict.

mod errors;
pub(crate) mod extended;
mod figure;
mod finding;
pub(crate) mod html;
pub mod report;
mod verdict;

use std::sync::Arc;

use trueup_machine::file::Term;

use trueup_numerics::blocks::rms;

use crate::{
    blocks::Folds,
    data::Data,
    fit::{Problem, fit},
    judge::Judgement,
    model::Model,
    parameters::step_s,
    repeats::{self, Repeats},
    search::{Found, Tried},
    terms::Extended,
};
use errors::{errors, largest, within_groups};
use finding::{finding, outliers};
use report::{After, Before, Finding, Rejected, Report};
use verdict::verdict;

/// The answer, with all that is needed to write it down.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// The answer.
    pub report: Report,
    /// The new terms of the extended machine file, in its order.
    pub terms: Vec<Term>,
    /// Terms in the place of those of the machine file that are not right any more, with their numbers
    /// in it, from 0.
    pub corrected: Vec<(usize, Term)>,
    pub(crate) data: Arc<Data>,
    /// What the machine file as it is predicts of each row, in µm.
    pub(crate) before: Vec<f64>,
    /// What the extended one predicts, in µm.
    pub(crate) after: Vec<f64>,
    /// Rows that were set aside.
    pub(crate) aside: Vec<bool>,
}

/// The answer to what was found and `judged`; `test`: a hold-out.
pub(crate) fn conclude(
    data: Arc<Data>,
    problem: &Problem,
    found: Found,
    judged: &[Judgement],
    aside: Vec<bool>,
    test: Option<&Data>,
) -> Diagnosis {
    let model = kept(problem, &found, judged);
    let before = Model::default().predict(&data);
    let after = model.predict(&data);
    let before_rows = errors(&data, &before, None);
    let after_rows = errors(&data, &after, Some(&aside));
    // Groups are means of rows: what they average away is in each row again.
    let within = within_groups(&data, problem, &after, &aside);
    let unseen = Unseen { problem, folds: &found.folds, within, test };
    let (holdout_before_um, holdout_after_um) = (unseen.before_um(), unseen.after_um(&model));
    let compensated = compensated(&model);
    let holdout_compensated_um =
        if compensated == model { holdout_after_um } else { unseen.after_um(&compensated) };

    let has_outliers = aside.contains(&true);
    let repeats = repeats::analyse(&data, &after);
    let (verdict, reasons) = verdict(&found, judged, has_outliers, repeats.as_ref());
    let mut findings: Vec<Finding> = judged
        .iter()
        .map(|it| {
            let mut finding = finding(it, found.folds.unit);
            finding.gain.by_row(within);
            finding
        })
        .collect();
    if has_outliers {
        findings.push(outliers(&data, &after, &aside));
    }
    let report = Report {
        schema: 1,
        rows: data.rows,
        rows_used: after_rows.len(),
        quantity: data.quantity.name().into(),
        noise_um: noise_um(problem, &found, &after_rows, repeats.as_ref()),
        noise_memory: found.noise.memory * problem.groups.size as f64 * step_s(problem),
        before: Before {
            rms_um: rms(&before_rows),
            max_um: largest(&before_rows),
            holdout_rms_um: holdout_before_um,
        },
        after: After {
            rms_um: rms(&after_rows),
            max_um: largest(&after_rows),
            holdout_rms_um: holdout_after_um,
            compensated_holdout_rms_um: holdout_compensated_um,
        },
        verdict,
        reasons: reasons.iter().map(ToString::to_string).collect(),
        notes: data.notes.iter().chain(test.iter().flat_map(|test| &test.notes)).cloned().collect(),
        findings,
        rejected: found.rejected.into_iter().map(rejected).collect(),
    };
    let Extended { replaced: corrected, new: terms } = Extended::by(&data, &model);
    Diagnosis { report, terms, corrected, data, before, after, aside }
}

/// The model as it is handed out: terms that are not kept leave, and the others are fitted again
/// without them. Without a term the machine file stays, and with it its zero.
fn kept(problem: &Problem, found: &Found, judged: &[Judgement]) -> Model {
    let mut model = found.fitted.model.clone();
    if judged.iter().any(|it| !it.is_kept) {
        model.parts.retain(|part| judged.iter().all(|it| it.is_kept || *it.cause() != part.kind));
        model = fit(problem, &model, None).model;
    }
    if model.parts.is_empty() { Model::default() } else { model }
}

/// The model as the board runs it: without what only happened once, and what is not the machine's.
fn compensated(model: &Model) -> Model {
    let mut compensated = model.clone();
    compensated.parts.retain(|part| part.kind.is_compensated());
    if compensated.parts.is_empty() { Model::default() } else { compensated }
}

/// Data that nothing was fitted to: a hold-out, else the left-out blocks.
struct Unseen<'u> {
    problem: &'u Problem,
    folds: &'u Folds,
    /// Mean square that the groups of the problem average away, in µm².
    within: f64,
    test: Option<&'u Data>,
}

impl Unseen<'_> {
    /// What the machine file as it is leaves: RMS, in µm.
    fn before_um(&self) -> f64 {
        let believed = Model::default();
        self.on_test(&believed).unwrap_or_else(|| self.by_row(&self.problem.residual(&believed)))
    }

    /// What `model` leaves; without terms it is the machine file as it is.
    fn after_um(&self, model: &Model) -> f64 {
        if model.parts.is_empty() {
            return self.before_um();
        }
        let left_out = || self.by_row(&self.folds.left_out(self.problem, model));
        self.on_test(model).unwrap_or_else(left_out)
    }

    fn on_test(&self, model: &Model) -> Option<f64> {
        self.test.map(|test| rms(&errors(test, &model.predict(test), None)))
    }

    fn by_row(&self, groups: &[f64]) -> f64 {
        (rms(groups).powi(2) + self.within).sqrt()
    }
}

/// The noise of one reading, in µm: from repeats where there are any, else from what differs between
/// neighbours in `errors`, with the memory of the noise taken into account.
fn noise_um(problem: &Problem, found: &Found, errors: &[f64], repeats: Option<&Repeats>) -> f64 {
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

fn rejected(tried: Tried) -> Rejected {
    Rejected {
        cause: tried.cause.name().into(),
        column: tried.cause.column(),
        reason: tried.why_not.to_string(),
        rms_um: tried.rms_um,
        left_out_um: tried.left_out_um,
    }
}
