//! A run file read line by line into columns. A fault in a row does not keep the next ones from being
//! looked at: all faults of a file are reported at once.

use std::{collections::HashMap, io::BufRead, path::Path, sync::Arc};

use rayon::prelude::*;
use trueup_output::escape::{escape_line, shell_quote};

use super::{
    cell_format::ColumnFormats,
    clock, column_typos,
    faults::InputErrorList,
    field_positions::FieldPositions,
    fields::{Fields, QuoteError, detect_separator, parse_separator_line},
    line::{LineReadError, RunFileLines, RunLine},
    numeric_row,
    run_table::{ColumnTypo, MAX_RUN_FILE_COLUMNS, RunColumn, RunFileSizeLimits, RunTable},
    time_order::TimeOrderChecker,
    tool_label,
};
use crate::{
    known_columns,
    location::{InputFileError, Location, truncate_text},
};

/// A file that is being read.
pub(super) struct RunReader<'p> {
    path: &'p Path,
    separator: char,
    header_line: usize,
    columns: Vec<ColumnBuilder>,
    slips: Vec<ColumnTypo>,
    labels: Vec<(f64, String)>,
    line_of_row: Vec<u32>,
    cells: ColumnFormats,
    order: TimeOrderChecker,
    /// The row that is being read: values, and where each stands.
    row: Vec<(f64, usize)>,
    faults: InputErrorList,
}

/// The column of a lathe's diameters.
const DIAMETER_COLUMN: &str = "x_dia_mm";

/// A column that is being filled.
struct ColumnBuilder {
    name: String,
    is_diameter: bool,
    is_direction: bool,
    has_labels: bool,
    values: Vec<f64>,
    starts: FieldPositions,
}

/// Lines that are looked at at once, on all cores, and their bytes, but for those of the last one: a line may be long.
const LINES_PER_BATCH: usize = 4096;
const BYTES_PER_BATCH: usize = 1 << 20;

/// Reads all of `source`.
pub(super) fn read(
    bounds: RunFileSizeLimits,
    source: impl BufRead,
    path: &Path,
) -> Result<RunTable, InputFileError> {
    let mut lines = RunFileLines::new(source, path, bounds.bytes);
    let mut stated = None;
    let header = loop {
        match lines.read_line().map_err(LineReadError::into_error)? {
            Some(line) if line.has_content() => match parse_separator_line(&line.text) {
                Some(separator) => stated = Some(separator),
                None => break line,
            },
            Some(_) => {}
            None => {
                let rule = "is empty: a run file needs a header row with the names of its columns";
                return Err(InputFileError::new(Location::start_of_file(path), rule));
            }
        }
    };
    let mut reading = RunReader::from_header(&header, path, stated)?;
    let mut goes_on = true;
    while goes_on {
        let mut batch = Vec::new();
        let mut bytes = 0;
        while goes_on && batch.len() < LINES_PER_BATCH && bytes < BYTES_PER_BATCH {
            match lines.read_line() {
                Ok(None) => goes_on = false,
                Ok(Some(line)) if !line.has_content() => {}
                Ok(Some(line)) => {
                    bytes += line.text.len();
                    batch.push(Ok(line));
                }
                Err(LineReadError::Line(error)) => batch.push(Err(error)),
                Err(LineReadError::Rest(error)) => {
                    batch.push(Err(error));
                    goes_on = false;
                }
            }
        }
        goes_on &= reading.read_rows(&batch, bounds.values);
    }
    reading.finish()
}

