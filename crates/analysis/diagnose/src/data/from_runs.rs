//! From runs to the table: all files one after the other, in series, with what the model says.

use std::{borrow::Cow, sync::Arc};

use trueup_machine::{
    InputFileError, Machine, RunFile,
    applied_offsets::UncompensatedRun,
    effect::{SpeedExponent, relative_heat_input},
    machine_file::{Quantity, is_temperature_column},
};

use super::{
    channel_faults,
    data_table::{
        DataSettings, DataTable, ReferenceState, RowLocations, RowPredictions, heating_column_name,
    },
    input_columns,
    lag_column_cache::LagColumnCache,
    lag_filter::first_finite_or_zero,
    prediction::fill_predictions,
    reversal_decay::reversal_decay_columns,
    single_pass,
    stated_terms::StatedTerm,
    table_columns::{ColumnGroup, KnownColumn, NamedColumn, TableColumns},
};

impl DataTable {
    /// Returns the table of `runs`, compared in `quantity` (checked by `resolve_quantity`).
    pub(crate) fn new(
        machine: &Machine,
        runs: &[RunFile],
        quantity: Quantity,
    ) -> Result<Self, InputFileError> {
        Self::with_offset_factor(machine, runs, quantity, 1.0)
    }

    /// Returns the same where the CNC has applied `factor` times the offsets of a bridge.
    pub(crate) fn with_offset_factor(
        machine: &Machine,
        runs: &[RunFile],
        quantity: Quantity,
        factor: f64,
    ) -> Result<Self, InputFileError> {
        let (runs, notes) = remove_bridge_offsets(machine, runs, quantity, factor)?;
        let rows: usize = runs.iter().map(|run| run.row_count()).sum();
        let concatenate_column = |name: &str| concatenate_column(&runs, rows, name);
        let measured =
            concatenate_column(&format!("measured_{}_um", quantity.name())).unwrap_or_default();
        let mut columns = TableColumns::from_fn(concatenate_column);
        if columns[KnownColumn::Time].is_none() {
            columns[KnownColumn::GaugeTime] = None;
        }
        let (file, restart) = row_files_and_restarts(&runs, rows);
        // Where there is time, it says how far apart two runs are.
        let run =
            columns[KnownColumn::Run].as_deref().filter(|_| columns[KnownColumn::Time].is_none());
        let series = series_numbers(&restart, run);
        for column in runs[0].columns() {
            // What is only in some of the files cannot be compared over all of them.
            if !runs.iter().all(|run| run.column(&column.name).is_some()) {
                continue;
            }
            let name = column.name.as_str();
            let list = if is_temperature_column(name) {
                ColumnGroup::Temperatures
            } else if is_known_column(name) {
                continue;
            } else {
                ColumnGroup::Others
            };
            columns[list].push((column.name.clone(), concatenate_column(name).unwrap_or_default()));
        }
        columns[ColumnGroup::Heating] = heating_columns(columns[KnownColumn::Speed].as_deref());
        let setting = DataSettings {
            machine: machine.clone(),
            quantity,
            files: runs.iter().map(|run| run.path().display().to_string()).collect(),
            passed_columns: Vec::new(),
            has_other_inputs: false,
            is_pass_alone: false,
            is_guide_map: false,
            has_elongation: quantity == Quantity::Elongation || machine.has_elongation(),
            stated: StatedTerm::from_machine(machine, quantity),
            constants_um: StatedTerm::sum_constants_um(machine, quantity),
        };
        let mut data = Self {
            setting: setting.into(),
            rows,
            places: RowLocations {
                file: file.into(),
                restart: restart.into(),
                series: series.into(),
            },
            columns,
            measured,
            predicted: RowPredictions::default(),
            used: Arc::default(),
            origin: ReferenceState::default(),
            notes,
            distrusted: Vec::new(),
            whole: None,
            stepped: LagColumnCache::default(),
        };
        channel_faults::exclude_channel_faults(
            &mut data,
            &runs.iter().map(|run| &**run).collect::<Vec<&RunFile>>(),
        );
        input_columns::retain_input_columns(&mut data);
        let passed_columns = single_pass::passed_columns(&data);
        let has_other_inputs = single_pass::has_other_inputs(&data);
        let is_pass_alone = !has_other_inputs && single_pass::is_pass(&data, &passed_columns);
        let is_guide_map = single_pass::is_guide_map(&data);
        let setting = Arc::make_mut(&mut data.setting);
        setting.passed_columns = passed_columns;
        setting.has_other_inputs = has_other_inputs;
        (setting.is_pass_alone, setting.is_guide_map) = (is_pass_alone, is_guide_map);
        if is_pass_alone {
            single_pass::exclude_redundant_clock(&mut data);
        }
        let first_c = |(name, values): &NamedColumn| (name.clone(), first_finite_or_zero(values));
        data.origin = ReferenceState {
            temperatures_c: data.temperatures().iter().map(first_c).collect(),
            start_s: data.time_s().map_or(0.0, first_finite_or_zero),
        };
        data.columns[ColumnGroup::Reversal] = reversal_decay_columns(&data);
        fill_predictions(&mut data, &runs);
        if !data.used.iter().any(|&used| used) {
            return Err(no_usable_rows_error(machine, &runs, quantity));
        }
        Ok(data)
    }
}

