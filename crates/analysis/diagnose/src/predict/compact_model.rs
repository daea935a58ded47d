//! The few terms that predict what the mean of many searches does.
//!
//! Candidates are the terms of all subsamples. A set is worth what it leaves of the blocks that each subsample has not
//! seen, fitted to those that it has; terms are added, and exchanged, as long as that falls, and the smallest set
//! within one standard error of the best is taken. It is fitted half to what was measured and half to the mean.

use nalgebra::{DMatrix, DVector};
use trueup_numerics::{parallel::parallel_map, repeats::DETERMINACY_THRESHOLD};

use crate::{fit::EQUIVALENCE_TOLERANCE, model::Model, predict::dictionary::TermDictionary};

/// Most terms: what the board has room for next to those of the file.
pub(super) const MAX_COMPACT_MODEL_TERMS: usize = 8;
/// A term does at most this many times what was measured: of two terms of which each explains all and the other takes it
/// back, each is larger.
pub(crate) const MAX_EFFECT_RATIO: f64 = 2.0;
/// Most candidates: those that the most subsamples have.
const MAX_CANDIDATES: usize = 60;
/// The weight of the mean against what was measured.
const ENSEMBLE_MEAN_WEIGHT: f64 = 0.5;

/// A fitted set of terms.
#[derive(Clone, Debug, Default)]
pub(super) struct CompactModel {
    pub terms: Vec<usize>,
    /// Of each column of each term, in its unit.
    pub amplitudes: Vec<f64>,
    pub constant_um: f64,
}

/// A subsample: the groups in it and outside, and what was found in it.
pub(super) struct Subsample {
    pub inside: Vec<usize>,
    pub outside: Vec<usize>,
    pub fitted: CompactModel,
}

impl CompactModel {
    /// Returns it as a model.
    pub(super) fn to_model(&self, dictionary: &TermDictionary, base: Model) -> Model {
        let mut model = Model { parts: Vec::new(), ..base };
        let mut next = self.amplitudes.iter();
        for &entry in &self.terms {
            let mut part = dictionary.entries[entry].part.clone();
            let first = part.kind.nonlinear_parameters().len();
            part.values[first..].iter_mut().zip(&mut next).for_each(|(value, a)| *value = *a);
            model.parts.push(part);
        }
        model.constant_um = Some(self.constant_um);
        model.sort_parts();
        model
    }

    /// Returns what it adds to a group.
    pub(super) fn predict_group(&self, dictionary: &TermDictionary, row: usize) -> f64 {
        let columns = self.terms.iter().flat_map(|&term| dictionary.entries[term].columns.clone());
        let sum: f64 = columns
            .zip(&self.amplitudes)
            .map(|(column, a)| a * dictionary.columns[column][row])
            .sum();
        self.constant_um + sum
    }

    /// Returns what it leaves of these groups.
    pub(super) fn residuals(
        &self,
        dictionary: &TermDictionary,
        y: &[f64],
        rows: &[usize],
    ) -> Vec<f64> {
        rows.iter().map(|&row| y[row] - self.predict_group(dictionary, row)).collect()
    }
}

/// Returns the fit of `terms` to these groups.
pub(super) fn fit_terms(
    dictionary: &TermDictionary,
    y: &[f64],
    rows: &[usize],
    terms: &[usize],
) -> CompactModel {
    let target: Vec<f64> = rows.iter().map(|&row| y[row]).collect();
    fit_ridge(dictionary, &target, rows, terms, DETERMINACY_THRESHOLD)
}

