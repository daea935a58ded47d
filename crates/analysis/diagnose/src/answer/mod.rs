//! The answer: the model as it is handed out, what it brings on data that nothing was fitted to, and
//! the verdict.

mod aliases;
pub(crate) mod applied;
pub(crate) mod at_tool;
mod chosen;
mod curve;
mod errors;
pub(crate) mod extended;
mod figure;
mod finding;
mod harm;
mod held_out;
mod hint;
pub(crate) mod hold_out;
pub(crate) mod html;
mod measured;
mod new_day;
mod next;
mod not_written;
mod on_board;
mod pictures;
mod power;
mod predicted;
mod range;
mod ranges;
pub mod report;
mod rest;
mod shortfall;
mod slow_step;
mod transfer;
mod unknown_rest;
mod unseen;
mod verdict;
mod wandering;
mod worse;
pub(crate) mod written;

use std::sync::Arc;

use trueup_machine::{BadInput, RunFile, compile::missing_inputs, effect::spread, file::Term};
use trueup_numerics::blocks::rms;

use crate::{
    blocks::Folds,
    data::Data,
    fit::Problem,
    judge::Judgement,
    kind::{Kind, Part},
    model::Model,
    next::question::{Question, questions},
    outliers::{Aside, SetAside},
    parameters::step_s,
    repeats::{self, Repeats},
    search::{Found, Tried},
    terms::Extended,
};
use applied::Bridge;
use chosen::{Chosen, Search};
use errors::{Residuals, about_zero, errors_by_row};
use finding::{not_claimed, outliers};
use held_out::LeftOutParts;
use hold_out::HoldOut;
use on_board::left_on_board;
use power::{COVERAGE, Power};
use report::{After, Before, HeldOutParts, Rejected, Report, Verdict};
use shortfall::Shortfall;
use unknown_rest::UnknownRest;
use unseen::Unseen;
use verdict::{Grounds, Reason, verdict};
use wandering::Wandering;

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
    /// The current machine file's prediction of each row, in µm.
    pub(crate) before: Vec<f64>,
    /// The extended one's prediction of each row, in µm.
    pub(crate) after: Vec<f64>,
    /// Rows that were set aside.
    pub(crate) aside: Vec<bool>,
    /// Whether the noise of a reading is known from its repeats.
    pub(crate) noise_is_measured: bool,
    pub(crate) promise: at_tool::Grounds,
    /// The open questions, and the runs as they were read: for the run that comes next.
    pub(crate) questions: Vec<Question>,
    pub(crate) runs: Vec<RunFile>,
}

/// Inputs of the answer next to the result of the search.
pub(crate) struct Asked<'a> {
    /// The runs, as files.
    pub runs: &'a [RunFile],
    pub hold_out: Option<&'a HoldOut<'a>>,
    /// The size of an error that matters: RMS, in µm; by default what is left.
    pub matters_um: Option<f64>,
    /// The offsets that a bridge applied.
    pub bridge: &'a Bridge,
    /// Notes on the files, a sentence each.
    pub notes: Vec<String>,
}

