//! Revision of a term once other terms are there: whether it is still needed, and whether
//! another cause, or two of them, do better in its place.

use trueup_numerics::parallel::on_all_cores;

use crate::{
    candidates::columns_in_use,
    fit::Fitted,
    gain::Gain,
    kind::Kind,
    search::{
        criterion::{EQUAL_PREDICTION, STRONG_EVIDENCE, bic, degrees},
        extend::{Extension, with_each_cause},
        state::{Added, RELEVANT, Search},
    },
};

impl Search<'_> {
    /// Tries, for each term, whether it is still needed, and whether another cause does better in its
    /// place now that others are there.
    pub(crate) fn revise(&mut self) {
        for _ in 0..2 {
            let mut has_changed = false;
            for index in (0..self.added.len()).rev() {
                has_changed |= self.revise_term(index);
            }
            if !has_changed {
                break;
            }
        }
        self.name_paths();
    }

    fn revise_term(&mut self, index: usize) -> bool {
        let cause = self.added[index].cause.clone();
        if !self.fitted.model.has(&cause) {
            return false;
        }
        let places = self.replacements(&cause, 6);
        let own = self.bic();
        let without = bic(self.problem, &places.without);
        match Extension::best(places.instead) {
            Some(other) if other.bic <= without => {
                let is_better = other.bic < own - self.margin(&cause, &other)
                    && self.predicts_better(&cause, &other);
                if is_better {
                    self.replace(index, other);
                }
                is_better
            }
            _ => {
                let is_needed = without > own
                    || self.left_out_um(&places.without)
                        > (1.0 + RELEVANT) * self.left_out_um(&self.fitted);
                if !is_needed {
                    self.remove(index, places.without);
                }
                !is_needed
            }
        }
    }

    /// By how much the BIC of another cause in a term's place must be better: what needs more values
    /// must be much better, but for a lag on the same column; what needs fewer only as good.
    fn margin(&self, cause: &Kind, other: &Extension) -> f64 {
        let path = |cause: &Kind| {
            let path = cause.heat_path().filter(|path| !path.is_second)?;
            Some(path.column.to_string())
        };
        let is_same_path = path(cause).is_some() && path(&other.cause) == path(cause);
        let [own, other] = [&self.fitted, &other.fitted].map(|it| degrees(&it.model));
        if other > own && !is_same_path {
            3.0 * STRONG_EVIDENCE
        } else if other < own {
            0.0
        } else {
            STRONG_EVIDENCE
        }
    }

    /// Returns whether `other` in a term's place leaves less on left-out blocks: clearly less, where what the
    /// model has already gives way to something that it has not.
    pub(crate) fn predicts_better(&self, cause: &Kind, other: &Extension) -> bool {
        let most = if degrees(&other.fitted.model) < degrees(&self.fitted.model) {
            1.0 + RELEVANT
        } else if other.cause.tier() > cause.tier() {
            1.0 - 2.0 * (EQUAL_PREDICTION - 1.0)
        } else {
            1.0
        };
        self.left_out_um(&other.fitted) < most * self.left_out_um(&self.fitted)
    }

    /// Two terms may do together what the one that is there does nearly as well alone. Tries, in the
    /// place of each term, each good rival together with the best that can then be added; whether it
    /// has changed the model.
    pub(crate) fn look_two_ahead(&mut self) -> bool {
        let own = self.bic();
        let terms: Vec<usize> = (0..self.added.len()).collect();
        let pairs = on_all_cores(&terms, self.problem.is_large(), |&index| {
            self.pair_in_place(index, own - STRONG_EVIDENCE)
        });
        let best = pairs.into_iter().flatten().min_by(|a, b| a.bic.total_cmp(&b.bic));
        let Some(pair) = best else { return false };
        let [before, after] = [&self.fitted, &pair.fitted].map(|it| self.left_out_um(it));
        if after >= before {
            return false;
        }
        let gain = self.added[pair.index].gain;
        let gain = Gain { left_out_before_um: before, left_out_after_um: after, ..gain };
        self.fitted = pair.fitted;
        let [first, second] = pair.causes;
        self.added[pair.index].cause = first;
        self.added.push(Added { cause: second, gain, tried: Vec::new() });
        true
    }

    /// Returns the best pair in the place of a term with a BIC below `most`.
    fn pair_in_place(&self, index: usize, most: f64) -> Option<Pair> {
        // Two of what is farther away are no better than one of what is near.
        let tier = self.added[index].cause.tier();
        let is_near = |it: &Extension| it.cause.tier() <= tier;
        let mut best: Option<Pair> = None;
        let places = self.replacements(&self.added[index].cause, 4);
        for first in places.instead.into_iter().filter(is_near) {
            let pairs = with_each_cause(self.problem, &first.fitted, 3, |_| true);
            for second in pairs.into_iter().filter(is_near) {
                let Extension { cause, fitted, bic } = second;
                if bic < best.as_ref().map_or(most, |best| best.bic) {
                    best = Some(Pair { bic, index, causes: [first.cause.clone(), cause], fitted });
                }
            }
        }
        best
    }

    /// A slow path of a column that the model does not go by otherwise is a path, not a second one.
    pub(crate) fn name_paths(&mut self) {
        let used = columns_in_use(&self.problem.data, &self.fitted.model);
        for part in &mut self.fitted.model.parts {
            let second = part.kind.heat_path().filter(|path| path.is_second);
            if let Some(second) = second
                && !used.iter().any(|column| column == second.column)
                && let Some(path) = part.kind.as_own_path(second.has_lag)
            {
                for there in self.added.iter_mut().filter(|there| there.cause == part.kind) {
                    there.cause = path.clone();
                }
                part.kind = path;
            }
        }
    }
}

/// Two causes in the place of one term.
struct Pair {
    bic: f64,
    /// The term's number.
    index: usize,
    causes: [Kind; 2],
    fitted: Fitted,
}
