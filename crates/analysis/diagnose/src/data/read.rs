//! From runs to the table: all files one after the other, in series, with what the model says.

use std::{borrow::Cow, sync::Arc};

use trueup_machine::{
    BadInput, Machine, RunFile,
    applied::Uncompensated,
    effect::{SpeedPower, heating},
    file::{Quantity, is_temperature_column},
};

use super::{
    channels, inputs,
    lag::first_of,
    one_pass,
    prediction::predict,
    reversal::reversal_decay,
    stated::Stated,
    stepped::Stepped,
    table::{Column, Data, drive},
};

impl Data {
    /// Returns the table of `runs`, compared in `quantity` (checked by `quantity_of`).
    pub(crate) fn new(
        machine: &Machine,
        runs: &[RunFile],
        quantity: Quantity,
    ) -> Result<Self, BadInput> {
        Self::applied(machine, runs, quantity, 1.0)
    }

    /// Returns the same where the CNC has applied `factor` times the offsets of a bridge.
    pub(crate) fn applied(
        machine: &Machine,
        runs: &[RunFile],
        quantity: Quantity,
        factor: f64,
    ) -> Result<Self, BadInput> {
        let (runs, notes) = without_bridge(machine, runs, quantity, factor)?;
        let rows: usize = runs.iter().map(|run| run.rows()).sum();
        let joined = |name: &str| joined(&runs, rows, name);
        let measured = joined(&format!("measured_{}_um", quantity.name())).unwrap_or_default();
        let time_s = joined("time_s");
        let gauge_time_s = joined("gauge_time_s").filter(|_| time_s.is_some());
        let run = joined("run");
        let (file, restart) = places(&runs, rows);
        // Where there is time, it says how far apart two runs are.
        let series = series(&restart, run.as_deref().filter(|_| time_s.is_none()));
        let mut temperatures = Vec::new();
        let mut others = Vec::new();
        for column in runs[0].columns() {
            // What is only in some of the files cannot be compared over all of them.
            if !runs.iter().all(|run| run.column(&column.name).is_some()) {
                continue;
            }
            let name = column.name.as_str();
            let target = if is_temperature_column(name) {
                &mut temperatures
            } else if is_known(name) {
                continue;
            } else {
                &mut others
            };
            target.push((column.name.clone(), joined(name).unwrap_or_default()));
        }
        let mut data = Self {
            machine: machine.clone(),
            quantity,
            rows,
            file: file.into(),
            files: runs.len(),
            names: runs.iter().map(|run| run.path().display().to_string()).collect(),
            restart: restart.into(),
            series: series.into(),
            time_s,
            gauge_time_s,
            run,
            temperatures,
            distrusted: Vec::new(),
            others,
            is_one_pass: false,
            drives: drives(joined("spindle_rpm").as_deref()),
            spindle_rpm: joined("spindle_rpm"),
            load_n: joined("load_n"),
            position_mm: ["x_mm", "y_mm", "z_mm"].map(joined),
            direction: ["dir_x", "dir_y", "dir_z"].map(joined),
            reversal_decay: Vec::new(),
            measured,
            stated: Stated::all(machine, quantity),
            constants_um: Stated::constants_um(machine, quantity),
            elongation: Vec::new(),
            law: Vec::new(),
            along: Arc::default(),
            has_elongation: quantity == Quantity::Elongation || machine.has_elongation(),
            axis: Vec::new(),
            thermal: Vec::new(),
            used: Arc::default(),
            references_c: Vec::new(),
            start_s: 0.0,
            notes,
            whole: None,
            stepped: Stepped::default(),
        };
        channels::set_aside(&mut data, &runs.iter().map(|run| &**run).collect::<Vec<&RunFile>>());
        inputs::retain(&mut data);
        data.is_one_pass = one_pass::is_one_pass(&data);
        if data.is_one_pass {
            one_pass::leave_the_clock(&mut data);
        }
        data.references_c = data
            .temperatures
            .iter()
            .map(|(name, values)| (name.clone(), first_of(values)))
            .collect();
        data.start_s = data.time_s.as_deref().map_or(0.0, first_of);
        data.reversal_decay = reversal_decay(&data);
        predict(&mut data, &runs);
        if !data.used.iter().any(|&used| used) {
            return Err(unusable(machine, &runs, quantity));
        }
        Ok(data)
    }
}

