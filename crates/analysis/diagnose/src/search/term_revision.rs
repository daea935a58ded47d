//! Revision of a term once other terms are there: whether it is still needed, and whether
//! another cause, or two of them, do better in its place.

use trueup_numerics::parallel::parallel_map;

use crate::{
    candidates::used_temperature_columns,
    fit::{EQUIVALENCE_TOLERANCE, FittedModel},
    search::{
        extension::{ModelExtension, fit_single_cause_extensions},
        model_comparison::{STRONG_EVIDENCE_BIC_DIFFERENCE, bic, degrees_of_freedom},
        search_state::{AddedTerm, MIN_RELEVANT_RMS_FRACTION, Search},
    },
    term_gain::TermGain,
    term_kind::TermKind,
};

impl Search<'_> {
    /// Tries, for each term, whether it is still needed, and whether another cause does better in its
    /// place now that others are there.
    pub(crate) fn revise_terms(&mut self) {
        for _ in 0..2 {
            let mut has_changed = false;
            for index in (0..self.added.len()).rev() {
                has_changed |= self.revise_term(index);
            }
            if !has_changed {
                break;
            }
        }
        self.promote_second_heat_paths();
    }

    fn revise_term(&mut self, index: usize) -> bool {
        let cause = self.added[index].cause.clone();
        if !self.fitted.model.contains(&cause) {
            return false;
        }
        let places = self.fit_replacements(&cause, 6);
        let own = self.bic();
        let without = bic(self.problem, &places.without);
        match ModelExtension::best_by_bic(places.instead) {
            Some(other) if other.bic <= without => {
                let is_better = other.bic < own - self.required_bic_gain(&cause, &other)
                    && self.predicts_better(&cause, &other);
                if is_better {
                    self.replace_term(index, other);
                }
                is_better
            }
            _ => {
                let is_needed = without > own
                    || self.held_out_rms_um(&places.without)
                        > (1.0 + MIN_RELEVANT_RMS_FRACTION) * self.held_out_rms_um(&self.fitted);
                if !is_needed {
                    self.remove_term(index, places.without);
                }
                !is_needed
            }
        }
    }

    /// By how much the BIC of another cause in a term's place must be better: what needs more values
    /// must be much better, but for a lag on the same column; what needs fewer only as good.
    fn required_bic_gain(&self, cause: &TermKind, other: &ModelExtension) -> f64 {
        let path = |cause: &TermKind| {
            let path = cause.heat_path().filter(|path| !path.is_second)?;
            Some(path.column.to_string())
        };
        let is_same_path = path(cause).is_some() && path(&other.cause) == path(cause);
        let [own, other] =
            [&self.fitted, &other.fitted].map(|fitted| degrees_of_freedom(&fitted.model));
        if other > own && !is_same_path {
            3.0 * STRONG_EVIDENCE_BIC_DIFFERENCE
        } else if other < own {
            0.0
        } else {
            STRONG_EVIDENCE_BIC_DIFFERENCE
        }
    }

    /// Returns whether `other` in a term's place leaves less on held-out blocks: clearly less, where what the
    /// model has already gives way to something that it has not.
    pub(crate) fn predicts_better(&self, cause: &TermKind, other: &ModelExtension) -> bool {
        let most =
            if degrees_of_freedom(&other.fitted.model) < degrees_of_freedom(&self.fitted.model) {
                1.0 + MIN_RELEVANT_RMS_FRACTION
            } else if other.cause.tier() > cause.tier() {
                1.0 - 2.0 * EQUIVALENCE_TOLERANCE
            } else {
                1.0
            };
        self.held_out_rms_um(&other.fitted) < most * self.held_out_rms_um(&self.fitted)
    }

    /// Two terms may do together what the one that is there does nearly as well alone. Tries, in the
    /// place of each term, each good rival together with the best that can then be added; then two constants of the machine's
    /// own model, which come first where the BIC cannot distinguish them from the term. Returns whether it has changed the model.
    pub(crate) fn try_two_step_lookahead(&mut self) -> bool {
        let own = self.bic();
        self.adopt_best_pair(own - STRONG_EVIDENCE_BIC_DIFFERENCE, Self::find_replacement_pairs)
            || self.adopt_best_pair(
                own + STRONG_EVIDENCE_BIC_DIFFERENCE,
                Self::find_own_constant_pairs,
            )
    }

    /// Takes the best of the pairs that `find` gives for the terms, if its BIC is below `most` and it predicts held-out blocks
    /// better. Returns whether it has.
    fn adopt_best_pair(
        &mut self,
        most: f64,
        find: impl Fn(&Self, usize) -> Vec<ReplacementPair> + Sync,
    ) -> bool {
        let terms: Vec<usize> = (0..self.added.len()).collect();
        let pairs = parallel_map(&terms, self.problem.is_parallel_worthwhile(), |&index| {
            find(self, index).into_iter().min_by(|a, b| a.bic.total_cmp(&b.bic))
        });
        let best = pairs.into_iter().flatten().min_by(|a, b| a.bic.total_cmp(&b.bic));
        let Some(pair) = best.filter(|pair| pair.bic < most) else { return false };
        let [before, after] =
            [&self.fitted, &pair.fitted].map(|fitted| self.held_out_rms_um(fitted));
        if after >= before {
            return false;
        }
        let gain = self.added[pair.index].gain;
        let gain = TermGain { left_out_before_um: before, left_out_after_um: after, ..gain };
        self.fitted = pair.fitted;
        let [first, second] = pair.causes;
        self.added[pair.index].cause = first;
        self.added.push(AddedTerm { cause: second, gain, tried: Vec::new() });
        true
    }

    /// Returns pairs in the place of a term: each good rival with what can then be added.
    fn find_replacement_pairs(&self, index: usize) -> Vec<ReplacementPair> {
        // Two of what is farther away are no better than one of what is near.
        let tier = self.added[index].cause.tier();
        let is_near = |extension: &ModelExtension| extension.cause.tier() <= tier;
        let places = self.fit_replacements(&self.added[index].cause, 4);
        let firsts = places.instead.into_iter().filter(is_near);
        firsts
            .flat_map(|first| {
                let seconds = fit_single_cause_extensions(self.problem, &first.fitted, 3, |_| true);
                let seconds = seconds.into_iter().filter(is_near);
                seconds.map(move |second| ReplacementPair::new(index, first.cause.clone(), second))
            })
            .collect()
    }

    /// Returns pairs of constants of the machine's own model in the place of something else, if they need no more values. The
    /// constants of one law may hide each other: heat that ends higher and comes later is two of them.
    fn find_own_constant_pairs(&self, index: usize) -> Vec<ReplacementPair> {
        let cause = &self.added[index].cause;
        if cause.tier() == 0 {
            return Vec::new();
        }
        let fit_own_constants = |base: &FittedModel| {
            fit_single_cause_extensions(self.problem, base, usize::MAX, |kind| kind.tier() == 0)
        };
        let values = degrees_of_freedom(&self.fitted.model);
        let firsts = fit_own_constants(&self.refit_without(cause)).into_iter();
        let pairs = firsts.flat_map(|first| {
            let seconds = fit_own_constants(&first.fitted).into_iter();
            seconds.map(move |second| ReplacementPair::new(index, first.cause.clone(), second))
        });
        pairs.filter(|pair| degrees_of_freedom(&pair.fitted.model) <= values).collect()
    }

    /// A slow path of a column that the model does not go by otherwise is a path, not a second one.
    pub(crate) fn promote_second_heat_paths(&mut self) {
        let used = used_temperature_columns(&self.problem.data, &self.fitted.model);
        for part in &mut self.fitted.model.parts {
            let second = part.kind.heat_path().filter(|path| path.is_second);
            if let Some(second) = second
                && !used.iter().any(|column| column == second.column)
                && let Some(path) = part.kind.to_separate_heat_path(second.has_lag)
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
struct ReplacementPair {
    bic: f64,
    /// The term's number.
    index: usize,
    causes: [TermKind; 2],
    fitted: FittedModel,
}

impl ReplacementPair {
    fn new(index: usize, first: TermKind, second: ModelExtension) -> Self {
        let ModelExtension { cause, fitted, bic } = second;
        Self { bic, index, causes: [first, cause], fitted }
    }
}
