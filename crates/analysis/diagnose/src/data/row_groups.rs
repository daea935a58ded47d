//! Neighbouring rows put together, so that a search costs no more where more was written down.

use trueup_numerics::noise::RowSpacings;

use super::{data_table::DataTable, row_blocks::RowBlocks};

/// Rows put together for the search: `size` neighbours of one series are one group, so that its cost
/// does not depend on how often a slow thing was written down. Linear laws stay exact: means of
/// what was measured are compared with means of what is predicted.
#[derive(Clone, Debug)]
pub(crate) struct RowGroups {
    pub(super) rows: RowBlocks,
    count: Vec<f64>,
    /// Rows in a full group.
    pub size: usize,
    /// Mean row number of each group.
    pub steps: RowSpacings,
    /// The first row of each group.
    pub first_row: Vec<usize>,
}

impl RowGroups {
    /// Groups of `size` rows.
    pub(crate) fn new(data: &DataTable, used: &[bool], size: usize) -> Self {
        let mut open: Option<(u32, usize)> = None;
        let rows = RowBlocks::new((0..data.rows).filter(|&row| used[row]), |row| match &mut open {
            Some((series, in_group)) if *series == data.places.series[row] && *in_group < size => {
                *in_group += 1;
                false
            }
            _ => {
                open = Some((data.places.series[row], 1));
                true
            }
        });
        let first_row = rows.first_rows();
        let series: Vec<u32> = first_row.iter().map(|&row| data.places.series[row]).collect();
        let time = |row: usize| {
            let time = data.time_s().map_or(row as f64, |times| times[row]);
            if time.is_nan() { row as f64 } else { time }
        };
        let clock = rows.means(&(0..data.rows).map(time).collect::<Vec<f64>>());
        Self {
            count: rows.block_weights(),
            size,
            steps: group_spacings(&clock, &series),
            first_row,
            rows,
        }
    }

    /// Returns the same groups of a table whose rows `rows` puts together.
    pub(super) fn with_row_blocks(&self, rows: RowBlocks) -> Self {
        Self { first_row: rows.first_rows(), rows, ..self.clone() }
    }

    pub(crate) fn len(&self) -> usize {
        self.count.len()
    }

    /// Rows in all groups.
    pub(crate) fn row_count(&self) -> f64 {
        self.count.iter().sum()
    }

    /// Returns the mean of `values` in each group.
    pub(crate) fn means(&self, values: &[f64]) -> Vec<f64> {
        self.rows.means(values)
    }
}

/// Returns how far each group is from the one before in median steps, by the mean times of both.
fn group_spacings(clock: &[f64], series: &[u32]) -> RowSpacings {
    let gap = |group: usize| clock[group] - clock[group - 1];
    let is_next = |group: usize| group > 0 && series[group] == series[group - 1];
    let mut gaps: Vec<f64> =
        (1..clock.len()).filter(|&n| is_next(n)).map(gap).filter(|&gap| gap > 0.0).collect();
    gaps.sort_unstable_by(f64::total_cmp);
    let step = gaps.get(gaps.len() / 2).copied().unwrap_or(1.0);
    let steps = (0..clock.len()).map(|group| {
        if is_next(group) {
            // Rows at one time are still one after the other; and what a pause does to the noise is
            // not known: it is not believed to end it.
            (gap(group) / step).clamp(0.1, 2.0)
        } else {
            f64::INFINITY
        }
    });
    RowSpacings(steps.collect())
}
