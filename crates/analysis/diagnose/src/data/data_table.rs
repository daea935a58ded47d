//! The table itself: its columns, and how they are requested by name.

use std::sync::Arc;

use trueup_machine::{
    Machine,
    effect::{SpeedExponent, ThermometerDelay},
    machine_file::{LinearAxis, Quantity},
    model::part_temperature_c,
};

use super::{
    lag_cache::{LagCache, LagRows},
    lag_column_cache::{LagColumnCache, LagSource},
    lag_filter::{LagInitialState, apply_lag, forward_fill, smooth_zero_phase},
    row_blocks::RowBlocks,
    stated_terms::StatedTerm,
    table_columns::{ColumnGroup, KnownColumn, NamedColumn, TableColumns},
};

/// The measurements of the runs, all files one after the other, and the model's prediction of each row. A list has one
/// value a row.
#[derive(Clone, Debug)]
pub(crate) struct DataTable {
    pub setting: Arc<DataSettings>,
    pub rows: usize,
    pub places: RowLocations,
    pub columns: TableColumns,
    /// The quantity, in µm; NaN where it is missing.
    pub measured: Arc<[f64]>,
    pub predicted: RowPredictions,
    /// Rows that count: measured and predicted.
    pub used: Arc<[bool]>,
    pub origin: ReferenceState,
    /// Data that were excluded before anything was compared, and why: a sentence each.
    pub notes: Vec<String>,
    /// The thermometers that did not measure for most of the time, or have jumped.
    pub distrusted: Vec<String>,
    /// Where these are drawn rows, or means of rows: all of them, for what a row has from the rows
    /// before it.
    pub whole: Option<ParentTable>,
    /// Its temperatures that were stepped through all rows.
    pub(super) stepped: LagColumnCache,
}

/// The settings that all rows share.
#[derive(Clone, Debug)]
pub(crate) struct DataSettings {
    pub machine: Machine,
    pub quantity: Quantity,
    /// The files, as the user has named them.
    pub files: Vec<String>,
    /// The positions that went one way all the time, by column: an error over one of them and a drift are one question.
    pub passed_columns: Vec<String>,
    /// Whether something has changed that an error may depend on next to positions and the time.
    pub has_other_inputs: bool,
    /// Whether it has not, and the record goes along an axis once.
    pub is_pass_alone: bool,
    /// Whether the axes that have moved are others than the own one.
    pub is_guide_map: bool,
    pub has_elongation: bool,
    /// The machine file's terms that change the quantity.
    pub stated: Vec<StatedTerm>,
    /// The sums that the constants of the file's terms add to the elongation and to the axis, in µm.
    pub constants_um: [f64; 2],
}

/// Where each row stands in the runs.
#[derive(Clone, Debug)]
pub(crate) struct RowLocations {
    /// The number of its file.
    pub file: Arc<[u32]>,
    /// Rows at which states begin anew: the first of a file, and where time runs back.
    pub restart: Arc<[bool]>,
    /// The number of its series: files, runs, restarts.
    pub series: Arc<[u32]>,
}

/// The machine file's prediction of each row, in µm.
#[derive(Clone, Debug, Default)]
pub(crate) struct RowPredictions {
    /// The elongation.
    pub elongation: Arc<[f64]>,
    /// The same by the source's own law, without the file's terms.
    pub law: Arc<[f64]>,
    /// How much of the elongation is in the quantity, −1…1.
    pub along: Arc<[f64]>,
    /// The axis's error but for the tool's growth and the file's terms.
    pub axis: Arc<[f64]>,
    /// The part of it that depends on the axis's temperature.
    pub thermal: Arc<[f64]>,
}

/// From where terms count: the first row that was trained on. A hold-out has its own first row and never refers to it.
#[derive(Clone, Debug, Default)]
pub(crate) struct ReferenceState {
    /// The temperatures, by column.
    pub temperatures_c: Vec<(String, f64)>,
    pub start_s: f64,
}

