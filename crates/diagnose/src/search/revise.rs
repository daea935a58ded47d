//! What is looked at again once other terms are there: whether a term is still needed, and whether
//! another cause does better in its place.

use crate::{
    candidates::columns_in_use,
    kind::Kind,
    search::{
        criterion::{STRONG_EVIDENCE, bic, degrees},
        extend::Extension,
        state::Search,
    },
};

/// A term leaves if it predicts left-out blocks less than this times better.
const NEEDED: f64 = 1.01;
/// Something that is farther away than a term takes its place if it leaves less than this share.
const CLEARLY_BETTER: f64 = 0.9;

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
                    || self.left_out_um(&places.without) > NEEDED * self.left_out_um(&self.fitted);
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

    /// Whether `other` in a term's place leaves less on left-out blocks: clearly less, where what the
    /// model has already gives way to something that it has not.
    pub(crate) fn predicts_better(&self, cause: &Kind, other: &Extension) -> bool {
        let most = if degrees(&other.fitted.model) < degrees(&self.fitted.model) {
            NEEDED
        } else if other.cause.tier() > cause.tier() {
            CLEARLY_BETTER
        } else {
            1.0
        };
        self.left_out_um(&other.fitted) < most * self.left_out_um(&self.fitted)
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
