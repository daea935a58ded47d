//! Simplification once the search is over: a law in the place of what stands for it, a term that
//! does not gain, the cause that needs the fewest values.

use trueup_machine::{
    effect::{BoardTerm, Effect},
    machine_file::PitchErrorTable,
};

use trueup_numerics::block_resampling::rms;

use crate::{
    fit::{FittedModel, fit},
    model::Model,
    search::{
        extension::{ModelExtension, centred_effect, effects_cancel, fit_single_cause_extensions},
        model_comparison::{
            MAX_EQUIVALENT_RMS_RATIO, STRONG_EVIDENCE_BIC_DIFFERENCE, bic, bic_gap,
            degrees_of_freedom,
        },
        search_state::{AddedTerm, Search},
    },
    term_kind::{ModelPart, TermKind},
};

impl Search<'_> {
    /// All of it, in this order; whether a term was given up, so that others may be worth a try.
    pub(crate) fn simplify_model(&mut self) -> bool {
        let given_up = self.given_up.len();
        self.replace_term_by_lag();
        self.replace_heat_paths_by_difference();
        self.replace_by_bidirectional_table();
        self.replace_table_by_laws();
        self.drop_cancelling_heat_paths();
        self.drop_smoothing_lags();
        self.drop_single_reading_terms();
        self.drop_unneeded_terms();
        self.prefer_simplest_cause();
        self.promote_second_heat_paths();
        self.order_heat_paths_by_size();
        self.given_up.len() > given_up
    }

    /// A path without a lag may need another term to mend what its lag would do. Tries the lag, with
    /// each other term omitted in turn.
    fn replace_term_by_lag(&mut self) {
        if self.problem.data.time_s().is_none() {
            return;
        }
        for index in 0..self.added.len() {
            let cause = self.added[index].cause.clone();
            let is_prompt = cause.heat_path().is_some_and(|path| !path.has_lag);
            let Some(late) = cause.to_separate_heat_path(true).filter(|_| is_prompt) else {
                continue;
            };
            if !self.fitted.model.contains(&cause) {
                continue;
            }
            let Some((other, with)) = self.find_best_lag_substitution(&cause, &late) else {
                continue;
            };
            // As in the choice of a term, what predicts clearly better comes before the BIC.
            if with.bic < self.bic() && self.predicts_better(&cause, &with)
                || MAX_EQUIVALENT_RMS_RATIO * self.held_out_rms_um(&with.fitted)
                    < self.held_out_rms_um(&self.fitted)
            {
                self.replace_term(index, with);
                self.added.retain(|term| term.cause != other);
                return;
            }
        }
    }

    /// Returns the best model with the path `late` for the path `plain` and one other term less: that term,
    /// and the model.
    fn find_best_lag_substitution(
        &self,
        plain: &TermKind,
        late: &TermKind,
    ) -> Option<(TermKind, ModelExtension)> {
        let [low, high] = self.problem.bounds.time_constant_s;
        let mut best: Option<(TermKind, ModelExtension)> = None;
        for other in self.added.iter().map(|term| &term.cause).filter(|other| *other != plain) {
            for tau in [3.0 * low, (low * high).sqrt()] {
                let mut model = self.fitted.model.clone();
                model.parts.retain(|part| part.kind != *other);
                for part in model.parts.iter_mut().filter(|part| part.kind == *plain) {
                    part.kind = late.clone();
                    part.values.insert(0, tau);
                }
                let fitted = fit(self.problem, &model, None);
                let with = ModelExtension::new(self.problem, late.clone(), fitted);
                if best.as_ref().is_none_or(|(_, best)| with.bic < best.bic) {
                    best = Some((other.clone(), with));
                }
            }
        }
        best
    }

    /// A table for one way next to what depends on the direction may stand for one table each way. Tries
    /// that in the place of all of them.
    fn replace_by_bidirectional_table(&mut self) {
        let is_part = |cause: &TermKind| match cause.as_pitch_table() {
            Some(table) => table.reverse_um.is_none(),
            None => cause.cause().is_some_and(Effect::depends_on_direction),
        };
        let tables = self.fitted.model.parts.iter().filter_map(|part| part.kind.as_pitch_table());
        let table = tables.into_iter().find(|table| table.reverse_um.is_none()).and_then(|table| {
            let reverse_um = Some(table.forward_um.clone());
            let own = self.problem.data.setting.quantity.axis();
            TermKind::from_board_term(
                own,
                &BoardTerm::Table(PitchErrorTable { reverse_um, ..table.clone() }),
            )
        });
        let Some(table) = table else { return };
        let mut model = self.fitted.model.clone();
        model.parts.retain(|part| !is_part(&part.kind));
        if model.parts.len() + 1 >= self.fitted.model.parts.len() {
            return;
        }
        model
            .parts
            .push(ModelPart { values: vec![0.0; table.degrees_of_freedom()], kind: table.clone() });
        model.sort_parts();
        let with = ModelExtension::new(self.problem, table, fit(self.problem, &model, None));
        let (there, own) = (self.held_out_rms_um(&with.fitted), self.held_out_rms_um(&self.fitted));
        let is_better = with.bic < self.bic() && there < own;
        if is_better || MAX_EQUIVALENT_RMS_RATIO * there < own {
            let first = self.added.iter().position(|term| is_part(&term.cause)).unwrap_or(0);
            self.replace_term(first, with);
            self.added.retain(|term| !is_part(&term.cause));
        }
    }

    /// A table has room for a scale, a backlash and a wave. Where these alone say as much as it does,
    /// they are the simpler names.
    fn replace_table_by_laws(&mut self) {
        let is_table = |cause: &TermKind| cause.as_pitch_table().is_some();
        let is_additive = |cause: &TermKind| self.added.iter().any(|term| term.cause == *cause);
        let table = self.fitted.model.parts.iter().map(|part| &part.kind);
        let table = table.filter(|cause| is_table(cause)).find(|cause| is_additive(cause)).cloned();
        let Some(table) = table else { return };
        let Some(ReplacementLaws { causes, fitted, bic }) = self.find_best_replacement_laws(&table)
        else {
            return;
        };
        if bic >= self.bic()
            || self.held_out_rms_um(&fitted)
                > MAX_EQUIVALENT_RMS_RATIO * self.held_out_rms_um(&self.fitted)
        {
            return;
        }
        self.fitted = fitted;
        let Some(index) = self.added.iter().position(|term| term.cause == table) else { return };
        let old = self.added.remove(index);
        let new = causes.into_iter().map(|cause| AddedTerm { cause, ..old.clone() });
        self.added.splice(index..index, new);
        // A wave that gave way to another, or came back as it was.
        let mut seen: Vec<TermKind> = Vec::new();
        self.added.retain(|term| {
            let is_new = self.fitted.model.contains(&term.cause) && !seen.contains(&term.cause);
            seen.push(term.cause.clone());
            is_new
        });
    }

    /// Returns the best laws in the place of a table.
    fn find_best_replacement_laws(&self, table: &TermKind) -> Option<ReplacementLaws> {
        let own = self.problem.data.setting.quantity.axis();
        let laws: Vec<TermKind> = [
            BoardTerm::OwnPosition(1.0),
            BoardTerm::Reversed { width_um: 1.0, um_per_m: 0.0 },
            BoardTerm::Reversed { width_um: 0.0, um_per_m: 1.0 },
        ]
        .iter()
        .filter_map(|form| Effect::from_board(own, form, &mut 0.0))
        .map(|law| TermKind::Cause(law.with_values(&[0.0])))
        .collect();
        let is_both_ways = table.as_pitch_table().is_some_and(|table| table.reverse_um.is_some());
        let counts = if is_both_ways { 2..=3 } else { 1..=1 };
        let mut all: Vec<ReplacementLaws> = Vec::new();
        for count in counts {
            let mut model = self.fitted.model.clone();
            model.parts.retain(|part| part.kind != *table);
            let new: Vec<TermKind> =
                laws[..count].iter().filter(|law| !model.contains(law)).cloned().collect();
            model
                .parts
                .extend(new.iter().map(|law| ModelPart { kind: law.clone(), values: vec![0.0] }));
            model.sort_parts();
            let with = fit(self.problem, &model, None);
            let waves = self.fit_single_wave_extensions(&with.model);
            all.extend(waves.into_iter().map(|ModelExtension { cause, fitted, bic }| {
                ReplacementLaws { causes: [&new[..], &[cause]].concat(), fitted, bic }
            }));
            all.push(ReplacementLaws { causes: new, bic: bic(self.problem, &with), fitted: with });
        }
        all.into_iter().min_by(|a, b| a.bic.total_cmp(&b.bic))
    }

    /// `model` with each wave that the data show, without those that it has: what was found next to a
    /// table may be what the table could not follow of another.
    fn fit_single_wave_extensions(&self, model: &Model) -> Vec<ModelExtension> {
        let mut plain = model.clone();
        plain.parts.retain(|part| !part.kind.has_spatial_period());
        let plain = fit(self.problem, &plain, None);
        fit_single_cause_extensions(self.problem, &plain, usize::MAX, TermKind::has_spatial_period)
    }

    /// Two columns that go together, stacked with opposite signs, are their difference and no heat: of such
    /// two paths the one leaves without which less is left.
    fn drop_cancelling_heat_paths(&mut self) {
        while let Some((index, without)) = self.find_cancelling_heat_path() {
            self.given_up.push(self.added[index].cause.clone());
            self.remove_term(index, without);
        }
    }

    /// Returns the path to leave of the first two that take each other back, and the model without it.
    fn find_cancelling_heat_path(&self) -> Option<(usize, FittedModel)> {
        let column = |index: usize| self.added[index].cause.heat_path().map(|path| path.column);
        let effects: Vec<Vec<f64>> = self
            .added
            .iter()
            .map(|term| centred_effect(self.problem, &self.fitted, &term.cause))
            .collect();
        let pairs = (0..effects.len()).flat_map(|b| (0..b).map(move |a| [a, b]));
        let is_stack = |[a, b]: &[usize; 2]| {
            let (one, other) = (column(*a), column(*b));
            one.is_some()
                && other.is_some()
                && one != other
                && effects_cancel(&effects[*a], &effects[*b])
        };
        let pair = pairs.into_iter().find(is_stack)?;
        pair.into_iter()
            .map(|index| (index, self.refit_without(&self.added[index].cause)))
            .min_by(|a, b| a.1.sum.total_cmp(&b.1.sum))
    }

    /// Of two paths of a column the one that does more is the first, whichever was found before.
    fn order_heat_paths_by_size(&mut self) {
        let size = |cause: &TermKind| rms(&centred_effect(self.problem, &self.fitted, cause));
        let second =
            |term: &AddedTerm| term.cause.heat_path().filter(|path| path.is_second).is_some();
        let renamed = self.added.iter().filter(|term| second(term)).find_map(|term| {
            let own_path = term.cause.to_separate_heat_path(true)?;
            let column = term.cause.heat_path()?.column;
            let first = |there: &&AddedTerm| {
                let path = there.cause.heat_path().filter(|path| !path.is_second);
                path.is_some_and(|path| path.column == column && !path.has_lag)
            };
            let first = self.added.iter().find(first)?;
            (size(&term.cause) > size(&first.cause)).then(|| (term.cause.clone(), own_path))
        });
        let Some((second, own_path)) = renamed else { return };
        for part in self.fitted.model.parts.iter_mut().filter(|part| part.kind == second) {
            part.kind = own_path.clone();
        }
        for it in self.added.iter_mut().filter(|term| term.cause == second) {
            it.cause = own_path.clone();
        }
    }

    /// Returns whether `other` predicts held-out blocks as well as a model that leaves `own` there: within the
    /// standard error of the difference, or by a share that does not matter.
    pub(crate) fn predicts_as_well(&self, other: &FittedModel, own: &[f64]) -> bool {
        let there = self.held_out_residuals(other);
        !self.folds.compare_paired(&there, own).is_better()
            || rms(&there) <= MAX_EQUIVALENT_RMS_RATIO * rms(own)
    }

    /// A term that rises from the start on, or jumps once, and gains most of all at one reading is that reading: the
    /// first of a day may be a bad one. Drops the term; the reading is judged as all others are.
    fn drop_single_reading_terms(&mut self) {
        if self.problem.groups.size > 1 {
            return;
        }
        let with = self.held_out_residuals(&self.fitted);
        // A constant in its place is no gain of it.
        let zero = |cause: &TermKind| {
            let mut rest = self.fitted.model.clone();
            rest.parts.retain(|part| part.kind != *cause);
            if !rest.parts.iter().any(|part| part.kind.cause().is_some_and(Effect::is_constant)) {
                rest.constant_um = Some(rest.constant_um.unwrap_or(0.0));
            }
            fit(self.problem, &rest, None)
        };
        let held_up = self.added.iter().position(|term| {
            (term.cause.is_settling_from_start() || term.cause.has_instant())
                && is_single_reading_gain(&self.held_out_residuals(&zero(&term.cause)), &with)
        });
        if let Some(index) = held_up {
            let without = self.refit_without(&self.added[index].cause);
            self.given_up.push(self.added[index].cause.clone());
            self.remove_term(index, without);
        }
    }

    /// Of models that predict held-out blocks equally well the one with the fewest values is the answer:
    /// a term without which no more is left there, beyond the standard error of the difference, leaves.
    /// That which is needed least goes first.
    fn drop_unneeded_terms(&mut self) {
        while !self.added.is_empty() {
            let with = self.held_out_residuals(&self.fitted);
            let least = (0..self.added.len())
                .map(|index| {
                    let without = self.refit_without(&self.added[index].cause);
                    let paired =
                        self.folds.compare_paired(&self.held_out_residuals(&without), &with);
                    (index, without, paired)
                })
                .min_by(|a, b| a.2.gain.total_cmp(&b.2.gain));
            match least {
                Some((index, without, paired)) if !paired.is_better() => {
                    self.given_up.push(self.added[index].cause.clone());
                    self.remove_term(index, without);
                }
                _ => break,
            }
        }
    }

    /// Of causes that predict held-out blocks as well the one that needs the fewest values gives the
    /// name.
    fn prefer_simplest_cause(&mut self) {
        for index in 0..self.added.len() {
            let own = degrees_of_freedom(&self.fitted.model);
            let with = self.held_out_residuals(&self.fitted);
            let simpler = self
                .fit_replacements(&self.added[index].cause, 6)
                .instead
                .into_iter()
                .filter(|extension| degrees_of_freedom(&extension.fitted.model) < own)
                .map(|extension| {
                    (bic_gap(self.problem, &self.fitted, &extension.fitted), extension)
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            // What ended where its search ends has the wrong form; how well it fits here says nothing.
            let cause = &self.added[index].cause;
            let mut parts = self.fitted.model.parts.iter().filter(|part| part.kind == *cause);
            let is_at_the_end = parts.any(|part| self.problem.is_at_bound(part));
            let Some((gap, it)) = simpler else { continue };
            let as_well = || self.predicts_as_well(&it.fitted, &with);
            // What the likelihood prefers clearly need only not predict worse beyond doubt.
            let is_open = || {
                !self
                    .folds
                    .compare_paired(&self.held_out_residuals(&it.fitted), &with)
                    .is_significant()
            };
            if (gap < STRONG_EVIDENCE_BIC_DIFFERENCE || is_at_the_end) && as_well()
                || gap < -STRONG_EVIDENCE_BIC_DIFFERENCE && is_open()
            {
                self.replace_term(index, it);
            }
        }
    }
}

/// Returns whether most of what is gained between `before` and `after`, both in groups, is gained at a single reading.
pub(crate) fn is_single_reading_gain(before: &[f64], after: &[f64]) -> bool {
    let gains = || before.iter().zip(after).map(|(before, after)| before * before - after * after);
    2.0 * gains().fold(0.0, f64::max) > gains().sum::<f64>()
}

/// Laws in the place of a table.
struct ReplacementLaws {
    /// Those that are new.
    causes: Vec<TermKind>,
    fitted: FittedModel,
    bic: f64,
}
