//! The machine file's prediction for each row.

use trueup_machine::{
    Machine,
    applied_offsets::UncompensatedRun,
    machine_file::LinearAxis,
    model::{
        ReferenceModel, RowInputs, part_temperature_columns, required_columns, shift_series,
        time_shift_s,
    },
};

use super::{
    data_table::{DataTable, RowPredictions},
    table_columns::NamedColumn,
};

/// Steps the reference model through the runs: as the machine file says, and by the machine's own laws,
/// without its terms.
pub(super) fn fill_predictions(data: &mut DataTable, runs: &[UncompensatedRun<'_>]) {
    let machine = data.setting.machine.clone();
    let mut prediction = simulate_machine(data, runs, &machine);
    let laws = if machine.terms.is_empty() {
        prediction.clone()
    } else {
        simulate_machine(data, runs, &Machine { terms: Vec::new(), ..machine.clone() })
    };
    // A machine that has been diagnosed before may have a time shift among its terms.
    let shift_s = time_shift_s(&machine.terms, data.setting.quantity);
    if let (Some(time_s), true) = (data.time_s(), shift_s != 0.0) {
        let is_axis = data.setting.quantity.axis().is_some();
        let part = if is_axis { &mut prediction.axis } else { &mut prediction.elongation };
        *part = shift_series(time_s, part, shift_s);
    }
    data.used = (0..data.rows)
        .map(|row| {
            let p = prediction.along[row] * prediction.elongation[row] + prediction.axis[row];
            data.measured[row].is_finite() && p.is_finite()
        })
        .collect();
    data.predicted = RowPredictions {
        elongation: prediction.elongation.into(),
        along: prediction.along.into(),
        law: laws.elongation.into(),
        axis: laws.axis.into(),
        thermal: laws.thermal.into(),
    };
}

/// A machine's prediction for each row.
#[derive(Clone)]
struct MachinePrediction {
    elongation: Vec<f64>,
    along: Vec<f64>,
    axis: Vec<f64>,
    thermal: Vec<f64>,
}

fn simulate_machine(
    data: &DataTable,
    runs: &[UncompensatedRun<'_>],
    machine: &Machine,
) -> MachinePrediction {
    let at = |column: Option<&[f64]>, row: usize| column.map_or(f64::NAN, |values| values[row]);
    let angles: Vec<[Option<&[f64]>; 3]> =
        runs.iter().map(|run| ["a_deg", "b_deg", "c_deg"].map(|name| run.column(name))).collect();
    let counts: Vec<Option<&[f64]>> = runs.iter().map(|run| run.column("sensor_counts")).collect();
    let feeds: Vec<Option<&[f64]>> = runs.iter().map(|run| run.column("feed_mm_per_min")).collect();
    let lengths: Vec<Option<&[f64]>> =
        runs.iter().map(|run| run.column("tool_length_mm")).collect();
    let axis = data.setting.quantity.axis().map(LinearAxis::index);
    let list = || Vec::with_capacity(data.rows);
    let mut stepped =
        MachinePrediction { elongation: list(), along: list(), axis: list(), thermal: list() };
    let needed = required_columns(machine);
    let mut row = 0;
    for (number, run) in runs.iter().enumerate() {
        let [has_time, has_run, has_speed, has_load] =
            ["time_s", "run", "spindle_rpm", "load_n"].map(|name| run.column(name).is_some());
        let mut reference = ReferenceModel::new(machine);
        let parts_c = part_temperature_columns(machine, |name| run.column(name));
        let columns = data.temperatures().iter().map(|(name, _)| name);
        let columns = columns.chain(parts_c.iter().map(|(name, _)| name));
        let mut temperatures: Vec<(&str, f64)> =
            columns.map(|name| (name.as_str(), f64::NAN)).collect();
        let is_read = |name: &str| needed.iter().any(|needed| needed == name);
        let read: Vec<&NamedColumn> =
            data.unknown_columns().iter().filter(|(name, _)| is_read(name)).collect();
        let mut others: Vec<(&str, f64)> =
            read.iter().map(|(name, _)| (name.as_str(), f64::NAN)).collect();
        for own in 0..run.row_count() {
            for ((_, now), (_, values)) in others.iter_mut().zip(&read) {
                *now = values[row];
            }
            for ((_, now_c), (_, values)) in temperatures.iter_mut().zip(data.temperatures()) {
                *now_c = values[row];
            }
            let of_parts = temperatures.iter_mut().skip(data.temperatures().len()).zip(&parts_c);
            of_parts.for_each(|((_, now_c), (_, values))| *now_c = values[own]);
            let of = |column: Option<&[f64]>| column.map_or(f64::NAN, |values| values[own]);
            let parts = reference.step(&RowInputs {
                time_s: has_time.then(|| at(data.time_s(), row)),
                run: has_run.then(|| at(data.run_numbers(), row)),
                sensor_counts: of(counts[number]),
                spindle_rpm: has_speed.then(|| at(data.spindle_rpm(), row)),
                load_n: has_load.then(|| at(data.load_n(), row)),
                feed_mm_per_min: of(feeds[number]),
                temperatures_c: &temperatures,
                others: &others,
                position_mm: data.positions_mm().map(|axis| at(axis, row)),
                angle_deg: angles[number].map(of),
                direction: LinearAxis::ALL.map(|axis| at(data.approach_direction(axis), row)),
                tool_length_mm: lengths[number].map(|lengths| lengths[own]),
            });
            let (along, rest, thermal) = match axis {
                None => (1.0, 0.0, 0.0),
                Some(axis) => (
                    parts.tool_direction[axis],
                    parts.error_um()[axis] - parts.tool_um[axis],
                    parts.thermal_um[axis],
                ),
            };
            let is_blind = along == 0.0 || !data.setting.has_elongation;
            stepped.elongation.push(if is_blind { 0.0 } else { parts.elongation_um });
            stepped.along.push(if is_blind && axis.is_some() { 0.0 } else { along });
            stepped.axis.push(rest);
            stepped.thermal.push(thermal);
            row += 1;
        }
    }
    stepped
}
