//! Several terms at once: what one term alone cannot show.
//!
//! A search term by term stops where no single term is worth it, and keeps a rich term that took the
//! part of several plain ones. This one floats on from the model in work (sequential floating forward
//! selection: Pudil, Novovičová, Kittler, 1994): it adds the best term whether it is worth it or not,
//! takes away every term that is not needed beside it, and so on; the best model on the way is the
//! answer, if it is clearly better and foresees better. As each term is the best of many that were tried,
//! it pays for that: models are compared by
//!
//! ```text
//! EBIC = BIC + 2·terms·ln(causes that may be tried)          (Chen and Chen, 2008, with γ = 1)
//! ```

use trueup_numerics::{blocks::rms, parallel::on_all_cores};

use crate::{
    candidates::possible,
    fit::{Fitted, fit},
    gain::Gain,
    kind::Kind,
    search::{
        MOST_TERMS,
        criterion::{STRONG_EVIDENCE, bic},
        extend::{Extension, centred_effect, take_back, with_each_cause, without},
        state::{Added, Search},
    },
};

/// Terms that are added without being worth it, before the search turns back: two may hide each other,
/// and a third one both.
const MOST_AHEAD: usize = 3;
/// Several terms at once must be identified: where they were not fitted they leave at most so many times the
/// squares that they leave where they were.
const MOST_LEFT_OUT: f64 = 2.0;
/// Candidates that are fitted for each term.
const MOST_FITTED: usize = 8;

/// A model that is better than the one in work.
struct Better {
    score: f64,
    fitted: Fitted,
    /// What it leaves on left-out blocks, in each group, in µm.
    left_out: Vec<f64>,
}

/// What a model must be better than.
struct Own {
    score: f64,
    left_out: Vec<f64>,
    /// What each term pays for the choice among all causes.
    price: f64,
}

impl Search<'_> {
    /// Floats on from the model in work; whether that has changed it.
    pub(crate) fn float(&mut self) -> bool {
        let mut own =
            Own { score: 0.0, left_out: self.foresight(&self.fitted), price: self.price() };
        own.score = self.score(&self.fitted, &own);
        let better = self.float_from(self.fitted.clone(), &own);
        let Some(Better { fitted, left_out, .. }) = better else { return false };
        self.adopt(fitted, &own.left_out, &left_out);
        true
    }

    /// The best model on the way from `here` that is clearly better than the `own`, and foresees better.
    fn float_from(&self, mut here: Fitted, own: &Own) -> Option<Better> {
        let mut best: Option<Better> = None;
        let mut ahead = 0;
        while ahead < MOST_AHEAD && here.model.parts.len() < MOST_TERMS {
            let Some(there) = self.with_one_more(&here) else { break };
            let there = self.begun_anew(there);
            here = self.without_what_is_not_needed(there, own.price);
            let score = self.score(&here, own);
            let least = best.as_ref().map_or(own.score, |best| best.score);
            let sound = (score < least - STRONG_EVIDENCE).then(|| self.sound(&here, score, own));
            match sound.flatten() {
                Some(better) => (best, ahead) = (Some(better), 0),
                None => ahead += 1,
            }
        }
        best
    }

    /// `fitted`, if no terms of it cancel, it is identified, and it foresees better than the `own` model.
    fn sound(&self, fitted: &Fitted, score: f64, own: &Own) -> Option<Better> {
        if self.has_terms_that_cancel(fitted) {
            return None;
        }
        let left_out = self.foresight(fitted);
        let is_identified = rms(&left_out).powi(2) <= MOST_LEFT_OUT * fitted.rms().powi(2);
        let is_sound = is_identified && self.folds.paired(&own.left_out, &left_out).is_better();
        is_sound.then(|| Better { score, fitted: fitted.clone(), left_out })
    }

    fn score(&self, fitted: &Fitted, own: &Own) -> f64 {
        bic(self.problem, fitted) + own.price * fitted.model.parts.len() as f64
    }

    /// What each term pays for the choice among all causes.
    fn price(&self) -> f64 {
        let fitted = &self.fitted;
        let causes = possible(self.problem, &fitted.model, &fitted.residual);
        2.0 * (causes.len().max(1) as f64).ln()
    }

    /// `base` with the cause of the best BIC, whatever it is. What is looked for at many periods or instants
    /// answers for that where it is alone.
    fn with_one_more(&self, base: &Fitted) -> Option<Extension> {
        let is_open = |cause: &Kind| {
            let is_searched = cause.is_wave() || cause.is_of_instrument() || cause.has_instant();
            cause.tier() < 3 && !is_searched && !cause.is_shift() && !self.given_up.contains(cause)
        };
        Extension::best(with_each_cause(self.problem, base, MOST_FITTED, is_open))
    }

    /// Whether two terms take each other back: rich terms that cancel follow whatever a law leaves.
    fn has_terms_that_cancel(&self, fitted: &Fitted) -> bool {
        let causes = fitted.model.parts.iter().map(|part| &part.kind);
        let effects: Vec<Vec<f64>> =
            causes.map(|cause| centred_effect(self.problem, fitted, cause)).collect();
        let mut pairs = (0..effects.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
        pairs.any(|(a, b)| take_back(&effects[a], &effects[b]))
    }

    /// The same terms, each time constant looked for again beside the others: a fit stays where it began.
    fn begun_anew(&self, new: Extension) -> Extension {
        let Extension { cause, mut fitted, .. } = new;
        let parts: Vec<Kind> = fitted.model.parts.iter().map(|part| part.kind.clone()).collect();
        for kind in parts.iter().filter(|kind| kind.has_time_constant() && **kind != cause) {
            let less = fit(self.problem, &without(self.problem, &fitted.model, kind), None);
            let again = with_each_cause(self.problem, &less, MOST_FITTED, |there| there == kind);
            match Extension::best(again) {
                Some(again) if again.fitted.sum < fitted.sum => fitted = again.fitted,
                _ => {}
            }
        }
        Extension::new(self.problem, cause, fitted)
    }

    /// A model without the terms that cost more than they explain; the one that has just come stays.
    fn without_what_is_not_needed(&self, new: Extension, price: f64) -> Fitted {
        let Extension { cause, mut fitted, mut bic } = new;
        loop {
            let others: Vec<Kind> =
                fitted.model.parts.iter().map(|part| part.kind.clone()).collect();
            let others: Vec<Kind> = others.into_iter().filter(|kind| *kind != cause).collect();
            let less = on_all_cores(&others, self.problem.is_large(), |kind| {
                let model = without(self.problem, &fitted.model, kind);
                Extension::new(self.problem, kind.clone(), fit(self.problem, &model, None))
            });
            match Extension::best(less) {
                Some(less) if less.bic < bic + price => (fitted, bic) = (less.fitted, less.bic),
                _ => return fitted,
            }
        }
    }

    /// Takes `fitted` for the model in work; `before` and `after`: what the two leave on left-out blocks.
    fn adopt(&mut self, fitted: Fitted, before: &[f64], after: &[f64]) {
        let reduction = self.folds.reduction(before, after);
        let gain = Gain::new([self.fitted.rms(), fitted.rms()], [before, after], &reduction);
        self.fitted = fitted;
        self.added.retain(|there| self.fitted.model.has(&there.cause));
        self.by_squares.retain(|cause| self.fitted.model.has(cause));
        for part in &self.fitted.model.parts {
            if !self.added.iter().any(|there| there.cause == part.kind) {
                self.added.push(Added { cause: part.kind.clone(), gain, tried: Vec::new() });
            }
        }
    }
}
