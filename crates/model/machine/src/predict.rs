//! For each row of a run: what the model says, and what the board's integers make of it.
//!
//! Two columns a quantity, both before filter, limits, slew and wire rounding:
//!
//! ```text
//! row ─► model, f64 ─────────────────────────────────────────► predicted_<quantity>_um
//!    └► nearest reading, position, temperature ─► the board's own code ─► bridge_<quantity>_um
//! ```
//!
//! The bridge's side runs the functions of `trueup-core` that the firmware runs, on the calibration
//! that [`compile`](mod@crate::compile) gives the board, so the difference between the two columns
//! is what fixed-point arithmetic costs. Heat is stepped as the board steps it, every 100 ms of the
//! run's time.
//!
//! A quantity that depends on a column that the run does not have stays empty; a run from which
//! nothing can be predicted is refused.

mod bridge;
mod columns;
mod number_format;

use std::{
    borrow::Cow,
    io::{self, Write},
};

use trueup_core::design_parameters::THERMAL_STEP_MS;

use crate::{
    effect::Quantity,
    location::{InputFileError, Location},
    machine_file::Machine,
    model::{
        ReferenceModel, RowInputs, part_temperature_columns, required_columns, shift_series,
        time_shift_s,
    },
    run_file::RunFile,
    sections::ElongationSource,
    unit_conversion::NM_PER_UM,
};
use bridge::{SimulatedBridge, SimulatedBridgeRun};
use columns::{ModelColumns, value_at_row};
use number_format::{write_shortest_decimal, write_six_decimals};

pub use crate::model::ErrorValues;

/// The columns that a prediction adds to those of the run, in their order.
pub(crate) const PREDICTION_COLUMNS: [&str; 8] = [
    "predicted_elongation_um",
    "bridge_elongation_um",
    "predicted_dx_um",
    "bridge_dx_um",
    "predicted_dy_um",
    "bridge_dy_um",
    "predicted_dz_um",
    "bridge_dz_um",
];

/// One bit of an offset on the wire, in nm: what fixed-point arithmetic may add to the differences that
/// [`compile`](crate::compile()) states, because it cannot be seen.
pub(crate) const OFFSET_RESOLUTION_NM: f64 = 10.0;

/// Both sides for one row; a value that cannot be predicted is NaN on both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowPrediction {
    /// The reference arithmetic.
    pub model: ErrorValues,
    /// The same without the terms that only explain (`drift`, `time-shift` and the like), for the tool of the
    /// machine file: what the board is to correct.
    pub compensated: ErrorValues,
    /// The board's arithmetic; `None` where the machine does not say how the sensor is connected.
    pub bridge: Option<ErrorValues>,
}

impl RowPrediction {
    /// Returns the largest difference between the bridge and the model, in nm, of the columns that are written; `None`
    /// without a bridge or a value.
    #[must_use]
    pub(crate) fn max_difference_nm(&self) -> Option<f64> {
        self.max_bridge_difference_nm(self.model)
    }

    /// Returns the same between the bridge and what it is to correct: what its arithmetic costs.
    #[must_use]
    pub fn arithmetic_error_nm(&self) -> Option<f64> {
        self.max_bridge_difference_nm(self.compensated)
    }

    fn max_bridge_difference_nm(&self, model: ErrorValues) -> Option<f64> {
        let bridge = self.bridge?.to_array();
        let apart = model.to_array().into_iter().zip(bridge).map(|(model, bridge)| model - bridge);
        apart.filter(|um| !um.is_nan()).map(|um| um.abs() * NM_PER_UM).reduce(f64::max)
    }
}

/// A machine's prediction for a run, checked and ready to be written.
#[derive(Clone, Debug)]
pub struct RunPredictor<'a> {
    machine: &'a Machine,
    run: &'a RunFile,
    columns: ModelColumns<'a>,
    missing: Vec<String>,
    bridge: Result<SimulatedBridge, String>,
}

/// The summary of a written prediction.
#[derive(Clone, Debug, PartialEq)]
pub struct PredictionSummary {
    /// Rows of the run.
    pub rows: usize,
    /// Rows whose counts are missing, of which at least the elongation is not predicted.
    pub rows_without_counts: usize,
    /// Rows whose counts the sensor cannot give. They are predicted like all others.
    pub rows_out_of_range: usize,
    /// Where the first of these stands.
    pub first_out_of_range: Option<Location>,
    /// The largest difference between model and bridge, in nm, of the columns that were written; `None` without a
    /// bridge or rows.
    pub largest_difference_nm: Option<f64>,
    /// The part of it that is the board's arithmetic, in nm; the rest is of terms that it does not run.
    pub largest_arithmetic_nm: Option<f64>,
    /// Where the bridge is further from the model than [`RunPredictor::difference_bound_nm`], the furthest: its row, from
    /// 0, and the difference in nm.
    pub broken_promise: Option<(usize, f64)>,
}

