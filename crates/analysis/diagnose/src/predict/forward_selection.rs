//! Forward selection by what a term takes off the blocks that took no part in its value.
//!
//! With the columns made orthogonal to those that are chosen, all blocks are held out in closed form (S = Σ z·r and
//! N = Σ z² of a block b, of all without an index):
//!
//! ```text
//! β₋b = (S − S_b)/(N − N_b)        gain = Σ_b 2·β₋b·S_b − β₋b²·N_b
//! ```
//!
//! The best gain wins; of those within one standard error (paired over the blocks) and the tolerance of equality the simplest.

use trueup_numerics::block_resampling::MIN_GAIN_STANDARD_ERRORS;

use crate::{
    data::MAX_DUPLICATE_VARIANCE_FRACTION,
    fit::{CONFIDENCE_LEVEL, EQUIVALENCE_TOLERANCE},
    predict::dictionary::TermDictionary,
};

/// Within one standard error, but worth less than this share of the best, a simple term is no rival: what equal terms do
/// differs by no more than the tolerance, and gains are squares.
const MIN_ALTERNATIVE_GAIN_RATIO: f64 =
    (1.0 - EQUIVALENCE_TOLERANCE) * (1.0 - EQUIVALENCE_TOLERANCE);
/// A column is to be seen on as many occasions.
const MIN_EFFECTIVE_BLOCKS: f64 = 3.0;

/// A selection.
pub(super) struct ForwardSelection<'f> {
    pub dictionary: &'f TermDictionary,
    pub y: &'f [f64],
    /// Whether it stops where a term is no longer worth a standard error.
    pub stops: bool,
}

/// The gain of an entry in each block.
struct EntryGain {
    entry: usize,
    of_blocks: Vec<f64>,
    sum: f64,
}

impl ForwardSelection<'_> {
    /// Returns at most `most` entries, in the order in which they were chosen; `blocks` is the block of each of `rows`.
    pub(super) fn select_terms(&self, rows: &[usize], blocks: &[usize], most: usize) -> Vec<usize> {
        let ends = block_ends(blocks);
        let mut columns: Vec<Vec<f64>> =
            self.dictionary.columns.iter().map(|column| centred(column, rows)).collect();
        let mut r = centred(self.y, rows);
        let whole: Vec<f64> = columns.iter().map(|z| dot(z, z)).collect();
        let mut is_open = vec![true; self.dictionary.entries.len()];
        let mut chosen = Vec::new();
        while chosen.len() < most {
            let gains = self.compute_gains(&mut columns, &r, &ends, &whole, &is_open);
            let Some(best) = gains.iter().max_by(|a, b| a.sum.total_cmp(&b.sum)) else { break };
            if best.sum <= 0.0 {
                break;
            }
            let pick = self.select_simplest_entry(&gains, best);
            let is_worth = [best, pick].iter().any(|gain| {
                gain.sum > MIN_GAIN_STANDARD_ERRORS * standard_error_of_sum(&gain.of_blocks)
            });
            if self.stops && !is_worth {
                break;
            }
            let entry = &self.dictionary.entries[pick.entry];
            for column in entry.columns.clone() {
                let mut q = columns[column].clone();
                let size = dot(&q, &q).sqrt();
                if size * size <= MAX_DUPLICATE_VARIANCE_FRACTION * whole[column] {
                    continue;
                }
                q.iter_mut().for_each(|q| *q /= size);
                subtract_projection(&mut r, &q);
                for (number, other) in self.dictionary.entries.iter().enumerate() {
                    if is_open[number] {
                        other
                            .columns
                            .clone()
                            .for_each(|z| subtract_projection(&mut columns[z], &q));
                    }
                }
            }
            chosen.push(pick.entry);
            for (number, other) in self.dictionary.entries.iter().enumerate() {
                is_open[number] &= other.kind != entry.kind;
            }
        }
        chosen
    }

    fn compute_gains(
        &self,
        columns: &mut [Vec<f64>],
        r: &[f64],
        ends: &[usize],
        whole: &[f64],
        is_open: &[bool],
    ) -> Vec<EntryGain> {
        let mut gains = Vec::new();
        for (entry, of) in self.dictionary.entries.iter().enumerate() {
            if !is_open[entry] {
                continue;
            }
            // Columns of one term are made orthogonal to each other.
            for column in of.columns.start + 1..of.columns.end {
                let (before, rest) = columns.split_at_mut(column);
                for q in &before[of.columns.start..] {
                    let size = dot(q, q);
                    if size > 0.0 {
                        let share = dot(q, &rest[0]) / size;
                        rest[0].iter_mut().zip(q).for_each(|(z, q)| *z -= share * q);
                    }
                }
            }
            let mut of_blocks = vec![0.0; ends.len()];
            let mut is_seen = false;
            for column in of.columns.clone() {
                is_seen |=
                    add_block_gains(&columns[column], r, ends, whole[column], &mut of_blocks);
            }
            if is_seen {
                let sum = of_blocks.iter().sum();
                gains.push(EntryGain { entry, of_blocks, sum });
            }
        }
        gains
    }

    fn select_simplest_entry<'g>(
        &self,
        gains: &'g [EntryGain],
        best: &'g EntryGain,
    ) -> &'g EntryGain {
        let degrees = |gain: &EntryGain| self.dictionary.entries[gain.entry].degrees;
        let is_rival = |gain: &&EntryGain| {
            let apart: Vec<f64> =
                best.of_blocks.iter().zip(&gain.of_blocks).map(|(a, b)| a - b).collect();
            gain.sum >= MIN_ALTERNATIVE_GAIN_RATIO * best.sum
                && best.sum - gain.sum <= MIN_GAIN_STANDARD_ERRORS * standard_error_of_sum(&apart)
        };
        let rivals = gains.iter().filter(is_rival);
        let order = |a: &&EntryGain, b: &&EntryGain| {
            degrees(a).cmp(&degrees(b)).then(b.sum.total_cmp(&a.sum))
        };
        rivals.min_by(order).unwrap_or(best)
    }
}

