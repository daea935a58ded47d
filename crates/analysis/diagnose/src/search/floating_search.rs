//! Several terms at once: what one term alone cannot show.
//!
//! A search term by term stops where no single term is worth it, and keeps a rich term that took the
//! part of several plain ones. This one floats on from the model in work (sequential floating forward
//! selection: Pudil, Novovičová, Kittler, 1994): it adds the best term whether it is worth it or not,
//! takes away every term that is not needed next to it, and so on; the best model on the way is the
//! answer, if it is clearly better and predicts better, or as good with no more values
//! and predicts better beyond doubt. As each term is the best of many that were tried,
//! it pays for that: models are compared by
//!
//! ```text
//! EBIC = BIC + 2·terms·ln(causes that may be tried)          (Chen and Chen, 2008, with γ = 1)
//! ```

use trueup_numerics::{block_resampling::rms, noise::NoiseModel, parallel::parallel_map};

use crate::{
    candidates::single_input_candidates,
    fit::{FittedModel, fit},
    model::Model,
    search::{
        MAX_ADDED_TERMS,
        extension::{
            ModelExtension, centred_effect, effects_cancel, fit_single_cause_extensions,
            without_term,
        },
        model_comparison::{
            MAX_HELD_OUT_SQUARES_RATIO, STRONG_EVIDENCE_BIC_DIFFERENCE, bic, degrees_of_freedom,
            estimate_noise, extended_bic_penalty,
        },
        search_state::{AddedTerm, Search},
    },
    term_gain::TermGain,
    term_kind::TermKind,
};

/// Terms that are added without being worth it, before the search turns back: two may hide each other,
/// and a third one both.
const MAX_LOOKAHEAD_TERMS: usize = 3;
/// Candidates that are fitted for each term.
const MAX_FITTED_CANDIDATES: usize = 8;

/// By what a step is taken. Whether the way was worth it is always judged by the likelihood and by what is
/// predicted.
#[derive(Clone, Copy)]
enum SelectionCriterion {
    /// BIC, the memory of the noise estimated.
    Likelihood,
    /// The same as if the noise had no memory: as long as several slow laws are missing, the likelihood takes them
    /// for slow noise, and one of them alone for nothing.
    Squares,
}

impl SelectionCriterion {
    fn evaluate(self, ModelExtension { fitted, bic, .. }: &ModelExtension) -> f64 {
        match self {
            Self::Likelihood => *bic,
            Self::Squares => {
                let rows = fitted.residual.len() as f64;
                rows * fitted.sum.max(f64::MIN_POSITIVE).ln()
                    + degrees_of_freedom(&fitted.model) as f64 * rows.ln()
            }
        }
    }
}

/// How a float goes on.
#[derive(Clone, Copy)]
struct FloatingSearchOptions {
    by: SelectionCriterion,
    /// Whether it may add lists: curves and tables.
    with_lists: bool,
    /// The price of each term for the choice among all causes.
    price: f64,
}

/// A model and what it is worth.
struct ScoredModel {
    fitted: FittedModel,
    score: f64,
    /// Its residual on held-out blocks, in each group, in µm.
    left_out: Vec<f64>,
}