fn fit_ridge(
    dictionary: &TermDictionary,
    target: &[f64],
    rows: &[usize],
    terms: &[usize],
    ridge: f64,
) -> CompactModel {
    let has_constant = dictionary.has_constant(terms);
    let columns: Vec<usize> =
        terms.iter().flat_map(|&term| dictionary.entries[term].columns.clone()).collect();
    if columns.is_empty() {
        return CompactModel::default();
    }
    let moments = SecondMoments::new(dictionary, target, rows, &columns, has_constant);
    let all: Vec<usize> = (0..columns.len()).collect();
    let most = MAX_EFFECT_RATIO * max_abs(target.iter().map(|um| um - moments.mean_y));
    // Terms that take each other back are held until none does more than a machine can.
    let is_possible = |amplitudes: &DVector<f64>| {
        columns.iter().zip(amplitudes.iter()).zip(&moments.mean).all(|((&column, a), mean)| {
            max_abs(rows.iter().map(|&row| a * (dictionary.columns[column][row] - mean))) <= most
        })
    };
    let ridges = std::iter::successors(Some(ridge), |ridge| Some(10.0 * ridge));
    let ridges = ridges.take_while(|ridge| ridge.is_finite());
    let mut solutions = ridges.map(|ridge| moments.solve_ridge(&all, ridge));
    let Some(amplitudes) = solutions.find(is_possible) else { return CompactModel::default() };
    let of_mean: f64 = amplitudes.iter().zip(&moments.mean).map(|(a, mean)| a * mean).sum();
    let constant_um = if has_constant { moments.mean_y - of_mean } else { 0.0 };
    CompactModel {
        terms: terms.to_vec(),
        amplitudes: amplitudes.iter().copied().collect(),
        constant_um,
    }
}

fn max_abs(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0_f64, |most, value| most.max(value.abs()))
}

/// Second moments of columns and of a target over some groups.
struct SecondMoments {
    gram: DMatrix<f64>,
    with_y: DVector<f64>,
    yy: f64,
    /// Standard deviations of the columns.
    size: Vec<f64>,
    mean: Vec<f64>,
    mean_y: f64,
    rows: f64,
}

impl SecondMoments {
    fn new(
        dictionary: &TermDictionary,
        target: &[f64],
        rows: &[usize],
        columns: &[usize],
        is_centred: bool,
    ) -> Self {
        let of = |column: usize| rows.iter().map(|&row| dictionary.columns[column][row]).collect();
        let values: Vec<Vec<f64>> = columns.iter().map(|&column| of(column)).collect();
        let mean_of = |values: &[f64]| {
            if is_centred { values.iter().sum::<f64>() / values.len() as f64 } else { 0.0 }
        };
        let mean: Vec<f64> = values.iter().map(|values| mean_of(values)).collect();
        let mean_y = mean_of(target);
        Self::centred_at(&values, target, &mean, mean_y)
    }

    fn centred_at(values: &[Vec<f64>], target: &[f64], mean: &[f64], mean_y: f64) -> Self {
        let rows = target.len();
        let matrix =
            DMatrix::from_fn(rows, values.len(), |row, column| values[column][row] - mean[column]);
        let y = DVector::from_iterator(rows, target.iter().map(|y| y - mean_y));
        let gram = matrix.tr_mul(&matrix);
        let size = gram.diagonal().iter().map(|square| (square / rows as f64).sqrt()).collect();
        Self {
            with_y: matrix.tr_mul(&y),
            yy: y.dot(&y),
            gram,
            size,
            mean: mean.to_vec(),
            mean_y,
            rows: rows as f64,
        }
    }

    /// Returns the amplitudes of these columns, held back by a ridge on columns of unit variance.
    fn solve_ridge(&self, columns: &[usize], ridge: f64) -> DVector<f64> {
        let penalty =
            |column: usize| ridge * self.rows * self.size[column].powi(2) + f64::MIN_POSITIVE;
        let gram = DMatrix::from_fn(columns.len(), columns.len(), |row, column| {
            let own = if row == column { penalty(columns[row]) } else { 0.0 };
            self.gram[(columns[row], columns[column])] + own
        });
        let with_y = DVector::from_iterator(columns.len(), columns.iter().map(|&n| self.with_y[n]));
        gram.cholesky()
            .map_or_else(|| DVector::zeros(columns.len()), |factor| factor.solve(&with_y))
    }

