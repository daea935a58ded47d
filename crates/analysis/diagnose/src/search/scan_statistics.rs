//! T and U of the scan: what columns take away from what a model leaves, for each noise.

use nalgebra::{DMatrix, DMatrixView};
use trueup_numerics::{
    least_squares::normal_equations::{cholesky, dot, forward_substitute, orthonormalise},
    noise::{NoiseModel, Whitener},
    parallel::parallel_map,
};

use crate::fit::FitProblem;

/// Columns of one trial's matrix at a time, so that they stay in the cache.
const COLUMNS_PER_CHUNK: usize = 16;
/// Values of all trials' columns below which threads cost more than they bring.
const MIN_PARALLEL_VALUES: usize = 50_000;

/// Rows up to which a product of matrices is quicker row by row: for more there is a routine in blocks.
const MAX_NAIVE_PRODUCT_ROWS: usize = 5;

/// A candidate at one setting, in columns.
pub(crate) struct CandidateTrial {
    /// Its number among the candidates.
    pub candidate: usize,
    /// Its nonlinear values.
    pub setting: Vec<f64>,
    /// Whether the last column is a constant.
    pub with_constant: bool,
    /// A change of fixed size, with no amplitude to fit.
    pub is_fixed: bool,
    /// Its effect for each amplitude of 1, in groups.
    pub columns: Vec<Vec<f64>>,
    /// How many values it would take to fit it.
    pub degrees: f64,
}

/// The part of a trial that does not depend on the lists: G, and the squares of its columns.
pub(crate) struct TrialGram {
    outside_basis: DMatrix<f64>,
    whole: Vec<f64>,
}

/// T and U of each trial on each of `lists`, next to the columns of the model's own values. `own` is empty, or what
/// other lists have left there for the same trials and noises.
pub(crate) fn compute_scan_statistics(
    trials: &[CandidateTrial],
    nuisance: &[Vec<f64>],
    lists: &[Vec<f64>],
    problem: &FitProblem,
    noises: &[NoiseModel],
    independent: f64,
    own: &mut Vec<Vec<TrialGram>>,
) -> Vec<Vec<[f64; 2]>> {
    let steps = &problem.groups.steps;
    let rows = problem.groups.len() as f64;
    let mut base = vec![f64::INFINITY; lists.len()];
    let mut with = vec![vec![f64::INFINITY; lists.len()]; trials.len()];
    let mut share = vec![vec![0.0_f64; lists.len()]; trials.len()];
    let chunks = chunk_trials(trials);
    for (which, &noise) in noises.iter().enumerate() {
        let whitener = Whitener::new(noise, steps);
        let known = own.get(which).map(Vec::as_slice);
        let projector = Projector::new(&whitener, nuisance, lists, known.is_some());
        let deviance = |sum: f64| rows * (sum / rows).max(1e-300).ln() + whitener.log_det;
        for (base, sum) in base.iter_mut().zip(&projector.sums) {
            *base = base.min(deviance(*sum));
        }
        let of = |&(start, chunk): &(usize, &[CandidateTrial])| {
            let known = known.map(|known| &known[start..start + chunk.len()]);
            projector.compute_gains(&whitener, chunk, known)
        };
        let is_worth = trials.len() * rows as usize > MIN_PARALLEL_VALUES;
        let all = parallel_map(&chunks, is_worth, of);
        let (all, new): (Vec<_>, Vec<_>) = all.into_iter().unzip();
        if known.is_none() {
            own.push(new.into_iter().flatten().collect());
        }
        for (trial, gains) in all.iter().flatten().enumerate() {
            for (list, gain) in gains.iter().enumerate() {
                let sum = projector.sums[list];
                // More than all cannot be explained but by rounding.
                let left = (sum - gain).max(1e-12 * sum);
                with[trial][list] = with[trial][list].min(deviance(left));
                if which == 0 && sum > 0.0 {
                    share[trial][list] = 1.0 - left / sum;
                }
            }
        }
    }
    let length = rows.ln();
    trials
        .iter()
        .enumerate()
        .map(|(number, trial)| {
            (0..lists.len())
                .map(|list| {
                    let t = base[list] - with[number][list] - trial.degrees * length;
                    let left = 1.0 - share[number][list];
                    let u = -independent * left.ln() - trial.degrees * independent.ln();
                    [t, u]
                })
                .collect()
        })
        .collect()
}

/// Trials side by side, about [`COLUMNS_PER_CHUNK`] columns each, with the number of the first.
fn chunk_trials(trials: &[CandidateTrial]) -> Vec<(usize, &[CandidateTrial])> {
    let mut chunks = Vec::new();
    let (mut start, mut columns) = (0, 0);
    for (index, trial) in trials.iter().enumerate() {
        columns += trial.columns.len();
        if columns >= COLUMNS_PER_CHUNK {
            chunks.push((start, &trials[start..=index]));
            (start, columns) = (index + 1, 0);
        }
    }
    if start < trials.len() {
        chunks.push((start, &trials[start..]));
    }
    chunks
}

/// The reduction of lists by columns, next to what the model's own values could absorb; all whitened.
///
/// ```text
/// Q  basis of the model's own columns        l ⊥ Q  the lists
/// w  a trial's columns                       G = wᵀw − (wᵀQ)(wᵀQ)ᵀ,  b = wᵀl
/// gain = bᵀ·G⁻¹·b                            of a change of fixed size, the first column: 2·b − G,
///                                            and what the others explain of the rest
/// ```
struct Projector {
    /// Q, unless all G are known, and the lists, a row each.
    left: DMatrix<f64>,
    /// The same as they were, where they are few.
    rows: Vec<Vec<f64>>,
    /// How many of them are Q's.
    basis: usize,
    /// Squares of the lists.
    sums: Vec<f64>,
}

