//! The run file: what was measured, one observation a row, in CSV.
//!
//! Numbers only, under one header row whose names carry the unit. A number that would be misread in
//! silence (a decimal comma, a repeated column, an infinite value, a row that is too short) is an
//! error with its line and column. Lines that begin with `#` are comments. Where a logger writes the
//! time of day (ISO 8601) it is read as seconds from the first one of the file.
//!
//! The file is read line by line, one line a row, and its memory is that of its values: 12 bytes
//! each. It is bounded: by [`MOST_BYTES`], [`MOST_COLUMNS`] and [`MOST_VALUES`], and a line by
//! 1 MiB.

mod cells;
mod clock;
mod fields;
mod known;
mod line;
mod meant;
mod places;

use std::{
    collections::HashMap,
    fmt::Display,
    fs::File,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    sync::Arc,
};

use crate::{
    bounded,
    location::{BadInput, Location, did_you_mean, shortened},
};
use cells::Cells;
use fields::{BadQuote, Fields, separator_of};
use line::Line;
use places::Places;

pub use known::{KNOWN_COLUMNS, KnownColumn, is_known_column};

/// The longest run file that is read, in bytes: a million rows of fifty numbers of twenty digits.
pub const MOST_BYTES: u64 = 1 << 30;

/// The most columns that a run file may have.
pub const MOST_COLUMNS: usize = 4096;

/// The most values that a run file may have, rows times columns: a million rows of fifty columns.
pub const MOST_VALUES: usize = 50_000_000;

/// A measured run.
#[derive(Clone, Debug)]
pub struct RunFile {
    path: PathBuf,
    columns: Vec<Column>,
    header_line: usize,
    /// The line of each row, from 1: empty lines and comments are no rows.
    line_of_row: Vec<u32>,
    slips: Vec<Slip>,
}

/// A column that is not known, and the known one that was probably meant.
#[derive(Clone, Debug)]
struct Slip {
    name: String,
    meant: String,
    /// The character column of its name in the header, from 1.
    column: usize,
}

/// One column of a run.
#[derive(Clone, Debug)]
pub struct Column {
    /// Its name in the header, without surrounding blanks.
    pub name: String,
    /// Its value in each row; NaN where it is missing. Shared with who goes on with it: a run may be large.
    pub values: Arc<Vec<f64>>,
    /// The character column at which each value stands in its line, from 1.
    starts: Places,
}

/// How much a run file may hold.
#[derive(Clone, Copy)]
struct Bounds {
    bytes: u64,
    values: usize,
}

impl RunFile {
    /// Reads the run file at `path`.
    ///
    /// # Errors
    /// The file cannot be read, or breaks a rule of [`Self::from_reader`].
    pub fn read(path: &Path) -> Result<Self, BadInput> {
        Self::from_reader(BufReader::new(Self::open(path)?), path)
    }

    /// Opens the run file at `path`, for [`Self::from_reader`].
    ///
    /// # Errors
    /// The file cannot be opened, or is longer than [`MOST_BYTES`].
    pub fn open(path: &Path) -> Result<File, BadInput> {
        bounded::open(path, MOST_BYTES)
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
    /// text that is not UTF-8; a source that cannot be read; more than [`MOST_BYTES`],
    /// [`MOST_COLUMNS`] or [`MOST_VALUES`].
    pub fn from_reader(source: impl BufRead, path: &Path) -> Result<Self, BadInput> {
        Self::within(Bounds { bytes: MOST_BYTES, values: MOST_VALUES }, source, path)
    }

    fn within(bounds: Bounds, mut source: impl BufRead, path: &Path) -> Result<Self, BadInput> {
        let mut line = Line::new(bounds.bytes);
        loop {
            if !line.read(&mut source, path)? {
                let rule = "is empty: a run file needs a header row with the names of its columns";
                return Err(BadInput::new(Location::start_of(path), rule));
            }
            if line.is_content() {
                break;
            }
        }
        let separator = separator_of(&line.text);
        let mut run = Self {
            path: path.to_path_buf(),
            columns: Vec::new(),
            header_line: line.number,
            line_of_row: Vec::new(),
            slips: Vec::new(),
        };
        run.read_header(&line, separator)?;
        let mut cells = Cells::new(run.columns.len());
        let mut order = TimeOrder::new(&run.columns);

        while line.read(&mut source, path)? {
            if line.is_content() {
                run.check_room(&line, bounds.values)?;
                run.read_row(&line, separator, &mut cells)?;
                order.check(&run, &cells)?;
            }
        }
        if run.line_of_row.is_empty() {
            return Err(BadInput::new(
                run.header_place(),
                "there is a header row, but no row of values",
            ));
        }
        run.name_clock(&cells);
        Ok(run)
    }

    /// The path under which the run was read.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The number of rows, at least 1.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.line_of_row.len()
    }

