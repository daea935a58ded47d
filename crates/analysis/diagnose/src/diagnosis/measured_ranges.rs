//! Limits that the measured range sets to a term, and to all of them in every state: more is taken back by another
//! term.
//!
//! The states are those of [`envelope`]: after a start, after a stop, at the corners of the recorded inputs.

use trueup_machine::{
    Machine, RunFile,
    check::{self, ImplausibleValue, Plausibility},
    effect::PredictionStage,
    envelope::{self, InputRanges, predict_states},
    machine_file::Quantity,
};

use crate::{
    data::DataTable,
    diagnosis::{
        extended_machine_file::extend_machine, input_ranges::recorded_input_ranges,
        omission_reason::OmissionReason,
    },
    fit::FitProblem,
    model::Model,
    predict::compact_model::MAX_EFFECT_RATIO,
    term_kind::TermKind,
};

/// Returns the values of a machine file that no machine can have.
fn find_impossible_values(machine: &Machine) -> Vec<ImplausibleValue> {
    let findings = check::list_implausible_values(machine).into_iter();
    findings.filter(|finding| finding.grade == Plausibility::Impossible).collect()
}

/// The ranges of the measured values and of the inputs.
pub(super) struct MeasuredRanges<'m> {
    machine: &'m Machine,
    quantity: Quantity,
    ranges: InputRanges,
    /// The largest error, and the largest of what the machine file leaves: a term does no more than twice that.
    largest_um: f64,
    /// Least and most of what was measured.
    range_um: [f64; 2],
    /// Whether `compile` refuses the machine file already.
    is_refused: bool,
    /// Keys of the machine file whose values no machine can have.
    impossible: Vec<String>,
}

impl<'m> MeasuredRanges<'m> {
    pub(super) fn new(problem: &'m FitProblem, runs: &[RunFile]) -> Self {
        let data: &DataTable = &problem.data;
        let machine = &data.setting.machine;
        let left = problem.residual(&Model::default());
        let about = |values: &[f64]| {
            let is_axis = data.setting.quantity.axis().is_some();
            let zero =
                if is_axis { values.iter().sum::<f64>() / values.len().max(1) as f64 } else { 0.0 };
            values.iter().fold(0.0_f64, |most, um| most.max((um - zero).abs()))
        };
        let range_um =
            problem.measured.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], um| {
                [low.min(*um), high.max(*um)]
            });
        Self {
            machine,
            quantity: data.setting.quantity,
            ranges: recorded_input_ranges(data, runs),
            largest_um: about(&problem.measured).max(about(&left)),
            range_um,
            is_refused: envelope::find_limit_violation(machine).is_some(),
            impossible: find_impossible_values(machine)
                .into_iter()
                .map(|finding| finding.key)
                .collect(),
        }
    }

    /// Returns the first term that is more than what was measured lets it be, and why.
    pub(super) fn find_first_violation(
        &self,
        problem: &FitProblem,
        model: &Model,
    ) -> Option<(TermKind, OmissionReason)> {
        let largest = model
            .parts
            .iter()
            .filter(|part| part.kind.list_length().is_none())
            .map(|part| (self.max_effect_um(problem, model, &part.kind), &part.kind))
            .max_by(|a, b| a.0.total_cmp(&b.0))?;
        let (um, kind) = (largest.0, largest.1.clone());
        if um > MAX_EFFECT_RATIO * self.largest_um {
            return Some((kind, OmissionReason::TooLarge { um, measured_um: self.largest_um }));
        }
        let machine = extend_machine(&problem.data, model);
        if let Some(excess) = envelope::find_limit_violation(&machine).filter(|_| !self.is_refused)
        {
            return Some((kind, OmissionReason::Rejected(excess.rule)));
        }
        let beyond = find_impossible_values(&machine);
        if let Some(finding) =
            beyond.into_iter().find(|finding| !self.impossible.contains(&finding.key))
        {
            return Some((kind, OmissionReason::Rejected(finding.warning.what)));
        }
        self.find_range_violation(&machine).map(|why| (kind, why))
    }

    /// Returns what a term does in the rows, at the most; of one that rises from a start on all that it rises by. A
    /// gain and a bend of a source are one characteristic, and count together.
    fn max_effect_um(&self, problem: &FitProblem, model: &Model, kind: &TermKind) -> f64 {
        let is_bent = |there: &TermKind| {
            matches!(there.prediction_stage(), PredictionStage::Factor | PredictionStage::Bend)
        };
        let is_of_it = |there: &TermKind| there == kind || is_bent(there) && is_bent(kind);
        let parts = model.parts.iter().filter(|part| !is_of_it(&part.kind)).cloned().collect();
        let without = Model { parts, ..model.clone() };
        let [with, without] = [model, &without].map(|model| problem.predict(model));
        let mut effect: Vec<f64> = with.iter().zip(&without).map(|(a, b)| a - b).collect();
        if self.quantity.axis().is_some() {
            let mean = effect.iter().sum::<f64>() / effect.len().max(1) as f64;
            effect.iter_mut().for_each(|um| *um -= mean);
        }
        let in_rows = effect.iter().fold(0.0_f64, |most, um| most.max(um.abs()));
        let own = model.parts.iter().find(|part| part.kind == *kind);
        let risen = own
            .filter(|part| part.kind.is_settling_from_start())
            .map_or(0.0, |part| part.values[1].abs());
        in_rows.max(risen)
    }

    /// Returns the state in which the machine is farthest outside what was measured, if beyond the margin, and farther
    /// than the machine file is already.
    fn find_range_violation(&self, extended: &Machine) -> Option<OmissionReason> {
        let number = Quantity::ALL.iter().position(|quantity| *quantity == self.quantity)?;
        let believed = predict_states(self.machine, &self.ranges);
        let [low, high] = believed
            .iter()
            .map(|state| state.um[number])
            .filter(|um| um.is_finite())
            .fold(self.range_um, |[low, high], um| [low.min(um), high.max(um)]);
        // As far beyond as the measured range is wide.
        let margin_um = self.range_um[1] - self.range_um[0];
        let outside = |um: f64| (low - margin_um - um).max(um - high - margin_um);
        let worst = predict_states(extended, &self.ranges)
            .into_iter()
            .filter(|state| state.um[number].is_finite())
            .max_by(|a, b| outside(a.um[number]).total_cmp(&outside(b.um[number])))?;
        let um = worst.um[number];
        (outside(um) > 0.0).then_some(OmissionReason::LeavesRange {
            um,
            range_um: self.range_um,
            since_start_s: worst.since_start_s,
        })
    }
}
