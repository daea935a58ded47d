//! Which of the terms that were found are handed out, which of them are written, and how they stand on the hold-out.

use std::sync::Arc;

use trueup_machine::{BadInput, RunFile};

use super::{
    applied::Open,
    finding::{finding, merged},
    held_out::LeftOutParts,
    hold_out::HoldOut,
    predicted::{self, Choice, is_settled},
    report::Finding,
    rest::{kept, lasting, without_all},
    shortfall::{Promised, Shortfall},
    slow_step,
    transfer::Transfer,
    wandering::Wandering,
    written::Written,
};
use crate::{
    blocks::Folds,
    data::Data,
    fit::{Problem, fit},
    judge::Judgement,
    kind::Kind,
    model::Model,
    repeats,
    search::Found,
};

/// Terms that only explain fall short where they leave more than this times the residual of left-out parts.
const MORE_LEFT: f64 = 1.5;

/// The result of the search, with what it was made from.
pub(super) struct Search<'a> {
    pub data: &'a Arc<Data>,
    pub problem: &'a Problem,
    pub found: &'a Found,
    pub judged: &'a [Judgement],
    /// The runs, as files.
    pub runs: &'a [RunFile],
    /// Rows that were set aside.
    pub aside: &'a [bool],
}

/// The model as it is handed out.
pub(super) struct Chosen {
    /// With what only explains.
    pub model: Model,
    /// The terms that are written, and those that are left out.
    pub written: Written,
    /// Whether it is for prediction alone.
    pub choice: Choice,
    /// How it stands on the hold-out; `None` without one.
    pub transfer: Option<Transfer>,
}

impl Chosen {
    /// Returns the choice from what was found and judged.
    ///
    /// # Errors
    /// A column is missing in the hold-out that a term needs.
    pub(super) fn of(
        search: &Search<'_>,
        hold_out: Option<&HoldOut<'_>>,
    ) -> Result<Self, BadInput> {
        let Search { data, problem, found, judged, runs, aside } = *search;
        let mut model = kept(problem, found, judged);
        let mut written = Written::new(problem, found, judged, &model, runs);
        // What was measured several times at the same positions is judged by its repeats.
        let repeats_itself = data.quantity.axis().is_some()
            && repeats::analyse(data, &Model::default().predict(data), aside).is_some();
        let wanders = Wandering::of(problem, found).is_some();
        let is_settled = is_settled(found, judged, wanders) && written.left.is_empty();
        let choice = if is_settled || repeats_itself {
            Choice::default()
        } else {
            written.choose(problem, found, judged, &model, runs)
        };
        if choice.is_predicted {
            model.parts.retain(|part| !part.kind.is_compensated());
            model.parts.extend(written.board.parts.iter().cloned());
            model.constant_um = written.board.constant_um;
            model.sort();
        }
        let mut transfer = None;
        if let Some(hold_out) = hold_out {
            hold_out.check(data, &model)?;
            let on_hold_out = Transfer::new(problem, model, hold_out);
            model = on_hold_out.model.clone();
            if !on_hold_out.dropped.is_empty() && !choice.is_predicted {
                written = Written::new(problem, found, judged, &model, runs);
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
        Ok(Self { model, written, choice, transfer })
    }

    /// Returns how far the terms that the board runs (`compensated`, promised by `floor`), or those that only explain,
    /// fall short on the hold-out; `None` where they do not.
    pub(super) fn shortfall(
        &self,
        search: &Search<'_>,
        hold_out: &HoldOut<'_>,
        compensated: &Model,
        floor: Option<f64>,
        folds: &Folds,
        within: f64,
    ) -> Option<Shortfall> {
        let Search { data, problem, found, .. } = *search;
        let memory = found.noise.memory * problem.groups.size as f64;
        let of_board = hold_out.data.compensated();
        let test = of_board.as_ref().unwrap_or(&hold_out.data);
        let on_board = floor.and_then(|floor| {
            let promised = Promised { floor, most_left_um: 0.0 };
            Shortfall::new(data, hold_out, test, compensated, promised, memory)
        });
        // What only explains is to hold on another day as well.
        on_board.or_else(|| {
            let lasting = lasting(&self.model);
            if lasting.parts.len() <= compensated.parts.len() {
                return None;
            }
            let parts = LeftOutParts { problem, folds, model: &lasting, foreseen: None, within };
            let figures = parts.held_out().figures;
            let most_left_um = MORE_LEFT * figures.after_um;
            let promised = Promised { floor: figures.reduction_floor95, most_left_um };
            Shortfall::new(data, hold_out, &hold_out.data, &lasting, promised, memory)
        })
    }

    /// Returns a finding for each term that was judged, and for those that were chosen for prediction. No name is claimed
    /// where most of the error is left and may be the machine.
    pub(super) fn findings(
        &self,
        search: &Search<'_>,
        open: &Open,
        after: &[f64],
        within: f64,
        is_most_unknown: bool,
    ) -> Vec<Finding> {
        let Search { data, problem, found, judged, .. } = *search;
        let Self { written, choice, transfer, .. } = self;
        let is_disproved = transfer.as_ref().is_some_and(|it| it.is_disproved);
        let is_dropped =
            |cause: &Kind| transfer.as_ref().is_some_and(|it| it.dropped.contains(cause));
        let of_judgement = |it: &Judgement| {
            let mut finding = finding(problem, it, found.folds.unit);
            finding.gain.by_row(within);
            slow_step::tell_duration(&mut finding, &it.part, data, after);
            if is_dropped(it.cause()) {
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
        };
        let mut findings: Vec<Finding> = judged.iter().map(of_judgement).collect();
        // A term may be open only since it could not be written.
        let open_ones = judged.iter().zip(&findings).filter(|(_, finding)| !finding.claimed);
        let open_ones: Vec<&Kind> = open_ones.map(|(it, _)| it.cause()).collect();
        for (it, finding) in judged.iter().zip(&mut findings) {
            if let Some(open) = open_ones.iter().find(|open| it.cause().may_be_of(open)) {
                finding.hangs_on(open);
            }
            if is_most_unknown {
                finding.leaves_most_unknown();
            }
        }
        open.mark(&mut findings);
        findings = merged(judged, findings);
        if let Some(foreseen) = choice.foreseen.as_ref().filter(|_| choice.is_predicted) {
            findings.extend(predicted::findings(problem, written, foreseen, judged, &found.folds));
        }
        findings
    }
}
