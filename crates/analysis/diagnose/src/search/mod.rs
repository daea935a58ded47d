//! The search: a term is added as long as one explains more than noise would, and predicts what it
//! has not seen.
//!
//! ```text
//! scan all causes ─► significant? ─► fit with all terms ─► BIC ─► gain on held-out blocks ─► add
//!        ▲                                                                             │
//!        └───────── is another cause better in a term's place? is it still needed? ◄───┘
//! ```
//!
//! | page | does |
//! |---|---|
//! | `scan`, `statistics` | which candidates explain more than noise would |
//! | `extend` | fits of the model with one cause more, or another in a term's place |
//! | `criterion` | how two models are compared |
//! | `lack_of_fit` | curves that find what no cause explains |
//! | `state` | the model in work, its terms, what was rejected and why |
//! | `choose` | which extension is taken |
//! | `table` | a table that was measured several times, judged by its repeats |
//! | `interaction`, `bound` | what takes two inputs together: differences of two temperatures, ranges and their bounds |
//! | `run_floating_search` | several terms at once, what one alone cannot show |
//! | `revise` | what is looked at again once other terms are there |
//! | `simplification` | what is made simpler at the end |
//! | `smoothing` | lags that only take noise away |
//!
//! Models whose BIC cannot be distinguished are equal; then the simpler cause wins, among those the one
//! that predicts held-out blocks better, and the machine's own model and sensors come before others.

pub(crate) mod extension;
mod extension_choice;
mod floating_search;
pub(crate) mod interaction;
pub(crate) mod lack_of_fit;
pub(crate) mod model_comparison;
pub(crate) mod range_bound;
pub(crate) mod scan;
mod scan_statistics;
pub(crate) mod search_state;
pub(crate) mod simplification;
pub(crate) mod smoothing;
pub(crate) mod table_from_repeats;
mod term_revision;

use trueup_numerics::noise::NoiseModel;

use crate::{
    candidates::{
        all_candidates, non_interaction_candidates, propose_curve_candidates,
        single_input_candidates,
    },
    data::DataTable,
    fit::{FitProblem, FittedModel},
    folds::Folds,
    model::Model,
    term_kind::ModelPart,
};
use extension::fit_scan_hits;
use extension_choice::{ChosenExtension, SelectionOutcome, choose_extension, find_suppressor_pair};
use interaction::fit_interaction_replacements;
use lack_of_fit::{CurveInputs, LackOfFit};
use model_comparison::{degrees_of_freedom, estimate_noise};
use scan::{NoiseSimulation, ScanHit, ScanResult, scan};
pub(crate) use search_state::{AddedTerm, RejectedCandidate};
use search_state::{RejectReason, Search, SearchStage};

/// Most terms of one diagnosis.
const MAX_ADDED_TERMS: usize = 8;
/// Most rounds: one for each term, and as many as find nothing.
const MAX_SEARCH_ROUNDS: usize = MAX_ADDED_TERMS + 8;
/// How often the search begins again after a term was given up.
const MAX_SEARCH_RESTARTS: usize = 3;
/// Candidates that are fitted with everything else, of those that a scan puts first.
const MAX_FITTED_CANDIDATES: usize = 10;
/// Groups times fitted values up to which several terms ahead are looked at: it is many fits.
const MAX_LOOKAHEAD_COST: usize = 40_000;

/// How far a search goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SearchScope {
    /// One recorded input a term, and products.
    Simple,
    /// Also what takes two inputs together.
    Composed,
}

/// The outcome.
pub(crate) struct SearchOutcome {
    pub fitted: FittedModel,
    /// In the order in which they were added.
    pub added: Vec<AddedTerm>,
    /// Extensions that were tried at the end and not taken.
    pub rejected: Vec<RejectedCandidate>,
    /// Tests that fire on what is left.
    pub lack_of_fit: Vec<LackOfFit>,
    pub noise: NoiseModel,
    pub folds: Folds,
}

/// Returns the model to begin with: an axis's measurement has an arbitrary zero.
pub(crate) fn initial_model(data: &DataTable) -> Model {
    Model { parts: Vec::<ModelPart>::new(), constant_um: data.setting.quantity.axis().map(|_| 0.0) }
}

/// Returns the search on `problem`, from the current model; `known` was found before some rows were excluded as outliers, and
/// is the answer to go on from where it is better than what is found now. `progress` receives what is being tried, and
/// how far the search has come (0…1).
pub(crate) fn search(
    problem: &FitProblem,
    start: &Model,
    known: Option<&Model>,
    breadth: SearchScope,
    progress: &mut dyn FnMut(&str, f64),
) -> SearchOutcome {
    let mut search = Search::new(problem, start, breadth);
    let mut no_gain = search.add_terms(progress);
    // A few rows more or less may let a search stop short of what another one has found.
    if known.is_some_and(|known| search.adopt_if_better(known)) {
        search.restart_search();
        no_gain = search.add_terms(progress);
    }
    // What predicts nothing may have stood in the way of what does.
    let mut returns = 0;
    while search.simplify_model() && returns < MAX_SEARCH_RESTARTS {
        search.restart_search();
        no_gain = search.add_terms(progress);
        returns += 1;
    }
    search.into_outcome(no_gain)
}

