//! Blocks that are held out in turn, to see what a term is worth on data that it has not seen.
//!
//! Whole files where there are several, whole runs where there are at least three, else stretches of
//! the record. Where there is no time it is single rows of few, as in a table of readings, and drawn ones of a map of guides:
//! the form of a guide has no law that goes on into a stretch that was never passed, as a screw's has. Where something else
//! changes too, each term is judged by its own inputs: guides by drawn rows, the rest by stretches of what they leave.

use std::{fmt, sync::Arc};

use trueup_numerics::{
    block_resampling::{PairedComparison, RmsReduction, RowBlocks, SEGMENT_COUNT, segment_indices},
    parallel::parallel_map,
    random::RandomGenerator,
};

use crate::{
    fit::{FitProblem, fit},
    model::Model,
    term_kind::{ModelPart, TermKind},
};

/// The fold of each group.
#[derive(Clone, Debug)]
pub(crate) struct Folds {
    of_group: Vec<usize>,
    /// Of a record cut into stretches: the same in stretches of another kind.
    otherwise: Option<(Vec<usize>, usize)>,
    /// Of a map of guides cut into stretches: the fold of each group for the guides.
    for_guides: Option<Vec<usize>>,
    pub count: usize,
    unit: FoldUnit,
    /// Finer blocks, for intervals.
    blocks: RowBlocks,
}

/// The unit that is held out at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FoldUnit {
    Files,
    Runs,
    /// Parts of a record.
    Segments,
    /// Single rows.
    Readings,
}

impl fmt::Display for FoldUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Files => "files",
            Self::Runs => "runs",
            Self::Segments => "stretches",
            Self::Readings => "readings",
        })
    }
}

/// Whole runs that are held out in turn, at least: of two, one would have to show all that the other is judged by.
const MIN_RUN_FOLDS: usize = 3;
/// Stretches of equal length, next to those: one cut through a record may fall well or badly for a term, two of
/// different kinds seldom do alike. One fewer, so that no two cuts coincide where the record changes evenly.
const EQUAL_LENGTH_BLOCK_COUNT: usize = SEGMENT_COUNT - 1;

impl Folds {
    /// Returns the folds; blocks for intervals are at least five correlation times of `memory` steps long.
    pub(crate) fn new(problem: &FitProblem, memory: f64) -> Self {
        Self::with_min_runs(problem, memory, MIN_RUN_FOLDS)
    }

    /// Returns the folds of a promise: two runs differ as two days do, so that each is held out as a whole.
    pub(crate) fn for_prediction(problem: &FitProblem) -> Self {
        Self::with_min_runs(problem, 0.0, 2)
    }

    /// Whole runs are held out where there are at least this many.
    fn with_min_runs(problem: &FitProblem, memory: f64, fewest_runs: usize) -> Self {
        let groups = &problem.groups;
        let count = groups.len();
        let data = &problem.data;
        let runs = run_index_by_group(&groups.first_row, data.run_numbers());
        let run_count = runs.iter().max().map_or(0, |most| most + 1);
        // What comes again to its places at another time is judged as all else is.
        let is_map = data.setting.is_guide_map
            && (data.time_s().is_none() || !data.setting.passed_columns.is_empty());
        let (of_group, count_folds, unit) = if data.setting.files.len() > 1 {
            let file_of = |&row: &usize| data.places.file[row] as usize;
            (
                groups.first_row.iter().map(file_of).collect(),
                data.setting.files.len(),
                FoldUnit::Files,
            )
        } else if run_count >= fewest_runs {
            // Of many runs, several at once.
            let folds = if run_count > 10 { SEGMENT_COUNT } else { run_count };
            let of = |run: usize| run * folds / run_count;
            (runs.into_iter().map(of).collect(), folds, FoldUnit::Runs)
        } else if data.time_s().is_none() && count <= 50 {
            ((0..count).collect(), count, FoldUnit::Readings)
        } else if is_map && !data.setting.has_other_inputs {
            (drawn_block_indices(count), SEGMENT_COUNT, FoldUnit::Readings)
        } else {
            (
                activity_block_indices(&problem.measured, SEGMENT_COUNT),
                SEGMENT_COUNT,
                FoldUnit::Segments,
            )
        };
        let otherwise = (unit == FoldUnit::Segments)
            .then(|| (segment_indices(count, EQUAL_LENGTH_BLOCK_COUNT), EQUAL_LENGTH_BLOCK_COUNT));
        let for_guides = (unit == FoldUnit::Segments && is_map).then(|| drawn_block_indices(count));
        let blocks = RowBlocks::new(count, memory);
        Self { of_group, otherwise, for_guides, count: count_folds, unit, blocks }
    }