    /// All columns, in the order of the file.
    #[must_use]
    pub fn columns(&self) -> &[Column] {
        &self.columns
    }

    /// The values of the column `name`, NaN where missing; `None` if there is no such column.
    #[must_use]
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        self.columns.iter().find(|column| column.name == name).map(|column| &column.values[..])
    }

    /// The values of the column `name`, NaN where missing.
    ///
    /// # Errors
    /// There is no such column: the rule lists those that are there.
    pub fn require(&self, name: &str) -> Result<&[f64], BadInput> {
        self.column(name).ok_or_else(|| {
            if let Some(slip) = self.slips.iter().find(|slip| slip.meant == name) {
                return BadInput::new(
                    self.header_column(slip.column),
                    format!(
                        "column {name} is missing; {} is no column that is known: if it was meant, \
                             give it as {name}",
                        slip.name
                    ),
                );
            }
            let names = || self.columns.iter().map(|column| column.name.as_str());
            let there = names().collect::<Vec<_>>().join(", ");
            let suggestion = did_you_mean(name, names());
            let rule = format!("column {name} is missing; there are {there}{suggestion}");
            BadInput::new(self.header_place(), rule)
        })
    }

    /// Names of columns that look like a known one, each with its place and what was probably meant.
    pub fn slips(&self) -> impl Iterator<Item = BadInput> {
        self.slips.iter().map(|Slip { name, meant, column }| {
            let rule = format!("{name} is no column that is known; did you mean {meant}?");
            let help =
                format!("give it as {meant}, in that unit; else it is only a possible explanation");
            BadInput::new(self.header_column(*column), rule).with_help(help)
        })
    }

    /// Where a column stands that was probably meant as one of those for which `is_wanted` holds, and
    /// what to do about it.
    ///
    /// ```
    /// # use trueup_machine::RunFile;
    /// let text = "time_s,measured_dz_mm\n0,0.012\n";
    /// let run = RunFile::from_reader(text.as_bytes(), "r.csv".as_ref()).unwrap();
    /// let slip = run.slip(|name| name.starts_with("measured_")).unwrap();
    /// assert!(slip.to_string().starts_with("r.csv:1:8: column measured_dz_um is missing; measured_dz_mm is"));
    /// ```
    pub fn slip(&self, is_wanted: impl Fn(&str) -> bool) -> Option<BadInput> {
        let slip = self.slips.iter().find(|slip| is_wanted(&slip.meant))?;
        self.require(&slip.meant).err()
    }

    /// Other values in the place of those of the column `name`, one for each row.
    pub(crate) fn replace(&mut self, name: &str, values: Vec<f64>) {
        if let Some(column) = self.columns.iter_mut().find(|column| column.name == name) {
            column.values = Arc::new(values);
        }
    }

    /// The first `rows` rows, with what `change` makes of the values of each column: a run that was not measured.
    #[must_use]
    pub fn altered(&self, rows: usize, mut change: impl FnMut(&str, &mut [f64])) -> Self {
        let rows = rows.min(self.rows());
        let columns = self.columns.iter().map(|column| {
            let mut values = column.values[..rows].to_vec();
            change(&column.name, &mut values);
            Column {
                name: column.name.clone(),
                values: Arc::new(values),
                starts: column.starts.clone(),
            }
        });
        Self {
            path: self.path.clone(),
            columns: columns.collect(),
            header_line: self.header_line,
            line_of_row: self.line_of_row[..rows].to_vec(),
            slips: self.slips.clone(),
        }
    }

    /// Leaves out the columns whose name is one of these.
    pub(crate) fn remove(&mut self, is_one: impl Fn(&str) -> bool) {
        self.columns.retain(|column| !is_one(&column.name));
    }

    /// Where the value of `column` in `row` (from 0) stands; the start of the row's line if there
    /// is no such column, of the file if there is no such row.
    #[must_use]
    pub fn place(&self, row: usize, column: &str) -> Location {
        let Some(&line) = self.line_of_row.get(row) else { return Location::start_of(&self.path) };
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
    pub fn bad(&self, row: usize, column: &str, rule: impl Display) -> BadInput {
        BadInput::new(self.place(row, column), format!("{column} {rule}"))
    }

    /// Where the header row begins: for what is wrong with the columns as a whole.
    pub(crate) fn header_place(&self) -> Location {
        self.header_column(1)
    }

    fn header_column(&self, column: usize) -> Location {
        Location { file: self.path.clone(), line: self.header_line, column }
    }

    fn read_header(&mut self, line: &Line, separator: char) -> Result<(), BadInput> {
        let mut first_of_name = HashMap::new();
        for field in Fields::of(&line.text, separator) {
            let field = field.map_err(|fault| bad_quote(line, &self.path, fault))?;
            let name = field.text.trim();
            let bad = |rule: String| BadInput::new(line.place(&self.path, field.column), rule);
            if name.is_empty() {
                return Err(bad(format!("column {} has no name", self.columns.len() + 1)));
            }
            if name.parse::<f64>().is_ok() {
                return Err(bad(format!(
                    "the first row must name the columns, but {} is a number",
                    shortened(name)
                )));
            }
            if name.contains('\t') {
                return Err(bad("columns must be separated by , or ; and not by tabs".into()));
            }
            if self.columns.len() == MOST_COLUMNS {
                return Err(bad(format!("more than {MOST_COLUMNS} columns")));
            }
            let number = self.columns.len() + 1;
            if let Some(first) = first_of_name.insert(name.to_string(), number) {
                return Err(bad(format!("column {name} is repeated: it is also column {first}")));
            }
            if let Some(meant) = meant::meant(name) {
                self.slips.push(Slip { name: name.to_string(), meant, column: field.column });
            }
            self.columns.push(Column {
                name: name.to_string(),
                values: Arc::default(),
                starts: Places::new(),
            });
        }
        Ok(())
    }

    /// The time of a logger, if it was one, is `time_s`; where there is one already it is left out: it
    /// explains nothing that `time_s` does not. What is known by then is no slip any more.
    fn name_clock(&mut self, cells: &Cells) {
        let mut number = 0;
        let mut has_time_s = self.column("time_s").is_some();
        self.columns.retain_mut(|column| {
            let is_clock = cells.holds_times(number) && clock::is_of_logger(&column.name);
            number += 1;
            if is_clock && !has_time_s {
                column.name = "time_s".into();
                has_time_s = true;
                return true;
            }
            !is_clock
        });
        let columns = &self.columns;
        let is_there = |name: &str| columns.iter().any(|column| column.name == name);
        self.slips.retain(|slip| !is_there(&slip.meant) && is_there(&slip.name));
    }

    /// Refuses the row on `line` where it would make more than `most` values.
    fn check_room(&self, line: &Line, most: usize) -> Result<(), BadInput> {
        let columns = self.columns.len();
        if (self.rows() + 1) * columns <= most {
            return Ok(());
        }
        let rule =
            format!("more than {most} values ({columns} columns): leave out rows or columns");
        Err(BadInput::new(line.place(&self.path, 1), rule))
    }

    fn read_row(
        &mut self,
        line: &Line,
        separator: char,
        cells: &mut Cells,
    ) -> Result<(), BadInput> {
        let wanted = self.columns.len();
        let mut there = 0;
        for field in Fields::of(&line.text, separator) {
            let field = field.map_err(|fault| bad_quote(line, &self.path, fault))?;
            let place = || line.place(&self.path, field.column);
            let Some(column) = self.columns.get_mut(there) else {
                let fields = Fields::of(&line.text, separator).count();
                let hint =
                    if separator == ',' { " (decimals are written with a point)" } else { "" };
                let rule = format!("the row has {fields} fields, the header {wanted}{hint}");
                return Err(BadInput::new(place(), rule));
            };
            let value = cells
                .read(there, &column.name, field.text.trim())
                .and_then(|value| check_direction(&column.name, value))
                .map_err(|rule| BadInput::new(place(), format!("{} {rule}", column.name)))?;
            Arc::make_mut(&mut column.values).push(value);
            column.starts.push(field.column);
            there += 1;
        }
        if there < wanted {
            let missing = &self.columns[there].name;
            let rule = format!("the row has {there} fields, the header {wanted}: no {missing}");
            let end = line.text.chars().count() + 1;
            return Err(BadInput::new(line.place(&self.path, end), rule));
        }
        // The file has less than 2³⁰ bytes.
        self.line_of_row.push(u32::try_from(line.number).unwrap_or(u32::MAX));
        Ok(())
    }
}

