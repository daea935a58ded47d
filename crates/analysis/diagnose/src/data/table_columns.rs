//! The columns of a table: what each is called in a run file, and what drawn rows have of it.

use std::{
    ops::{Index, IndexMut},
    sync::Arc,
};

use trueup_machine::machine_file::LinearAxis;
use trueup_numerics::parallel::parallel_map;

use super::{lag_filter::forward_fill, row_blocks::RowBlocks};

/// A column with its name. It is shared by the copies of a table.
pub(crate) type NamedColumn = (String, Arc<[f64]>);

/// Rows from which a column is worth a core of its own.
const MIN_PARALLEL_ROWS: usize = 10_000;

/// A column that the project knows; a run has at most one of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum KnownColumn {
    /// In s.
    Time,
    /// The gauge's own clock, in s, where the run has it next to the time: the two may differ either way.
    GaugeTime,
    Run,
    /// In 1/min.
    Speed,
    /// The load along the tool, in N.
    Load,
    /// In mm.
    Position(LinearAxis),
    /// −1 or 1.
    Direction(LinearAxis),
}

/// Columns of one kind, each under its own name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ColumnGroup {
    /// In °C.
    Temperatures,
    /// Columns that this project does not know.
    Others,
    /// How hard the spindle heats by each power of its speed, by [`heating_column_name`](super::data_table::heating_column_name).
    Heating,
    /// The rest of the last reversal of the quantity's own axis if it is taken up over a way, for several ways.
    Reversal,
}

/// The value of a column in drawn rows, or in means of rows.
#[derive(Clone, Copy)]
enum AggregationRule {
    /// The value of the row, of the first one of a mean.
    First,
    /// The value of the row; where it is missing, the one before it, also if that one is not drawn.
    Held,
    /// The same in means alone.
    HeldInMeans,
    /// The value of the row.
    Picked,
}

impl KnownColumn {
    const ALL: [Self; 11] = {
        use LinearAxis::{X, Y, Z};
        [
            Self::Time,
            Self::GaugeTime,
            Self::Run,
            Self::Speed,
            Self::Load,
            Self::Position(X),
            Self::Position(Y),
            Self::Position(Z),
            Self::Direction(X),
            Self::Direction(Y),
            Self::Direction(Z),
        ]
    };

    /// Returns where it stands in [`Self::ALL`], its name in a run file, and what drawn rows have of it.
    fn descriptor(self) -> (usize, &'static str, AggregationRule) {
        match self {
            Self::Time => (0, "time_s", AggregationRule::HeldInMeans),
            Self::GaugeTime => (1, "gauge_time_s", AggregationRule::HeldInMeans),
            Self::Run => (2, "run", AggregationRule::First),
            Self::Speed => (3, "spindle_rpm", AggregationRule::Held),
            Self::Load => (4, "load_n", AggregationRule::Held),
            Self::Position(axis) => (
                5 + axis.index(),
                ["x_mm", "y_mm", "z_mm"][axis.index()],
                AggregationRule::HeldInMeans,
            ),
            Self::Direction(axis) => (
                8 + axis.index(),
                ["dir_x", "dir_y", "dir_z"][axis.index()],
                AggregationRule::HeldInMeans,
            ),
        }
    }
}

impl ColumnGroup {
    const ALL: [Self; 4] = [Self::Temperatures, Self::Others, Self::Heating, Self::Reversal];

    /// Returns what drawn rows have of its columns.
    fn aggregation_rule(self) -> AggregationRule {
        match self {
            Self::Temperatures | Self::Heating => AggregationRule::Held,
            Self::Others => AggregationRule::HeldInMeans,
            Self::Reversal => AggregationRule::Picked,
        }
    }
}

impl AggregationRule {
    /// Returns the column in the drawn rows.
    fn aggregate(self, values: &[f64], blocks: &RowBlocks) -> Arc<[f64]> {
        match self {
            Self::First => blocks.first_rows().into_iter().map(|row| values[row]).collect(),
            Self::Held => blocks.means(&forward_fill(values)).into(),
            Self::HeldInMeans if blocks.has_multirow_blocks() => {
                Self::Held.aggregate(values, blocks)
            }
            Self::HeldInMeans | Self::Picked => blocks.means(values).into(),
        }
    }
}