    /// Returns whether each group is in the second half: of the files or runs where they are held out, else of the
    /// record.
    pub(crate) fn second_half_mask(&self) -> Vec<bool> {
        let groups = self.of_group.len();
        let is_second = |group: usize| match self.has_record_folds() {
            true => 2 * self.of_group[group] >= self.count,
            false => 2 * group >= groups,
        };
        (0..groups).map(is_second).collect()
    }

    /// Returns whether each fold is a record of its own.
    pub(crate) fn has_record_folds(&self) -> bool {
        matches!(self.unit, FoldUnit::Files | FoldUnit::Runs)
    }

    /// Returns what `model`, fitted to the others, leaves in each group, each fold held out in turn.
    pub(crate) fn held_out_residuals(&self, problem: &FitProblem, model: &Model) -> Vec<f64> {
        let first = self.cross_validation(problem, model, &self.of_group, self.count);
        self.root_mean_square_residuals(problem, model, &first.0)
    }

    /// Returns the squares that are left in each group, on the average of both ways to cut a record; with the sign
    /// of the first.
    fn root_mean_square_residuals(
        &self,
        problem: &FitProblem,
        model: &Model,
        first: &[f64],
    ) -> Vec<f64> {
        let Some((of_group, count)) = &self.otherwise else { return first.to_vec() };
        let second = self.cross_validation(problem, model, of_group, *count);
        let mean = |(a, b): (&f64, &f64)| (0.5 * (a * a + b * b)).sqrt().copysign(*a);
        first.iter().zip(&second.0).map(mean).collect()
    }

    /// Returns what `model` leaves in each group of the first of both ways to cut a record, with its sign; `run`: as it
    /// is run once it is fitted.
    pub(crate) fn signed_fold_residuals(
        &self,
        problem: &FitProblem,
        model: &Model,
        run: impl Fn(&Model) -> Model,
    ) -> Vec<f64> {
        if model.parts.is_empty() {
            return problem.residual(model);
        }
        let left_out = self.cross_validation(problem, model, &self.of_group, self.count);
        let (residual, models) = &*left_out;
        if run(model) == *model {
            return residual.clone();
        }
        let each: Vec<Vec<f64>> =
            models.iter().map(|model| problem.residual(&run(model))).collect();
        self.of_group.iter().enumerate().map(|(group, &fold)| each[fold][group]).collect()
    }

    /// Returns the part of each group, from 0: the folds; of single readings neighbours are put together.
    pub(crate) fn block_index_by_group(&self) -> Vec<usize> {
        let groups = self.of_group.len();
        if self.unit == FoldUnit::Readings {
            return segment_indices(groups, SEGMENT_COUNT.min(groups));
        }
        self.of_group.clone()
    }

    /// Returns the same, with the model that was fitted without each fold.
    pub(crate) fn held_out_residuals_and_models(
        &self,
        problem: &FitProblem,
        model: &Model,
    ) -> (Vec<f64>, Vec<Model>) {
        let first = self.cross_validation(problem, model, &self.of_group, self.count);
        (self.root_mean_square_residuals(problem, model, &first.0), first.1.clone())
    }

    /// Returns what is held out at once to judge a term.
    pub(crate) fn unit_for(&self, kind: &TermKind) -> FoldUnit {
        match self.for_guides {
            Some(_) if kind.depends_on_positions_alone() => FoldUnit::Readings,
            _ => self.unit,
        }
    }