/// The table that rows were drawn from, or are means of.
#[derive(Clone, Debug)]
pub(crate) struct ParentTable {
    pub data: Arc<DataTable>,
    /// Which of its rows each row is, or is the mean of.
    blocks: RowBlocks,
    /// Its temperatures behind lags, in these rows.
    lags: LagCache,
}

/// Returns the name of the column of what the speed heats by this power.
pub(super) fn heating_column_name(power: SpeedExponent) -> &'static str {
    match power {
        SpeedExponent::First => "heating by the speed",
        SpeedExponent::Second => "heating by the square of the speed",
    }
}

impl ParentTable {
    pub(super) fn new(data: Arc<DataTable>, blocks: RowBlocks) -> Self {
        let columns =
            [&data.columns[ColumnGroup::Temperatures][..], &data.columns[ColumnGroup::Heating]]
                .concat();
        let lags = LagCache::new(data.lag_rows(&blocks), &columns);
        Self { data, blocks, lags }
    }

    /// Returns the same rows of `data`: another table than before in the temperatures of `with_changed_columns`.
    pub(super) fn with_data(&self, data: Arc<DataTable>, changed: &[NamedColumn]) -> Self {
        let lags = self.lags.with_changed_columns(data.lag_rows(&self.blocks), changed);
        Self { data, blocks: self.blocks.clone(), lags }
    }

    /// Returns a column of the whole behind a lag, in the drawn rows.
    fn lagged_column(&self, column: &str, lags_s @ [rise_s, fall_s]: [f64; 2]) -> Arc<Vec<f64>> {
        let (values, start) = self.data.heat_source(column).unzip();
        let values =
            (column, values.map(|values| &values[..]), start.unwrap_or(LagInitialState::Settled));
        self.lags.lagged_column(&self.blocks, values, lags_s, || {
            self.data.lagged_column(column, rise_s, fall_s)
        })
    }

    /// Returns the same for the temperature of the part whose thermometer is late.
    fn lagged_part_temperature(
        &self,
        column: &str,
        late: ThermometerDelay,
        lags_s: [f64; 2],
    ) -> Arc<Vec<f64>> {
        let lagged = || self.lagged_column(column, lags_s);
        let stepped = || self.data.lagged_part_temperature(column, Some(late), lags_s);
        self.lags.lagged_part_temperature(&self.blocks, column, late, lags_s, lagged, stepped)
    }

    /// Returns what the machine file says of `whole`, in the drawn rows.
    pub(super) fn aggregate_predictions(&self, whole: &DataTable) -> RowPredictions {
        whole.predicted.aggregate_blocks(&self.blocks)
    }

    /// Returns which of its rows each row is, or begins with.
    pub(crate) fn first_source_rows(&self) -> Vec<usize> {
        self.blocks.first_rows()
    }

    /// Of values for all rows, those of the drawn ones, or their means.
    pub(crate) fn aggregate_values(&self, all: &[f64]) -> Vec<f64> {
        self.blocks.means(all)
    }
}

impl DataTable {
    /// Returns the table without the terms of the machine file that the board does not run; `None`: there are none.
    pub(crate) fn without_unsupported_terms(&self) -> Option<Self> {
        let is_run = |stated: &StatedTerm| stated.effect.is_compensable();
        let mut setting = (*self.setting).clone();
        setting.stated.retain(is_run);
        if setting.stated.len() == self.setting.stated.len() {
            return None;
        }
        setting.constants_um = StatedTerm::sum_constants_um(
            &setting.machine.with_only_compensated_terms(),
            setting.quantity,
        );
        Some(Self { setting: setting.into(), ..self.clone() })
    }

    /// Returns the time of each row, in s.
    pub(crate) fn time_s(&self) -> Option<&[f64]> {
        self.columns[KnownColumn::Time].as_deref()
    }

    /// Returns the speed of the spindle, in 1/min.
    pub(crate) fn spindle_rpm(&self) -> Option<&[f64]> {
        self.columns[KnownColumn::Speed].as_deref()
    }

    /// Returns the load along the tool, in N.
    pub(crate) fn load_n(&self) -> Option<&[f64]> {
        self.columns[KnownColumn::Load].as_deref()
    }

