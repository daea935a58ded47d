//! Some of the rows of a table, or means of neighbouring ones, as a table: for the search.

use std::sync::Arc;

use super::{
    data_table::{DataTable, ParentTable, RowLocations, RowPredictions},
    lag_column_cache::LagColumnCache,
    lag_filter::forward_fill,
    row_blocks::RowBlocks,
    row_groups::RowGroups,
    table_columns::{ColumnGroup, NamedColumn},
};

/// Pieces of a group that a search works on in the place of its rows. The mean of what bends over a
/// group is off by 1/24 of the bend over a piece, which is 1/16² of that over the group: 2·10⁻⁴.
const PIECES_PER_GROUP: usize = 16;

impl RowPredictions {
    /// Returns the means over the rows of each block.
    pub(super) fn aggregate_blocks(&self, blocks: &RowBlocks) -> Self {
        let Self { elongation, law, along, axis, thermal } = self;
        let [elongation, law, along, axis, thermal] =
            [elongation, law, along, axis, thermal].map(|values| blocks.means(values).into());
        Self { elongation, law, along, axis, thermal }
    }
}

impl DataTable {
    /// Returns the rows of `mask` alone; what has a memory is still stepped through all of them.
    pub(crate) fn subset(self: &Arc<Self>, mask: &[bool]) -> Self {
        self.aggregate_blocks(RowBlocks::new((0..self.rows).filter(|&row| mask[row]), |_| true))
    }

    /// Means of neighbouring rows of each of `groups`, and the groups that these make; none where a
    /// group has not twice as many rows. Laws with a memory are still stepped through all rows: what is linear in the
    /// columns stays exact.
    pub(crate) fn average_within_groups(
        self: &Arc<Self>,
        groups: &RowGroups,
    ) -> Option<(Self, RowGroups)> {
        (groups.size > 2 * PIECES_PER_GROUP).then(|| {
            let (pieces, whole) = groups.rows.split_blocks(PIECES_PER_GROUP);
            let condensed = self.aggregate_blocks(pieces);
            (condensed, groups.with_row_blocks(whole))
        })
    }

    /// Returns a row for each of `blocks`.
    fn aggregate_blocks(self: &Arc<Self>, blocks: RowBlocks) -> Self {
        let rows = blocks.first_rows();
        let series: Vec<u32> = rows.iter().map(|&row| self.places.series[row]).collect();
        Self {
            setting: self.setting.clone(),
            rows: rows.len(),
            places: RowLocations {
                file: rows.iter().map(|&row| self.places.file[row]).collect(),
                restart: (0..rows.len()).map(|n| n == 0 || series[n] != series[n - 1]).collect(),
                series: series.into(),
            },
            columns: self.columns.aggregate_blocks(&blocks, self.rows),
            measured: blocks.means(&self.measured).into(),
            predicted: self.predicted.aggregate_blocks(&blocks),
            used: rows.iter().map(|&row| self.used[row]).collect(),
            origin: self.origin.clone(),
            notes: Vec::new(),
            distrusted: Vec::new(),
            whole: Some(ParentTable::new(self.clone(), blocks)),
            stepped: LagColumnCache::default(),
        }
    }

    /// Returns the same rows of `whole`: another table than that these were drawn from in some of the temperatures,
    /// and in what the machine's own laws make of them.
    pub(crate) fn with_parent_table(&self, whole: Self) -> Self {
        let Some(before) = &self.whole else { return whole };
        let is_changed = |(name, values): &&NamedColumn| {
            before.data.temperature_c(name).is_none_or(|there| !std::ptr::eq(there, &values[..]))
        };
        let changed: Vec<NamedColumn> =
            whole.temperatures().iter().filter(is_changed).cloned().collect();
        let mut drawn = self.clone();
        for (name, values) in &mut drawn.columns[ColumnGroup::Temperatures] {
            if let Some((_, all)) = changed.iter().find(|(there, _)| there == name) {
                *values = before.aggregate_values(&forward_fill(all)).into();
            }
        }
        drawn.predicted = before.aggregate_predictions(&whole);
        drawn.whole = Some(before.with_data(Arc::new(whole), &changed));
        drawn
    }
}
