//! The correction for prediction, where structure remains that the claimed causes leave.
//!
//! Names and correction are two outputs. A name is one answer; of a correction it is only asked what it foresees, and
//! there the mean over many searches is better than any one of them: which of several thermometers a search takes
//! depends on the rows that it was shown.
//!
//! ```text
//! dictionary ─► forward ─► on subsamples of three quarters of the blocks ─► mean
//!                                            └► their terms ─► compact: at most 8 terms ─► fitted to measured and mean
//! ```
//!
//! Nothing is promised of a fit: the whole of it is done again without each part of the record, which it then foresees.

pub(crate) mod compact;
mod dictionary;
mod forward;

use trueup_numerics::{blocks::stretches, parallel::on_all_cores, random::Generator};

use crate::{
    blocks::Folds,
    fit::Problem,
    model::Model,
    predict::{
        compact::{Compact, compact, single},
        dictionary::Dictionary,
        forward::{Forward, memory},
    },
    search::start,
};

/// Pairs of subsamples, and of those of a fit without a part of the record.
const PAIRS: usize = 15;
const PAIRS_WITHOUT: usize = 6;
/// The share of the blocks in a subsample.
const SHARE: f64 = 0.75;
/// Terms that a subsample may have more than the whole record.
const MORE: usize = 2;
/// Blocks are this many times as long as what is left remembers; this many there are at least and at most.
const MEMORIES: f64 = 4.0;
const BLOCKS: [usize; 2] = [8, 60];
/// Blocks to begin with.
const FIRST_BLOCKS: usize = 24;
/// Of fewer groups a subsample shows too little.
const FEW: usize = 40;

/// A correction, and what it foresaw of parts that it was not fitted to.
#[derive(Clone, Debug)]
pub(crate) struct Prediction {
    pub model: Model,
    pub foreseen: Predicted,
}

/// Residuals of parts that took no part in search and fit.
#[derive(Clone, Debug)]
pub(crate) struct Predicted {
    /// Of each group, by a fit to the other parts ([`Folds::of_promise`]), in µm.
    pub left: Vec<f64>,
    /// Of the rest, by a fit to the first half and the first two thirds: from which group on, and in each.
    pub later: Vec<(usize, Vec<f64>)>,
}

/// Where the rest begins that is foreseen from the groups before.
pub(crate) fn later_from(groups: usize) -> [usize; 2] {
    [groups / 2, 2 * groups / 3]
}

/// Returns the correction that foresees left-out parts best; none where no term gains on left-out blocks. `beside` is
/// what no board runs and is explained in each group, in µm: a gauge that drifts is no growth.
pub(crate) fn prediction(problem: &Problem, folds: &Folds, beside: &[f64]) -> Option<Prediction> {
    let dictionary = Dictionary::new(problem);
    let measured = problem.residual(&Model::default());
    let y: Vec<f64> = measured.iter().zip(beside).map(|(um, beside)| um - beside).collect();
    let groups = y.len();
    let is_timed = problem.data.time_s.is_some();
    let all: Vec<usize> = (0..groups).collect();
    let engine = Engine { dictionary: &dictionary, y: &y, is_timed, is_large: problem.is_large() };
    let whole = engine.run(&all, PAIRS)?;
    let model = whole.model(&dictionary, start(&problem.data));
    let parts = folds.parts();
    let count = parts.iter().max().map_or(0, |last| last + 1);
    let mut left = measured.clone();
    for part in 0..count {
        let rows: Vec<usize> = all.iter().copied().filter(|&row| parts[row] != part).collect();
        let without = engine.run(&rows, PAIRS_WITHOUT);
        for row in (0..groups).filter(|&row| parts[row] == part) {
            left[row] -= without.as_ref().map_or(0.0, |it| it.at(&dictionary, row));
        }
    }
    let later = later_from(groups).into_iter().filter(|first| *first > 0).map(|first| {
        let without = engine.run(&all[..first], PAIRS_WITHOUT);
        let of = |row: usize| without.as_ref().map_or(0.0, |it| it.at(&dictionary, row));
        (first, (first..groups).map(|row| measured[row] - of(row)).collect())
    });
    Some(Prediction { model, foreseen: Predicted { later: later.collect(), left } })
}

/// The search with all that it needs.
struct Engine<'e> {
    dictionary: &'e Dictionary,
    /// The machine file's residual in each group, in µm.
    y: &'e [f64],
    is_timed: bool,
    is_large: bool,
}

impl Engine<'_> {
    /// Returns the compact correction by these groups, which are in order.
    fn run(&self, rows: &[usize], pairs: usize) -> Option<Compact> {
        let count = rows.len();
        let forward = |rows: &[usize], blocks: &[usize], most: usize, stops: bool| {
            Forward { dictionary: self.dictionary, y: self.y, stops }.terms(rows, blocks, most)
        };
        let first = if self.is_timed { FIRST_BLOCKS.min(count / 4) } else { (count / 2).min(40) };
        let mut blocks = stretches(count, first.max(2));
        if self.is_timed {
            // Of what is left by a search that does not stop: what is still to be found remembers longer.
            let rich = forward(rows, &blocks, compact::MAX_TERMS, false);
            let left =
                single(self.dictionary, self.y, rows, &rich).left(self.dictionary, self.y, rows);
            let length = MEMORIES * memory(&left);
            let most = (count as f64 / length).min(count as f64 / 8.0) as usize;
            blocks = stretches(count, most.clamp(BLOCKS[0], BLOCKS[1]).min(count));
        }
        let terms = forward(rows, &blocks, compact::MAX_TERMS, true);
        if terms.is_empty() {
            return None;
        }
        if count < FEW {
            return Some(single(self.dictionary, self.y, rows, &terms));
        }
        let number = blocks[count - 1] + 1;
        let kept = ((SHARE * number as f64).round() as usize).clamp(1, number - 1);
        let mut generator = Generator::new(count as u64);
        let sides: Vec<Vec<bool>> = (0..pairs)
            .flat_map(|_| {
                let order = shuffled(number, &mut generator);
                let of = |blocks: &[usize]| {
                    let mut is_in = vec![false; number];
                    blocks.iter().for_each(|&block| is_in[block] = true);
                    is_in
                };
                [of(&order[..kept]), of(&order[number - kept..])]
            })
            .collect();
        let samples = on_all_cores(&sides, self.is_large, |is_in| {
            let inside: Vec<usize> = (0..count).filter(|&n| is_in[blocks[n]]).collect();
            let of: Vec<usize> = inside.iter().map(|&n| rows[n]).collect();
            let there: Vec<usize> = inside.iter().map(|&n| blocks[n]).collect();
            let found = forward(&of, &there, terms.len() + MORE, true);
            let outside: Vec<usize> =
                (0..count).filter(|&n| !is_in[blocks[n]]).map(|n| rows[n]).collect();
            let fitted = single(self.dictionary, self.y, &of, &found);
            compact::Sample { inside: of, outside, fitted }
        });
        Some(compact(self.dictionary, self.y, rows, &samples, self.is_large))
    }
}

/// Returns the numbers below `count` in a random order.
fn shuffled(count: usize, generator: &mut Generator) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    for last in (1..count).rev() {
        order.swap(last, generator.below(last + 1));
    }
    order
}