    /// Returns the number of the run of each row.
    pub(crate) fn run_numbers(&self) -> Option<&[f64]> {
        self.columns[KnownColumn::Run].as_deref()
    }

    /// Returns the position of an axis, in mm.
    pub(crate) fn position_mm(&self, axis: LinearAxis) -> Option<&[f64]> {
        self.columns[KnownColumn::Position(axis)].as_deref()
    }

    /// Returns the positions of X, Y and Z, in mm.
    pub(crate) fn positions_mm(&self) -> [Option<&[f64]>; 3] {
        LinearAxis::ALL.map(|axis| self.position_mm(axis))
    }

    /// Returns from which side an axis came to its position: −1 or 1.
    pub(crate) fn approach_direction(&self, axis: LinearAxis) -> Option<&[f64]> {
        self.columns[KnownColumn::Direction(axis)].as_deref()
    }

    /// Returns the temperatures, by column.
    pub(crate) fn temperatures(&self) -> &[NamedColumn] {
        &self.columns[ColumnGroup::Temperatures]
    }

    /// Returns the columns that this project does not know.
    pub(crate) fn unknown_columns(&self) -> &[NamedColumn] {
        &self.columns[ColumnGroup::Others]
    }

    /// Returns the position of the quantity's own axis.
    pub(crate) fn own_position_mm(&self) -> Option<&[f64]> {
        self.position_mm(self.setting.quantity.axis()?)
    }

    /// Returns the direction of the quantity's own axis.
    pub(crate) fn own_approach_direction(&self) -> Option<&[f64]> {
        self.approach_direction(self.setting.quantity.axis()?)
    }

    /// Returns a column of temperatures, in °C.
    pub(crate) fn temperature_c(&self, name: &str) -> Option<&[f64]> {
        let found = self.temperatures().iter().find(|(there, _)| there == name);
        found.map(|(_, values)| &values[..])
    }

    /// Returns the temperature that a term on `column` is counted from.
    pub(crate) fn reference_temperature_c(&self, column: &str) -> f64 {
        let found = self.origin.temperatures_c.iter().find(|(name, _)| name == column);
        found.map_or(0.0, |&(_, reference_c)| reference_c)
    }

    /// Counts from where `training` does.
    pub(crate) fn copy_origin_from(&mut self, training: &Self) {
        self.origin.clone_from(&training.origin);
    }

    /// Returns the table that these rows were drawn from, where others are missing between them.
    pub(crate) fn sampling_parent(&self) -> Option<&ParentTable> {
        self.whole.as_ref().filter(|whole| !whole.blocks.has_multirow_blocks())
    }

    /// Returns the table that these rows were drawn from, or this one: no row is missing between its rows.
    pub(crate) fn full_table(&self) -> &Self {
        self.sampling_parent().map_or(self, |drawn| &drawn.data)
    }

    /// Returns the rows that were written down for these: where they are means, there were more.
    pub(crate) fn recorded_row_count(&self) -> usize {
        let means = self.whole.as_ref().filter(|whole| whole.blocks.has_multirow_blocks());
        means.map_or(self.rows, |whole| whole.data.rows)
    }

    /// Its rows, of which those in `blocks` are requested.
    fn lag_rows<'t>(&'t self, blocks: &'t RowBlocks) -> LagRows<'t> {
        LagRows { time_s: self.time_s(), restart: &self.places.restart, blocks }
    }

    /// Returns the fastest lag that is looked for in this many rows, in s; 0 where any is.
    pub(crate) fn min_resolved_lag_s(&self) -> f64 {
        self.whole.as_ref().map_or(0.0, |whole| whole.lags.min_resolved_lag_s())
    }

    /// Returns a temperature, or a power of the speed that heats, and where a lag of it starts.
    fn heat_source(&self, name: &str) -> Option<(&Arc<[f64]>, LagInitialState)> {
        let starts = [
            (ColumnGroup::Temperatures, LagInitialState::Settled),
            (ColumnGroup::Heating, LagInitialState::Cold),
        ];
        starts.into_iter().find_map(|(list, start)| {
            let found = self.columns[list].iter().find(|(there, _)| there == name);
            found.map(|(_, values)| (values, start))
        })
    }

