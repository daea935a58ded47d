//! The readings of a record: rows in which the reference was measured, or the probe was checked.

use trueup_machine::{InputFileError, RunFile, machine_file::Quantity};

use crate::learner_state::fnv1a_64;

/// From the end of one record to the beginning of the next where the clock begins anew, in s: a day.
const ASSUMED_RECORD_GAP_S: f64 = 86_400.0;

/// A clock from here on is seconds of Unix, of the year 2001 or later.
const MIN_UNIX_TIME_S: f64 = 1e9;

/// One reading.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReferenceReading {
    /// The row in the record, from 0.
    pub row: usize,
    /// The reading in µm, where the row has one.
    pub um: Option<f64>,
    /// The check of the probe in µm, where the row has one.
    pub check_um: Option<f64>,
    /// The record's clock in s, where it has one.
    pub time_s: Option<f64>,
    /// A hash that identifies it in whatever record it stands: its clock and value, or all of its row and its number
    /// where there is no clock.
    pub identity: u64,
    /// The hash of the form before this one: all of its row.
    pub identity_before: u64,
}

/// Returns the readings of `run`.
///
/// # Errors
/// It measures nothing, or in no row.
pub(crate) fn collect_readings(
    run: &RunFile,
    quantity: Quantity,
) -> Result<Vec<ReferenceReading>, InputFileError> {
    let name = format!("measured_{}_um", quantity.name());
    let (times, checks) = (run.column("time_s"), run.column("check_um"));
    let whole = |row: usize, time_s: Option<f64>| {
        let number = time_s.map_or(row as f64, |_| -1.0);
        let columns = run.columns().iter().flat_map(|column| {
            let value = column.values[row].to_le_bytes();
            column.name.bytes().chain(value)
        });
        fnv1a_64(number.to_le_bytes().into_iter().chain(columns))
    };
    let rows = run.require_column(&name)?.iter().enumerate();
    let all: Vec<ReferenceReading> = rows
        .filter_map(|(row, &um)| {
            let um = Some(um).filter(|um| um.is_finite());
            let check_um = checks.map(|check| check[row]).filter(|um| um.is_finite());
            (um.is_some() || check_um.is_some()).then_some((row, um, check_um))
        })
        .map(|(row, um, check_um)| {
            let time_s = times.map(|times| times[row]).filter(|time_s| time_s.is_finite());
            // Dates keep the time between records; to a millisecond, as clocks are.
            let date_s = |time_s: f64, epoch_s: f64| ((epoch_s + time_s) * 1e3).round() / 1e3;
            let time_s =
                time_s.map(|s| run.time_origin_unix_s().map_or(s, |epoch_s| date_s(s, epoch_s)));
            let identity_before = whole(row, time_s);
            let identity = match time_s {
                Some(time_s) => {
                    // A check may be written into a row later: then it is another reading.
                    let value = um.or(check_um).unwrap_or_default();
                    let bytes = [time_s, value].into_iter().flat_map(f64::to_le_bytes);
                    fnv1a_64(bytes.chain([u8::from(um.is_some())]))
                }
                None => identity_before,
            };
            ReferenceReading { row, um, check_um, time_s, identity, identity_before }
        })
        .collect();
    if all.is_empty() {
        return Err(run.value_error(
            0,
            &name,
            "has no value in any row: there is nothing to learn from",
        ));
    }
    Ok(all)
}

/// A clock that begins within its first day in each record says nothing of the date.
pub(crate) const MAX_RELATIVE_START_S: f64 = 86_400.0;

/// Returns the time between two readings, in s; a clock that runs back is another day's.
pub(crate) fn elapsed_s(before_s: Option<f64>, now_s: Option<f64>) -> f64 {
    match (before_s, now_s) {
        // Records with dates after records without.
        (Some(before_s), Some(now_s)) if before_s < MIN_UNIX_TIME_S && now_s >= MIN_UNIX_TIME_S => {
            ASSUMED_RECORD_GAP_S
        }
        (Some(before_s), Some(now_s)) if now_s >= before_s => now_s - before_s,
        (None, Some(_)) => 0.0,
        _ => ASSUMED_RECORD_GAP_S,
    }
}
