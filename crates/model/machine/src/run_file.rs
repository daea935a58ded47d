//! The run file: what was measured, one observation a row, in CSV.
//!
//! Numbers only, under one header row whose names carry the unit. A number that would be misread in
//! silence (a decimal comma, a repeated column, an infinite value, a row that is too short) is an
//! error with its line and column. Lines that begin with `#` are comments. Where a logger writes the
//! time of day (ISO 8601) it is read as seconds from the first one of the file.
//!
//! The file is read line by line, one line a row, and its memory is that of its values: 12 bytes
//! each. It is bounded: by `MAX_RUN_FILE_BYTES`, [`MAX_RUN_FILE_COLUMNS`] and `MAX_RUN_FILE_VALUES`, and a line by
//! 1 MiB.

mod bridge_record;
mod cell_format;
mod clock;
mod column_typos;
mod faults;
mod field_positions;
mod fields;
mod line;
mod numeric_row;
mod reader;
mod run_table;
mod time_order;
mod tool_label;
mod tool_numbers;

use std::{
    fmt::Display,
    fs::File,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
};

use crate::{
    bounded_read,
    location::{InputFileError, Location, format_suggestion},
};
use run_table::{ColumnTypo, RunFileSizeLimits, RunTable};

pub(crate) use run_table::MAX_RUN_FILE_BYTES;
pub(crate) use run_table::MAX_RUN_FILE_VALUES;
pub use run_table::{MAX_RUN_FILE_COLUMNS, RunColumn};

pub use crate::known_columns::is_known_column;

/// A measured run.
#[derive(Clone, Debug)]
pub struct RunFile {
    path: PathBuf,
    columns: Vec<RunColumn>,
    header_line: usize,
    /// The line of each row, from 1: empty lines and comments are no rows.
    line_of_row: Vec<u32>,
    slips: Vec<ColumnTypo>,
    labels: Vec<(f64, String)>,
    epoch_s: Option<f64>,
}

impl RunFile {
    /// Reads the run file at `path`.
    ///
    /// # Errors
    /// The file cannot be read, or breaks a rule of [`Self::from_reader`].
    pub fn read(path: &Path) -> Result<Self, InputFileError> {
        Self::from_reader(BufReader::new(Self::open(path)?), path)
    }

    /// Opens the run file at `path`, for [`Self::from_reader`].
    ///
    /// # Errors
    /// The file cannot be opened, or is longer than `MAX_RUN_FILE_BYTES`.
    pub fn open(path: &Path) -> Result<File, InputFileError> {
        bounded_read::open(path, MAX_RUN_FILE_BYTES)
    }

    /// Reads a run from `source`; `path` names it in errors.
    ///
    /// Fields are separated by `,` or `;`, whichever is in the header more often. A byte order
    /// mark, CRLF, blanks around a field, `"` around it, empty lines, and lines that begin with `#`
    /// are accepted. An empty field and `nan` are missing values. Where there is no `time_s`, a column
    /// `time` of times by ISO 8601 is `time_s`.
    ///
    /// # Errors
    /// No header or no row; a column without a name or with that of another; a row with more or
    /// fewer fields than the header; text, a decimal comma or an infinite value where a number
    /// belongs; `time_s` that runs back while `run` stays the same; `dir_*` other than 1 and −1;
    /// text that is not UTF-8; a source that cannot be read; more than `MAX_RUN_FILE_BYTES`,
    /// [`MAX_RUN_FILE_COLUMNS`] or `MAX_RUN_FILE_VALUES`. All that is wrong with a file is reported at once, up to
    /// [`MAX_LISTED_ERRORS`](crate::location::MAX_LISTED_ERRORS) faults with their places.
    pub fn from_reader(source: impl BufRead, path: &Path) -> Result<Self, InputFileError> {
        Self::read_within_limits(
            RunFileSizeLimits { bytes: MAX_RUN_FILE_BYTES, values: MAX_RUN_FILE_VALUES },
            source,
            path,
        )
    }

    fn read_within_limits(
        bounds: RunFileSizeLimits,
        source: impl BufRead,
        path: &Path,
    ) -> Result<Self, InputFileError> {
        let RunTable { columns, header_line, line_of_row, slips, labels, epoch_s } =
            reader::read(bounds, source, path)?;
        let path = path.to_path_buf();
        Ok(Self { path, columns, header_line, line_of_row, slips, labels, epoch_s })
    }

    /// Returns the path under which the run was read.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the number of rows, at least 1.
    #[must_use]
    pub fn row_count(&self) -> usize {
        self.line_of_row.len()
    }

    /// Returns the instant from which `time_s` counts, in s from 1970, where the file has dates: it keeps the time between
    /// files. Dates without a time zone count as UTC.
    #[must_use]
    pub fn time_origin_unix_s(&self) -> Option<f64> {
        self.epoch_s
    }

    /// Returns all columns, in the order of the file.
    #[must_use]
    pub fn columns(&self) -> &[RunColumn] {
        &self.columns
    }