impl<'a> RunPredictor<'a> {
    /// Returns the prediction of `machine` for `run`.
    ///
    /// `[inputs]` may be missing: without the sensor that is the source there is no bridge side
    /// then; temperatures are taken to be on channels of their own.
    ///
    /// # Errors
    /// A column is missing without which nothing can be predicted; a column of the run has the name
    /// of one that is to be written.
    pub fn new(machine: &'a Machine, run: &'a RunFile) -> Result<Self, InputFileError> {
        for name in PREDICTION_COLUMNS {
            if run.column(name).is_some() {
                let rule = format!("column {name} is already there, and would be repeated");
                return Err(InputFileError::new(run.header_location(), rule));
            }
        }
        let missing: Vec<String> = required_columns(machine)
            .into_iter()
            .filter(|name| run.column(name).is_none())
            .collect();
        let columns = ModelColumns::new(machine, run);
        if let Some(first) = missing.first()
            && is_unpredictable(machine, &columns)
        {
            run.require_column(first)?;
        }
        Ok(Self { machine, run, columns, missing, bridge: SimulatedBridge::from_machine(machine) })
    }

    /// Why there is no bridge side, if there is none: the machine does not say how the sensor is
    /// connected, or the board could not run it, with the place and the rule.
    #[must_use]
    pub fn bridge_error(&self) -> Option<&str> {
        self.bridge.as_ref().err().map(String::as_str)
    }

    /// Returns the largest difference between bridge and model that `compile` promises, in nm: those of all parts of
    /// the calibration together, and `OFFSET_RESOLUTION_NM`. `None` without a bridge.
    #[must_use]
    pub fn difference_bound_nm(&self) -> Option<f64> {
        let bridge = self.bridge.as_ref().ok()?;
        Some(bridge.compiled.parts.iter().map(|(_, nm)| nm).sum::<f64>() + OFFSET_RESOLUTION_NM)
    }