impl Projector {
    fn new(whitener: &Whitener, nuisance: &[Vec<f64>], lists: &[Vec<f64>], is_known: bool) -> Self {
        let mut columns = orthonormalise(whitener.whiten_columns(nuisance));
        let mut basis = columns.len();
        let mut sums = Vec::with_capacity(lists.len());
        for mut list in whitener.whiten_columns(lists) {
            for column in &columns[..basis] {
                let share = dot(&list, column);
                list.iter_mut().zip(column).for_each(|(v, c)| *v -= share * c);
            }
            sums.push(dot(&list, &list));
            columns.push(list);
        }
        if is_known {
            columns.drain(..basis);
            basis = 0;
        }
        let left = matrix_from_columns(&columns).transpose();
        let rows = if columns.len() > MAX_NAIVE_PRODUCT_ROWS { Vec::new() } else { columns };
        Self { left, rows, basis, sums }
    }

    /// Q and the lists times columns, a column each.
    fn inner_products(&self, white: &DMatrix<f64>) -> DMatrix<f64> {
        if self.left.nrows() > MAX_NAIVE_PRODUCT_ROWS {
            return &self.left * white;
        }
        let rows = self.rows.as_slice();
        let of = |i: usize, j: usize| dot(&rows[i], white.column(j).as_slice());
        DMatrix::from_fn(self.left.nrows(), white.ncols(), of)
    }

    /// Returns the gain of each trial on each list, and what of it does not depend on them where it is not `known`.
    fn compute_gains(
        &self,
        whitener: &Whitener,
        trials: &[CandidateTrial],
        known: Option<&[TrialGram]>,
    ) -> (Vec<Vec<f64>>, Vec<TrialGram>) {
        let columns: Vec<&Vec<f64>> = trials.iter().flat_map(|trial| &trial.columns).collect();
        let rows = self.left.ncols();
        let mut white = DMatrix::zeros(rows, columns.len());
        whitener.whiten_columns_into(&columns, white.as_mut_slice());
        let products = self.inner_products(&white);
        let lists = self.sums.len();
        let mut first = 0;
        let mut new = Vec::new();
        let gain = |(number, trial): (usize, &CandidateTrial)| {
            let count = trial.columns.len();
            let on_lists = products.view((self.basis, first), (lists, count)).transpose();
            let white = &white.as_slice()[first * rows..(first + count) * rows];
            let own = match known {
                Some(known) => &known[number],
                None => {
                    let in_basis = products.view((0, first), (self.basis, count));
                    let squares = gram_matrix(white, count);
                    let whole = squares.diagonal().as_slice().to_vec();
                    let outside_basis = squares - in_basis.transpose() * in_basis;
                    new.push(TrialGram { outside_basis, whole });
                    &new[number]
                }
            };
            first += count;
            if trial.is_fixed {
                return explained_sum_of_squares_with_fixed_amplitude(
                    &own.outside_basis,
                    &own.whole,
                    &on_lists,
                );
            }
            explained_sum_of_squares(own.outside_basis.clone(), &own.whole, on_lists)
        };
        (trials.iter().enumerate().map(gain).collect(), new)
    }
}

/// XᵀX; of a few columns the lower half, which is all that is read.
fn gram_matrix(columns: &[f64], count: usize) -> DMatrix<f64> {
    let rows = columns.len() / count.max(1);
    if count > MAX_NAIVE_PRODUCT_ROWS {
        let columns = DMatrixView::from_slice(columns, rows, count);
        return columns.transpose() * columns;
    }
    let of = |i: usize| &columns[i * rows..(i + 1) * rows];
    DMatrix::from_fn(count, count, |i, j| if j <= i { dot(of(i), of(j)) } else { 0.0 })
}

fn matrix_from_columns(columns: &[Vec<f64>]) -> DMatrix<f64> {
    let rows = columns.first().map_or(0, Vec::len);
    DMatrix::from_iterator(rows, columns.len(), columns.iter().flatten().copied())
}

/// Returns what a change of fixed size, the first column, and then the others explain of each list.
fn explained_sum_of_squares_with_fixed_amplitude(
    g: &DMatrix<f64>,
    whole: &[f64],
    b: &DMatrix<f64>,
) -> Vec<f64> {
    let others = g.nrows() - 1;
    let of_change = b.row(0).iter().map(|b| 2.0 * b - g[(0, 0)]).collect();
    if others == 0 {
        return of_change;
    }
    let mut left = b.rows(1, others).into_owned();
    for mut list in left.column_iter_mut() {
        list -= g.view((1, 0), (others, 1));
    }
    let rest =
        explained_sum_of_squares(g.view((1, 1), (others, others)).into_owned(), &whole[1..], left);
    of_change.into_iter().zip(rest).map(|(change, rest)| change + rest).collect()
}

/// bᵀ·G⁻¹·b for each column b.
fn explained_sum_of_squares(g: DMatrix<f64>, whole: &[f64], mut b: DMatrix<f64>) -> Vec<f64> {
    let lower = cholesky(g, whole);
    let count = b.nrows();
    let column = |b: &mut [f64]| {
        forward_substitute(&lower, b);
        dot(b, b)
    };
    b.as_mut_slice().chunks_exact_mut(count).map(column).collect()
}