    /// Returns the values of the column `name`, NaN where missing; `None` if there is no such column.
    #[must_use]
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        self.columns.iter().find(|column| column.name == name).map(|column| &column.values[..])
    }

    /// Returns the values of the column `name`, NaN where missing.
    ///
    /// # Errors
    /// There is no such column: the rule lists those that are there.
    pub fn require_column(&self, name: &str) -> Result<&[f64], InputFileError> {
        self.column(name).ok_or_else(|| {
            if let Some(typo) = self.slips.iter().find(|typo| typo.meant == name) {
                return InputFileError::new(
                    self.header_location_at(typo.column),
                    format!(
                        "column {name} is missing; {} is no column that is known: if it was meant, \
                             give it as {name}",
                        typo.name
                    ),
                );
            }
            let names = || self.columns.iter().map(|column| column.name.as_str());
            let there = names().collect::<Vec<_>>().join(", ");
            let suggestion = format_suggestion(name, names());
            let rule = format!("column {name} is missing; there are {there}{suggestion}");
            InputFileError::new(self.header_location(), rule)
        })
    }

    /// Names of columns that look like a known one, each with its place and what was probably meant.
    pub fn column_typos(&self) -> impl Iterator<Item = InputFileError> {
        self.slips.iter().map(|ColumnTypo { name, meant, column }| {
            let rule = format!("{name} is no column that is known; did you mean {meant}?");
            let help =
                format!("give it as {meant}, in that unit; else it is only a possible explanation");
            InputFileError::new(self.header_location_at(*column), rule).with_help(help)
        })
    }

    /// Where a column stands that was probably meant as one of those for which `is_wanted` holds, and
    /// what to do about it.
    ///
    /// ```
    /// # use trueup_machine::RunFile;
    /// let text = "time_s,measured_dz_mm\n0,0.012\n";
    /// let run = RunFile::from_reader(text.as_bytes(), "r.csv".as_ref()).unwrap();
    /// let slip = run.find_column_typo(|name| name.starts_with("measured_")).unwrap();
    /// assert!(slip.to_string().starts_with("r.csv:1:8: column measured_dz_um is missing; measured_dz_mm is"));
    /// ```
    pub fn find_column_typo(&self, is_requested: impl Fn(&str) -> bool) -> Option<InputFileError> {
        let typo = self.slips.iter().find(|typo| is_requested(&typo.meant))?;
        self.require_column(&typo.meant).err()
    }

    /// Other values in the place of those of the column `name`, one for each row.
    pub(crate) fn replace_column(&mut self, name: &str, values: Vec<f64>) {
        if let Some(column) = self.columns.iter_mut().find(|column| column.name == name) {
            column.values = values.into();
        }
    }

    /// Adds a column of values that the file does not have; each has the place of the value of `beside`.
    pub(crate) fn add_column(&mut self, name: &str, adjacent: &str, values: Vec<f64>) {
        let starts = self
            .columns
            .iter()
            .find(|column| column.name == adjacent)
            .map(|column| column.starts.clone());
        if let Some(starts) = starts {
            self.columns.push(RunColumn { name: name.into(), values: values.into(), starts });
        }
    }

    /// Returns the first `rows` rows, with what `change` makes of the values of each column: a run that was not
    /// measured.
    #[must_use]
    pub fn with_altered_values(
        &self,
        rows: usize,
        mut change: impl FnMut(&str, &mut [f64]),
    ) -> Self {
        let rows = rows.min(self.row_count());
        let columns = self.columns.iter().map(|column| {
            let mut values = column.values[..rows].to_vec();
            change(&column.name, &mut values);
            RunColumn {
                name: column.name.clone(),
                values: values.into(),
                starts: column.starts.clone(),
            }
        });
        Self {
            path: self.path.clone(),
            columns: columns.collect(),
            header_line: self.header_line,
            line_of_row: self.line_of_row[..rows].to_vec(),
            slips: self.slips.clone(),
            labels: self.labels.clone(),
            epoch_s: self.epoch_s,
        }
    }

    /// Leaves out the columns whose name is one of these.
    pub(crate) fn remove_columns(&mut self, is_one: impl Fn(&str) -> bool) {
        self.columns.retain(|column| !is_one(&column.name));
    }

    /// Where the value of `column` in `row` (from 0) stands; the start of the row's line if there
    /// is no such column, of the file if there is no such row.
    #[must_use]
    pub fn value_location(&self, row: usize, column: &str) -> Location {
        let Some(&line) = self.line_of_row.get(row) else {
            return Location::start_of_file(&self.path);
        };
        let column = self
            .columns
            .iter()
            .find(|there| there.name == column)
            .and_then(|there| there.starts.get(row))
            .unwrap_or(1);
        Location { file: self.path.clone(), line: line as usize, column }
    }

    /// The value of `column` in `row` (from 0) breaks a rule; `rule` goes on after the column's
    /// name: "40000 is outside 0…32768".
    #[must_use]
    pub fn value_error(&self, row: usize, column: &str, rule: impl Display) -> InputFileError {
        InputFileError::new(self.value_location(row, column), format!("{column} {rule}"))
    }

    /// Where the header row begins: for what is wrong with the columns as a whole.
    pub(crate) fn header_location(&self) -> Location {
        self.header_location_at(1)
    }

    fn header_location_at(&self, column: usize) -> Location {
        Location { file: self.path.clone(), line: self.header_line, column }
    }
}

#[cfg(test)]
mod tests;
