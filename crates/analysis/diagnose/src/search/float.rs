//! Several terms at once: what one term alone cannot show.
//!
//! A search term by term stops where no single term is worth it, and keeps a rich term that took the
//! part of several plain ones. This one floats on from the model in work (sequential floating forward
//! selection: Pudil, Novovičová, Kittler, 1994): it adds the best term whether it is worth it or not,
//! takes away every term that is not needed next to it, and so on; the best model on the way is the
//! answer, if it is clearly better and foresees better, or as good with no more values
//! and foresees better beyond doubt. As each term is the best of many that were tried,
//! it pays for that: models are compared by
//!
//! ```text
//! EBIC = BIC + 2·terms·ln(causes that may be tried)          (Chen and Chen, 2008, with γ = 1)
//! ```

use trueup_numerics::{blocks::rms, noise::Noise, parallel::on_all_cores};

use crate::{
    candidates::possible,
    fit::{Fitted, fit},
    gain::Gain,
    kind::Kind,
    model::Model,
    search::{
        MAX_TERMS,
        criterion::{CHOICE, STRONG_EVIDENCE, bic, degrees, noise_of},
        extend::{Extension, centred_effect, take_back, with_each_cause, without},
        state::{Added, Search},
    },
};

/// Terms that are added without being worth it, before the search turns back: two may hide each other,
/// and a third one both.
const MAX_AHEAD: usize = 3;
/// Several terms at once must be identified: where they were not fitted they leave at most this many times the
/// squares that they leave where they were.
const MAX_LEFT_OUT: f64 = 2.0;
/// Candidates that are fitted for each term.
const MAX_FITTED: usize = 8;

/// By what a step is taken. Whether the way was worth it, is always asked of the likelihood and of what is
/// foreseen.
#[derive(Clone, Copy)]
enum Yardstick {
    /// BIC, the memory of the noise estimated.
    Likelihood,
    /// The same as if the noise had no memory: as long as several slow laws are missing, the likelihood takes them
    /// for slow noise, and one of them alone for nothing.
    Squares,
}

impl Yardstick {
    fn of(self, Extension { fitted, bic, .. }: &Extension) -> f64 {
        match self {
            Self::Likelihood => *bic,
            Self::Squares => {
                let rows = fitted.residual.len() as f64;
                rows * fitted.sum.max(f64::MIN_POSITIVE).ln()
                    + degrees(&fitted.model) as f64 * rows.ln()
            }
        }
    }
}

/// How a float goes on.
#[derive(Clone, Copy)]
struct Way {
    by: Yardstick,
    /// Whether it may add lists: curves and tables.
    with_lists: bool,
    /// The price of each term for the choice among all causes.
    price: f64,
}

/// A model and what it is worth.
struct Assessed {
    fitted: Fitted,
    score: f64,
    /// Its residual on left-out blocks, in each group, in µm.
    left_out: Vec<f64>,
}

