//! The answer: the model as it is handed out, what it brings on data that nothing was fitted to, and
//! the verdict.

mod aliases;
pub(crate) mod applied;
pub(crate) mod at_tool;
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
mod next;
mod not_written;
mod on_board;
mod pictures;
mod power;
mod predicted;
mod range;
mod ranges;
pub mod report;
mod shortfall;
mod slow_step;
mod transfer;
mod unseen;
mod verdict;
mod wandering;
mod worse;
pub(crate) mod written;

use std::sync::Arc;

use trueup_machine::{
    BadInput, RunFile,
    compile::missing_inputs,
    effect::{Effect, spread},
    file::Term,
};
use trueup_numerics::blocks::rms;

use crate::{
    blocks::Folds,
    data::Data,
    fit::{Problem, fit},
    judge::Judgement,
    kind::{Kind, Part},
    model::Model,
    next::question::{Question, questions},
    outliers::{Aside, SetAside},
    parameters::step_s,
    repeats::{self, Repeats},
    search::{Found, Tried, extend::without},
    terms::Extended,
};
use applied::Bridge;
use errors::{about_zero, errors, largest, within_groups};
use finding::{finding, merged, not_claimed, outliers};
use held_out::LeftOutParts;
use hold_out::HoldOut;
use on_board::left_on_board;
use power::Power;
use predicted::{Choice, is_settled};
use report::{After, Before, Finding, HeldOutParts, Rejected, Report};
use shortfall::{Promised, Shortfall};
use transfer::Transfer;
use unseen::Unseen;
use verdict::{Grounds, verdict};
use wandering::Wandering;
use written::Written;

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
    let mut model = kept(problem, &found, judged);
    let mut written = Written::new(problem, &found, judged, &model, asked.runs);
    let wandering = Wandering::of(problem, &found);
    // What was measured several times at the same positions is judged by its repeats.
    let repeats_itself = data.quantity.axis().is_some()
        && repeats::analyse(&data, &Model::default().predict(&data), &aside).is_some();
    let is_settled = is_settled(&found, judged, wandering.is_some()) && written.left.is_empty();
    let choice = if is_settled || repeats_itself {
        Choice::default()
    } else {
        written.choose(problem, &found, judged, &model, asked.runs)
    };
    if choice.is_predicted {
        model.parts.retain(|part| !part.kind.is_compensated());
        model.parts.extend(written.board.parts.iter().cloned());
        model.constant_um = written.board.constant_um;
        model.sort();
    }
    let mut transfer = None;
    if let Some(hold_out) = asked.hold_out {
        hold_out.check(&data, &model)?;
        let on_hold_out = Transfer::new(problem, model, hold_out);
        model = on_hold_out.model.clone();
        if !on_hold_out.dropped.is_empty() && !choice.is_predicted {
            written = Written::new(problem, &found, judged, &model, asked.runs);
        }
        transfer = Some(on_hold_out);
        written.check_on(problem, hold_out);
    }
    // What no machine can do explains nothing either.
    let impossible = written.left.iter().filter(|(_, why)| why.is_inseparable());
    let impossible: Vec<Kind> = impossible.map(|(kind, _)| kind.clone()).collect();
    if !impossible.is_empty() {
        model = without_all(problem, &model, impossible.iter());
        model = if model.parts.iter().all(|part| part.kind.is_compensated()) {
            written.board.clone()
        } else {
            fit(problem, &model, None).model
        };
    }
    let dropped: &[Kind] = transfer.as_ref().map_or(&[], |it| &it.dropped);
    let before = Model::default().predict(&data);
    let after = model.predict(&data);
    let before_rows = about_zero(&data, errors(&data, &before, None));
    let after_rows = errors(&data, &after, Some(&aside));
    let after_rows = about_zero(&data, after_rows);
    // Groups are means of rows: what they average away is in each row again.
    let within = within_groups(&data, problem, &after, &aside);
    let test = asked.hold_out.map(|hold_out| &hold_out.data);
    let unseen = Unseen { problem, folds: &found.folds, within, test };
    let (holdout_before_um, holdout_after_um) = (unseen.before_um(), unseen.after_um(&model));
    let open = asked.bridge.open(problem, &found, judged);
    if open.forbids_writing() {
        written.write_nothing();
    }
    let compensated = compensated(&written.board);
    let holdout_compensated_um = if compensated == model {
        holdout_after_um
    } else {
        written.unseen_um(&unseen, problem, &compensated)
    };
    let machine = extended::extended_by(&data, &written.board);
    let on_board = left_on_board(&data, asked.runs, &machine, &compensated, &aside);
    // The zero of an axis's measurement counts neither before nor after.
    let on_board = about_zero(&data, on_board);

    let not_run = written.not_run(&data, &model);
    let promise = at_tool::Grounds::new(written.problem(problem), &found, &compensated, not_run);
    let own = written.problem(problem);
    let is_corrected = !compensated.parts.is_empty();
    let folds = Folds::of_promise(own);
    let foreseen = choice.foreseen.as_ref();
    let parts =
        LeftOutParts { problem: own, folds: &folds, model: &written.board, foreseen, within };
    let held_out = is_corrected.then(|| parts.held_out());
    let memory = found.noise.memory * problem.groups.size as f64;
    let shortfall = asked.hold_out.and_then(|hold_out| {
        let of_board = hold_out.data.compensated();
        let test = of_board.as_ref().unwrap_or(&hold_out.data);
        let on_board = held_out.as_ref().and_then(|held_out| {
            let floor = held_out.figures.reduction_floor95;
            let promised = Promised { floor, most_left_um: 0.0 };
            Shortfall::new(&data, hold_out, test, &compensated, promised, memory)
        });
        // What only explains is to hold on another day as well.
        on_board.or_else(|| {
            let lasting = lasting(&model);
            let parts =
                LeftOutParts { problem, folds: &folds, model: &lasting, foreseen: None, within };
            let promised = || {
                let figures = parts.held_out().figures;
                let most_left_um = MORE_LEFT * figures.after_um;
                Promised { floor: figures.reduction_floor95, most_left_um }
            };
            let has_more = lasting.parts.len() > compensated.parts.len();
            let short =
                || Shortfall::new(&data, hold_out, &hold_out.data, &lasting, promised(), memory);
            has_more.then(short).flatten()
        })
    });
    let questions = questions(problem, &found, judged);
    let has_outliers = known == Aside::Wrong;
    let mut notes = asked.notes;
    notes.extend(not_claimed(&aside, known));
    let repeats = repeats::analyse(&data, &after, &aside);
    let left_um = rms(&after_rows);
    let power = Power::new(problem, &found, left_um, after_rows.len(), asked.matters_um);
    let (verdict, reasons) = verdict(&Grounds {
        found: &found,
        judged,
        has_outliers,
        repeats: repeats.as_ref(),
        power: &power,
        wandering: wandering.as_ref(),
        between_neighbours_um: between_neighbours_um(&after_rows),
        instrument_um: data.machine.instrument_um,
        transfer: transfer.as_ref(),
        shortfall: shortfall.as_ref(),
        is_predicted: choice.is_predicted,
        is_withheld: written.left.iter().any(|(_, why)| why.is_inseparable()),
    });
    let (verdict, reasons) = open.judge(verdict, reasons);
    let is_disproved = transfer.as_ref().is_some_and(|it| it.is_disproved);
    let mut findings: Vec<Finding> = judged
        .iter()
        .map(|it| {
            let mut finding = finding(problem, it, found.folds.unit);
            finding.gain.by_row(within);
            slow_step::tell_duration(&mut finding, &it.part, &data, &after);
            if dropped.contains(it.cause()) {
                finding.leave_out();
            }
            if is_disproved && finding.claimed {
                finding.disclaim();
            }
            match written.left.iter().find(|(kind, _)| kind == it.cause()) {
                Some((_, why)) => finding.is_not_written(why),
                None => finding.is_written(written.estimates(problem, it.cause())),
            }
            finding
        })
        .collect();
    open.mark(&mut findings);
    findings = merged(judged, findings);
    if let Some(foreseen) = foreseen.filter(|_| choice.is_predicted) {
        findings.extend(predicted::findings(problem, &written, foreseen, judged, &found.folds));
    }
    findings.splice(0..0, open.finding(asked.bridge, &data, &after));
    if has_outliers {
        findings.push(outliers(&data, &after, &aside));
    }
    let hints = hint::hints(&data.machine, &findings, &data.law);
    let noise_um = noise_um(problem, &found, &after_rows, repeats.as_ref());
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
        wandering: wandering.as_ref().map(|it| report::Wandering {
            rms_um: it.rms_um,
            memory_s: it.memory.seconds(),
            memory_rows: it.memory.rows(),
        }),
        before: Before {
            rms_um: rms(&before_rows),
            max_um: largest(&before_rows),
            holdout_rms_um: holdout_before_um,
        },
        after: After {
            rms_um: left_um,
            max_um: largest(&after_rows),
            holdout_rms_um: holdout_after_um,
            compensated_holdout_rms_um: holdout_compensated_um,
            compensated_rms_um: rms(&on_board),
            compensated_max_um: largest(&on_board),
        },
        verdict,
        reasons: reasons.iter().map(ToString::to_string).collect(),
        notes,
        holdout_used: !dropped.is_empty(),
        left_out: dropped
            .iter()
            .map(|cause| HeldOutParts { cause: cause.name().into(), column: cause.column() })
            .collect(),
        findings,
        hints,
        missing_inputs: Vec::new(),
        at_tool,
        held_out,
        rejected: found.rejected.into_iter().map(rejected).collect(),
    };
    let Extended { replaced: mut corrected, new: mut terms } = Extended::by(&data, &written.board);
    let explains = Extended::by(&data, &written.explains);
    corrected.extend(explains.replaced);
    terms.extend(explains.new);
    let noise_is_measured = repeats.is_some();
    let mut diagnosis = Diagnosis {
        report,
        terms,
        corrected,
        data,
        before,
        after,
        aside,
        noise_is_measured,
        promise,
        questions,
        runs: asked.runs.to_vec(),
    };
    if diagnosis.corrects() {
        diagnosis.report.missing_inputs = missing_inputs(&extended::machine(&diagnosis));
    }
    Ok(diagnosis)
}

