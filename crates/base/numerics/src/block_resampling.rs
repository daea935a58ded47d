//! Blocks of neighbouring rows, which noise with a memory ties together: held out in turn, or drawn
//! again and again, they show what single rows would only pretend to.

use crate::random::RandomGenerator;

/// Draws for an interval.
const BOOTSTRAP_RESAMPLES: usize = 400;
/// Blocks for an interval: fewer draw too coarse a distribution, more are shorter than they need be.
pub const MIN_BLOCKS: usize = 8;
/// Parts of a record: what is gained in one of them alone was seen once.
pub const SEGMENT_COUNT: usize = 6;
/// Most blocks that a record is cut into.
pub const MAX_BLOCKS: usize = 40;
/// Correlation times in a block, at least: then blocks are as good as independent.
pub const MIN_CORRELATION_TIMES_PER_BLOCK: f64 = 5.0;
/// Standard errors by which one of two predicts better: the rule of one (Breiman 1984).
pub const MIN_GAIN_STANDARD_ERRORS: f64 = 1.0;
/// Standard errors that are beyond doubt, as 95 % go; the coverage factor of an expanded uncertainty of 95 % (GUM 6.2:
/// 1.96, rounded to 2).
pub const COVERAGE_FACTOR_95: f64 = 2.0;

/// Returns the number, from 0, of the stretch of each of `rows` rows that are cut into `stretches` of equal length.
///
/// ```
/// assert_eq!(trueup_numerics::block_resampling::segment_indices(6, 3), [0, 0, 1, 1, 2, 2]);
/// ```
#[must_use]
pub fn segment_indices(rows: usize, stretches: usize) -> Vec<usize> {
    (0..rows).map(|row| row * stretches / rows).collect()
}

/// Returns the root of the mean square, in the unit of `values`; 0 of none.
#[must_use]
pub fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// By how much an RMS falls.
#[derive(Clone, Copy, Debug)]
pub struct RmsReduction {
    /// 1 − after/before, at most 1; negative where it rises.
    pub value: f64,
    /// Its 95 % interval: whole blocks drawn again and again.
    pub ci95: [f64; 2],
    /// Whether it is above 0, and in four of five draws.
    pub is_gain: bool,
}

/// Reduction of the sum of squares, compared block by block.
#[derive(Clone, Copy, Debug)]
pub struct PairedComparison {
    /// Σ before² − Σ after², in µm² or whatever the squares are in; negative where more is left.
    pub gain: f64,
    /// The standard error of the gain, by what differs between the blocks.
    pub standard_error: f64,
    /// The gain of all rows but the sixth of them that gains most, wherever sixths begin: what happened
    /// once, in less than a twelfth of the rows, is wholly in one of them.
    pub without_best: f64,
}

impl PairedComparison {
    /// Returns whether what is left after is less than before by more than the standard error of the
    /// difference: else both predict equally well.
    #[must_use]
    pub fn is_better(&self) -> bool {
        self.gain > MIN_GAIN_STANDARD_ERRORS * self.standard_error
    }

    /// Returns whether it is less by more than two standard errors: beyond doubt, as 95 % go.
    #[must_use]
    pub fn is_significant(&self) -> bool {
        self.gain > COVERAGE_FACTOR_95 * self.standard_error
    }
}

/// Blocks to draw from.
#[derive(Clone, Debug)]
pub struct RowBlocks {
    of_row: Vec<usize>,
    count: usize,
}

impl RowBlocks {
    /// Of `rows` rows, at least five correlation times of `memory` rows long where that leaves enough
    /// of them.
    #[must_use]
    pub fn new(rows: usize, memory: f64) -> Self {
        let least = (MIN_CORRELATION_TIMES_PER_BLOCK * memory).max(1.0);
        let count = ((rows as f64 / least) as usize).clamp(MIN_BLOCKS, MAX_BLOCKS).min(rows);
        Self { of_row: segment_indices(rows, count), count }
    }

    /// Squares of `before` and `after` in each block.
    fn block_sums_of_squares(&self, before: &[f64], after: &[f64]) -> Vec<[f64; 2]> {
        let mut sums = vec![[0.0; 2]; self.count];
        for (row, &block) in self.of_row.iter().enumerate() {
            sums[block][0] += before[row] * before[row];
            sums[block][1] += after[row] * after[row];
        }
        sums
    }

    /// Returns what `after` leaves less of the squares than `before`, a value for each row.
    #[must_use]
    pub fn compare_paired(&self, before: &[f64], after: &[f64]) -> PairedComparison {
        let gains: Vec<f64> =
            self.block_sums_of_squares(before, after).iter().map(|[b, a]| b - a).collect();
        let count = gains.len() as f64;
        let gain: f64 = gains.iter().sum();
        let scatter: f64 = gains.iter().map(|g| (g - gain / count).powi(2)).sum();
        let standard_error = (count / (count - 1.0).max(1.0) * scatter).sqrt();
        let best = max_segment_gain(before, after);
        PairedComparison { gain, standard_error, without_best: gain - best }
    }

