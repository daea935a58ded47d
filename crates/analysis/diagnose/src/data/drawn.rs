//! Some of the rows of a table, or means of neighbouring ones, as a table: for the search.

use std::sync::Arc;

use trueup_numerics::parallel::on_all_cores;

use super::{
    groups::Groups,
    lag::filled,
    row_blocks::RowBlocks,
    stepped::Stepped,
    table::{Column, Data, DrawnFrom},
};

/// Pieces of a group that a search works on in the place of its rows. The mean of what bends over a
/// group is off by 1/24 of the bend over a piece, which is 1/16² of that over the group: 2·10⁻⁴.
const PIECES: usize = 16;

/// Rows from which a column is worth a core of its own.
const WORTH_CORES: usize = 10_000;

type Shared = Arc<[f64]>;

impl Data {
    /// Returns the rows of `mask` alone; what has a memory is still stepped through all of them.
    pub(crate) fn subset(self: &Arc<Self>, mask: &[bool]) -> Self {
        self.of_blocks(RowBlocks::new((0..self.rows).filter(|&row| mask[row]), |_| true))
    }

    /// Means of neighbouring rows of each of `groups`, and the groups that these make; none where a
    /// group has not twice as many rows. Laws with a memory are still stepped through all rows: what is linear in the
    /// columns stays exact.
    pub(crate) fn condensed(self: &Arc<Self>, groups: &Groups) -> Option<(Self, Groups)> {
        (groups.size > 2 * PIECES).then(|| {
            let (pieces, whole) = groups.rows.cut(PIECES);
            let condensed = self.of_blocks(pieces);
            (condensed, groups.of(whole))
        })
    }

    /// Returns a row for each of `blocks`.
    fn of_blocks(self: &Arc<Self>, blocks: RowBlocks) -> Self {
        let rows = blocks.first_rows();
        let is_condensed = blocks.has_means();
        let pick = |values: &[f64]| -> Vec<f64> { blocks.means(values) };
        // A missing value holds the one before it, also if that one is not drawn.
        let hold = |values: &[f64]| -> Vec<f64> { pick(&filled(values)) };
        let held = |values: &Option<Shared>| values.as_deref().map(|it| Shared::from(hold(it)));
        let maybe = |values: &Option<Shared>| {
            let of = |it| if is_condensed { hold(it) } else { pick(it) };
            values.as_deref().map(|it| Shared::from(of(it)))
        };
        let first = |values: &Option<Shared>| -> Option<Shared> {
            values.as_ref().map(|values| rows.iter().map(|&row| values[row]).collect())
        };
        let named = |columns: &[Column], of: &(dyn Fn(&[f64]) -> Vec<f64> + Sync)| {
            let of = |(name, values): &Column| (name.clone(), of(values).into());
            on_all_cores(columns, self.rows > WORTH_CORES, of)
        };
        let series: Vec<u32> = rows.iter().map(|&row| self.series[row]).collect();
        Self {
            rows: rows.len(),
            file: rows.iter().map(|&row| self.file[row]).collect(),
            restart: (0..rows.len()).map(|n| n == 0 || series[n] != series[n - 1]).collect(),
            series: series.into(),
            time_s: maybe(&self.time_s),
            gauge_time_s: maybe(&self.gauge_time_s),
            run: first(&self.run),
            temperatures: named(&self.temperatures, &hold),
            distrusted: Vec::new(),
            others: named(&self.others, if is_condensed { &hold } else { &pick }),
            spindle_rpm: held(&self.spindle_rpm),
            drives: named(&self.drives, &hold),
            load_n: held(&self.load_n),
            position_mm: self.position_mm.each_ref().map(maybe),
            direction: self.direction.each_ref().map(maybe),
            reversal_decay: named(&self.reversal_decay, &pick),
            measured: pick(&self.measured).into(),
            stated: self.stated.clone(),
            constants_um: self.constants_um,
            elongation: pick(&self.elongation),
            law: pick(&self.law),
            along: pick(&self.along).into(),
            axis: pick(&self.axis),
            thermal: pick(&self.thermal),
            used: rows.iter().map(|&row| self.used[row]).collect(),
            machine: self.machine.clone(),
            quantity: self.quantity,
            files: self.files,
            is_one_pass: self.is_one_pass,
            names: self.names.clone(),
            has_elongation: self.has_elongation,
            references_c: self.references_c.clone(),
            start_s: self.start_s,
            notes: Vec::new(),
            whole: Some(DrawnFrom::new(self.clone(), blocks)),
            stepped: Stepped::default(),
        }
    }

    /// Returns the same rows of `whole`: another table than that these were drawn from in some of the temperatures,
    /// and in what the machine's own laws make of them.
    pub(crate) fn drawn_from(&self, whole: Self) -> Self {
        let Some(before) = &self.whole else { return whole };
        let is_changed = |(name, values): &&Column| {
            before.data.temperature(name).is_none_or(|there| !std::ptr::eq(there, &values[..]))
        };
        let changed: Vec<Column> = whole.temperatures.iter().filter(is_changed).cloned().collect();
        let pick = |values: &[f64]| before.pick(values);
        let mut drawn = self.clone();
        for (name, values) in &mut drawn.temperatures {
            if let Some((_, all)) = changed.iter().find(|(there, _)| there == name) {
                *values = pick(&filled(all)).into();
            }
        }
        (drawn.elongation, drawn.law) = (pick(&whole.elongation), pick(&whole.law));
        (drawn.axis, drawn.thermal) = (pick(&whole.axis), pick(&whole.thermal));
        drawn.whole = Some(before.of(Arc::new(whole), &changed));
        drawn
    }
}