/// The outcome of a round.
enum RoundOutcome {
    /// A term is there, or two.
    AddedTerm,
    /// Nothing; there is more to try.
    Widened,
    /// Nothing, and everything was tried. With the last scan.
    Exhausted(Vec<ScanHit>),
}

impl Search<'_> {
    /// Adds terms until nothing more is to be found; what is more than noise then, but predicts nothing.
    fn add_terms(&mut self, progress: &mut dyn FnMut(&str, f64)) -> Vec<LackOfFit> {
        for round in 0..MAX_SEARCH_ROUNDS {
            let part = |rounds: f64| (rounds / MAX_ADDED_TERMS as f64).min(0.9);
            progress("looking for a cause", part(round as f64));
            match self.run_round(progress) {
                RoundOutcome::AddedTerm if self.added.len() >= MAX_ADDED_TERMS => break,
                RoundOutcome::AddedTerm => {
                    progress("comparing with alternatives", part(round as f64 + 0.7));
                    self.revise_terms();
                }
                RoundOutcome::Widened => {}
                RoundOutcome::Exhausted(hits) => return self.collect_rejected_candidates(&hits),
            }
        }
        Vec::new()
    }

    /// Scans what may be tried now, and takes the best if it is worth it.
    fn run_round(&mut self, progress: &mut dyn FnMut(&str, f64)) -> RoundOutcome {
        let all = match self.stage {
            SearchStage::Composed => all_candidates,
            SearchStage::PeriodicInTime => non_interaction_candidates,
            _ => single_input_candidates,
        };
        let mut candidates = all(self.problem, &self.fitted.model, &self.fitted.residual);
        candidates.retain(|candidate| {
            self.stage.admits(&candidate.kind)
                && !self.has_interaction_on_column(&candidate.kind)
                && !self.rejected.iter().any(|tried| tried.cause == candidate.kind)
                && !self.given_up.contains(&candidate.kind)
        });
        let tier = candidates.iter().map(|candidate| candidate.kind.tier()).max().unwrap_or(0);
        let scanned = scan(self.problem, &self.fitted, &candidates, self.limits);
        let is_open = |hit: &&ScanHit| self.is_admissible(hit);
        let hits: Vec<ScanHit> = scanned.hits.iter().filter(is_open).cloned().collect();
        let mut options = fit_scan_hits(self.problem, &self.fitted, &hits, MAX_FITTED_CANDIDATES);
        if self.stage == SearchStage::Composed {
            let causes = self.added.iter().map(|term| &term.cause);
            let alone = fit_interaction_replacements(self.problem, &self.fitted, causes);
            let bic = self.bic();
            options.extend(alone.into_iter().filter(|extension| extension.bic < bic));
            options.retain(|option| !self.is_interaction_cancelling_other_term(option));
        }
        match choose_extension(self, options, tier, progress) {
            SelectionOutcome::Accept(taken) => {
                self.accept_extension(taken, &hits);
                RoundOutcome::AddedTerm
            }
            SelectionOutcome::Reject(tried) => self.widen_search(scanned, tier, tried, progress),
        }
    }

    /// Returns whether a hit may be taken. One slow misfit may be explained that the likelihood would leave to
    /// the noise (only the squares see it); with that the few independent rows that it rests on are
    /// used up, and a second one would follow the wander of the first one's remainder.
    fn is_admissible(&self, hit: &ScanHit) -> bool {
        let is_free = self.by_squares.is_empty() || hit.part.kind.tier() == 0;
        hit.is_likely || hit.is_significant && is_free
    }

    fn accept_extension(&mut self, taken: ChosenExtension, hits: &[ScanHit]) {
        self.rejected.clear();
        self.limits = NoiseSimulation::Robust;
        self.fitted = taken.fitted;
        self.added.retain(|there| self.fitted.model.contains(&there.cause));
        self.by_squares.retain(|cause| self.fitted.model.contains(cause));
        for cause in taken.causes {
            let own = || hits.iter().filter(|hit| hit.part.kind == cause);
            let by_squares = own().next().is_some() && !own().any(|hit| hit.is_likely);
            if cause.tier() > 0 && by_squares {
                self.by_squares.push(cause.clone());
            }
            self.added.push(AddedTerm { cause, gain: taken.gain, tried: taken.tried.clone() });
        }
    }

    /// Returns what to try after a round that took none of `tried`: two causes that hide each other, the next
    /// stage, sharper limits, two terms ahead, what takes two inputs together, what depends on the clock alone; in this
    /// order.
    fn widen_search(
        &mut self,
        scanned: ScanResult,
        tier: u8,
        tried: Vec<RejectedCandidate>,
        progress: &mut dyn FnMut(&str, f64),
    ) -> RoundOutcome {
        let is_empty = self.added.is_empty();
        if self.stage == SearchStage::TimeAndLagged && is_empty {
            let limit = scanned.likelihood_limit.unwrap_or(0.0);
            if let Some(ChosenExtension { fitted, causes, gain, .. }) =
                find_suppressor_pair(self, &scanned.hits, tier, limit)
            {
                self.fitted = fitted;
                let added = |cause| AddedTerm { cause, gain, tried: Vec::new() };
                self.added = causes.into_iter().map(added).collect();
                self.restart_search();
                return RoundOutcome::Widened;
            }
        }
        self.rejected.extend(tried);
        if let Some(next) = self.stage.next_stage() {
            self.stage = next;
            return RoundOutcome::Widened;
        }
        // Two causes may together look like slow noise. Before all is called noise, a sharper look.
        if is_empty && self.limits == NoiseSimulation::Robust {
            self.limits = NoiseSimulation::Sharp;
            self.restart_search();
            return RoundOutcome::Widened;
        }
        let work = self.problem.groups.len() * degrees_of_freedom(&self.fitted.model);
        if !is_empty && self.record_new_lookahead() {
            progress("looking several terms ahead", f64::NAN);
            let is_cheap = work < MAX_LOOKAHEAD_COST;
            if self.replace_lists_by_plain_terms()
                || is_cheap && (self.run_floating_search() || self.try_two_step_lookahead())
            {
                self.revise_terms();
                return RoundOutcome::Widened;
            }
        }
        // What was measured several times is judged by that, once all that is not of the axis is there.
        if !self.has_judged_repeats {
            self.has_judged_repeats = true;
            progress("comparing repeats", f64::NAN);
            if self.apply_table_from_repeats() {
                self.restart_search();
                return RoundOutcome::Widened;
            }
        }
        // Many candidates, any of which may imitate a simple one: last.
        if self.stage == SearchStage::TimeAndLagged && self.breadth == SearchScope::Composed {
            self.stage = SearchStage::Composed;
            return RoundOutcome::Widened;
        }
        if self.stage != SearchStage::PeriodicInTime {
            self.stage = SearchStage::PeriodicInTime;
            return RoundOutcome::Widened;
        }
        RoundOutcome::Exhausted(scanned.hits)
    }

    /// Gathers what was rejected on the way, down to what was not even significant in the last scan;
    /// what is more than noise, but does not predict, is a lack of fit.
    fn collect_rejected_candidates(&mut self, hits: &[ScanHit]) -> Vec<LackOfFit> {
        for added in &self.added {
            for tried in &added.tried {
                let is_in = added.cause == tried.cause || self.fitted.model.contains(&tried.cause);
                if !is_in && !self.rejected.iter().any(|there| there.cause == tried.cause) {
                    self.rejected.push(tried.clone());
                }
            }
        }
        let rms_um = self.fitted.rms();
        let lack_of_fit = self
            .rejected
            .iter()
            .filter(|tried| rms_um - tried.rms_um > self.relevant_um)
            .filter_map(|tried| match tried.why_not {
                RejectReason::NoGain { left_out, .. } => {
                    Some(LackOfFit::NoGain { cause: tried.cause.clone(), left_out })
                }
                _ => None,
            })
            .collect();
        for hit in hits {
            let name = hit.part.kind.name();
            if self.rejected.iter().any(|tried| tried.cause.name() == name) {
                continue;
            }
            let same = hits.iter().filter(|there| there.part.kind.name() == name);
            let best = same.max_by(|a, b| a.by_likelihood.total_cmp(&b.by_likelihood));
            self.rejected.push(RejectedCandidate {
                cause: best.unwrap_or(hit).part.kind.clone(),
                rms_um,
                left_out_um: None,
                why_not: RejectReason::Insignificant,
            });
        }
        lack_of_fit
    }

    /// Returns the outcome, with what fires on what is left next to `lack_of_fit`.
    fn into_outcome(self, mut lack_of_fit: Vec<LackOfFit>) -> SearchOutcome {
        let (problem, fitted) = (self.problem, self.fitted);
        let scanned = scan(problem, &fitted, &propose_curve_candidates(problem), self.limits);
        let share_um = |hit: &ScanHit| (hit.explained * fitted.rms().powi(2)).sqrt();
        let counts = |hit: &&ScanHit| hit.is_significant && share_um(hit) > self.relevant_um;
        let inputs = scanned
            .hits
            .iter()
            .filter(counts)
            .filter_map(|hit| CurveInputs::from_kind(&hit.part.kind));
        for inputs in inputs {
            if !lack_of_fit.iter().any(|there| there.depends_on(&inputs)) {
                lack_of_fit.push(LackOfFit::CorrelatedWith(inputs));
            }
        }
        let noise = estimate_noise(problem, &fitted.residual, degrees_of_freedom(&fitted.model));
        let folds = Folds::new(problem, noise.memory);
        let (added, rejected) = (self.added, self.rejected);
        SearchOutcome { fitted, added, rejected, lack_of_fit, noise, folds }
    }
}