    /// Returns the reduction of the RMS from `before` to `after`, a value for each row.
    #[must_use]
    pub fn rms_reduction(&self, before: &[f64], after: &[f64]) -> RmsReduction {
        let sums = self.block_sums_of_squares(before, after);
        let of = |[before, after]: [f64; 2]| {
            if before > 0.0 { 1.0 - (after / before).sqrt() } else { 0.0 }
        };
        let add = |a: [f64; 2], b: [f64; 2]| [a[0] + b[0], a[1] + b[1]];
        let value = of(sums.iter().copied().fold([0.0; 2], add));
        let mut generator = RandomGenerator::new(self.count as u64);
        let mut draws: Vec<f64> = (0..BOOTSTRAP_RESAMPLES)
            .map(|_| {
                let drawn = (0..self.count).map(|_| sums[generator.uniform_index(self.count)]);
                of(drawn.fold([0.0; 2], add))
            })
            .collect();
        draws.sort_unstable_by(f64::total_cmp);
        let [low, high, fifth] = [
            BOOTSTRAP_RESAMPLES / 40 - 1,
            BOOTSTRAP_RESAMPLES - BOOTSTRAP_RESAMPLES / 40 - 1,
            BOOTSTRAP_RESAMPLES / 5 - 1,
        ];
        RmsReduction {
            value,
            ci95: [draws[low], draws[high]],
            is_gain: value > 0.0 && draws[fifth] > 0.0,
        }
    }
}

/// Returns the most that one of six parts gains, cut as they come or half a part later; at least 0.
fn max_segment_gain(before: &[f64], after: &[f64]) -> f64 {
    let rows = before.len();
    let mut gains = [vec![0.0; SEGMENT_COUNT + 1], vec![0.0; SEGMENT_COUNT + 1]];
    for (row, (before, after)) in before.iter().zip(after).enumerate() {
        let gain = before * before - after * after;
        gains[0][row * SEGMENT_COUNT / rows] += gain;
        gains[1][(2 * row * SEGMENT_COUNT / rows).div_ceil(2)] += gain;
    }
    gains.iter().flatten().copied().fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_of_the_error_everywhere_is_a_reduction_by_half_whatever_is_drawn() {
        let before: Vec<f64> = (0..200).map(|row| f64::from(row % 7) - 3.0).collect();
        let after: Vec<f64> = before.iter().map(|e| e / 2.0).collect();
        let found = RowBlocks::new(200, 3.0).rms_reduction(&before, &after);
        let all = [found.value, found.ci95[0], found.ci95[1]];
        assert!(all.iter().all(|value| (value - 0.5).abs() < 1e-12) && found.is_gain, "{found:?}");
    }

    #[test]
    fn what_helps_one_block_and_harms_the_others_is_no_gain() {
        let before = vec![1.0; 400];
        let after: Vec<f64> = (0..400).map(|row| if row < 40 { 0.0 } else { 1.05 }).collect();
        let found = RowBlocks::new(400, 1.0).rms_reduction(&before, &after);
        assert!(found.ci95[0] < 0.0 && found.ci95[1] > 0.0, "{found:?}");
    }

    #[test]
    fn what_one_block_alone_gains_is_not_a_gain_beyond_its_standard_error() {
        let before = vec![1.0; 400];
        let blocks = RowBlocks::new(400, 1.0);
        let once: Vec<f64> = (0..400).map(|row| if row < 10 { 0.0 } else { 1.0 }).collect();
        let paired = blocks.compare_paired(&before, &once);
        assert_eq!([paired.gain, paired.without_best], [10.0, 0.0]);
        assert!((paired.standard_error - 10.0).abs() < 1e-9 && !paired.is_better(), "{paired:?}");
        // Over the border of two sixths as well.
        let once: Vec<f64> =
            (0..400).map(|row| if (60..75).contains(&row) { 0.0 } else { 1.0 }).collect();
        assert_eq!(blocks.compare_paired(&before, &once).without_best, 0.0);
        let everywhere: Vec<f64> = (0..400).map(|row| 0.5 + 0.1 * f64::from(row % 3)).collect();
        let paired = blocks.compare_paired(&before, &everywhere);
        assert!(paired.is_better() && paired.without_best > 0.0, "{paired:?}");
    }

    #[test]
    fn blocks_are_five_correlation_times_long_but_at_least_eight_and_at_most_forty() {
        assert_eq!([0.0, 5.0, 1e3].map(|memory| RowBlocks::new(400, memory).count), [40, 16, 8]);
        assert_eq!(RowBlocks::new(5, 0.0).count, 5);
    }
}