impl<'p> RunReader<'p> {
    fn from_header(
        line: &RunLine,
        path: &'p Path,
        stated: Option<char>,
    ) -> Result<Self, InputFileError> {
        let separator = stated.unwrap_or_else(|| detect_separator(&line.text));
        let mut columns: Vec<ColumnBuilder> = Vec::new();
        let mut slips = Vec::new();
        let mut faults = InputErrorList::default();
        let mut first_of_name = HashMap::new();
        for field in Fields::new(&line.text, separator) {
            let field = field.map_err(|fault| input_error_from_quote_error(line, path, fault))?;
            // What would move a terminal's cursor is written out from here on, in every report and file.
            let shown = escape_line(field.text.trim());
            let name = shown.as_str();
            let bad = |rule: String| InputFileError::new(line.location(path, field.column), rule);
            let number = columns.len() + 1;
            // Where these are wrong it is unknown what the rows should be.
            if name.parse::<f64>().is_ok() {
                let rule = format!(
                    "the first row must name the columns, but {} is a number",
                    truncate_text(name)
                );
                return Err(bad(rule).with_help(
                    "write a row before it with a name for each column, as in time_s,sensor_counts",
                ));
            }
            if field.text.trim().contains('\t') {
                return Err(bad("columns must be separated by , or ; and not by tabs".into()));
            }
            if columns.len() == MAX_RUN_FILE_COLUMNS {
                return Err(bad(format!("more than {MAX_RUN_FILE_COLUMNS} columns")));
            }
            if name.is_empty() {
                faults.push(bad(format!("column {number} has no name")).with_help(
                    "give it one; a name that is not known is kept as a possible explanation",
                ));
            }
            // Diameters are read as radii: from here on the column is that of the axis.
            let is_diameter = name == DIAMETER_COLUMN;
            let axis = if is_diameter { "x_mm" } else { name };
            if name.is_empty() {
                // Said above.
            } else if let Some(first) = first_of_name.insert(axis.to_string(), number) {
                let rule = match is_diameter || columns[first - 1].is_diameter {
                    true => {
                        format!(
                            "{name}: {DIAMETER_COLUMN} and x_mm are the same axis, column {first}"
                        )
                    }
                    false => format!("column {name} is repeated: it is also column {first}"),
                };
                faults.push(bad(rule).with_help("leave one of them out, or give it another name"));
            }
            if let Some(meant) = column_typos::suggest_column(name) {
                slips.push(ColumnTypo { name: name.to_string(), meant, column: field.column });
            }
            columns.push(ColumnBuilder {
                name: axis.to_string(),
                is_diameter,
                is_direction: matches!(name, "dir_x" | "dir_y" | "dir_z"),
                has_labels: tool_label::can_have_labels(name),
                values: Vec::new(),
                starts: FieldPositions::new(),
            });
        }
        let names: Vec<&str> = columns.iter().map(|column| column.name.as_str()).collect();
        Ok(Self {
            path,
            separator,
            header_line: line.number,
            cells: ColumnFormats::new(columns.len()),
            order: TimeOrderChecker::new(&names),
            row: Vec::with_capacity(columns.len()),
            columns,
            slips,
            labels: Vec::new(),
            line_of_row: Vec::new(),
            faults,
        })
    }

    /// Refuses the row on `line` where it would make more than `most` values.
    fn check_value_limit(&self, line: &RunLine, most: usize) -> Result<(), InputFileError> {
        let columns = self.columns.len();
        if (self.line_of_row.len() + 1) * columns <= most {
            return Ok(());
        }
        let rule =
            format!("more than {most} values ({columns} columns): leave out rows or columns");
        Err(InputFileError::new(line.location(self.path, 1), rule))
    }

    /// Takes the rows on `lines`, or notes what is wrong with them; false where there is no room for more values
    /// than `most`.
    fn read_rows(&mut self, lines: &[Result<RunLine, InputFileError>], most: usize) -> bool {
        let (columns, separator) = (self.columns.len(), self.separator);
        let plain = |line: &Result<RunLine, InputFileError>| {
            let line = line.as_ref().ok()?;
            numeric_row::parse_numeric_row(&line.text, separator, columns)
        };
        let plain: Vec<_> = lines.par_iter().map(plain).collect();
        for (line, plain) in lines.iter().zip(plain) {
            match line {
                Err(error) => self.faults.push(error.clone()),
                Ok(line) => {
                    if let Err(error) = self.check_value_limit(line, most) {
                        self.faults.push(error);
                        return false;
                    }
                    self.read_row(line, plain);
                }
            }
        }
        true
    }

