//! The table itself: its columns, and how they are asked for by name.

use std::sync::Arc;

use trueup_machine::{
    Machine,
    effect::{Late, SpeedPower},
    file::Quantity,
    model::part_temperature,
};

use super::{
    lag::{Start, filled, lag, smoothed},
    lags::{Lags, Rows},
    row_blocks::RowBlocks,
    stated::Stated,
    stepped::{Source, Stepped},
};

pub(super) use super::lags::Column;

/// A run's columns, all files one after the other. A list has one value a row; NaN where missing. Columns that stay as
/// they were read are shared by the copies of a table.
#[derive(Clone, Debug)]
pub(crate) struct Data {
    pub machine: Machine,
    pub quantity: Quantity,
    pub rows: usize,
    /// The number of the file of each row.
    pub file: Arc<[u32]>,
    pub files: usize,
    /// Their names, as the user has given them.
    pub names: Vec<String>,
    /// Rows at which states begin anew: the first of a file, and where time runs back.
    pub restart: Arc<[bool]>,
    /// The number of the series of each row: files, runs, restarts.
    pub series: Arc<[u32]>,
    pub time_s: Option<Arc<[f64]>>,
    /// The gauge's own clock, in s, where the run has it next to `time_s`: the two may differ either way.
    pub gauge_time_s: Option<Arc<[f64]>>,
    pub run: Option<Arc<[f64]>>,
    /// By column, in °C.
    pub temperatures: Vec<Column>,
    /// Those of them that did not measure for most of the time, or have jumped.
    pub distrusted: Vec<String>,
    /// Columns that this project does not know.
    pub others: Vec<Column>,
    /// Whether the own axis went one way all the time: an error along it and a drift are one question.
    pub is_one_pass: bool,
    /// In 1/min.
    pub spindle_rpm: Option<Arc<[f64]>>,
    /// How hard the spindle heats by each power of its speed, by [`drive`].
    pub drives: Vec<Column>,
    /// The load along the tool, in N.
    pub load_n: Option<Arc<[f64]>>,
    pub position_mm: [Option<Arc<[f64]>>; 3],
    pub direction: [Option<Arc<[f64]>>; 3],
    /// The rest of the last reversal of the quantity's own axis if it is taken up over a way, for
    /// several ways, each under its name.
    pub reversal_decay: Vec<Column>,
    /// The quantity, in µm.
    pub measured: Arc<[f64]>,
    /// The machine file's terms that change the quantity.
    pub stated: Vec<Stated>,
    /// The sums that the constants of the file's terms add to the elongation and to the axis, in µm.
    pub constants_um: [f64; 2],
    /// The elongation by the machine file, in µm.
    pub elongation: Vec<f64>,
    /// The same by the source's own law, without the file's terms.
    pub law: Vec<f64>,
    /// How much of the elongation is in the quantity, −1…1.
    pub along: Arc<[f64]>,
    pub has_elongation: bool,
    /// The axis's error but for the tool's growth and the file's terms, in µm.
    pub axis: Vec<f64>,
    /// The part of it that goes with the axis's temperature.
    pub thermal: Vec<f64>,
    /// Rows that count: measured and predicted.
    pub used: Arc<[bool]>,
    /// The temperatures that terms are counted from, by column, and the start of time: those of the
    /// first row that was trained on. A hold-out has its own first row and never refers to it.
    pub references_c: Vec<(String, f64)>,
    pub start_s: f64,
    /// Data that were set aside before anything was compared, and why: a sentence each.
    pub notes: Vec<String>,
    /// Where these are drawn rows, or means of rows: all of them, for what a row has from the rows
    /// before it.
    pub whole: Option<DrawnFrom>,
    /// Its temperatures that were stepped through all rows.
    pub(super) stepped: Stepped,
}

/// The table that rows were drawn from, or are means of.
#[derive(Clone, Debug)]
pub(crate) struct DrawnFrom {
    pub data: Arc<Data>,
    /// Which of its rows each row is, or is the mean of.
    blocks: RowBlocks,
    /// Its temperatures behind lags, in these rows.
    lags: Lags,
}

/// Returns the name of the column of what the speed heats by this power.
pub(super) fn drive(power: SpeedPower) -> &'static str {
    match power {
        SpeedPower::First => "heating by the speed",
        SpeedPower::Second => "heating by the square of the speed",
    }
}