    /// Returns what the spindle heats by this power of its speed, behind a first-order lag that starts cold.
    pub(crate) fn lagged_spindle_heat(&self, power: SpeedExponent, lag_s: f64) -> Arc<Vec<f64>> {
        self.lagged_column(heating_column_name(power), lag_s, lag_s)
    }

    /// Returns a temperature behind a first-order lag with one time constant while it rises and one while it
    /// falls, both in s; missing values hold.
    pub(crate) fn lagged_column(&self, column: &str, rise_s: f64, fall_s: f64) -> Arc<Vec<f64>> {
        if let Some(whole) = &self.whole {
            return whole.lagged_column(column, [rise_s, fall_s]);
        }
        match (self.heat_source(column), self.lag_source(column)) {
            (None, _) => vec![0.0; self.rows].into(),
            (Some((values, _)), None) => forward_fill(values).into(),
            (Some(_), Some(source)) => self.apply_lag_row_by_row(&source, None, [rise_s, fall_s]),
        }
    }

    /// Returns what a temperature is stepped through, where there is time.
    fn lag_source(&self, column: &str) -> Option<LagSource> {
        let (values, start) = self.heat_source(column)?;
        let time_s = self.columns[KnownColumn::Time].clone()?;
        Some(LagSource {
            values: values.clone(),
            time_s,
            restart: self.places.restart.clone(),
            start,
        })
    }

    /// Returns a temperature, or that of the part whose thermometer is late, behind a lag, stepped through all rows.
    fn apply_lag_row_by_row(
        &self,
        source: &LagSource,
        late: Option<ThermometerDelay>,
        lags_s: [f64; 2],
    ) -> Arc<Vec<f64>> {
        let behind = |values: &[f64]| {
            apply_lag(values, &source.time_s, &source.restart, lags_s, source.start)
        };
        self.stepped.memoise(source, (late, Some(lags_s)), || match late {
            None => behind(&source.values),
            Some(late) => behind(&self.part_temperature_c(source, late)),
        })
    }

    /// Returns the temperature of the part whose thermometer is late, series by series.
    fn part_temperature_c(&self, source: &LagSource, late: ThermometerDelay) -> Arc<Vec<f64>> {
        let LagSource { values, time_s, restart, .. } = source;
        self.stepped.memoise(source, (Some(late), None), || {
            let mut part_c = Vec::with_capacity(self.rows);
            let mut start = 0;
            for end in (1..=self.rows).filter(|&row| row == self.rows || restart[row]) {
                part_c.extend(part_temperature_c(late, &time_s[start..end], &values[start..end]));
                start = end;
            }
            part_c
        })
    }

    /// Smooths a temperature over `width_s`, where there is time, without making it late.
    pub(crate) fn smooth_temperature(&mut self, column: &str, width_s: f64) {
        let Some(time_s) = self.columns[KnownColumn::Time].clone() else { return };
        let mut temperatures = self.columns[ColumnGroup::Temperatures].iter_mut();
        if let Some((_, values)) = temperatures.find(|(there, _)| there == column) {
            *values = smooth_zero_phase(values, &time_s, &self.places.restart, width_s).into();
        }
    }

    /// Returns the temperature of the part whose thermometer, in `column`, is late, behind a lag as in
    /// [`Self::lagged_column`].
    pub(crate) fn lagged_part_temperature(
        &self,
        column: &str,
        late: Option<ThermometerDelay>,
        [rise_s, fall_s]: [f64; 2],
    ) -> Arc<Vec<f64>> {
        let (Some(late), Some(source)) = (late, self.lag_source(column)) else {
            return self.lagged_column(column, rise_s, fall_s);
        };
        match &self.whole {
            Some(whole) => whole.lagged_part_temperature(column, late, [rise_s, fall_s]),
            None => self.apply_lag_row_by_row(&source, Some(late), [rise_s, fall_s]),
        }
    }
}