    /// Takes the row on `line`, or notes what is wrong with it; `plain`: its fields, if it is a row of plain numbers.
    fn read_row(&mut self, line: &RunLine, plain: Option<Vec<(f64, usize)>>) {
        let faults_before = self.faults.count();
        self.row = plain.unwrap_or_default();
        if self.row.is_empty()
            || !self.cells.try_record_numbers(&self.row)
            || self.has_invalid_cell()
        {
            self.row.clear();
            self.read_fields(line);
        }
        if self.row.len() != self.columns.len() {
            return;
        }
        if let Err((column, rule, is_hour)) = self.order.check_row(&self.row, &self.cells) {
            self.record_time_reversal_error(line, column, &rule, is_hour);
        }
        if self.faults.count() != faults_before {
            return;
        }
        for (column, &(value, start)) in self.columns.iter_mut().zip(&self.row) {
            column.values.push(value);
            column.starts.push(start);
        }
        // The file has less than 2³⁰ bytes.
        self.line_of_row.push(u32::try_from(line.number).unwrap_or(u32::MAX));
    }

    /// Splits the row on `line`; as many values as the header has names, unless that is its fault.
    fn read_fields(&mut self, line: &RunLine) {
        let requested = self.columns.len();
        for field in Fields::new(&line.text, self.separator) {
            let field = match field {
                Ok(field) => field,
                Err(fault) => {
                    self.row.clear();
                    return self.faults.push(input_error_from_quote_error(line, self.path, fault));
                }
            };
            let there = self.row.len();
            let Some(column) = self.columns.get(there) else {
                self.row.clear();
                return self.faults.push(self.too_many_fields_error(line, field.column));
            };
            let cell = field.text.trim();
            let read = self.cells.parse_cell(there, &column.name, cell);
            let read = if column.has_labels { tool_label::parse(cell, read) } else { read };
            if let Ok(code) = read
                && code < 0.0
                && column.has_labels
                && self.labels.iter().all(|(known, _)| *known != code)
            {
                self.labels.push((code, cell.into()));
            }
            let read = read.and_then(|value| match column.is_direction {
                true => check_direction(value),
                false => Ok(value),
            });
            match read {
                Ok(value) => self.row.push((value, field.column)),
                Err(rule) => {
                    self.record_value_error(line, field.column, there, &rule);
                    self.row.push((f64::NAN, field.column));
                }
            }
        }
        let there = self.row.len();
        if there < requested {
            let missing = &self.columns[there].name;
            let rule = format!("the row has {there} fields, the header {requested}: no {missing}");
            let end = line.text.chars().count() + 1;
            let error = InputFileError::new(line.location(self.path, end), rule);
            self.faults.push(error.with_help(
                "every row has a field for each column; one without a value is left empty",
            ));
        }
    }

    fn has_invalid_cell(&self) -> bool {
        let mut fields = self.columns.iter().zip(&self.row);
        fields.any(|(column, (value, _))| {
            column.is_direction && check_direction(*value).is_err()
                || column.has_labels && tool_label::parse("", Ok(*value)).is_err()
        })
    }

    fn too_many_fields_error(&self, line: &RunLine, column: usize) -> InputFileError {
        let requested = self.columns.len();
        let fields = Fields::new(&line.text, self.separator).count();
        let (hint, help) = match self.separator {
            ',' => (
                " (decimals are written with a point)",
                "write 1.5 and not 1,5; or separate the columns by ; in the header too",
            ),
            _ => ("", "every row has one field for each column of the header"),
        };
        let rule = format!("the row has {fields} fields, the header {requested}{hint}");
        InputFileError::new(line.location(self.path, column), rule).with_help(help)
    }

    /// The value of a column breaks a rule, which goes on after the column's name.
    fn record_value_error(&mut self, line: &RunLine, place: usize, column: usize, rule: &str) {
        let name = &self.columns[column].name;
        let place = line.location(self.path, place);
        self.faults.push(
            InputFileError::new(place, format!("{name} {rule}")).with_help(column_help(name)),
        );
    }

