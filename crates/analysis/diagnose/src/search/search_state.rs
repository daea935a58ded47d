//! How far a search has come: the model in work, how its terms came in, and what was rejected next to it.

use std::fmt;

use trueup_machine::effect::{Effect, HeatPath};

use crate::{
    fit::{FitProblem, FittedModel, fit},
    folds::{FoldUnit, Folds},
    model::Model,
    search::{
        SearchScope,
        extension::{ModelExtension, TermReplacements, fit_replacements, without_term},
        model_comparison::{bic, held_out_rms_um},
        scan::NoiseSimulation,
    },
    term_gain::TermGain,
    term_kind::TermKind,
};

/// The search on one problem.
pub(crate) struct Search<'p> {
    pub problem: &'p FitProblem,
    /// The blocks that are held out in turn.
    pub folds: Folds,
    /// The model in work.
    pub fitted: FittedModel,
    /// Its terms, in the order in which they were added.
    pub added: Vec<AddedTerm>,
    pub breadth: SearchScope,
    pub stage: SearchStage,
    /// How the limits of the scan are drawn.
    pub limits: NoiseSimulation,
    /// Extensions that were tried next to the model in work and rejected; they are not tried next to it again.
    pub rejected: Vec<RejectedCandidate>,
    /// Terms that were there and predicted no better than without them; they are not tried again.
    pub given_up: Vec<TermKind>,
    /// Terms that only the statistic of squares called for.
    pub by_squares: Vec<TermKind>,
    /// The causes next to which several terms ahead have been looked at.
    looked_ahead: Vec<Vec<TermKind>>,
    /// Whether a table was judged by its repeats.
    pub has_judged_repeats: bool,
    /// The reduction of the RMS below which a term is not worth it, in µm.
    pub relevant_um: f64,
}

/// Which causes are tried. A stage begins once the one before has nothing more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SearchStage {
    /// Possible errors of the machine's own model.
    OwnModel,
    /// Other recorded inputs that act at once.
    Instantaneous,
    /// Time alone, and what acts late.
    TimeAndLagged,
    /// Causes that take two recorded inputs together: the difference of two, or a range of one.
    Composed,
    /// Causes that are periodic in time alone: before all else is tried, they would follow what is missing.
    PeriodicInTime,
}

impl SearchStage {
    pub(crate) fn admits(self, cause: &TermKind) -> bool {
        let of_path = |path: HeatPath<'_>| path.has_lag && !path.is_second;
        let is_late = match cause.heat_path() {
            Some(path) => of_path(path),
            None => {
                matches!(cause.cause(), Some(Effect::Dependence(_))) && cause.has_time_constant()
            }
        };
        match self {
            Self::OwnModel => cause.tier() == 0,
            Self::Instantaneous => cause.tier() == 0 || cause.tier() <= 1 && !is_late,
            Self::TimeAndLagged | Self::PeriodicInTime | Self::Composed => true,
        }
    }

    /// Returns the next one; none after the last that is tried before all else is.
    pub(crate) fn next_stage(self) -> Option<Self> {
        match self {
            Self::OwnModel => Some(Self::Instantaneous),
            Self::Instantaneous => Some(Self::TimeAndLagged),
            Self::TimeAndLagged | Self::PeriodicInTime | Self::Composed => None,
        }
    }
}

/// A term that was added, with what it brought then, and what was tried in its place.
#[derive(Clone, Debug)]
pub(crate) struct AddedTerm {
    pub cause: TermKind,
    pub gain: TermGain,
    pub tried: Vec<RejectedCandidate>,
}

/// A cause that was tried and not taken.
#[derive(Clone, Debug)]
pub(crate) struct RejectedCandidate {
    pub cause: TermKind,
    /// The residual of the model with it: RMS, in µm.
    pub rms_um: f64,
    /// The same on held-out blocks, where it was worked out.
    pub left_out_um: Option<f64>,
    pub why_not: RejectReason,
}

/// Why a cause was not taken.
#[derive(Clone, Debug)]
pub(crate) enum RejectReason {
    /// Another explains as much and is simpler, or predicts better.
    Outperformed,
    /// It predicts no better what was held out.
    NoGain { left_out: FoldUnit, before_um: f64, after_um: f64 },
    /// Noise would show as much.
    Insignificant,
}