/// Returns a column of all runs, one after the other; NaN where a run has none.
fn joined(runs: &[Uncompensated<'_>], rows: usize, name: &str) -> Option<Arc<[f64]>> {
    if !runs.iter().any(|run| run.column(name).is_some()) {
        return None;
    }
    // Of one run it is the run's own.
    if let [run] = runs {
        return run.columns().iter().find(|it| it.name == name).map(|it| it.values.clone());
    }
    let mut all = Vec::with_capacity(rows);
    for run in runs {
        match run.column(name) {
            Some(values) => all.extend_from_slice(values),
            None => all.resize(all.len() + run.rows(), f64::NAN),
        }
    }
    Some(all.into())
}

/// Returns of each row the number of its file, and whether a record begins with it.
fn places(runs: &[Uncompensated<'_>], rows: usize) -> (Vec<u32>, Vec<bool>) {
    let (mut file, mut restart) = (Vec::with_capacity(rows), Vec::with_capacity(rows));
    for (number, run) in runs.iter().enumerate() {
        let times = run.column("time_s");
        let mut last_s = f64::NEG_INFINITY;
        for row in 0..run.rows() {
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
fn series(restart: &[bool], run: Option<&[f64]>) -> Vec<u32> {
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
fn unusable(machine: &Machine, runs: &[Uncompensated<'_>], quantity: Quantity) -> BadInput {
    for name in trueup_machine::model::required_columns(machine) {
        for run in runs {
            match run.require(&name) {
                Err(missing) => return missing,
                Ok(values) if values.iter().all(|value| value.is_nan()) => {
                    let rule = "has no value in any row, and the machine file needs it";
                    return run.bad(0, &name, rule);
                }
                Ok(_) => {}
            }
        }
    }
    let name = format!("measured_{}_um", quantity.name());
    runs[0].bad(0, &name, "has no row that is both measured and predicted")
}

/// Returns the runs without what a bridge applied while they were measured, and what is reported of that.
fn without_bridge<'r>(
    machine: &Machine,
    runs: &'r [RunFile],
    quantity: Quantity,
    factor: f64,
) -> Result<(Vec<Uncompensated<'r>>, Vec<String>), BadInput> {
    let mut notes = Vec::new();
    let mut taken_out = |run: &'r RunFile| {
        let (run, told) = Uncompensated::of(Cow::Borrowed(run), Some(machine), Some(quantity))?;
        notes.extend(run.slips().map(|slip| slip.to_string()));
        notes.extend(told);
        Ok(if factor == 1.0 { run } else { run.with_factor(quantity, factor) })
    };
    let runs = runs.iter().map(&mut taken_out).collect::<Result<_, _>>()?;
    Ok((runs, notes))
}

/// Returns how hard the spindle heats in each row, by either power of its speed.
fn drives(speed_rpm: Option<&[f64]>) -> Vec<Column> {
    let of = |speed_rpm: &[f64], power| {
        let heat = |&rpm: &f64| heating(power, rpm);
        (drive(power).into(), speed_rpm.iter().map(heat).collect())
    };
    let powers = [SpeedPower::First, SpeedPower::Second];
    speed_rpm.map_or_else(Vec::new, |speed_rpm| powers.map(|power| of(speed_rpm, power)).into())
}

fn is_known(name: &str) -> bool {
    const KNOWN: [&str; 15] = [
        "time_s",
        "gauge_time_s",
        "run",
        "sensor_counts",
        "spindle_rpm",
        "load_n",
        "x_mm",
        "y_mm",
        "z_mm",
        "a_deg",
        "b_deg",
        "c_deg",
        "dir_x",
        "dir_y",
        "dir_z",
    ];
    KNOWN.contains(&name)
        || ["measured_", "predicted_", "bridge_"].iter().any(|start| name.starts_with(start))
        || inputs::is_of_record(name)
}
