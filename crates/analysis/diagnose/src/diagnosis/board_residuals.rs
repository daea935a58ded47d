//! The residual of a record on the board: its own arithmetic on the rows that were measured.

use trueup_machine::{Machine, RunFile, predict::RunPredictor};

use crate::{data::DataTable, model::Model};

/// Longer records, in s, are predicted by the model alone: the board's heat is stepped ten times a second, and it
/// differs by nanometres.
const MAX_SIMULATED_RECORD_S: f64 = 5e6;

/// Returns what the board leaves with `machine` in the rows that count, in µm; `model` is what it runs, for a record
/// that the board's arithmetic cannot be stepped through.
pub(super) fn compute_board_residuals(
    data: &DataTable,
    runs: &[RunFile],
    machine: &Machine,
    model: &Model,
    aside: &[bool],
) -> Vec<f64> {
    let predicted = predict_on_board(data, runs, machine).unwrap_or_else(|| model.predict(data));
    (0..data.rows)
        .filter(|&row| data.used[row] && !aside[row])
        .map(|row| data.measured[row] - predicted[row])
        .filter(|error| error.is_finite())
        .collect()
}

/// Returns the board's prediction of each row; `None` where there is none: the file does not say how the sensor is
/// connected, or the record is too long.
fn predict_on_board(data: &DataTable, runs: &[RunFile], machine: &Machine) -> Option<Vec<f64>> {
    let length_s = |run: &RunFile| {
        let times = run.column("time_s").unwrap_or_default().iter().copied();
        let [first_s, last_s] = super::value_range::min_max(times);
        if first_s < last_s { last_s - first_s } else { 0.0 }
    };
    if runs.iter().map(length_s).sum::<f64>() > MAX_SIMULATED_RECORD_S {
        return None;
    }
    let number = trueup_machine::machine_file::Quantity::ALL
        .iter()
        .position(|quantity| *quantity == data.setting.quantity)?;
    let mut predicted = Vec::with_capacity(data.rows);
    for run in runs {
        let first = predicted.len();
        // Of a thermometer that measured nothing the board uses nothing either.
        let run = run.with_altered_values(run.row_count(), |name, values| {
            if let Some(trusted) = data.temperature_c(name) {
                values.copy_from_slice(&trusted[first..first + values.len()]);
            }
        });
        let predictor = RunPredictor::new(machine, &run).ok()?;
        for row in predictor.predictions() {
            predicted.push(row.bridge?.to_array()[number]);
        }
    }
    (predicted.len() == data.rows).then_some(predicted)
}