/// Returns a column of all runs, one after the other; NaN where a run has none.
fn concatenate_column(
    runs: &[UncompensatedRun<'_>],
    rows: usize,
    name: &str,
) -> Option<Arc<[f64]>> {
    if !runs.iter().any(|run| run.column(name).is_some()) {
        return None;
    }
    // Of one run it is the run's own.
    if let [run] = runs {
        return run
            .columns()
            .iter()
            .find(|column| column.name == name)
            .map(|column| column.values.clone());
    }
    let mut all = Vec::with_capacity(rows);
    for run in runs {
        match run.column(name) {
            Some(values) => all.extend_from_slice(values),
            None => all.resize(all.len() + run.row_count(), f64::NAN),
        }
    }
    Some(all.into())
}

/// Returns of each row the number of its file, and whether a record begins with it.
fn row_files_and_restarts(runs: &[UncompensatedRun<'_>], rows: usize) -> (Vec<u32>, Vec<bool>) {
    let (mut file, mut restart) = (Vec::with_capacity(rows), Vec::with_capacity(rows));
    for (number, run) in runs.iter().enumerate() {
        let times = run.column("time_s");
        let mut last_s = f64::NEG_INFINITY;
        for row in 0..run.row_count() {
            let now_s = times.map_or(f64::NAN, |times| times[row]);
            restart.push(row == 0 || now_s < last_s);
            if !now_s.is_nan() {
                last_s = now_s;
            }
            file.push(number as u32);
        }
    }
    (file, restart)
}

/// Returns the number of the series of each row: one begins with a record, and where the number of the `run` changes.
fn series_numbers(restart: &[bool], run: Option<&[f64]>) -> Vec<u32> {
    let mut number: u32 = 0;
    let of = |(row, restarts): (usize, &bool)| {
        let is_new_run =
            |run: &[f64]| run[row] != run[row - 1] && !(run[row].is_nan() && run[row - 1].is_nan());
        if row > 0 && (*restarts || run.is_some_and(is_new_run)) {
            number += 1;
        }
        number
    };
    restart.iter().enumerate().map(of).collect()
}

/// Returns the reason why no row can be used: a column without a value, where there is one.
fn no_usable_rows_error(
    machine: &Machine,
    runs: &[UncompensatedRun<'_>],
    quantity: Quantity,
) -> InputFileError {
    for name in trueup_machine::model::required_columns(machine) {
        for run in runs {
            match run.require_column(&name) {
                Err(missing) => return missing,
                Ok(values) if values.iter().all(|value| value.is_nan()) => {
                    let rule = "has no value in any row, and the machine file needs it";
                    return run.value_error(0, &name, rule);
                }
                Ok(_) => {}
            }
        }
    }
    let name = format!("measured_{}_um", quantity.name());
    runs[0].value_error(0, &name, "has no row that is both measured and predicted")
}

/// Returns the runs without what a bridge applied while they were measured, and what is reported of that.
fn remove_bridge_offsets<'r>(
    machine: &Machine,
    runs: &'r [RunFile],
    quantity: Quantity,
    factor: f64,
) -> Result<(Vec<UncompensatedRun<'r>>, Vec<String>), InputFileError> {
    let mut notes = Vec::new();
    let mut taken_out = |run: &'r RunFile| {
        let (run, reported) =
            UncompensatedRun::from_run(Cow::Borrowed(run), Some(machine), Some(quantity))?;
        notes.extend(run.column_typos().map(|slip| slip.to_string()));
        notes.extend(reported);
        Ok(if factor == 1.0 { run } else { run.with_offset_factor(quantity, factor) })
    };
    let runs = runs.iter().map(&mut taken_out).collect::<Result<_, _>>()?;
    Ok((runs, notes))
}

/// Returns how hard the spindle heats in each row, by either power of its speed.
fn heating_columns(speed_rpm: Option<&[f64]>) -> Vec<NamedColumn> {
    let of = |speed_rpm: &[f64], power| {
        let heat = |&rpm: &f64| relative_heat_input(power, rpm);
        (heating_column_name(power).into(), speed_rpm.iter().map(heat).collect())
    };
    let powers = [SpeedExponent::First, SpeedExponent::Second];
    speed_rpm.map_or_else(Vec::new, |speed_rpm| powers.map(|power| of(speed_rpm, power)).into())
}

fn is_known_column(name: &str) -> bool {
    const KNOWN_COLUMNS: [&str; 12] = [
        "time_s",
        "gauge_time_s",
        "run",
        "sensor_counts",
        "spindle_rpm",
        "load_n",
        "x_mm",
        "y_mm",
        "z_mm",
        "dir_x",
        "dir_y",
        "dir_z",
    ];
    KNOWN_COLUMNS.contains(&name)
        || ["measured_", "predicted_", "bridge_"].iter().any(|start| name.starts_with(start))
        || input_columns::is_record_metadata_column(name)
}