    /// Returns the squares that amplitudes of these columns leave.
    fn residual_sum_of_squares(&self, columns: &[usize], amplitudes: &DVector<f64>) -> f64 {
        let mut left = self.yy;
        for (n, &column) in columns.iter().enumerate() {
            left -= 2.0 * amplitudes[n] * self.with_y[column];
            for (m, &other) in columns.iter().enumerate() {
                left += amplitudes[n] * amplitudes[m] * self.gram[(column, other)];
            }
        }
        left
    }
}

/// The moments of a subsample that are needed to judge a set.
struct SubsampleMoments {
    inside: SecondMoments,
    outside: SecondMoments,
}

/// Sets of candidates and what they leave.
struct SubsetSearch<'s> {
    dictionary: &'s TermDictionary,
    candidates: Vec<usize>,
    /// Columns of each candidate among those of all candidates.
    columns: Vec<Vec<usize>>,
    judges: Vec<SubsampleMoments>,
}

impl SubsetSearch<'_> {
    /// Returns what a set leaves of the outside of each subsample.
    fn held_out_squares_by_subsample(&self, set: &[usize]) -> Vec<f64> {
        let columns: Vec<usize> = set.iter().flat_map(|&n| self.columns[n].clone()).collect();
        let of = |judge: &SubsampleMoments| {
            // On columns of unit variance: a ridge takes that share of an effect back, and such effects are still equal.
            // Less ties a set too closely to its subsample, more forgets it.
            let amplitudes = judge.inside.solve_ridge(&columns, EQUIVALENCE_TOLERANCE);
            judge.outside.residual_sum_of_squares(&columns, &amplitudes)
        };
        self.judges.iter().map(of).collect()
    }

    fn held_out_sum_of_squares(&self, set: &[usize]) -> f64 {
        self.held_out_squares_by_subsample(set).iter().sum()
    }

    /// Returns the candidates that may join a set: one setting of a kind.
    fn addable_candidates(&self, set: &[usize]) -> Vec<usize> {
        let kind = |n: usize| self.dictionary.entries[self.candidates[n]].kind;
        let is_open = |n: &usize| set.iter().all(|there| kind(*there) != kind(*n));
        (0..self.candidates.len()).filter(is_open).collect()
    }

    /// Returns the best set with one candidate more, and what it leaves.
    fn find_best_addition(&self, set: &[usize], is_large: bool) -> Option<(Vec<usize>, f64)> {
        let with = |n: &usize| {
            let joined = [set, &[*n]].concat();
            let sum = self.held_out_sum_of_squares(&joined);
            (joined, sum)
        };
        let all = parallel_map(&self.addable_candidates(set), is_large, with);
        all.into_iter().min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Returns the best set of each size, as far as it falls.
    fn find_best_subsets(&self, is_large: bool) -> Vec<Vec<usize>> {
        let mut path: Vec<Vec<usize>> = Vec::new();
        let (mut set, mut least) = (Vec::new(), f64::INFINITY);
        while path.len() < MAX_COMPACT_MODEL_TERMS {
            let Some((joined, sum)) = self.find_best_addition(&set, is_large) else { break };
            let (exchanged, sum) = self.exchange_terms(joined, sum, is_large);
            if sum >= least {
                break;
            }
            (set, least) = (exchanged, sum);
            path.push(set.clone());
        }
        path
    }

    fn exchange_terms(
        &self,
        mut set: Vec<usize>,
        mut sum: f64,
        is_large: bool,
    ) -> (Vec<usize>, f64) {
        for number in (0..set.len()).rev().skip(1) {
            let mut rest = set.clone();
            rest.remove(number);
            if let Some((other, less)) = self.find_best_addition(&rest, is_large)
                && less < sum
            {
                (set, sum) = (other, less);
            }
        }
        (set, sum)
    }

    /// Returns the smallest set of a path within one standard error of the best.
    fn smallest_subset_within_one_se(&self, path: &[Vec<usize>]) -> Vec<usize> {
        let left: Vec<Vec<f64>> =
            path.iter().map(|set| self.held_out_squares_by_subsample(set)).collect();
        let Some(best) = left.last() else { return Vec::new() };
        let is_as_good = |left: &Vec<f64>| {
            let count = left.len() as f64;
            let apart: Vec<f64> = left.iter().zip(best).map(|(l, b)| l - b).collect();
            let mean = apart.iter().sum::<f64>() / count;
            let variance = apart.iter().map(|a| (a - mean).powi(2)).sum::<f64>() / (count - 1.0);
            // Every block is outside several subsamples: those that share none are as many as fit into a whole.
            let independent = count.min(1.0 / (1.0 - super::SUBSAMPLE_BLOCK_FRACTION));
            mean <= (variance / independent).sqrt()
        };
        let number = left.iter().position(is_as_good).unwrap_or(path.len() - 1);
        path[number].clone()
    }
}