fn bad_quote(line: &Line, path: &Path, fault: BadQuote) -> BadInput {
    BadInput::new(line.place(path, fault.column), fault.rule)
}

/// `dir_x`, `dir_y`, `dir_z` are the direction of approach: 1 or −1.
fn check_direction(column: &str, value: f64) -> Result<f64, String> {
    let is_direction = matches!(column, "dir_x" | "dir_y" | "dir_z");
    if is_direction && !value.is_nan() && value.abs() != 1.0 {
        return Err(format!("must be 1 or -1, not {value}"));
    }
    Ok(value)
}

/// Rows are in time order within a `run`.
struct TimeOrder {
    time_column: Option<usize>,
    /// That of a logger, if it comes to hold times.
    clock_column: Option<usize>,
    run_column: Option<usize>,
    /// `time_s` and `run` of the newest row that has a time.
    newest: Option<(f64, Option<f64>)>,
}

impl TimeOrder {
    fn new(columns: &[Column]) -> Self {
        let find = |name| columns.iter().position(|column| column.name == name);
        Self {
            time_column: find("time_s"),
            clock_column: columns.iter().position(|column| clock::is_of_logger(&column.name)),
            run_column: find("run"),
            newest: None,
        }
    }

    /// Looks at the newest row of `run`.
    fn check(&mut self, run: &RunFile, cells: &Cells) -> Result<(), BadInput> {
        let newest_value = |column: usize| run.columns[column].values.last().copied();
        let clock = || self.clock_column.filter(|&column| cells.holds_times(column));
        let Some(time_column) = self.time_column.or_else(clock) else { return Ok(()) };
        let Some(time) = newest_value(time_column).filter(|time| !time.is_nan()) else {
            return Ok(());
        };
        // Two missing run numbers are the same run; as NaN they would not be equal.
        let number = self.run_column.and_then(newest_value).filter(|number| !number.is_nan());
        if let Some((time_before, number_before)) = self.newest
            && number == number_before
            && time < time_before
        {
            let rule = format!(
                "runs back from {time_before} to {time} within a run: rows are in time order"
            );
            return Err(run.bad(run.rows() - 1, &run.columns[time_column].name, rule));
        }
        self.newest = Some((time, number));
        Ok(())
    }
}

#[cfg(test)]
mod tests;