impl Search<'_> {
    /// Floats on from the model in work; whether that has changed it.
    pub(crate) fn float(&mut self) -> bool {
        let price = self.price();
        let own = self.assessed(self.fitted.clone(), price);
        // A list has room for much that is none of it, and nothing else is needed next to it.
        let mut plain = own.fitted.model.clone();
        plain.parts.retain(|part| part.kind.list_length().is_none());
        let has_list = plain.parts.len() < own.fitted.model.parts.len();
        let plain = has_list.then(|| fit(self.problem, &plain, None));
        let noise = noise_of(self.problem, &own.fitted.residual, degrees(&own.fitted.model));
        let by_squares = (noise != Noise::WHITE).then_some(Yardstick::Squares);
        let found =
            [Some(Yardstick::Likelihood), by_squares].into_iter().flatten().find_map(|by| {
                let way = |with_lists| Way { by, with_lists, price };
                self.floated(&own.fitted, &own, way(true))
                    .or_else(|| self.floated(plain.as_ref()?, &own, way(false)))
            });
        let Some(found) = found else { return false };
        self.adopt(found, &own);
        true
    }

    /// Takes plain terms, waves too, in the place of all lists and waves, if they are better together: a list of many
    /// values has followed several of them at once before one of them alone was worth as much, and a wave next to
    /// it is what it could not follow. Whether that has changed the model.
    pub(crate) fn plain_in_place_of_lists(&mut self) -> bool {
        let is_list = |kind: &Kind| kind.list_length().is_some();
        let mut plain = self.fitted.model.clone();
        plain.parts.retain(|part| !is_list(&part.kind));
        if plain.parts.len() == self.fitted.model.parts.len() {
            return false;
        }
        plain.parts.retain(|part| !part.kind.is_wave() && !part.kind.is_of_instrument());
        let price = self.price();
        let is_plain = |kind: &Kind| {
            let is_once = kind.has_instant() || kind.is_of_instrument() || kind.is_shift();
            kind.tier() < 3 && !is_once && !is_list(kind)
        };
        let mut here = fit(self.problem, &plain, None);
        for _ in 0..MAX_AHEAD {
            let all = with_each_cause(self.problem, &here, MAX_FITTED, is_plain);
            let Some(best) = Extension::best(all) else { break };
            if best.bic + price >= bic(self.problem, &here) {
                break;
            }
            here = best.fitted;
        }
        let own = self.assessed(self.fitted.clone(), price);
        if self.score(&here, price) > own.score - STRONG_EVIDENCE {
            return false;
        }
        let here = self.assessed(here, price);
        let is_better = self.is_better(&here, &own);
        if is_better {
            self.adopt(here, &own);
        }
        is_better
    }

    /// Takes `known` for the model in work if it is better by the same measure; whether it is.
    pub(crate) fn recall(&mut self, known: &Model) -> bool {
        let price = self.price();
        let own = self.assessed(self.fitted.clone(), price);
        let known = self.assessed(fit(self.problem, known, None), price);
        let is_better = self.is_better(&known, &own);
        if is_better {
            self.adopt(known, &own);
        }
        is_better
    }

    /// Returns the best model on a way from `start` that is better than the `own`.
    fn floated(&self, start: &Fitted, own: &Assessed, way: Way) -> Option<Assessed> {
        let mut here = start.clone();
        let mut best: Option<Assessed> = None;
        let mut ahead = 0;
        while ahead < MAX_AHEAD && here.model.parts.len() < MAX_TERMS {
            let Some(there) = self.with_one_more(&here, way) else { break };
            let there = self.begun_anew(there);
            here = self.without_what_is_not_needed(there, way);
            let before = best.as_ref().unwrap_or(own);
            // What scores worse is not worth being left out in turn.
            let is_near = self.score(&here, way.price) < before.score + STRONG_EVIDENCE;
            let there = is_near.then(|| self.assessed(here.clone(), way.price));
            match there.filter(|there| self.is_better(there, before)) {
                Some(better) => (best, ahead) = (Some(better), 0),
                None => ahead += 1,
            }
        }
        best
    }

    fn score(&self, fitted: &Fitted, price: f64) -> f64 {
        bic(self.problem, fitted) + price * fitted.model.parts.len() as f64
    }

    fn assessed(&self, fitted: Fitted, price: f64) -> Assessed {
        let (score, left_out) = (self.score(&fitted, price), self.foresight(&fitted));
        Assessed { fitted, score, left_out }
    }

    /// Returns whether one model is clearly better than another one and foresees better; or as good with no more
    /// values, and foresees better beyond doubt. No terms of it may cancel, and it must be identified.
    fn is_better(&self, one: &Assessed, other: &Assessed) -> bool {
        let gap = other.score - one.score;
        let paired = self.folds.paired(&other.left_out, &one.left_out);
        let [own, others] = [one, other].map(|it| degrees(&it.fitted.model));
        let is_better = if gap >= STRONG_EVIDENCE {
            let fewer = own < others;
            paired.is_better() || fewer && self.predicts_as_well(&one.fitted, &other.left_out)
        } else {
            gap > -STRONG_EVIDENCE && own <= others && paired.is_certain()
        };
        let is_identified = rms(&one.left_out).powi(2) <= MAX_LEFT_OUT * one.fitted.rms().powi(2);
        is_better && is_identified && !self.has_terms_that_cancel(&one.fitted)
    }

    /// Returns what each term pays for the choice among all causes.
    fn price(&self) -> f64 {
        let fitted = &self.fitted;
        let causes = possible(self.problem, &fitted.model, &fitted.residual);
        CHOICE * (causes.len().max(1) as f64).ln()
    }

    /// `base` with the cause of the best BIC, whatever it is. Causes that are looked for at many periods or instants
    /// answer for that where they are alone.
    fn with_one_more(&self, base: &Fitted, way: Way) -> Option<Extension> {
        let is_open = |cause: &Kind| {
            let is_searched = cause.is_wave() || cause.is_of_instrument() || cause.has_instant();
            let is_admitted = way.with_lists || cause.list_length().is_none();
            cause.tier() < 3 && !is_searched && !cause.is_shift() && is_admitted
        };
        let all = with_each_cause(self.problem, base, MAX_FITTED, is_open);
        let all = all.into_iter().map(|it| self.with_its_start(it, way.price));
        all.min_by(|a, b| way.by.of(a).total_cmp(&way.by.of(b)))
    }

    /// Returns a model with a new lagged law from wherever that stood when the record began, if that is worth a term.
    fn with_its_start(&self, new: Extension, price: f64) -> Extension {
        let model = &new.fitted.model;
        let is_late = new.cause.has_time_constant() && !new.cause.is_from_the_start();
        if !is_late || model.parts.iter().any(|part| part.kind.is_from_the_start()) {
            return new;
        }
        let with_start = with_each_cause(self.problem, &new.fitted, 1, Kind::is_from_the_start)
            .into_iter()
            .next();
        match with_start {
            Some(with)
                if with.bic + price < new.bic && with.fitted.model.unsettled_start().is_some() =>
            {
                Extension { cause: new.cause, ..with }
            }
            _ => new,
        }
    }

    /// Returns whether two terms take each other back: rich terms that cancel follow whatever a law leaves.
    fn has_terms_that_cancel(&self, fitted: &Fitted) -> bool {
        let causes = fitted.model.parts.iter().map(|part| &part.kind);
        let effects: Vec<Vec<f64>> =
            causes.map(|cause| centred_effect(self.problem, fitted, cause)).collect();
        let mut pairs = (0..effects.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
        pairs.any(|(a, b)| take_back(&effects[a], &effects[b]))
    }

    /// Returns the same terms, each time constant looked for again next to the others: a fit stays where it began.
    fn begun_anew(&self, new: Extension) -> Extension {
        let Extension { cause, mut fitted, .. } = new;
        let parts: Vec<Kind> = fitted.model.parts.iter().map(|part| part.kind.clone()).collect();
        for kind in parts.iter().filter(|kind| kind.has_time_constant() && **kind != cause) {
            let less = fit(self.problem, &without(self.problem, &fitted.model, kind), None);
            let again = with_each_cause(self.problem, &less, MAX_FITTED, |there| there == kind);
            match Extension::best(again) {
                Some(again) if again.fitted.sum < fitted.sum => fitted = again.fitted,
                _ => {}
            }
        }
        Extension::new(self.problem, cause, fitted)
    }

    /// Returns a model without the terms that cost more than they explain; the one that has just come stays.
    fn without_what_is_not_needed(&self, new: Extension, way: Way) -> Fitted {
        let mut here = new;
        loop {
            let others = here.fitted.model.parts.iter().map(|part| part.kind.clone());
            let others: Vec<Kind> = others.filter(|kind| *kind != here.cause).collect();
            let less = on_all_cores(&others, self.problem.is_large(), |kind| {
                let model = without(self.problem, &here.fitted.model, kind);
                Extension::new(self.problem, here.cause.clone(), fit(self.problem, &model, None))
            });
            match less.into_iter().min_by(|a, b| way.by.of(a).total_cmp(&way.by.of(b))) {
                Some(less) if way.by.of(&less) < way.by.of(&here) + way.price => here = less,
                _ => return here.fitted,
            }
        }
    }

    /// Takes a better model for the `own`.
    fn adopt(&mut self, Assessed { fitted, left_out, .. }: Assessed, own: &Assessed) {
        let (before, after) = (&own.left_out[..], &left_out[..]);
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