impl DrawnFrom {
    pub(super) fn new(data: Arc<Data>, blocks: RowBlocks) -> Self {
        let columns = [&data.temperatures[..], &data.drives].concat();
        let lags = Lags::new(data.among(&blocks), &columns);
        Self { data, blocks, lags }
    }

    /// Returns the same rows of `data`: another table than before in the temperatures of `changed`.
    pub(super) fn of(&self, data: Arc<Data>, changed: &[Column]) -> Self {
        let lags = self.lags.changed(data.among(&self.blocks), changed);
        Self { data, blocks: self.blocks.clone(), lags }
    }

    /// Returns a column of the whole behind a lag, in the drawn rows.
    fn lagged(&self, column: &str, lags_s @ [rise_s, fall_s]: [f64; 2]) -> Arc<Vec<f64>> {
        let (values, start) = self.data.heated_by(column).unzip();
        let values = (column, values.map(|it| &it[..]), start.unwrap_or(Start::Settled));
        self.lags.lagged(&self.blocks, values, lags_s, || self.data.lagged(column, rise_s, fall_s))
    }

    /// Returns the same for the temperature of the part whose thermometer is late.
    fn followed(&self, column: &str, late: Late, lags_s: [f64; 2]) -> Arc<Vec<f64>> {
        let lagged = || self.lagged(column, lags_s);
        let stepped = || self.data.followed(column, Some(late), lags_s);
        self.lags.followed(&self.blocks, column, late, lags_s, lagged, stepped)
    }

    /// Returns which of its rows each row is, or begins with.
    pub(crate) fn rows(&self) -> Vec<usize> {
        self.blocks.first_rows()
    }

    /// Of values for all rows, those of the drawn ones, or their means.
    pub(crate) fn pick(&self, all: &[f64]) -> Vec<f64> {
        self.blocks.means(all)
    }
}

impl Data {
    /// Returns the table without the terms of the machine file that the board does not run; `None`: there are none.
    pub(crate) fn compensated(&self) -> Option<Self> {
        let is_run = |stated: &Stated| stated.effect.is_compensated();
        if self.stated.iter().all(is_run) {
            return None;
        }
        let mut data = self.clone();
        data.stated.retain(is_run);
        data.constants_um = Stated::constants_um(&self.machine.compensated(), self.quantity);
        Some(data)
    }

    /// Returns the position of the quantity's own axis.
    pub(crate) fn own_position(&self) -> Option<&[f64]> {
        self.quantity.axis().and_then(|axis| self.position_mm[axis.index()].as_deref())
    }

    /// Returns the direction of the quantity's own axis.
    pub(crate) fn own_direction(&self) -> Option<&[f64]> {
        self.quantity.axis().and_then(|axis| self.direction[axis.index()].as_deref())
    }

    /// Returns a column of temperatures, in °C.
    pub(crate) fn temperature(&self, name: &str) -> Option<&[f64]> {
        let found = self.temperatures.iter().find(|(there, _)| there == name);
        found.map(|(_, values)| &values[..])
    }

    /// Returns the temperature that a term on `column` is counted from.
    pub(crate) fn reference_c(&self, column: &str) -> f64 {
        let found = self.references_c.iter().find(|(name, _)| name == column);
        found.map_or(0.0, |&(_, reference_c)| reference_c)
    }

    /// Counts from where `training` does.
    pub(crate) fn refer_to(&mut self, training: &Self) {
        self.references_c.clone_from(&training.references_c);
        self.start_s = training.start_s;
    }

    /// Returns the table that these rows were drawn from, where others are missing between them.
    pub(crate) fn drawn(&self) -> Option<&DrawnFrom> {
        self.whole.as_ref().filter(|whole| !whole.blocks.has_means())
    }

    /// Returns the table that these rows were drawn from, or this one: no row is missing between its rows.
    pub(crate) fn without_holes(&self) -> &Self {
        self.drawn().map_or(self, |drawn| &drawn.data)
    }

    /// Returns the rows that were written down for these: where they are means, there were more.
    pub(crate) fn recorded_rows(&self) -> usize {
        let means = self.whole.as_ref().filter(|whole| whole.blocks.has_means());
        means.map_or(self.rows, |whole| whole.data.rows)
    }

    /// Its rows, of which those in `blocks` are asked for.
    fn among<'t>(&'t self, blocks: &'t RowBlocks) -> Rows<'t> {
        Rows { time_s: self.time_s.as_deref(), restart: &self.restart, blocks }
    }