    /// Returns what `model`, fitted to the others, leaves in each group, each fold held out in turn; with the models.
    fn cross_validation(
        &self,
        problem: &FitProblem,
        model: &Model,
        of_group: &[usize],
        count: usize,
    ) -> Arc<(Vec<f64>, Vec<Model>)> {
        let has_guide = model.parts.iter().any(|part| part.kind.depends_on_positions_alone());
        let Some(drawn) = self.for_guides.as_deref().filter(|_| has_guide) else {
            return cached_cross_validation(problem, model, of_group, count);
        };
        let guides = cached_cross_validation(problem, model, drawn, SEGMENT_COUNT);
        let what = format!("{count} folds held out, of guides drawn ones");
        problem.memoise(&what, model, || {
            let held_out = GuidesHeldOut { drawn, models: &guides.1 };
            held_out.cross_validate_rest(problem, model, of_group, count)
        })
    }

    /// Returns what `after` leaves less of the squares than `before` in the last stretch of a record; none where
    /// something else is held out.
    pub(crate) fn gain_in_last_block(&self, before: &[f64], after: &[f64]) -> Option<f64> {
        let rows = self.of_group.iter().zip(before).zip(after);
        let last = rows.filter(|((of, _), _)| **of == self.count - 1);
        let gain = last.map(|((_, b), a)| b * b - a * a).sum();
        (self.unit == FoldUnit::Segments).then_some(gain)
    }

    /// Returns what `after` leaves less of the squares than `before`, both in groups, block by block.
    pub(crate) fn compare_paired(&self, before: &[f64], after: &[f64]) -> PairedComparison {
        self.blocks.compare_paired(before, after)
    }

    /// Returns the reduction of the RMS from `before` to `after`, both in groups.
    pub(crate) fn rms_reduction(&self, before: &[f64], after: &[f64]) -> RmsReduction {
        self.blocks.rms_reduction(before, after)
    }
}

/// Drawn groups: every sixth of a map may be one place of each of its lines.
fn drawn_block_indices(groups: usize) -> Vec<usize> {
    let mut generator = RandomGenerator::new(groups as u64);
    (0..groups).map(|_| generator.uniform_index(SEGMENT_COUNT)).collect()
}

/// A model that was fitted without each of the folds that were drawn for its guides.
struct GuidesHeldOut<'g> {
    drawn: &'g [usize],
    models: &'g [Model],
}

impl GuidesHeldOut<'_> {
    /// Holds out the rest of the model where the guides, each group as predicted without it, are taken away. Returns what is
    /// left in each group, and the models: of each the guides without a drawn fold, and the rest without a fold.
    fn cross_validate_rest(
        &self,
        problem: &FitProblem,
        model: &Model,
        of_group: &[usize],
        count: usize,
    ) -> (Vec<f64>, Vec<Model>) {
        let without_guides = |model: &Model| {
            let mut rest = model.clone();
            rest.parts.retain(|part| !part.kind.depends_on_positions_alone());
            rest
        };
        let of_guides: Vec<Vec<f64>> = self
            .models
            .iter()
            .map(|model| {
                let whole = problem.predict(model).into_iter();
                let rest = problem.predict(&without_guides(model));
                let mut um: Vec<f64> = whole.zip(rest).map(|(whole, rest)| whole - rest).collect();
                // The level of a guide is the zero of the measurement's, where that is free.
                let level =
                    model.constant_um.map_or(0.0, |_| um.iter().sum::<f64>() / um.len() as f64);
                um.iter_mut().for_each(|um| *um -= level);
                um
            })
            .collect();
        let groups = problem.measured.iter().zip(self.drawn).enumerate();
        let measured = groups.map(|(group, (um, &fold))| um - of_guides[fold][group]).collect();
        let (residual, mut models) = cross_validate(
            &problem.with_measured(measured),
            &without_guides(model),
            of_group,
            count,
        );
        for (rest, guides) in models.iter_mut().zip(self.models) {
            let guides = guides.parts.iter().filter(|part| part.kind.depends_on_positions_alone());
            rest.parts.extend(guides.cloned());
            rest.sort_parts();
        }
        (residual, models)
    }
}

