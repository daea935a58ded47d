//! The table itself: its columns, and how they are asked for by name.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
};

use trueup_machine::{Machine, effect::Late, file::Quantity, model::part_temperature};

use super::{
    lag::{filled, lag, smoothed},
    lag_series::LagSeries,
    row_blocks::RowBlocks,
    stated::Stated,
};

/// A run's columns, all files one after the other. A list has one value a row; NaN where missing.
#[derive(Clone, Debug)]
pub(crate) struct Data {
    pub machine: Machine,
    pub quantity: Quantity,
    pub rows: usize,
    /// The number of the file of each row.
    pub file: Vec<usize>,
    pub files: usize,
    /// Their names, as the user has given them.
    pub names: Vec<String>,
    /// Rows at which states begin anew: the first of a file, and where time runs back.
    pub restart: Vec<bool>,
    /// The number of the series of each row: files, runs, restarts.
    pub series: Vec<u32>,
    pub time_s: Option<Vec<f64>>,
    /// The gauge's own clock, in s, where the run has it beside `time_s`: the two may differ either way.
    pub gauge_time_s: Option<Vec<f64>>,
    pub run: Option<Vec<f64>>,
    /// By column, in °C.
    pub temperatures: Vec<Column>,
    /// Those of them that did not measure for most of the time, or have jumped.
    pub distrusted: Vec<String>,
    /// Columns that this project does not know.
    pub others: Vec<Column>,
    /// In 1/min.
    pub spindle_rpm: Option<Vec<f64>>,
    /// The load along the tool, in N.
    pub load_n: Option<Vec<f64>>,
    pub position_mm: [Option<Vec<f64>>; 3],
    pub direction: [Option<Vec<f64>>; 3],
    /// What is left of the last reversal of the quantity's own axis if it is taken up over a way, for
    /// several ways, each under its name.
    pub reversal_decay: Vec<Column>,
    /// The quantity, in µm.
    pub measured: Vec<f64>,
    /// The machine file's terms that change the quantity.
    pub stated: Vec<Stated>,
    /// What the constants of the file's terms add to the elongation and to the axis, in µm.
    pub constants_um: [f64; 2],
    /// The elongation by the machine file, in µm.
    pub elongation: Vec<f64>,
    /// The same by the source's own law, without the file's terms.
    pub law: Vec<f64>,
    /// How much of the elongation is in the quantity, −1…1.
    pub along: Vec<f64>,
    pub has_elongation: bool,
    /// The axis's error but for the tool's growth and the file's terms, in µm.
    pub axis: Vec<f64>,
    /// The part of it that goes with the axis's temperature.
    pub thermal: Vec<f64>,
    /// Rows that count: measured and predicted.
    pub used: Vec<bool>,
    /// The temperatures that terms are counted from, by column, and the start of time: those of the
    /// first row that was trained on. A hold-out has its own first row and never refers to it.
    pub references_c: Vec<(String, f64)>,
    pub start_s: f64,
    /// What was set aside before anything was compared, and why: a sentence each.
    pub notes: Vec<String>,
    /// Where these are drawn rows, or means of rows: all of them, for what a row has from the rows
    /// before it.
    pub whole: Option<DrawnFrom>,
}

/// A column's name and values; shared, since most copies of a table change one column or none.
pub(super) type Column = (String, Arc<Vec<f64>>);

/// The table that rows were drawn from.
#[derive(Clone, Debug)]
pub(crate) struct DrawnFrom {
    pub data: Arc<Data>,
    /// Which of its rows each row is, or is the mean of.
    pub(super) blocks: RowBlocks,
    /// Where rows are means: the columns of temperatures that have no gap, for any lag.
    pub(super) series: Vec<(String, Arc<LagSeries>)>,
    /// Columns behind a lag that were asked for, the newest last.
    pub(super) lagged: Arc<Mutex<VecDeque<Lagged>>>,
}

/// A column, how late its thermometer is, and the time constants of its rise and fall, in s; the drawn rows
/// of it.
pub(super) type Lagged = ((String, Option<Late>, [f64; 2]), Vec<f64>);

impl DrawnFrom {
    /// Numbers in the columns that are kept, 8 bytes each: of a few thousand rows enough for a grid of
    /// time constants on each thermometer.
    const MOST_NUMBERS: usize = 2_000_000;

    /// A column of the whole behind a lag, in the drawn rows.
    pub(crate) fn lagged(&self, column: &str, rise_s: f64, fall_s: f64) -> Vec<f64> {
        let series = self.series.iter().find(|(name, _)| name == column && rise_s == fall_s);
        if let (Some((_, series)), Some(values)) = (series, self.data.temperature(column))
            && rise_s > 0.0
        {
            return series.means(values, &self.blocks, rise_s);
        }
        self.known((column.into(), None, [rise_s, fall_s]), || {
            self.data.lagged(column, rise_s, fall_s)
        })
    }