    /// Returns what the model has and the board does not run: the terms that only explain, by their causes, and
    /// tools of another length than that of the machine file.
    #[must_use]
    pub fn unsupported_features(&self) -> Vec<&'static str> {
        let terms = self.machine.terms.iter().filter(|term| !term.effect.is_compensable());
        let length = self.has_other_tool_lengths().then_some("tool_length_mm");
        terms.map(|term| term.effect.name()).chain(length).collect()
    }

    /// Returns whether a row has a tool of another length than the machine file, and that makes a difference.
    fn has_other_tool_lengths(&self) -> bool {
        let volume = &self.machine.volume;
        let is_other = |length_mm: &f64| *length_mm != volume.tool.length_mm;
        volume.has_geometric_errors()
            && self.columns.tool_length_mm.is_some_and(|lengths| lengths.iter().any(is_other))
    }

    /// Columns that the machine's model needs and the run does not have: what depends on them is
    /// not predicted.
    #[must_use]
    pub fn missing_columns(&self) -> &[String] {
        &self.missing
    }

    /// Returns both sides, row by row: heat is a state.
    pub fn predictions(&self) -> impl Iterator<Item = RowPrediction> {
        let mut model = self.model_values();
        let compensated = self.machine.with_only_compensated_terms();
        // Where nothing is left out it is the model, and is not computed twice.
        let is_less = matches!(compensated, Cow::Owned(_)) || self.has_other_tool_lengths();
        let mut compensated = is_less.then(|| ReferenceModel::from_machine(compensated));
        let mut bridge =
            self.bridge.as_ref().ok().map(|bridge| SimulatedBridgeRun::new(self.machine, bridge));
        (0..self.run.row_count()).map(move |row| {
            let temperatures = self.columns.temperatures_in_row(row);
            let others = self.columns.other_column_values_in_row(row);
            let situation = self.columns.row_inputs(row, &temperatures, &others);
            let model = model.next().expect("one for each row");
            let on_board = RowInputs { tool_length_mm: None, ..situation };
            let compensated = compensated
                .as_mut()
                .map_or(model, |compensated| compensated.step(&on_board).to_error_values());
            let bridge = bridge.as_mut().map(|bridge| {
                let bridge = bridge.step(&situation);
                // What the model cannot know the board does not know either.
                let known = |model: f64, bridge: f64| if model.is_nan() { model } else { bridge };
                ErrorValues {
                    elongation_um: known(compensated.elongation_um, bridge.elongation_um),
                    error_um: [0, 1, 2].map(|n| known(compensated.error_um[n], bridge.error_um[n])),
                }
            });
            RowPrediction { model, compensated, bridge }
        })
    }

    /// Returns the model's values row by row. A thermometer that is late is looked after beforehand; a time shift looks
    /// ahead and back, so that all of them are there before the first is given; otherwise none is kept.
    #[must_use]
    pub fn model_values(&self) -> Box<dyn Iterator<Item = ErrorValues> + '_> {
        let mut reference = ReferenceModel::new(self.machine);
        let parts = part_temperature_columns(self.machine, |name| self.run.column(name));
        let in_time = (0..self.run.row_count()).map(move |row| {
            let mut temperatures: Vec<(&str, f64)> = self.columns.temperatures_in_row(row);
            temperatures.extend(parts.iter().map(|(name, part_c)| (name.as_str(), part_c[row])));
            let others = self.columns.other_column_values_in_row(row);
            reference.step(&self.columns.row_inputs(row, &temperatures, &others)).to_error_values()
        });
        let shifts_s = Quantity::ALL.map(|quantity| time_shift_s(&self.machine.terms, quantity));
        if shifts_s == [0.0; 4] {
            return Box::new(in_time);
        }
        let mut columns = [const { Vec::new() }; 4];
        for values in in_time {
            for (column, value) in columns.iter_mut().zip(values.to_array()) {
                column.push(value);
            }
        }
        let never;
        let time_s = match self.columns.time_s {
            Some(time_s) => time_s,
            None => {
                never = vec![f64::NAN; self.run.row_count()];
                &never
            }
        };
        let [elongation, dx, dy, dz] =
            [0, 1, 2, 3].map(|n| shift_series(time_s, &columns[n], shifts_s[n]));
        Box::new((0..self.run.row_count()).map(move |row| ErrorValues {
            elongation_um: elongation[row],
            error_um: [dx[row], dy[row], dz[row]],
        }))
    }

    /// Writes the run as CSV with `PREDICTION_COLUMNS` after its own; a value that is missing is an empty
    /// cell. `row_done` learns of every row.
    ///
    /// # Errors
    /// `out` cannot be written.
    pub fn write_csv(
        &self,
        mut out: impl Write,
        mut row_done: impl FnMut(),
    ) -> io::Result<PredictionSummary> {
        let mut written = PredictionSummary {
            rows: self.run.row_count(),
            rows_without_counts: 0,
            rows_out_of_range: 0,
            first_out_of_range: None,
            largest_difference_nm: None,
            largest_arithmetic_nm: None,
            broken_promise: None,
        };
        for column in self.run.columns() {
            write_column_name(&mut out, &column.name)?;
            out.write_all(b",")?;
        }
        writeln!(out, "{}", PREDICTION_COLUMNS.join(","))?;
        let promised_nm = self.difference_bound_nm().unwrap_or(0.0);
        let mut before = ErrorValues { elongation_um: f64::NAN, error_um: [f64::NAN; 3] };
        for (row, prediction) in self.predictions().enumerate() {
            for column in self.run.columns() {
                let value = column.values.get(row).copied().unwrap_or(f64::NAN);
                if let Some(label) = self.run.tool_label(value).filter(|_| value < 0.0) {
                    out.write_all(label.as_bytes())?;
                } else if !value.is_nan() {
                    write_shortest_decimal(&mut out, value)?;
                }
                out.write_all(b",")?;
            }
            write_prediction(&mut out, &prediction)?;
            let between_nm = self.step_timing_error_nm(row, before, prediction.compensated);
            self.update_summary(row, &prediction, promised_nm + between_nm, &mut written);
            before = prediction.compensated;
            row_done();
        }
        out.flush()?;
        Ok(written)
    }

    /// Returns what a row that lies between two steps of the board's heat may be off next to the promise, in nm: the
    /// model's change since the row before, by the share of the time that the step is early or late. A lag
    /// is never faster at the end of an interval than in its mean; twice that.
    fn step_timing_error_nm(&self, row: usize, before: ErrorValues, now: ErrorValues) -> f64 {
        let step_s = f64::from(THERMAL_STEP_MS) / 1_000.0;
        let Some((time_s, earlier)) = self.columns.time_s.zip(row.checked_sub(1)) else {
            return 0.0;
        };
        let since_start_s = time_s[row] - time_s[0];
        let off_s = since_start_s - (since_start_s / step_s).round() * step_s;
        let share = (2.0 * off_s.abs() / (time_s[row] - time_s[earlier])).min(1.0);
        let changes = before
            .to_array()
            .into_iter()
            .zip(now.to_array())
            .map(|(before, now)| (now - before).abs());
        let change_um = changes.filter(|um| !um.is_nan()).fold(0.0, f64::max);
        if share.is_nan() { 0.0 } else { share * change_um * NM_PER_UM }
    }

    fn update_summary(
        &self,
        row: usize,
        prediction: &RowPrediction,
        allowed_nm: f64,
        written: &mut PredictionSummary,
    ) {
        if let Some(difference_nm) = prediction.max_difference_nm() {
            let before = written.largest_difference_nm.unwrap_or(0.0);
            written.largest_difference_nm = Some(before.max(difference_nm));
        }
        if let Some(difference_nm) = prediction.arithmetic_error_nm() {
            let before = written.largest_arithmetic_nm.unwrap_or(0.0);
            written.largest_arithmetic_nm = Some(before.max(difference_nm));
            let worst = written.broken_promise.map_or(0.0, |(_, nm)| nm);
            if difference_nm > allowed_nm && difference_nm > worst {
                written.broken_promise = Some((row, difference_nm));
            }
        }
        if self.machine.spindle.source != Some(ElongationSource::Sensor) {
            return;
        }
        let counts = value_at_row(self.columns.sensor_counts, row);
        if counts.is_nan() {
            written.rows_without_counts += 1;
            return;
        }
        let input = self.bridge.as_ref().ok().and_then(|bridge| bridge.input);
        if input.is_some_and(|input| !input.is_in_range(counts)) {
            written.rows_out_of_range += 1;
            let place = || self.run.value_location(row, "sensor_counts");
            written.first_out_of_range.get_or_insert_with(place);
        }
    }
}