/// Returns the model as it is handed out: terms that are not kept leave, and the others are fitted again
/// without them; but what is of this record alone is left out only then, for next to it the others are right.
fn kept(problem: &Problem, found: &Found, judged: &[Judgement]) -> Model {
    let model = &found.fitted.model;
    let open = judged.iter().filter(|it| !it.is_kept && !it.is_of_this_record());
    let mut kept = without_all(problem, model, open.map(Judgement::cause));
    if !kept.parts.is_empty() && kept.parts.len() < model.parts.len() {
        kept = fit(problem, &kept, None).model;
    }
    kept_of(problem, kept, judged)
}

/// `model` without what is of this record alone.
fn kept_of(problem: &Problem, model: Model, judged: &[Judgement]) -> Model {
    let of_record = judged.iter().filter(|it| !it.is_kept && it.is_of_this_record());
    of_record.fold(model, |model, it| without_this_record(problem, &model, it))
}

/// `model` without a term that another record would show otherwise, and with what of it lasts: where a start
/// has settled to, and where something slow stood at first.
fn without_this_record(problem: &Problem, model: &Model, term: &Judgement) -> Model {
    let mut rest = without_all(problem, model, std::iter::once(term.cause()));
    let parts = model.parts.iter().filter(|part| part.kind != *term.cause()).cloned().collect();
    let less = Model { parts, ..model.clone() };
    let [with, less] = [model, &less].map(|model| problem.predicted(model));
    let mut effect = with.iter().zip(&less).map(|(with, less)| with - less);
    let lasting = if term.is_of_the_start() { effect.next_back() } else { effect.next() };
    // The zero is a constant of its own, or that of the sensor.
    let of_sensor = |part: &&mut Part| part.kind.cause().is_some_and(Effect::is_constant);
    let of_sensor = rest.parts.iter_mut().find(of_sensor).map(|part| &mut part.values[0]);
    if let Some(zero_um) = rest.constant_um.as_mut().or(of_sensor) {
        *zero_um += lasting.unwrap_or(0.0);
    }
    rest
}

