//! The correction for prediction, where structure remains that the claimed causes leave.
//!
//! Names and correction are two outputs. A name is one answer; of a correction only its prediction counts, and
//! there the mean over many searches is better than any one of them: which of several thermometers a search takes
//! depends on the rows that it was shown.
//!
//! ```text
//! dictionary ─► forward ─► on subsamples of three quarters of the blocks ─► mean
//!                                            └► their terms ─► compact: at most 8 terms ─► fitted to measured and mean
//! ```
//!
//! Nothing is promised of a fit: the whole of it is done again without each part of the record, which it then predicts.

pub(crate) mod compact_model;
mod dictionary;
mod forward_selection;

use trueup_numerics::{
    block_resampling::{MAX_BLOCKS, MIN_BLOCKS, segment_indices},
    parallel::parallel_map,
    random::RandomGenerator,
};

use crate::{
    fit::FitProblem,
    folds::Folds,
    model::Model,
    predict::{
        compact_model::{CompactModel, fit_terms, select_compact_model},
        dictionary::TermDictionary,
        forward_selection::{ForwardSelection, autocorrelation_time_rows},
    },
    search::initial_model,
};

/// Pairs of subsamples, and of those of a fit without a part of the record: the mean of 30 is known to a fifth of their
/// scatter.
const SUBSAMPLE_PAIR_COUNT: usize = 15;
const HELD_OUT_SUBSAMPLE_PAIR_COUNT: usize = 6;
/// The share of the blocks in a subsample.
const SUBSAMPLE_BLOCK_FRACTION: f64 = 0.75;
/// Terms that a subsample may have more than the whole record.
const MAX_EXTRA_SUBSAMPLE_TERMS: usize = 2;
/// Blocks are this many times as long as what is left remembers.
const BLOCK_LENGTH_CORRELATION_TIMES: f64 = 4.0;
/// Blocks to begin with.
const INITIAL_BLOCK_COUNT: usize = 24;
/// Of fewer groups a subsample shows too little.
const MIN_SUBSAMPLED_GROUPS: usize = 40;

/// A correction, and what it predicted of parts not used for its fit.
#[derive(Clone, Debug)]
pub(crate) struct SelectedCorrection {
    pub model: Model,
    pub foreseen: HeldOutResiduals,
}

/// Residuals of parts that took no part in search and fit.
#[derive(Clone, Debug)]
pub(crate) struct HeldOutResiduals {
    /// Of each group, by a fit to the other parts ([`Folds::for_prediction`]), in µm.
    pub left: Vec<f64>,
    /// Of the rest, by a fit to the first half and the first two thirds: from which group on, and in each.
    pub later: Vec<(usize, Vec<f64>)>,
}

/// Where the rest begins that is predicted from the groups before.
pub(crate) fn forecast_origins(groups: usize) -> [usize; 2] {
    [groups / 2, 2 * groups / 3]
}

/// Returns the correction that predicts held-out parts best; none where no term gains on held-out blocks. `drift_um` is
/// what no board runs and is explained in each group, in µm: a gauge that drifts is no growth.
pub(crate) fn select_correction(
    problem: &FitProblem,
    folds: &Folds,
    drift_um: &[f64],
) -> Option<SelectedCorrection> {
    let dictionary = TermDictionary::new(problem);
    let measured = problem.residual(&Model::default());
    let y: Vec<f64> = measured.iter().zip(drift_um).map(|(um, drift)| um - drift).collect();
    let groups = y.len();
    let is_timed = problem.data.time_s().is_some();
    let all: Vec<usize> = (0..groups).collect();
    let engine = SubsampleSelection {
        dictionary: &dictionary,
        y: &y,
        is_timed,
        is_large: problem.is_parallel_worthwhile(),
    };
    let whole = engine.select_model(&all, SUBSAMPLE_PAIR_COUNT)?;
    let model = whole.to_model(&dictionary, initial_model(&problem.data));
    let parts = folds.block_index_by_group();
    let count = parts.iter().max().map_or(0, |last| last + 1);
    let mut left = measured.clone();
    for part in 0..count {
        let rows: Vec<usize> = all.iter().copied().filter(|&row| parts[row] != part).collect();
        let without = engine.select_model(&rows, HELD_OUT_SUBSAMPLE_PAIR_COUNT);
        for row in (0..groups).filter(|&row| parts[row] == part) {
            left[row] -=
                without.as_ref().map_or(0.0, |model| model.predict_group(&dictionary, row));
        }
    }
    let later = forecast_origins(groups).into_iter().filter(|first| *first > 0).map(|first| {
        let without = engine.select_model(&all[..first], HELD_OUT_SUBSAMPLE_PAIR_COUNT);
        let of = |row: usize| {
            without.as_ref().map_or(0.0, |model| model.predict_group(&dictionary, row))
        };
        (first, (first..groups).map(|row| measured[row] - of(row)).collect())
    });
    Some(SelectedCorrection { model, foreseen: HeldOutResiduals { later: later.collect(), left } })
}

