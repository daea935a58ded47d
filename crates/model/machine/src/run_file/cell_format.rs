//! A field of a run file as a number: written as one, or as a time of day.

use super::clock::{TimeOrigin, can_hold_timestamps, looks_like_date};
use crate::location::truncate_text;

/// The clock and the form of each column, by the fields read so far.
pub(super) struct ColumnFormats {
    clock: TimeOrigin,
    /// By column; `None` before its first value.
    form: Vec<Option<CellFormat>>,
}

#[derive(Clone, Copy, PartialEq)]
enum CellFormat {
    Number,
    Time,
}

impl ColumnFormats {
    pub(super) fn new(columns: usize) -> Self {
        Self { clock: TimeOrigin::default(), form: vec![None; columns] }
    }

    /// Returns whether the values of a column were written as times of day.
    pub(super) fn has_timestamps(&self, column: usize) -> bool {
        self.form.get(column) == Some(&Some(CellFormat::Time))
    }

    /// Returns the first time of the file in s from 1970, where a column of times is counted from it.
    pub(super) fn time_origin_unix_s(&self, column: usize) -> Option<f64> {
        self.clock.first_timestamp_unix_s().filter(|_| self.has_timestamps(column))
    }

    /// Takes note of a row of numbers, NaN where one is missing; false if a column has held times of day: one
    /// of its fields breaks a rule.
    pub(super) fn try_record_numbers(&mut self, row: &[(f64, usize)]) -> bool {
        self.form.iter_mut().zip(row).all(|(form, (value, _))| {
            value.is_nan() || *form.get_or_insert(CellFormat::Number) == CellFormat::Number
        })
    }

    /// Returns the value of a field of this column, NaN if it is missing; else the rule it breaks. A time of
    /// day is in seconds from the first one of the file.
    pub(super) fn parse_cell(
        &mut self,
        column: usize,
        name: &str,
        text: &str,
    ) -> Result<f64, String> {
        let is_time = looks_like_date(text) && text.parse::<f64>().is_err();
        let (value, form) = if is_time && can_hold_timestamps(name) {
            let seconds = self.clock.parse_seconds_since_first(text);
            (seconds.map_err(|rule| format!("{} {rule}", truncate_text(text)))?, CellFormat::Time)
        } else {
            (parse_number(text, is_time)?, CellFormat::Number)
        };
        if value.is_nan() {
            return Ok(value);
        }
        if let Some(known) = self.form.get_mut(column)
            && *known.get_or_insert(form) != form
        {
            return Err(match form {
                CellFormat::Number => {
                    format!("{} is a number, the first value a time of day", truncate_text(text))
                }
                CellFormat::Time => {
                    format!("{} is a time of day, the first value a number", truncate_text(text))
                }
            });
        }
        Ok(value)
    }
}

/// Returns the value of a field, NaN if it is missing; else the rule it breaks.
fn parse_number(text: &str, is_time: bool) -> Result<f64, String> {
    if text.is_empty() {
        return Ok(f64::NAN);
    }
    match text.parse::<f64>() {
        Ok(value) if value.is_infinite() => Err(format!("{} is infinite", truncate_text(text))),
        Ok(value) => Ok(value),
        Err(_) if has_decimal_comma(text) => Err(format!(
            "{} has a decimal comma: decimals are written with a point",
            truncate_text(text)
        )),
        Err(_) => {
            let hint =
                if is_time { ": a time of day stands in a column time or time_s" } else { "" };
            Err(format!("\"{}\" is not a number{hint}", truncate_text(text)))
        }
    }
}

/// Returns whether `text` is a number but for its commas.
fn has_decimal_comma(text: &str) -> bool {
    let of_a_number = |c: char| c.is_ascii_digit() || "+-.,eE".contains(c);
    text.contains(',')
        && text.contains(|c: char| c.is_ascii_digit())
        && text.chars().all(of_a_number)
}