/// `model` without the terms of these causes. Without a term the machine file stays, and with it its
/// zero.
fn without_all<'c>(
    problem: &Problem,
    model: &Model,
    causes: impl Iterator<Item = &'c Kind>,
) -> Model {
    let kept = causes.fold(model.clone(), |model, cause| without(problem, &model, cause));
    if kept.parts.is_empty() { Model::default() } else { kept }
}

/// Returns the model as the board runs it: without what only happened once, and what is not the machine's; and in the
/// form that needs no feed.
fn compensated(model: &Model) -> Model {
    let mut compensated = model.clone();
    compensated.parts.retain(|part| part.kind.is_compensated());
    compensated.parts.iter_mut().for_each(Part::forget_feed);
    if compensated.parts.is_empty() { Model::default() } else { compensated }
}

/// Returns the model without what time alone or the instrument explains.
fn lasting(model: &Model) -> Model {
    let parts: Vec<Part> =
        model.parts.iter().filter(|part| part.kind.tier() <= OF_THE_MACHINE).cloned().collect();
    if parts.is_empty() { Model::default() } else { Model { parts, ..model.clone() } }
}

/// Terms that only explain fall short where they leave more than this times the residual of left-out parts.
const MORE_LEFT: f64 = 1.5;

/// The highest tier of what is of the machine, or of what else was recorded ([`Kind::tier`]).
const OF_THE_MACHINE: u8 = 1;

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
    let stated_um = data.machine.instrument_um.map(|um| 0.5 * um);
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

fn rejected(tried: Tried) -> Rejected {
    Rejected {
        cause: tried.cause.name().into(),
        column: tried.cause.column(),
        reason: tried.why_not.to_string(),
        rms_um: tried.rms_um,
        left_out_um: tried.left_out_um,
    }
}