impl Search<'_> {
    /// Floats on from the model in work; whether that has changed it.
    pub(crate) fn run_floating_search(&mut self) -> bool {
        let price = self.term_penalty();
        let own = self.assess(self.fitted.clone(), price);
        // A list has room for much that is none of it, and nothing else is needed next to it.
        let mut plain = own.fitted.model.clone();
        plain.parts.retain(|part| part.kind.list_length().is_none());
        let has_list = plain.parts.len() < own.fitted.model.parts.len();
        let plain = has_list.then(|| fit(self.problem, &plain, None));
        let noise = estimate_noise(
            self.problem,
            &own.fitted.residual,
            degrees_of_freedom(&own.fitted.model),
        );
        let by_squares = (noise != NoiseModel::WHITE).then_some(SelectionCriterion::Squares);
        let found = [Some(SelectionCriterion::Likelihood), by_squares]
            .into_iter()
            .flatten()
            .find_map(|by| {
                let way = |with_lists| FloatingSearchOptions { by, with_lists, price };
                self.find_better_model(&own.fitted, &own, way(true))
                    .or_else(|| self.find_better_model(plain.as_ref()?, &own, way(false)))
            });
        let Some(found) = found else { return false };
        self.adopt_model(found, &own);
        true
    }

    /// Takes plain terms, waves too, in the place of all lists and waves, if they are better together: a list of many
    /// values has followed several of them at once before one of them alone was worth as much, and a wave next to
    /// it is what it could not follow. Whether that has changed the model.
    pub(crate) fn replace_lists_by_plain_terms(&mut self) -> bool {
        let is_list = |kind: &TermKind| kind.list_length().is_some();
        let mut plain = self.fitted.model.clone();
        plain.parts.retain(|part| !is_list(&part.kind));
        if plain.parts.len() == self.fitted.model.parts.len() {
            return false;
        }
        plain
            .parts
            .retain(|part| !part.kind.has_spatial_period() && !part.kind.is_instrument_error());
        let price = self.term_penalty();
        let is_plain = |kind: &TermKind| {
            let is_once = kind.has_instant() || kind.is_instrument_error() || kind.is_time_shift();
            kind.tier() < 3 && !is_once && !is_list(kind)
        };
        let mut here = fit(self.problem, &plain, None);
        for _ in 0..MAX_LOOKAHEAD_TERMS {
            let all =
                fit_single_cause_extensions(self.problem, &here, MAX_FITTED_CANDIDATES, is_plain);
            let Some(best) = ModelExtension::best_by_bic(all) else { break };
            if best.bic + price >= bic(self.problem, &here) {
                break;
            }
            here = best.fitted;
        }
        let own = self.assess(self.fitted.clone(), price);
        if self.penalised_bic(&here, price) > own.score - STRONG_EVIDENCE_BIC_DIFFERENCE {
            return false;
        }
        let here = self.assess(here, price);
        let is_better = self.is_better(&here, &own);
        if is_better {
            self.adopt_model(here, &own);
        }
        is_better
    }

    /// Takes `known` for the model in work if it is better by the same measure; whether it is.
    pub(crate) fn adopt_if_better(&mut self, known: &Model) -> bool {
        let price = self.term_penalty();
        let own = self.assess(self.fitted.clone(), price);
        let known = self.assess(fit(self.problem, known, None), price);
        let is_better = self.is_better(&known, &own);
        if is_better {
            self.adopt_model(known, &own);
        }
        is_better
    }

    /// Returns the best model on a way from `start` that is better than the `own`.
    fn find_better_model(
        &self,
        start: &FittedModel,
        own: &ScoredModel,
        way: FloatingSearchOptions,
    ) -> Option<ScoredModel> {
        let mut here = start.clone();
        let mut best: Option<ScoredModel> = None;
        let mut ahead = 0;
        while ahead < MAX_LOOKAHEAD_TERMS && here.model.parts.len() < MAX_ADDED_TERMS {
            let Some(there) = self.forward_step(&here, way) else { break };
            let there = self.refit_time_constants(there);
            here = self.backward_elimination(there, way);
            let before = best.as_ref().unwrap_or(own);
            // What scores worse is not worth a test on held-out blocks.
            let is_near = self.penalised_bic(&here, way.price)
                < before.score + STRONG_EVIDENCE_BIC_DIFFERENCE;
            let there = is_near.then(|| self.assess(here.clone(), way.price));
            match there.filter(|there| self.is_better(there, before)) {
                Some(better) => (best, ahead) = (Some(better), 0),
                None => ahead += 1,
            }
        }
        best
    }

    fn penalised_bic(&self, fitted: &FittedModel, price: f64) -> f64 {
        bic(self.problem, fitted) + price * fitted.model.parts.len() as f64
    }

    fn assess(&self, fitted: FittedModel, price: f64) -> ScoredModel {
        let (score, left_out) =
            (self.penalised_bic(&fitted, price), self.held_out_residuals(&fitted));
        ScoredModel { fitted, score, left_out }
    }

    /// Returns whether one model is clearly better than another one and predicts better; or as good with no more
    /// values, and predicts better beyond doubt. No terms of it may cancel, and it must be identified.
    fn is_better(&self, one: &ScoredModel, other: &ScoredModel) -> bool {
        let gap = other.score - one.score;
        let paired = self.folds.compare_paired(&other.left_out, &one.left_out);
        let [own, others] = [one, other].map(|model| degrees_of_freedom(&model.fitted.model));
        let is_better = if gap >= STRONG_EVIDENCE_BIC_DIFFERENCE {
            let fewer = own < others;
            paired.is_better() || fewer && self.predicts_as_well(&one.fitted, &other.left_out)
        } else {
            gap > -STRONG_EVIDENCE_BIC_DIFFERENCE && own <= others && paired.is_significant()
        };
        let is_identified =
            rms(&one.left_out).powi(2) <= MAX_HELD_OUT_SQUARES_RATIO * one.fitted.rms().powi(2);
        is_better && is_identified && !self.has_cancelling_terms(&one.fitted)
    }

    /// Returns what each term pays for the choice among all causes.
    fn term_penalty(&self) -> f64 {
        let fitted = &self.fitted;
        let causes = single_input_candidates(self.problem, &fitted.model, &fitted.residual);
        extended_bic_penalty(causes.len())
    }

    /// `base` with the cause of the best BIC, whatever it is. Causes that are looked for at many periods or instants
    /// answer for that where they are alone.
    fn forward_step(
        &self,
        base: &FittedModel,
        way: FloatingSearchOptions,
    ) -> Option<ModelExtension> {
        let is_open = |cause: &TermKind| {
            let is_searched =
                cause.has_spatial_period() || cause.is_instrument_error() || cause.has_instant();
            let is_admitted = way.with_lists || cause.list_length().is_none();
            cause.tier() < 3 && !is_searched && !cause.is_time_shift() && is_admitted
        };
        let all = fit_single_cause_extensions(self.problem, base, MAX_FITTED_CANDIDATES, is_open);
        let all = all.into_iter().map(|model| self.fit_with_initial_state(model, way.price));
        all.min_by(|a, b| way.by.evaluate(a).total_cmp(&way.by.evaluate(b)))
    }

    /// Returns a model with a new lagged law from wherever that stood when the record began, if that is worth a term.
    fn fit_with_initial_state(&self, new: ModelExtension, price: f64) -> ModelExtension {
        let model = &new.fitted.model;
        let is_late = new.cause.has_time_constant() && !new.cause.is_settling_from_start();
        if !is_late || model.parts.iter().any(|part| part.kind.is_settling_from_start()) {
            return new;
        }
        let with_start = fit_single_cause_extensions(
            self.problem,
            &new.fitted,
            1,
            TermKind::is_settling_from_start,
        )
        .into_iter()
        .next();
        match with_start {
            Some(with)
                if with.bic + price < new.bic
                    && with.fitted.model.find_initial_transient().is_some() =>
            {
                ModelExtension { cause: new.cause, ..with }
            }
            _ => new,
        }
    }

    /// Returns whether two terms take each other back: rich terms that cancel follow whatever a law leaves.
    fn has_cancelling_terms(&self, fitted: &FittedModel) -> bool {
        let causes = fitted.model.parts.iter().map(|part| &part.kind);
        let effects: Vec<Vec<f64>> =
            causes.map(|cause| centred_effect(self.problem, fitted, cause)).collect();
        let mut pairs = (0..effects.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
        pairs.any(|(a, b)| effects_cancel(&effects[a], &effects[b]))
    }

    /// Returns the same terms, each time constant looked for again next to the others: a fit stays where it began.
    fn refit_time_constants(&self, new: ModelExtension) -> ModelExtension {
        let ModelExtension { cause, mut fitted, .. } = new;
        let parts: Vec<TermKind> =
            fitted.model.parts.iter().map(|part| part.kind.clone()).collect();
        for kind in parts.iter().filter(|kind| kind.has_time_constant() && **kind != cause) {
            let less = fit(self.problem, &without_term(self.problem, &fitted.model, kind), None);
            let again =
                fit_single_cause_extensions(self.problem, &less, MAX_FITTED_CANDIDATES, |there| {
                    there == kind
                });
            match ModelExtension::best_by_bic(again) {
                Some(again) if again.fitted.sum < fitted.sum => fitted = again.fitted,
                _ => {}
            }
        }
        ModelExtension::new(self.problem, cause, fitted)
    }

    /// Returns a model without the terms that cost more than they explain; the one that has just come stays.
    fn backward_elimination(&self, new: ModelExtension, way: FloatingSearchOptions) -> FittedModel {
        let mut here = new;
        loop {
            let others = here.fitted.model.parts.iter().map(|part| part.kind.clone());
            let others: Vec<TermKind> = others.filter(|kind| *kind != here.cause).collect();
            let less = parallel_map(&others, self.problem.is_parallel_worthwhile(), |kind| {
                let model = without_term(self.problem, &here.fitted.model, kind);
                ModelExtension::new(
                    self.problem,
                    here.cause.clone(),
                    fit(self.problem, &model, None),
                )
            });
            match less.into_iter().min_by(|a, b| way.by.evaluate(a).total_cmp(&way.by.evaluate(b)))
            {
                Some(less) if way.by.evaluate(&less) < way.by.evaluate(&here) + way.price => {
                    here = less
                }
                _ => return here.fitted,
            }
        }
    }

    /// Takes a better model for the `own`.
    fn adopt_model(
        &mut self,
        ScoredModel { fitted, left_out, .. }: ScoredModel,
        own: &ScoredModel,
    ) {
        let (before, after) = (&own.left_out[..], &left_out[..]);
        let reduction = self.folds.rms_reduction(before, after);
        let gain = TermGain::new([self.fitted.rms(), fitted.rms()], [before, after], &reduction);
        self.fitted = fitted;
        self.added.retain(|there| self.fitted.model.contains(&there.cause));
        self.by_squares.retain(|cause| self.fitted.model.contains(cause));
        for part in &self.fitted.model.parts {
            if !self.added.iter().any(|there| there.cause == part.kind) {
                self.added.push(AddedTerm { cause: part.kind.clone(), gain, tried: Vec::new() });
            }
        }
    }
}