/// Returns the compact set of what the subsamples found, fitted to `rows`.
pub(super) fn select_compact_model(
    dictionary: &TermDictionary,
    y: &[f64],
    rows: &[usize],
    samples: &[Subsample],
    is_large: bool,
) -> CompactModel {
    let candidates = rank_candidates(samples);
    let mut next = 0;
    let columns: Vec<Vec<usize>> = candidates
        .iter()
        .map(|&entry| {
            let first = next;
            next += dictionary.entries[entry].columns.len();
            (first..next).collect()
        })
        .collect();
    let of_all: Vec<usize> =
        candidates.iter().flat_map(|&entry| dictionary.entries[entry].columns.clone()).collect();
    let judges = parallel_map(samples, is_large, |sample| {
        let target = |rows: &[usize]| -> Vec<f64> { rows.iter().map(|&row| y[row]).collect() };
        let has_constant = dictionary.has_constant(&candidates);
        let inside = SecondMoments::new(
            dictionary,
            &target(&sample.inside),
            &sample.inside,
            &of_all,
            has_constant,
        );
        let values: Vec<Vec<f64>> = of_all
            .iter()
            .map(|&n| sample.outside.iter().map(|&row| dictionary.columns[n][row]).collect())
            .collect();
        let outside = SecondMoments::centred_at(
            &values,
            &target(&sample.outside),
            &inside.mean,
            inside.mean_y,
        );
        SubsampleMoments { inside, outside }
    });
    let sets = SubsetSearch { dictionary, candidates, columns, judges };
    let set = sets.smallest_subset_within_one_se(&sets.find_best_subsets(is_large));
    let terms: Vec<usize> = set.iter().map(|&n| sets.candidates[n]).collect();
    let target: Vec<f64> = rows
        .iter()
        .map(|&row| {
            let mean = samples
                .iter()
                .map(|sample| sample.fitted.predict_group(dictionary, row))
                .sum::<f64>()
                / samples.len() as f64;
            (1.0 - ENSEMBLE_MEAN_WEIGHT) * y[row] + ENSEMBLE_MEAN_WEIGHT * mean
        })
        .collect();
    fit_ridge(dictionary, &target, rows, &terms, DETERMINACY_THRESHOLD)
}

/// Returns the terms of the subsamples, those that come back most often first.
fn rank_candidates(samples: &[Subsample]) -> Vec<usize> {
    let mut counted: Vec<(usize, usize)> = Vec::new();
    for &term in samples.iter().flat_map(|sample| &sample.fitted.terms) {
        match counted.iter_mut().find(|(there, _)| *there == term) {
            Some((_, count)) => *count += 1,
            None => counted.push((term, 1)),
        }
    }
    counted.sort_by_key(|&(term, count)| (std::cmp::Reverse(count), term));
    counted.into_iter().map(|(term, _)| term).take(MAX_CANDIDATES).collect()
}
