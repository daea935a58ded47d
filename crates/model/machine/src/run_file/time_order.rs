//! Rows are in time order within a `run`.

use super::{cell_format::ColumnFormats, clock};

/// A clock that is set back by an hour goes back by less, the time between two rows.
const DST_STEP_BACK_S: std::ops::RangeInclusive<f64> = 2700.0..=3600.0;

/// The time of the rows so far.
pub(super) struct TimeOrderChecker {
    time_column: Option<usize>,
    /// That of a logger, if it comes to hold times.
    clock_column: Option<usize>,
    run_column: Option<usize>,
    /// `time_s` and `run` of the newest row that has a time.
    newest: Option<(f64, Option<f64>)>,
}

impl TimeOrderChecker {
    /// Of a file with columns of these names.
    pub(super) fn new(names: &[&str]) -> Self {
        let find = |name| names.iter().position(|there| *there == name);
        Self {
            time_column: find("time_s"),
            clock_column: names.iter().position(|name| clock::is_logger_time_column(name)),
            run_column: find("run"),
            newest: None,
        }
    }

    /// Looks at the next row, a value and its place for each column; else the column at fault, the rule
    /// that it breaks, and whether it may be summer time. The rows after it are held against it: a clock that was set back is reported once.
    pub(super) fn check_row(
        &mut self,
        row: &[(f64, usize)],
        cells: &ColumnFormats,
    ) -> Result<(), (usize, String, bool)> {
        let value = |column: usize| row.get(column).map(|(value, _)| *value);
        let clock = || self.clock_column.filter(|&column| cells.has_timestamps(column));
        let Some(column) = self.time_column.or_else(clock) else { return Ok(()) };
        let Some(time) = value(column).filter(|time| !time.is_nan()) else { return Ok(()) };
        // Two missing run numbers are the same run; as NaN they would not be equal.
        let number = self.run_column.and_then(value).filter(|number| !number.is_nan());
        match self.newest.replace((time, number)) {
            Some((before, number_before)) if number == number_before && time < before => {
                let is_hour = DST_STEP_BACK_S.contains(&(before - time));
                let why = if is_hour { " (by an hour: the end of summer time?)" } else { "" };
                let rule = format!(
                    "runs back from {before} to {time} within a run: rows are in time order{why}"
                );
                Err((column, rule, is_hour))
            }
            _ => Ok(()),
        }
    }
}