    /// The drawn rows of a column that may have been asked for before; else `make` says what all rows are.
    fn known(
        &self,
        asked: (String, Option<Late>, [f64; 2]),
        make: impl FnOnce() -> Vec<f64>,
    ) -> Vec<f64> {
        let known = || self.lagged.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, values)) = known().iter().find(|(there, _)| *there == asked) {
            return values.clone();
        }
        let values = self.pick(&make());
        let mut known = known();
        known.push_back((asked, values.clone()));
        if known.len() * self.blocks.len() > Self::MOST_NUMBERS {
            known.pop_front();
        }
        values
    }

    /// Of values for all rows, those of the drawn ones, or their means.
    pub(crate) fn pick(&self, all: &[f64]) -> Vec<f64> {
        self.blocks.means(all)
    }
}

impl Data {
    /// The position of the quantity's own axis.
    pub(crate) fn own_position(&self) -> Option<&[f64]> {
        self.quantity.axis().and_then(|axis| self.position_mm[axis.index()].as_deref())
    }

    /// The direction of the quantity's own axis.
    pub(crate) fn own_direction(&self) -> Option<&[f64]> {
        self.quantity.axis().and_then(|axis| self.direction[axis.index()].as_deref())
    }

    /// A column of temperatures, in °C.
    pub(crate) fn temperature(&self, name: &str) -> Option<&[f64]> {
        let found = self.temperatures.iter().find(|(there, _)| there == name);
        found.map(|(_, values)| values.as_slice())
    }

    /// The temperature that a term on `column` is counted from.
    pub(crate) fn reference_c(&self, column: &str) -> f64 {
        let found = self.references_c.iter().find(|(name, _)| name == column);
        found.map_or(0.0, |&(_, reference_c)| reference_c)
    }

    /// Counts from where `training` does.
    pub(crate) fn refer_to(&mut self, training: &Self) {
        self.references_c.clone_from(&training.references_c);
        self.start_s = training.start_s;
    }

    /// The table that these rows were drawn from, where others are missing between them.
    pub(crate) fn drawn(&self) -> Option<&DrawnFrom> {
        self.whole.as_ref().filter(|whole| !whole.blocks.has_means())
    }

    /// The table that these rows were drawn from, or this one: no row is missing between its rows.
    pub(crate) fn without_holes(&self) -> &Self {
        self.drawn().map_or(self, |drawn| &drawn.data)
    }

    /// The rows that were written down for these: where they are means, there were more.
    pub(crate) fn recorded_rows(&self) -> usize {
        let means = self.whole.as_ref().filter(|whole| whole.blocks.has_means());
        means.map_or(self.rows, |whole| whole.data.rows)
    }

    /// A temperature behind a first-order lag with one time constant while it rises and one while it
    /// falls, both in s; missing values hold.
    pub(crate) fn lagged(&self, column: &str, rise_s: f64, fall_s: f64) -> Vec<f64> {
        if let Some(whole) = &self.whole {
            return whole.lagged(column, rise_s, fall_s);
        }
        match (self.temperature(column), self.time_s.as_deref()) {
            (None, _) => vec![0.0; self.rows],
            (Some(values), None) => filled(values),
            (Some(values), Some(time_s)) => lag(values, time_s, &self.restart, [rise_s, fall_s]),
        }
    }

    /// Smooths a temperature over `width_s`, without making it late.
    pub(crate) fn smooth(&mut self, column: &str, width_s: f64) {
        let Some(time_s) = self.time_s.as_deref() else { return };
        let found = self.temperatures.iter_mut().find(|(there, _)| there == column);
        if let Some((_, values)) = found {
            *values = Arc::new(smoothed(values, time_s, &self.restart, width_s));
        }
    }

    /// A temperature behind a lag.
    pub(crate) fn delay(&mut self, column: &str, late_s: f64) {
        let Some(time_s) = self.time_s.as_deref() else { return };
        let found = self.temperatures.iter_mut().find(|(there, _)| there == column);
        if let Some((_, values)) = found {
            *values = Arc::new(lag(values, time_s, &self.restart, [late_s; 2]));
        }
    }

    /// The temperature of the part whose thermometer, in `column`, is late, behind a lag as in
    /// [`Data::lagged`].
    pub(crate) fn followed(
        &self,
        column: &str,
        late: Option<Late>,
        [rise_s, fall_s]: [f64; 2],
    ) -> Vec<f64> {
        let known = |data: &'_ Self| data.temperature(column).is_some() && data.time_s.is_some();
        let Some(late) = late.filter(|_| known(self)) else {
            return self.lagged(column, rise_s, fall_s);
        };
        if let Some(whole) = &self.whole {
            let asked = (column.into(), Some(late), [rise_s, fall_s]);
            return whole
                .known(asked, || whole.data.followed(column, Some(late), [rise_s, fall_s]));
        }
        let shown_c = self.temperature(column).unwrap_or_default();
        let time_s = self.time_s.as_deref().unwrap_or_default();
        let starts = (0..self.rows).filter(|&row| self.restart[row]);
        let ends = (1..self.rows).filter(|&row| self.restart[row]).chain([self.rows]);
        let part_c: Vec<f64> = starts
            .zip(ends)
            .flat_map(|(start, end)| {
                part_temperature(late, &time_s[start..end], &shown_c[start..end])
            })
            .collect();
        lag(&part_c, time_s, &self.restart, [rise_s, fall_s])
    }
}
