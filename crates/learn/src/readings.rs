//! The readings of a record: rows in which the reference was measured.

use trueup_machine::{BadInput, RunFile, file::Quantity};

use crate::memory::hash;

/// From the end of one record to the beginning of the next where the clock begins anew, in s: a day.
const NEW_RECORD_S: f64 = 86_400.0;

/// One reading.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reading {
    /// The row in the record, from 0.
    pub row: usize,
    /// In µm.
    pub um: f64,
    /// The record's clock in s, where it has one.
    pub time_s: Option<f64>,
}

/// The readings of `run`.
///
/// # Errors
/// It measures nothing, or in no row.
pub(crate) fn of(run: &RunFile, quantity: Quantity) -> Result<Vec<Reading>, BadInput> {
    let name = format!("measured_{}_um", quantity.name());
    let times = run.column("time_s");
    let rows = run.require(&name)?.iter().enumerate();
    let all: Vec<Reading> = rows
        .filter(|(_, um)| um.is_finite())
        .map(|(row, &um)| {
            let time_s = times.map(|times| times[row]).filter(|time_s| time_s.is_finite());
            Reading { row, um, time_s }
        })
        .collect();
    if all.is_empty() {
        return Err(run.bad(0, &name, "has no value in any row: there is nothing to learn from"));
    }
    Ok(all)
}

/// What tells a record from others.
pub(crate) fn fingerprint(readings: &[Reading]) -> u64 {
    let numbers = readings.iter().flat_map(|it| [it.um, it.time_s.unwrap_or(-1.0)]);
    hash(numbers.flat_map(f64::to_le_bytes))
}

/// The time between two readings, in s; a clock that runs back is another day's.
pub(crate) fn between_s(before_s: Option<f64>, now_s: Option<f64>) -> f64 {
    match (before_s, now_s) {
        (Some(before_s), Some(now_s)) if now_s >= before_s => now_s - before_s,
        (None, Some(_)) => 0.0,
        _ => NEW_RECORD_S,
    }
}