/// The answer to what was found and `judged`.
///
/// # Errors
/// A column is missing in the hold-out that a term needs.
pub(crate) fn conclude(
    data: Arc<Data>,
    problem: &Problem,
    found: Found,
    judged: &[Judgement],
    SetAside { rows: aside, known }: SetAside,
    asked: Asked<'_>,
) -> Result<Diagnosis, BadInput> {
    let search =
        Search { data: &data, problem, found: &found, judged, runs: asked.runs, aside: &aside };
    let mut chosen = Chosen::of(&search, asked.hold_out)?;
    let residuals = Residuals::of(&data, problem, &chosen.model, &aside);
    let within = residuals.within;
    let open = asked.bridge.open(problem, &found, judged);
    if open.forbids_writing() {
        chosen.written.write_nothing();
    }
    let Chosen { model, written, choice, transfer } = &chosen;
    let dropped: &[Kind] = transfer.as_ref().map_or(&[], |it| &it.dropped);
    let compensated = compensated(&written.board);
    let test = asked.hold_out.map(|hold_out| &hold_out.data);
    let unseen = Unseen { problem, folds: &found.folds, within, test };
    let unseen_um = unseen_um(&unseen, &chosen, &compensated);
    let machine = extended::extended_by(&data, &written.board);
    let on_board = left_on_board(&data, asked.runs, &machine, &compensated, &aside);
    // The zero of an axis's measurement counts neither before nor after.
    let on_board = about_zero(&data, on_board);
    let own = written.problem(problem);
    let not_run = written.not_run(&data, model);
    let promise = at_tool::Grounds::new(own, &found, &compensated, not_run);
    let is_corrected = !compensated.parts.is_empty();
    let folds = Folds::of_promise(own);
    let foreseen = choice.foreseen.as_ref();
    let parts =
        LeftOutParts { problem: own, folds: &folds, model: &written.board, foreseen, within };
    let held_out = is_corrected.then(|| parts.held_out());
    let floor = held_out.as_ref().map(|held_out| held_out.figures.reduction_floor95);
    let shortfall = asked.hold_out.and_then(|hold_out| {
        chosen.shortfall(&search, hold_out, &compensated, floor, &folds, within)
    });
    let questions = questions(problem, &found, judged);
    let has_outliers = known == Aside::Wrong;
    let mut notes = asked.notes;
    notes.extend(not_claimed(&aside, known));
    let left = Left::of(&search, &residuals, asked.matters_um);
    let (verdict, reasons) = left.verdict(&search, &chosen, shortfall.as_ref(), has_outliers);
    let (verdict, reasons) = open.judge(verdict, reasons);
    let Residuals { before, after, before_rows, after_rows, .. } = residuals;
    let is_most_unknown = left.unknown_rest.is_some_and(|rest| rest.is_most);
    let mut findings = chosen.findings(&search, &open, &after, within, is_most_unknown);
    findings.splice(0..0, open.finding(asked.bridge, &data, &after));
    findings.extend(has_outliers.then(|| outliers(&data, &after, &aside)));
    let Left { noise_um, repeats, power, wandering, .. } = left;
    let mut at_tool = promise.on_table(&data, asked.runs)?;
    if is_corrected {
        let of_gauge_um = noise_of_gauge_um(&data, problem, noise_um, repeats.is_some());
        at_tool.bounded_by(parts.at_tool(of_gauge_um));
    }
    let report = Report {
        schema: 1,
        rows: data.rows,
        rows_used: after_rows.len(),
        quantity: data.quantity.name().into(),
        noise_um,
        noise_memory: found.noise.memory * problem.groups.size as f64 * step_s(problem),
        detectable_um: power.found_um,
        wandering: wandering.as_ref().map(Wandering::reported),
        before: Before::of(&before_rows, unseen_um[0]),
        after: After::of(&after_rows, &on_board, [unseen_um[1], unseen_um[2]]),
        verdict,
        reasons: each_once(reasons.iter().map(ToString::to_string)),
        notes,
        holdout_used: !dropped.is_empty(),
        left_out: dropped.iter().map(left_out).collect(),
        hints: hint::hints(&data.machine, &findings, &data.law),
        findings,
        missing_inputs: Vec::new(),
        at_tool,
        held_out,
        rejected: found.rejected.into_iter().map(rejected).collect(),
    };
    let Extended { replaced: corrected, new: terms } = written.extension(&data);
    let mut diagnosis = Diagnosis {
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
        runs: asked.runs.to_vec(),
    };
    if diagnosis.corrects() {
        diagnosis.report.missing_inputs = missing_inputs(&extended::machine(&diagnosis));
    }
    Ok(diagnosis)
}

/// The residual of the model.
struct Left {
    repeats: Option<Repeats>,
    /// The noise of a reading.
    noise_um: f64,
    between_neighbours_um: f64,
    power: Power,
    wandering: Option<Wandering>,
    unknown_rest: Option<UnknownRest>,
}

