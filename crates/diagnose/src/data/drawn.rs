//! Some of the rows of a table, or means of neighbouring ones, as a table: for the search.

use std::sync::Arc;

use trueup_numerics::parallel::on_all_cores;

use super::{
    groups::Groups,
    lag::filled,
    lag_series::{Clock, LagSeries},
    row_blocks::RowBlocks,
    table::{Column, Data, DrawnFrom},
};

/// Pieces of a group that a search works on in the place of its rows. The mean of what bends over a
/// group is off by 1/24 of the bend over a piece, which is 1/16² of that over the group: 2·10⁻⁴.
const PIECES: usize = 16;

impl Data {
    /// The rows of `mask` alone; what has a memory is still stepped through all of them.
    pub(crate) fn subset(self: &Arc<Self>, mask: &[bool]) -> Self {
        self.of_blocks(RowBlocks::new((0..self.rows).filter(|&row| mask[row]), |_| true))
    }

    /// Means of neighbouring rows of each of `groups`, and the groups that these make; none where a
    /// group has not twice as many rows. What has a memory is still stepped through all rows: what is
    /// linear in the columns stays exact.
    pub(crate) fn condensed(self: &Arc<Self>, groups: &Groups) -> Option<(Self, Groups)> {
        (groups.size > 2 * PIECES).then(|| {
            let (pieces, whole) = groups.rows.cut(PIECES);
            let condensed = self.of_blocks(pieces);
            (condensed, groups.of(whole))
        })
    }

    /// A row for each of `blocks`.
    fn of_blocks(self: &Arc<Self>, blocks: RowBlocks) -> Self {
        let rows = blocks.first_rows();
        let is_condensed = blocks.has_means();
        let pick = |values: &Vec<f64>| -> Vec<f64> { blocks.means(values) };
        // A missing value holds the one before it, also if that one is not drawn.
        let hold = |values: &Vec<f64>| -> Vec<f64> { pick(&filled(values)) };
        let held = |values: &Option<Vec<f64>>| values.as_ref().map(hold);
        let maybe = |values: &Option<Vec<f64>>| {
            values.as_ref().map(if is_condensed { &hold as &dyn Fn(&Vec<f64>) -> _ } else { &pick })
        };
        let first = |values: &Option<Vec<f64>>| -> Option<Vec<f64>> {
            values.as_ref().map(|values| rows.iter().map(|&row| values[row]).collect())
        };
        let named = |columns: &[Column], of: &dyn Fn(&Vec<f64>) -> Vec<f64>| {
            columns.iter().map(|(name, values)| (name.clone(), Arc::new(of(values)))).collect()
        };
        let lags = self.lag_series(&blocks, &self.temperatures);
        let series: Vec<u32> = rows.iter().map(|&row| self.series[row]).collect();
        Self {
            rows: rows.len(),
            file: rows.iter().map(|&row| self.file[row]).collect(),
            restart: (0..rows.len()).map(|n| n == 0 || series[n] != series[n - 1]).collect(),
            series,
            time_s: maybe(&self.time_s),
            gauge_time_s: maybe(&self.gauge_time_s),
            run: first(&self.run),
            temperatures: named(&self.temperatures, &hold),
            distrusted: Vec::new(),
            others: named(&self.others, if is_condensed { &hold } else { &pick }),
            spindle_rpm: held(&self.spindle_rpm),
            load_n: held(&self.load_n),
            position_mm: self.position_mm.each_ref().map(maybe),
            direction: self.direction.each_ref().map(maybe),
            reversal_decay: named(&self.reversal_decay, &pick),
            measured: pick(&self.measured),
            stated: self.stated.clone(),
            constants_um: self.constants_um,
            elongation: pick(&self.elongation),
            law: pick(&self.law),
            along: pick(&self.along),
            axis: pick(&self.axis),
            thermal: pick(&self.thermal),
            used: rows.iter().map(|&row| self.used[row]).collect(),
            machine: self.machine.clone(),
            quantity: self.quantity,
            files: self.files,
            names: self.names.clone(),
            has_elongation: self.has_elongation,
            references_c: self.references_c.clone(),
            start_s: self.start_s,
            notes: Vec::new(),
            whole: Some(DrawnFrom {
                data: self.clone(),
                series: lags,
                blocks,
                lagged: Arc::default(),
            }),
        }
    }

    /// The same rows of `whole`: another table than that these were drawn from in some of the temperatures,
    /// and in what the machine's own laws make of them.
    pub(crate) fn drawn_from(&self, whole: Self) -> Self {
        let Some(before) = &self.whole else { return whole };
        let blocks = before.blocks.clone();
        let is_changed = |(name, values): &&Column| {
            before
                .data
                .temperature(name)
                .is_none_or(|there| !std::ptr::eq(there, values.as_slice()))
        };
        let changed: Vec<Column> = whole.temperatures.iter().filter(is_changed).cloned().collect();
        let pick = |values: &[f64]| blocks.means(values);
        let mut drawn = self.clone();
        for (name, values) in &mut drawn.temperatures {
            if let Some((_, all)) = changed.iter().find(|(there, _)| there == name) {
                *values = Arc::new(pick(&filled(all)));
            }
        }
        (drawn.elongation, drawn.law) = (pick(&whole.elongation), pick(&whole.law));
        (drawn.axis, drawn.thermal) = (pick(&whole.axis), pick(&whole.thermal));
        let mut series = before.series.clone();
        series.retain(|(name, _)| !changed.iter().any(|(there, _)| there == name));
        series.extend(whole.lag_series(&blocks, &changed));
        drawn.whole =
            Some(DrawnFrom { data: Arc::new(whole), series, blocks, lagged: Arc::default() });
        drawn
    }

    /// Of each of `columns` that has no gap, where rows are means.
    fn lag_series(&self, blocks: &RowBlocks, columns: &[Column]) -> Vec<(String, Arc<LagSeries>)> {
        if !blocks.has_means() {
            return Vec::new();
        }
        let times = self.time_s.as_deref();
        let Some(clock) = times.and_then(|times| Clock::new(times, &self.restart, blocks)) else {
            return Vec::new();
        };
        let clock = Arc::new(clock);
        let of = |(name, values): &Column| {
            Some((name.clone(), Arc::new(LagSeries::new(&clock, values, blocks)?)))
        };
        let all = on_all_cores(columns, true, of);
        all.into_iter().flatten().collect()
    }
}