/// Adds the gain of a column in each block; returns whether the column is seen often enough.
fn add_block_gains(z: &[f64], r: &[f64], ends: &[usize], whole: f64, gains: &mut [f64]) -> bool {
    let count = ends.len() as f64;
    let mut of_blocks = Vec::with_capacity(ends.len());
    let mut first = 0;
    for &end in ends {
        of_blocks.push([dot(&z[first..end], &r[first..end]), dot(&z[first..end], &z[first..end])]);
        first = end;
    }
    let [s, n, squares] = of_blocks
        .iter()
        .fold([0.0; 3], |[s, n, squares], [sb, nb]| [s + sb, n + nb, squares + nb * nb]);
    if n <= MAX_DUPLICATE_VARIANCE_FRACTION * whole
        || n * n < MIN_EFFECTIVE_BLOCKS.min(count / 3.0) * squares
    {
        return false;
    }
    for (gain, [sb, nb]) in gains.iter_mut().zip(of_blocks) {
        let rest = n - nb;
        if rest > 0.0 {
            let beta = (s - sb) / rest;
            *gain += 2.0 * beta * sb - beta * beta * nb;
        }
    }
    true
}

/// Returns where each block ends.
fn block_ends(blocks: &[usize]) -> Vec<usize> {
    let changes = (1..blocks.len()).filter(|&n| blocks[n] != blocks[n - 1]);
    changes.chain([blocks.len()]).collect()
}

fn centred(values: &[f64], rows: &[usize]) -> Vec<f64> {
    let mean = rows.iter().map(|&row| values[row]).sum::<f64>() / rows.len() as f64;
    rows.iter().map(|&row| values[row] - mean).collect()
}

fn subtract_projection(from: &mut [f64], q: &[f64]) {
    let share = dot(from, q);
    from.iter_mut().zip(q).for_each(|(z, q)| *z -= share * q);
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Returns the standard error of the sum of values.
fn standard_error_of_sum(values: &[f64]) -> f64 {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let scatter: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (count / (count - 1.0).max(1.0) * scatter).sqrt()
}

/// Returns the integrated autocorrelation time of a residual in rows, up to where the correlation has fallen by 95 %.
pub(super) fn autocorrelation_time_rows(residual: &[f64]) -> f64 {
    let count = residual.len();
    let mean = residual.iter().sum::<f64>() / count.max(1) as f64;
    let e: Vec<f64> = residual.iter().map(|e| e - mean).collect();
    let variance = dot(&e, &e) / count.max(1) as f64;
    let correlation = |lag: usize| {
        dot(&e[lag..], &e[..count - lag]) / (count - lag) as f64 / variance.max(f64::MIN_POSITIVE)
    };
    let rows = (1..count / 3).map(correlation).take_while(|r| *r >= 1.0 - CONFIDENCE_LEVEL);
    1.0 + 2.0 * rows.sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: S = 4, 2 and N = 2, 2, so that β₋₁ = 2/2, β₋₂ = 4/2, and the gains are 2·1·4 − 1·2 and 2·2·2 − 4·2.
    #[test]
    fn a_gain_is_what_a_value_of_the_other_blocks_takes_off() {
        let (z, r) = ([1.0, -1.0, 1.0, -1.0], [2.0, -2.0, 1.0, -1.0]);
        let mut gains = [0.0; 2];
        assert!(add_block_gains(&z, &r, &[2, 4], 4.0, &mut gains));
        assert_eq!(gains, [6.0, 0.0]);
    }

    /// A column that is there in one block alone predicts nothing.
    #[test]
    fn a_column_that_is_seen_once_is_no_term() {
        let mut z = vec![0.0; 80];
        z[..10].copy_from_slice(&[1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0]);
        let ends: Vec<usize> = (1..=8).map(|n| 10 * n).collect();
        assert!(!add_block_gains(&z, &z.clone(), &ends, 10.0, &mut [0.0; 8]));
    }

    /// 1 + 2·(½ + ¼ + ⅛ + …), down to 0.05: ½, ¼, ⅛ and 1/16.
    #[test]
    fn the_memory_of_a_decay_is_its_sum() {
        let mut noise = trueup_numerics::random::RandomGenerator::new(5);
        let mut state = 0.0;
        let residual: Vec<f64> = (0..200_000)
            .map(|_| {
                state = 0.5 * state + noise.normal();
                state
            })
            .collect();
        assert!(
            (autocorrelation_time_rows(&residual) - 2.875).abs() < 0.1,
            "{}",
            autocorrelation_time_rows(&residual)
        );
    }
}