    /// The time runs back within a run; by an hour it may be summer time, which `import` takes out.
    fn record_time_reversal_error(
        &mut self,
        line: &RunLine,
        column: usize,
        rule: &str,
        is_hour: bool,
    ) {
        if !is_hour {
            return self.record_value_error(line, self.row[column].1, column, rule);
        }
        let word = |path: &Path| shell_quote(&path.to_string_lossy());
        let help = format!(
            "if the clock was changed (the end of summer time), write each time with its offset \
             (2026-10-25T02:30:00+01:00) or in UTC (2026-10-25T01:30:00Z). Or: trueup import {} \
             --summer-time yes -o {}",
            word(self.path),
            word(&self.path.with_extension("run.csv"))
        );
        let place = line.location(self.path, self.row[column].1);
        let rule = format!("{} {rule}", self.columns[column].name);
        self.faults.push(InputFileError::new(place, rule).with_help(help));
    }

    /// Returns the run, or all that is wrong with it.
    fn finish(self) -> Result<RunTable, InputFileError> {
        if let Some(error) = self.faults.into_error() {
            return Err(error);
        }
        if self.line_of_row.is_empty() {
            let header = Location { file: self.path.into(), line: self.header_line, column: 1 };
            return Err(InputFileError::new(header, "there is a header row, but no row of values"));
        }
        let columns = self.columns.into_iter().map(|mut column| {
            if column.is_diameter {
                column.values.iter_mut().for_each(|value| *value /= 2.0);
            }
            RunColumn {
                name: column.name,
                values: column.values.into(),
                starts: Arc::new(column.starts),
            }
        });
        let mut table = RunTable {
            columns: columns.collect(),
            header_line: self.header_line,
            line_of_row: self.line_of_row,
            slips: self.slips,
            labels: self.labels,
            epoch_s: None,
        };
        resolve_clock_columns(&mut table, &self.cells);
        Ok(table)
    }
}

fn input_error_from_quote_error(line: &RunLine, path: &Path, fault: QuoteError) -> InputFileError {
    InputFileError::new(line.location(path, fault.column), fault.rule)
        .with_help("numbers need no quotes; a quote inside a quoted name is written twice")
}

/// `dir_x`, `dir_y`, `dir_z` are the direction of approach: 1 or −1.
fn check_direction(value: f64) -> Result<f64, String> {
    if !value.is_nan() && value.abs() != 1.0 {
        return Err(format!("must be 1 or -1, not {value}"));
    }
    Ok(value)
}

/// Returns what belongs into a column of this name.
fn column_help(name: &str) -> String {
    let value = "a number with a decimal point; empty or nan where there is none";
    match known_columns::find_known_column(name) {
        Some(column) if column.unit.is_empty() => format!("{name}: {}; {value}", column.meaning),
        Some(column) => format!("{name} ({}): {}; {value}", column.unit, column.meaning),
        None => value.into(),
    }
}

/// The time of a logger, if it was one, or seconds of Unix, is `time_s`; where there is one already it is
/// left out: it explains nothing that `time_s` does not. A slip goes if its meant column is there by then,
/// or its own is not.
fn resolve_clock_columns(table: &mut RunTable, cells: &ColumnFormats) {
    let mut number = 0;
    let mut has_time_s = table.columns.iter().any(|column| column.name == "time_s");
    let mut epoch_s = None;
    table.columns.retain_mut(|column| {
        let is_time = cells.has_timestamps(number) || clock::is_unix_time_series(&column.values);
        let is_clock = is_time && clock::is_logger_time_column(&column.name);
        if column.name == "time_s" || is_clock && !has_time_s {
            epoch_s = cells.time_origin_unix_s(number);
        }
        number += 1;
        if is_clock && !has_time_s {
            column.name = "time_s".into();
            has_time_s = true;
            return true;
        }
        !is_clock
    });
    table.epoch_s = epoch_s;
    let columns = &table.columns;
    let is_there = |name: &str| columns.iter().any(|column| column.name == name);
    table.slips.retain(|typo| !is_there(&typo.meant) && is_there(&typo.name));
}
