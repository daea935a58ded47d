//! Blocks of rows that follow each other, and the mean of a column in each.

/// Rows, rising, put together in blocks; rows in none of them do not count.
#[derive(Clone, Debug, Default)]
pub(crate) struct RowBlocks {
    rows: Vec<u32>,
    /// Where each block ends among `rows`.
    ends: Vec<u32>,
    /// The weight of each of `rows`; none: 1 each.
    weights: Option<Vec<f64>>,
}

impl RowBlocks {
    /// Blocks of these rows; `begins`: whether a row is the first of a new block.
    pub(super) fn new(
        rows: impl Iterator<Item = usize>,
        mut begins: impl FnMut(usize) -> bool,
    ) -> Self {
        let mut it = Self::default();
        for row in rows {
            if begins(row) && !it.rows.is_empty() {
                it.ends.push(it.rows.len() as u32);
            }
            it.rows.push(row as u32);
        }
        if !it.rows.is_empty() {
            it.ends.push(it.rows.len() as u32);
        }
        it.rows.shrink_to_fit();
        it
    }

    /// Returns how many blocks there are.
    pub(crate) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Returns whether a block has more than one row.
    pub(super) fn has_multirow_blocks(&self) -> bool {
        self.len() < self.rows.len()
    }

    /// Where each block stands among the rows.
    fn block_ranges(&self) -> impl Iterator<Item = std::ops::Range<usize>> {
        let mut start = 0;
        self.ends.iter().map(move |&end| std::mem::replace(&mut start, end as usize)..end as usize)
    }

    /// Returns the rows of each block.
    pub(super) fn rows_by_block(&self) -> impl Iterator<Item = &[u32]> {
        self.block_ranges().map(|block| &self.rows[block])
    }

    /// Returns the first row of each block.
    pub(super) fn first_rows(&self) -> Vec<usize> {
        self.block_ranges().map(|block| self.rows[block.start] as usize).collect()
    }

    /// Returns what each block counts for: its rows.
    pub(super) fn block_weights(&self) -> Vec<f64> {
        let weigh = |block: std::ops::Range<usize>| match &self.weights {
            None => block.len() as f64,
            Some(weights) => weights[block].iter().sum(),
        };
        self.block_ranges().map(weigh).collect()
    }

    /// Returns the mean of `values`, one a row of the table, in each block.
    pub(crate) fn means(&self, values: &[f64]) -> Vec<f64> {
        if !self.has_multirow_blocks() {
            return self.rows.iter().map(|&row| values[row as usize]).collect();
        }
        self.block_ranges()
            .map(|block| match &self.weights {
                None => self.block_sum(block.clone(), values) / block.len() as f64,
                Some(weights) => {
                    let (rows, weights) = (&self.rows[block.clone()], &weights[block]);
                    let weighted =
                        rows.iter().zip(weights).map(|(&row, w)| w * values[row as usize]);
                    weighted.sum::<f64>() / weights.iter().sum::<f64>()
                }
            })
            .collect()
    }

    fn block_sum(&self, block: std::ops::Range<usize>, values: &[f64]) -> f64 {
        let rows = &self.rows[block];
        let (first, last) = (rows[0] as usize, rows[rows.len() - 1] as usize);
        if last - first + 1 == rows.len() {
            return sum_in_lanes(&values[first..=last]);
        }
        rows.iter().map(|&row| values[row as usize]).sum()
    }

    /// Returns each block cut into at most `pieces`, and how the pieces, a row each, make up the blocks again:
    /// a mean over them is the mean over all rows.
    pub(super) fn split_blocks(&self, pieces: usize) -> (Self, Self) {
        let mut fine = Self { rows: self.rows.clone(), ends: Vec::new(), weights: None };
        let mut whole = Self::default();
        let mut weights = Vec::new();
        for block in self.block_ranges() {
            let size = block.len().div_ceil(pieces);
            for start in block.clone().step_by(size) {
                let end = (start + size).min(block.end);
                whole.rows.push(fine.ends.len() as u32);
                fine.ends.push(end as u32);
                weights.push((end - start) as f64);
            }
            whole.ends.push(fine.ends.len() as u32);
        }
        whole.weights = Some(weights);
        (fine, whole)
    }
}

/// Σ values, in eight sums side by side: one sum alone waits for each addition.
fn sum_in_lanes(values: &[f64]) -> f64 {
    const SIMD_LANES: usize = 8;
    let chunks = values.chunks_exact(SIMD_LANES);
    let rest: f64 = chunks.remainder().iter().sum();
    let mut sums = [0.0; SIMD_LANES];
    for chunk in chunks {
        for lane in 0..SIMD_LANES {
            sums[lane] += chunk[lane];
        }
    }
    sums.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_of_pieces_make_the_means_of_the_blocks() {
        let rows = (0..1000).filter(|row| row % 13 != 5);
        let blocks = RowBlocks::new(rows, |row| row % 100 == 0 || row == 150);
        let values: Vec<f64> = (0..1000).map(|row| f64::from(row * row % 89)).collect();
        let (fine, whole) = blocks.split_blocks(7);
        assert!(fine.len() > 5 * blocks.len() && fine.len() <= 7 * blocks.len());
        assert_eq!(whole.block_weights(), blocks.block_weights());
        let means = whole.means(&fine.means(&values));
        for (mean, plain) in means.iter().zip(blocks.means(&values)) {
            assert!((mean - plain).abs() < 1e-12 * plain, "{mean} {plain}");
        }
        let second: Vec<f64> = (100..150).filter(|row| row % 13 != 5).map(|n| values[n]).collect();
        let exact = second.iter().sum::<f64>() / second.len() as f64;
        assert!((blocks.means(&values)[1] - exact).abs() < 1e-12 * exact);
    }
}