/// The search with all that it needs.
struct SubsampleSelection<'e> {
    dictionary: &'e TermDictionary,
    /// The machine file's residual in each group, in µm.
    y: &'e [f64],
    is_timed: bool,
    is_large: bool,
}

impl SubsampleSelection<'_> {
    /// Returns the compact correction by these groups, which are in order.
    fn select_model(&self, rows: &[usize], pairs: usize) -> Option<CompactModel> {
        let count = rows.len();
        let forward = |rows: &[usize], blocks: &[usize], most: usize, stops: bool| {
            ForwardSelection { dictionary: self.dictionary, y: self.y, stops }
                .select_terms(rows, blocks, most)
        };
        let first =
            if self.is_timed { INITIAL_BLOCK_COUNT.min(count / 4) } else { (count / 2).min(40) };
        let mut blocks = segment_indices(count, first.max(2));
        if self.is_timed {
            // Of what is left by a search that does not stop: what is still to be found remembers longer.
            let rich = forward(rows, &blocks, compact_model::MAX_COMPACT_MODEL_TERMS, false);
            let left = fit_terms(self.dictionary, self.y, rows, &rich).residuals(
                self.dictionary,
                self.y,
                rows,
            );
            let length = BLOCK_LENGTH_CORRELATION_TIMES * autocorrelation_time_rows(&left);
            let most = (count as f64 / length).min(count as f64 / 8.0) as usize;
            blocks = segment_indices(count, most.clamp(MIN_BLOCKS, MAX_BLOCKS).min(count));
        }
        let terms = forward(rows, &blocks, compact_model::MAX_COMPACT_MODEL_TERMS, true);
        if terms.is_empty() {
            return None;
        }
        if count < MIN_SUBSAMPLED_GROUPS {
            return Some(fit_terms(self.dictionary, self.y, rows, &terms));
        }
        let number = blocks[count - 1] + 1;
        let kept =
            ((SUBSAMPLE_BLOCK_FRACTION * number as f64).round() as usize).clamp(1, number - 1);
        let mut generator = RandomGenerator::new(count as u64);
        let sides: Vec<Vec<bool>> = (0..pairs)
            .flat_map(|_| {
                let order = random_permutation(number, &mut generator);
                let of = |blocks: &[usize]| {
                    let mut is_in = vec![false; number];
                    blocks.iter().for_each(|&block| is_in[block] = true);
                    is_in
                };
                [of(&order[..kept]), of(&order[number - kept..])]
            })
            .collect();
        let samples = parallel_map(&sides, self.is_large, |is_in| {
            let inside: Vec<usize> = (0..count).filter(|&n| is_in[blocks[n]]).collect();
            let of: Vec<usize> = inside.iter().map(|&n| rows[n]).collect();
            let there: Vec<usize> = inside.iter().map(|&n| blocks[n]).collect();
            let found = forward(&of, &there, terms.len() + MAX_EXTRA_SUBSAMPLE_TERMS, true);
            let outside: Vec<usize> =
                (0..count).filter(|&n| !is_in[blocks[n]]).map(|n| rows[n]).collect();
            let fitted = fit_terms(self.dictionary, self.y, &of, &found);
            compact_model::Subsample { inside: of, outside, fitted }
        });
        Some(select_compact_model(self.dictionary, self.y, rows, &samples, self.is_large))
    }
}

/// Returns the numbers below `count` in a random order.
fn random_permutation(count: usize, generator: &mut RandomGenerator) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    for last in (1..count).rev() {
        order.swap(last, generator.uniform_index(last + 1));
    }
    order
}