impl fmt::Display for RejectReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Outperformed => {
                f.write_str("another explains it as well and is simpler, or predicts better")
            }
            Self::NoGain { left_out, before_um, after_um } => write!(
                f,
                "no gain on held-out {left_out}: {before_um:.3} µm before, {after_um:.3} µm with it"
            ),
            Self::Insignificant => f.write_str("not more than noise would show"),
        }
    }
}

/// The share of the RMS below which nothing is worth a term: of what the machine file leaves, and of held-out blocks.
pub(crate) const MIN_RELEVANT_RMS_FRACTION: f64 = 0.01;

impl<'p> Search<'p> {
    pub(crate) fn new(problem: &'p FitProblem, start: &Model, breadth: SearchScope) -> Self {
        let fitted = fit(problem, start, None);
        Self {
            problem,
            // No interval is asked of them: the memory of the noise does not matter.
            folds: Folds::new(problem, 0.0),
            relevant_um: MIN_RELEVANT_RMS_FRACTION * fitted.rms(),
            fitted,
            added: Vec::new(),
            breadth,
            stage: SearchStage::OwnModel,
            limits: NoiseSimulation::Robust,
            rejected: Vec::new(),
            given_up: Vec::new(),
            by_squares: Vec::new(),
            looked_ahead: Vec::new(),
            has_judged_repeats: false,
        }
    }

    /// BIC of the model in work.
    pub(crate) fn bic(&self) -> f64 {
        bic(self.problem, &self.fitted)
    }

    /// Returns what `fitted` leaves on held-out blocks: RMS, in µm.
    pub(crate) fn held_out_rms_um(&self, fitted: &FittedModel) -> f64 {
        held_out_rms_um(self.problem, &self.folds, &fitted.model)
    }

    /// Returns what `fitted` leaves on held-out blocks, in each group, in µm.
    pub(crate) fn held_out_residuals(&self, fitted: &FittedModel) -> Vec<f64> {
        self.folds.held_out_residuals(self.problem, &fitted.model)
    }

    /// Returns the model in work without a term.
    pub(crate) fn refit_without(&self, cause: &TermKind) -> FittedModel {
        fit(self.problem, &without_term(self.problem, &self.fitted.model, cause), None)
    }

    /// Returns the model in work without a term, and with other causes in its place.
    pub(crate) fn fit_replacements(&self, cause: &TermKind, most: usize) -> TermReplacements {
        fit_replacements(self.problem, &self.fitted, cause, most)
    }

    /// Another cause takes the place of a term.
    pub(crate) fn replace_term(&mut self, index: usize, by: ModelExtension) {
        self.fitted = by.fitted;
        self.added[index].cause = by.cause;
    }

    /// A term leaves; `without` is the model without it.
    pub(crate) fn remove_term(&mut self, index: usize, without: FittedModel) {
        self.fitted = without;
        self.added.remove(index);
    }

    /// Returns whether several terms ahead have never been looked at from these causes; they have now. A failure to
    /// improve another model says nothing of this one.
    pub(crate) fn record_new_lookahead(&mut self) -> bool {
        let here: Vec<TermKind> =
            self.fitted.model.parts.iter().map(|part| part.kind.clone()).collect();
        let is_same = |there: &Vec<TermKind>| {
            there.len() == here.len() && here.iter().all(|kind| there.contains(kind))
        };
        let is_new = !self.looked_ahead.iter().any(is_same);
        if is_new {
            self.looked_ahead.push(here);
        }
        is_new
    }

    /// Begins anew with all causes: nothing counts as tried.
    pub(crate) fn restart_search(&mut self) {
        self.rejected.clear();
        self.stage = SearchStage::OwnModel;
    }
}

#[cfg(test)]
mod tests {
    use trueup_machine::effect::{Drift, Effect, SensorGain};

    use super::*;

    #[test]
    fn a_stage_admits_all_that_the_one_before_did_and_something_more() {
        let gain = TermKind::Cause(Effect::SensorGain(SensorGain::default()));
        let drift = TermKind::Cause(Effect::Drift(Drift::InTime { um_per_h: 0.0 }));
        let path = |has_lag| TermKind::heat_of("temp_a_c", has_lag);
        let causes = [gain, path(false), path(true), drift];
        let mut stage = Some(SearchStage::OwnModel);
        let mut admitted = Vec::new();
        while let Some(there) = stage {
            let admits = |cause: &&TermKind| there.admits(cause);
            admitted.push(causes.iter().filter(admits).count());
            stage = there.next_stage();
        }
        assert_eq!(admitted, [1, 2, 4]);
    }
}