impl Left {
    fn of(search: &Search<'_>, residuals: &Residuals, matters_um: Option<f64>) -> Self {
        let Search { data, problem, found, aside, .. } = *search;
        let Residuals { after, before_rows, after_rows, .. } = residuals;
        let repeats = repeats::analyse(data, after, aside);
        let left_um = rms(after_rows);
        let by_row = errors_by_row(data, after, Some(aside));
        let spread_um = [rms(before_rows), left_um];
        Self {
            noise_um: noise_um(problem, found, after_rows, repeats.as_ref()),
            between_neighbours_um: between_neighbours_um(after_rows),
            power: Power::new(problem, found, left_um, after_rows.len(), matters_um),
            wandering: Wandering::of(problem, found),
            unknown_rest: UnknownRest::of(data, repeats.as_ref(), spread_um, &by_row),
            repeats,
        }
    }

    /// Returns the verdict on the answer, and why.
    fn verdict(
        &self,
        search: &Search<'_>,
        chosen: &Chosen,
        shortfall: Option<&Shortfall>,
        has_outliers: bool,
    ) -> (Verdict, Vec<Reason>) {
        verdict(&Grounds {
            found: search.found,
            judged: search.judged,
            has_outliers,
            repeats: self.repeats.as_ref(),
            power: &self.power,
            wandering: self.wandering.as_ref(),
            unknown_rest: self.unknown_rest,
            between_neighbours_um: self.between_neighbours_um,
            instrument_um: search.data.machine.instrument_um,
            transfer: chosen.transfer.as_ref(),
            shortfall,
            is_predicted: chosen.choice.is_predicted,
            is_withheld: chosen.written.withholds(),
        })
    }
}

/// Returns what the machine file, the model and what is compensated of it leave on data that nothing was fitted to: RMS,
/// in µm.
fn unseen_um(unseen: &Unseen<'_>, chosen: &Chosen, compensated: &Model) -> [f64; 3] {
    let after_um = unseen.after_um(&chosen.model);
    let compensated_um = if *compensated == chosen.model {
        after_um
    } else {
        chosen.written.unseen_um(unseen, unseen.problem, compensated)
    };
    [unseen.before_um(), after_um, compensated_um]
}

/// Returns the sentences in their order, none of them twice: forms of one cause say the same.
fn each_once(sentences: impl Iterator<Item = String>) -> Vec<String> {
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
fn compensated(model: &Model) -> Model {
    let mut compensated = model.clone();
    compensated.parts.retain(|part| part.kind.is_compensated());
    compensated.parts.iter_mut().for_each(Part::forget_feed);
    if compensated.parts.is_empty() { Model::default() } else { compensated }
}

/// Returns the noise of one reading, in µm: from repeats where there are any, else from what differs between
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

/// Returns the part of `noise_um` that is surely the gauge's: it was seen at repeats, or from reading to reading while
/// next to nothing changed. Where an axis moves from reading to reading and none comes again, nothing of it is known.
fn noise_of_gauge_um(data: &Data, problem: &Problem, noise_um: f64, is_repeated: bool) -> f64 {
    let moves = data.own_position().is_some_and(|mm| spread(mm) > 0.0);
    let stated_um = data.machine.instrument_um.map(|um| um / COVERAGE);
    if is_repeated || !moves && problem.data.time_s.is_some() {
        noise_um
    } else {
        stated_um.unwrap_or(0.0).min(noise_um)
    }
}

/// Returns the noise of neighbouring `errors`: the standard deviation of each by their differences, in µm.
fn between_neighbours_um(errors: &[f64]) -> f64 {
    let differences: Vec<f64> = errors.windows(2).map(|pair| pair[1] - pair[0]).collect();
    rms(&differences) / 2.0_f64.sqrt()
}

fn left_out(cause: &Kind) -> HeldOutParts {
    HeldOutParts { cause: cause.name().into(), column: cause.column() }
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