/// Returns whether no quantity that the machine's model describes can be had from these columns.
fn is_unpredictable(machine: &Machine, columns: &ModelColumns<'_>) -> bool {
    // A row in which every column that is there has a value.
    let there = |column: &Option<&[f64]>| column.map_or(f64::NAN, |_| 1.0);
    let temperatures: Vec<_> =
        columns.temperatures_c.iter().map(|(name, _)| (*name, 20.0)).collect();
    let others: Vec<_> = columns.others.iter().map(|(name, _)| (*name, 1.0)).collect();
    let situation = RowInputs {
        time_s: columns.time_s.map(|_| 0.0),
        run: columns.run.map(|_| 1.0),
        sensor_counts: there(&columns.sensor_counts),
        spindle_rpm: columns.spindle_rpm.map(|_| 1.0),
        load_n: columns.load_n.map(|_| 1.0),
        feed_mm_per_min: there(&columns.feed_mm_per_min),
        temperatures_c: &temperatures,
        others: &others,
        position_mm: columns.position_mm.each_ref().map(there),
        angle_deg: columns.angle_deg.each_ref().map(there),
        direction: [1.0; 3],
        tool_length_mm: None,
    };
    let nothing = RowInputs { temperatures_c: &[], ..RowInputs::UNKNOWN };
    let known = ReferenceModel::new(machine).step(&situation).to_error_values().to_array();
    let blind = ReferenceModel::new(machine).step(&nothing).to_error_values().to_array();
    // Zero and known without any column is no quantity of this machine.
    known.iter().zip(blind).all(|(known, blind)| known.is_nan() || !blind.is_nan())
}

/// A column's name, in quotes where it would otherwise be read as something else.
fn write_column_name(out: &mut impl Write, name: &str) -> io::Result<()> {
    if name.contains([',', ';', '"']) {
        write!(out, "\"{}\"", name.replace('"', "\"\""))
    } else {
        out.write_all(name.as_bytes())
    }
}

/// The cells of `PREDICTION_COLUMNS`, to 1 pm, and the end of the line.
fn write_prediction(out: &mut impl Write, prediction: &RowPrediction) -> io::Result<()> {
    let bridge = prediction.bridge.map_or([f64::NAN; 4], ErrorValues::to_array);
    let pairs = prediction.model.to_array().into_iter().zip(bridge);
    for (number, value) in pairs.flat_map(|(model, bridge)| [model, bridge]).enumerate() {
        if number > 0 {
            out.write_all(b",")?;
        }
        if !value.is_nan() {
            // + 0.0 turns −0 into 0.
            write_six_decimals(out, value + 0.0)?;
        }
    }
    out.write_all(b"\n")
}

#[cfg(test)]
mod tests;
