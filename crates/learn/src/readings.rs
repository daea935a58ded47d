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
    /// What tells it from all others, in whatever record it stands: all of its row, and its number where there is no clock.
    pub identity: u64,
}

/// The readings of `run`.
///
/// # Errors
/// It measures nothing, or in no row.
pub(crate) fn of(run: &RunFile, quantity: Quantity) -> Result<Vec<Reading>, BadInput> {
    let name = format!("measured_{}_um", quantity.name());
    let times = run.column("time_s");
    let identity = |row: usize, time_s: Option<f64>| {
        let number = time_s.map_or(row as f64, |_| -1.0);
        let columns = run.columns().iter().flat_map(|column| {
            let value = column.values[row].to_le_bytes();
            column.name.bytes().chain(value)
        });
        hash(number.to_le_bytes().into_iter().chain(columns))
    };
    let rows = run.require(&name)?.iter().enumerate();
    let all: Vec<Reading> = rows
        .filter(|(_, um)| um.is_finite())
        .map(|(row, &um)| {
            let time_s = times.map(|times| times[row]).filter(|time_s| time_s.is_finite());
            Reading { row, um, time_s, identity: identity(row, time_s) }
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

/// A clock that begins within its first day in each record says nothing of the date.
const FIRST_DAY_S: f64 = 86_400.0;

/// Where the clock of a record stands against the last reading that was learned from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Order {
    /// After it, or there is no clock.
    Later,
    /// Before it, by a clock that may begin anew with each record.
    Anew,
    /// Before it.
    Earlier,
}

/// The order of these readings, those that are new.
pub(crate) fn order(last_s: Option<f64>, new: &[Reading]) -> Order {
    let first_s = new.iter().filter_map(|it| it.time_s).reduce(f64::min);
    match (last_s, first_s) {
        (Some(last_s), Some(first_s)) if first_s < last_s => match first_s < FIRST_DAY_S {
            true => Order::Anew,
            false => Order::Earlier,
        },
        _ => Order::Later,
    }
}

/// The time between two readings, in s; a clock that runs back is another day's.
pub(crate) fn between_s(before_s: Option<f64>, now_s: Option<f64>) -> f64 {
    match (before_s, now_s) {
        (Some(before_s), Some(now_s)) if now_s >= before_s => now_s - before_s,
        (None, Some(_)) => 0.0,
        _ => NEW_RECORD_S,
    }
}