/// Stretches of a record that are as long as each other and in which as much happens, half each: of a
/// warm-up all that can be learned is at its beginning, and a stretch of it that held all of that could
/// not be predicted by whatever model. How much happens is taken from the means of ten parts of a stretch, so that noise
/// averages out.
fn activity_block_indices(measured: &[f64], count: usize) -> Vec<usize> {
    let groups = measured.len();
    let parts = segment_indices(groups, (10 * count).min(groups));
    let number = parts.last().map_or(0, |last| last + 1);
    let mut means = vec![[0.0; 2]; number];
    for (value, &part) in measured.iter().zip(&parts) {
        means[part][0] += value;
        means[part][1] += 1.0;
    }
    let mean = |part: usize| means[part][0] / means[part][1];
    let changes: Vec<f64> =
        (0..number).map(|part| (mean(part) - mean(part.saturating_sub(1))).abs()).collect();
    let all: f64 = changes.iter().sum();
    let mut so_far = 0.0;
    (0..groups)
        .map(|group| {
            let (part, length) = (parts[group], means[parts[group]][1]);
            let happened = if all > 0.0 { changes[part] / all } else { 1.0 / number as f64 };
            let middle = so_far + 0.25 * (happened / length + 1.0 / groups as f64);
            so_far += 0.5 * (happened / length + 1.0 / groups as f64);
            ((middle * count as f64) as usize).min(count - 1)
        })
        .collect()
}

/// Returns what `model`, fitted to the others, leaves in each group, each fold held out in turn; with the models.
fn cached_cross_validation(
    problem: &FitProblem,
    model: &Model,
    of_group: &[usize],
    count: usize,
) -> Arc<(Vec<f64>, Vec<Model>)> {
    // This many folds are the same ones in one problem.
    let what = format!("{count} folds held out");
    problem.memoise(&what, model, || cross_validate(problem, model, of_group, count))
}

fn cross_validate(
    problem: &FitProblem,
    model: &Model,
    of_group: &[usize],
    count: usize,
) -> (Vec<f64>, Vec<Model>) {
    let folds: Vec<usize> = (0..count).collect();
    let begun = model
        .find_initial_transient()
        .map(|[start, _]| subtract_initial_transient(problem, model, start));
    let fitted = parallel_map(&folds, problem.is_parallel_worthwhile(), |&fold| {
        let mask: Vec<bool> = of_group.iter().map(|&of| of != fold).collect();
        match &begun {
            Some((problem, model)) if of_group.first() == Some(&fold) => {
                fit(problem, model, Some(&mask))
            }
            _ => fit(problem, model, Some(&mask)),
        }
    });
    let residual =
        (0..of_group.len()).map(|group| fitted[of_group[group]].residual[group]).collect();
    (residual, fitted.into_iter().map(|fitted| fitted.model).collect())
}

/// How far the machine had settled where a record begins cannot be predicted: the stretch with the start is predicted
/// from the `start` that was fitted to the whole. Returns the problem less the effect of `start`, and the rest of the
/// model.
fn subtract_initial_transient(
    problem: &FitProblem,
    model: &Model,
    start: &ModelPart,
) -> (FitProblem, Model) {
    let mut rest = model.clone();
    rest.parts.retain(|part| part != start);
    let [whole, less] = [model, &rest].map(|model| problem.predict(model));
    let measured = problem.measured.iter().zip(whole.iter().zip(&less));
    let measured = measured.map(|(m, (whole, less))| m - (whole - less)).collect();
    (problem.with_measured(measured), rest)
}

/// Returns the runs numbered from 0 in the order in which they come, by group.
fn run_index_by_group(first_row: &[usize], run: Option<&[f64]>) -> Vec<usize> {
    let Some(run) = run else { return Vec::new() };
    let mut known: Vec<u64> = Vec::new();
    first_row
        .iter()
        .map(|&row| {
            let value = run[row].to_bits();
            known.iter().position(|&there| there == value).unwrap_or_else(|| {
                known.push(value);
                known.len() - 1
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stretches_are_equal_where_as_much_happens_all_the_time_and_shorter_where_more_does() {
        let waves: Vec<f64> = (0..600).map(|n| f64::from(n % 20)).collect();
        let even = activity_block_indices(&waves, 6);
        let length = |of: &[usize], n: usize| of.iter().filter(|there| **there == n).count();
        assert!((0..6).all(|n| length(&even, n).abs_diff(100) <= 20), "{even:?}");
        let warming: Vec<f64> = (0..600).map(|n| 1.0 - (-f64::from(n) / 50.0).exp()).collect();
        let cut = activity_block_indices(&warming, 6);
        assert!(cut.is_sorted() && length(&cut, 0) < 40 && length(&cut, 5) > 150, "{cut:?}");
    }
}