    /// Returns the fastest lag that is looked for in this many rows, in s; 0 where any is.
    pub(crate) fn fastest_lag_s(&self) -> f64 {
        self.whole.as_ref().map_or(0.0, |whole| whole.lags.fastest_s())
    }

    /// Returns a temperature, or a power of the speed that heats, and where a lag of it starts.
    fn heated_by(&self, name: &str) -> Option<(&Arc<[f64]>, Start)> {
        let starts = [(&self.temperatures, Start::Settled), (&self.drives, Start::Cold)];
        starts.into_iter().find_map(|(columns, start)| {
            let found = columns.iter().find(|(there, _)| there == name);
            found.map(|(_, values)| (values, start))
        })
    }

    /// Returns what the spindle heats by this power of its speed, behind a first-order lag that starts cold.
    pub(crate) fn heated(&self, power: SpeedPower, lag_s: f64) -> Arc<Vec<f64>> {
        self.lagged(drive(power), lag_s, lag_s)
    }

    /// Returns a temperature behind a first-order lag with one time constant while it rises and one while it
    /// falls, both in s; missing values hold.
    pub(crate) fn lagged(&self, column: &str, rise_s: f64, fall_s: f64) -> Arc<Vec<f64>> {
        if let Some(whole) = &self.whole {
            return whole.lagged(column, [rise_s, fall_s]);
        }
        match (self.heated_by(column), self.source(column)) {
            (None, _) => vec![0.0; self.rows].into(),
            (Some((values, _)), None) => filled(values).into(),
            (Some(_), Some(source)) => self.stepped(&source, None, [rise_s, fall_s]),
        }
    }

    /// Returns what a temperature is stepped through, where there is time.
    fn source(&self, column: &str) -> Option<Source> {
        let (values, start) = self.heated_by(column)?;
        let time_s = self.time_s.clone()?;
        Some(Source { values: values.clone(), time_s, restart: self.restart.clone(), start })
    }

    /// Returns a temperature, or that of the part whose thermometer is late, behind a lag, stepped through all rows.
    fn stepped(&self, source: &Source, late: Option<Late>, lags_s: [f64; 2]) -> Arc<Vec<f64>> {
        let behind =
            |values: &[f64]| lag(values, &source.time_s, &source.restart, lags_s, source.start);
        self.stepped.known(source, (late, Some(lags_s)), || match late {
            None => behind(&source.values),
            Some(late) => behind(&self.part_c(source, late)),
        })
    }

    /// Returns the temperature of the part whose thermometer is late, series by series.
    fn part_c(&self, source: &Source, late: Late) -> Arc<Vec<f64>> {
        let Source { values, time_s, restart, .. } = source;
        self.stepped.known(source, (Some(late), None), || {
            let mut part_c = Vec::with_capacity(self.rows);
            let mut start = 0;
            for end in (1..=self.rows).filter(|&row| row == self.rows || restart[row]) {
                part_c.extend(part_temperature(late, &time_s[start..end], &values[start..end]));
                start = end;
            }
            part_c
        })
    }

    /// Smooths a temperature over `width_s`, without making it late.
    pub(crate) fn smooth(&mut self, column: &str, width_s: f64) {
        let Some(time_s) = self.time_s.as_deref() else { return };
        let found = self.temperatures.iter_mut().find(|(there, _)| there == column);
        if let Some((_, values)) = found {
            *values = smoothed(values, time_s, &self.restart, width_s).into();
        }
    }

    /// A temperature behind a lag.
    pub(crate) fn delay(&mut self, column: &str, late_s: f64) {
        let Some(time_s) = self.time_s.as_deref() else { return };
        let found = self.temperatures.iter_mut().find(|(there, _)| there == column);
        if let Some((_, values)) = found {
            *values = lag(values, time_s, &self.restart, [late_s; 2], Start::Settled).into();
        }
    }

    /// Returns the temperature of the part whose thermometer, in `column`, is late, behind a lag as in
    /// [`Data::lagged`].
    pub(crate) fn followed(
        &self,
        column: &str,
        late: Option<Late>,
        [rise_s, fall_s]: [f64; 2],
    ) -> Arc<Vec<f64>> {
        let (Some(late), Some(source)) = (late, self.source(column)) else {
            return self.lagged(column, rise_s, fall_s);
        };
        match &self.whole {
            Some(whole) => whole.followed(column, late, [rise_s, fall_s]),
            None => self.stepped(&source, Some(late), [rise_s, fall_s]),
        }
    }
}