/// All columns of a table. A column has one value a row; NaN where missing.
#[derive(Clone, Debug, Default)]
pub(crate) struct TableColumns {
    known: [Option<Arc<[f64]>>; KnownColumn::ALL.len()],
    lists: [Vec<NamedColumn>; ColumnGroup::ALL.len()],
}

impl TableColumns {
    /// Returns the known ones, each read by its name in a run file.
    pub(super) fn from_fn(column: impl Fn(&str) -> Option<Arc<[f64]>>) -> Self {
        Self {
            known: KnownColumn::ALL.map(|known| column(known.descriptor().1)),
            lists: Default::default(),
        }
    }

    /// Returns a known one by its name in a run file.
    pub(crate) fn by_name(&self, name: &str) -> Option<&[f64]> {
        let known = KnownColumn::ALL.into_iter().find(|known| known.descriptor().1 == name)?;
        self[known].as_deref()
    }

    /// Returns those of drawn rows, or of means of rows.
    pub(super) fn aggregate_blocks(&self, blocks: &RowBlocks, rows: usize) -> Self {
        let known = |known: KnownColumn| {
            let (place, _, drawn) = known.descriptor();
            self.known[place].as_deref().map(|values| drawn.aggregate(values, blocks))
        };
        let list = |list: ColumnGroup| {
            let drawn = list.aggregation_rule();
            let of = |(name, values): &NamedColumn| (name.clone(), drawn.aggregate(values, blocks));
            parallel_map(&self[list], rows > MIN_PARALLEL_ROWS, of)
        };
        Self { known: KnownColumn::ALL.map(known), lists: ColumnGroup::ALL.map(list) }
    }
}

impl Index<KnownColumn> for TableColumns {
    type Output = Option<Arc<[f64]>>;

    fn index(&self, known: KnownColumn) -> &Self::Output {
        &self.known[known.descriptor().0]
    }
}

impl IndexMut<KnownColumn> for TableColumns {
    fn index_mut(&mut self, known: KnownColumn) -> &mut Self::Output {
        &mut self.known[known.descriptor().0]
    }
}

impl Index<ColumnGroup> for TableColumns {
    type Output = Vec<NamedColumn>;

    fn index(&self, list: ColumnGroup) -> &Self::Output {
        &self.lists[list as usize]
    }
}

impl IndexMut<ColumnGroup> for TableColumns {
    fn index_mut(&mut self, list: ColumnGroup) -> &mut Self::Output {
        &mut self.lists[list as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_column_stands_where_it_is_declared() {
        for (number, known) in KnownColumn::ALL.into_iter().enumerate() {
            assert_eq!(known.descriptor().0, number, "{known:?}");
        }
        for (number, list) in ColumnGroup::ALL.into_iter().enumerate() {
            assert_eq!(list as usize, number, "{list:?}");
        }
        let columns =
            TableColumns::from_fn(|name| (name != "run").then(|| [name.len() as f64].into()));
        assert_eq!((columns.by_name("dir_z"), columns.by_name("run")), (Some(&[5.0][..]), None));
    }

    #[test]
    fn drawn_rows_have_of_each_kind_what_it_says() {
        let columns = TableColumns {
            lists: ColumnGroup::ALL
                .map(|_| vec![(String::new(), [1.0, f64::NAN, 3.0, 5.0].into())]),
            ..TableColumns::from_fn(|_| Some([1.0, f64::NAN, 3.0, 5.0].into()))
        };
        let rows = RowBlocks::new(1..4, |_| true);
        let means = RowBlocks::new(1..4, |row| row != 2);
        let text = |values: &[f64]| format!("{values:?}");
        let values_in = |blocks: &RowBlocks| {
            let of = columns.aggregate_blocks(blocks, 4);
            let known = [KnownColumn::Time, KnownColumn::Run, KnownColumn::Speed]
                .map(|column| of[column].clone());
            let mut all = known.map(|column| text(&column.expect("each is there"))).to_vec();
            all.extend(ColumnGroup::ALL.map(|list| text(&of[list][0].1)));
            all
        };
        let [picked, held] = ["[NaN, 3.0, 5.0]", "[1.0, 3.0, 5.0]"];
        assert_eq!(values_in(&rows), [picked, picked, held, held, picked, held, picked]);
        let [first, picked, held] = ["[NaN, 5.0]", "[NaN, 5.0]", "[2.0, 5.0]"];
        assert_eq!(values_in(&means), [held, first, held, held, held, held, picked]);
    }
}
