//! The values of a run file from the cells of a table.

use std::path::Path;

use trueup_machine::InputFileError;

use crate::{
    answers::{ImportAnswers, ImportError},
    cell_grid::Cell,
    cell_kinds::parse_number_with_unit,
    clock::{self, AllowedClockJumps, TimeFormat},
    column_mapping::{ColumnMapping, ColumnRole, target_column, unit_question},
    layout::SourceTable,
    number::{self, DecimalSeparator},
    timestamp::{DateOrder, Timestamp, TwoPartTimeFormat},
    unit::{Dimension, Unit, round_to_significant_digits},
    vocabulary,
};

/// A column of the run file.
pub(crate) struct ConvertedColumn {
    /// Its number in the table.
    pub(crate) source: usize,
    pub(crate) name: String,
    /// The unit before, for people.
    pub(crate) from: String,
    /// The unit in the run file, for people.
    pub(crate) to: String,
    pub(crate) values: Vec<f64>,
}

/// The run file's columns and the notes about them.
pub(crate) struct ConvertedRun {
    pub(crate) columns: Vec<ConvertedColumn>,
    pub(crate) notes: Vec<String>,
    pub(crate) order: Option<DateOrder>,
}

/// Converts each column by its plan.
///
/// # Errors
/// A cell is none of what its column holds; or a question is open.
pub(crate) fn convert(
    layout: &SourceTable,
    plans: &[ColumnMapping],
    decimal: DecimalSeparator,
    answers: &ImportAnswers,
    path: &Path,
) -> Result<ConvertedRun, ImportError> {
    let table = TableConverter { layout, plans, decimal, path };
    let mut notes = Vec::new();
    let mut columns = Vec::new();
    let dates: Vec<usize> = (0..plans.len())
        .filter(|at| {
            matches!(plans[*at].role, ColumnRole::AssociatedDate | ColumnRole::Timestamps { .. })
        })
        .collect();
    let order = clock::detect_date_order(&layout.rows, &dates, answers.date, path)?;
    let runs = plans
        .iter()
        .position(|plan| target_column(&plan.role).is_some_and(|column| column.name == "run"));
    let runs = runs.map(|at| table.parse_numbers(at, None)).transpose()?;
    let mut open = Vec::new();
    for (at, plan) in plans.iter().enumerate() {
        let done = table.convert_column(at, plan, order, runs.as_deref(), answers, &mut notes);
        match done {
            Ok(column) => columns.extend(column),
            Err(ImportError::Open(questions)) => open.extend(questions),
            Err(bad) => return Err(bad),
        }
    }
    if !open.is_empty() {
        return Err(ImportError::Open(open));
    }
    for column in &mut columns {
        if plans[column.source].is_negated {
            // A zero has no sign.
            column.values.iter_mut().for_each(|value| *value = 0.0 - *value);
            column.from.push_str(", sign turned");
        }
    }
    Ok(ConvertedRun { columns, notes, order })
}

struct TableConverter<'l> {
    layout: &'l SourceTable,
    plans: &'l [ColumnMapping],
    decimal: DecimalSeparator,
    path: &'l Path,
}

impl TableConverter<'_> {
    fn column_cells(&self, at: usize) -> impl Iterator<Item = &Cell> {
        self.layout.rows.iter().map(move |row| &row.cells[at])
    }

    fn cell_error(&self, row: usize, at: usize, rule: &str, help: &str) -> ImportError {
        let cell = self.layout.rows[row].cells[at].text();
        let short: String = cell.chars().take(40).collect();
        let place = self.layout.rows[row].location(self.path, at);
        InputFileError::new(
            place,
            format!("\"{short}\" {rule} in {}", self.layout.columns[at].header),
        )
        .with_help(help)
        .into()
    }

    /// Returns the numbers of a column as they are written, NaN where one is missing; those with `unit` behind them, or
    /// none.
    fn parse_numbers(&self, at: usize, unit: Option<Unit>) -> Result<Vec<f64>, ImportError> {
        let of_cell = |(row, cell): (usize, &Cell)| {
            if number::is_missing(&cell.text()) {
                return Ok(f64::NAN);
            }
            let Some((value, behind)) = parse_number_with_unit(cell, self.decimal) else {
                let help = "correct it in the file, or empty it: an empty cell is a missing value";
                return Err(self.cell_error(row, at, "is no number", help));
            };
            let is_other = !behind.is_empty()
                && crate::unit::parse(behind)
                    .is_none_or(|found| unit.is_some_and(|unit| unit != found));
            if is_other {
                let help =
                    "a column has one unit: convert these rows, or give them a column of their own";
                return Err(self.cell_error(row, at, "has another unit than the column", help));
            }
            Ok(value)
        };
        self.column_cells(at).enumerate().map(of_cell).collect()
    }

    fn parse_words(
        &self,
        at: usize,
        word: impl Fn(&str) -> Option<f64>,
        rule: &str,
        help: &str,
    ) -> Result<Vec<f64>, ImportError> {
        let of_cell = |(row, cell): (usize, &Cell)| {
            let text = cell.text();
            match word(&text) {
                Some(value) => Ok(value),
                None if number::is_missing(&text) => Ok(f64::NAN),
                None => Err(self.cell_error(row, at, rule, help)),
            }
        };
        self.column_cells(at).enumerate().map(of_cell).collect()
    }

    fn convert_column(
        &self,
        at: usize,
        plan: &ColumnMapping,
        order: Option<DateOrder>,
        runs: Option<&[f64]>,
        answers: &ImportAnswers,
        notes: &mut Vec<String>,
    ) -> Result<Option<ConvertedColumn>, ImportError> {
        let column = |name: &str, from: &str, to: &str, values| {
            Ok(Some(ConvertedColumn {
                source: at,
                name: name.into(),
                from: from.into(),
                to: to.into(),
                values,
            }))
        };
        match &plan.role {
            ColumnRole::Ignored(_) | ColumnRole::AssociatedDate => Ok(None),
            ColumnRole::Unconverted(target) => {
                column(&target.name, "", target.unit(), self.parse_numbers(at, None)?)
            }
            ColumnRole::Number { target, unit, per_base } => {
                let values = self.parse_numbers(at, Some(*unit))?;
                let values =
                    values.into_iter().map(|value| unit.convert(value, *per_base)).collect();
                let to = match target.dimension {
                    Some(_) => target.unit(),
                    None => Unit::base_unit(unit.dimension).name,
                };
                column(&target.name, unit.name, to, values)
            }
            ColumnRole::Direction(target) => {
                let help = "a direction is +1 or -1, hin or rück, forward or reverse";
                column(
                    &target.name,
                    "",
                    "+1, −1",
                    self.parse_words(at, vocabulary::parse_direction, "is no direction", help)?,
                )
            }
            ColumnRole::Switch(target) => {
                let help = "a switch is on or off, 1 or 0";
                let word = |text: &str| {
                    vocabulary::parse_on_off(text).or(match text {
                        "1" => Some(1.0),
                        "0" => Some(0.0),
                        _ => None,
                    })
                };
                column(&target.name, "", "0, 1", self.parse_words(at, word, "is no switch", help)?)
            }
            ColumnRole::Actual { target, unit, position } => {
                let commanded = self.positions_mm(*position)?;
                let actual = self.parse_numbers(at, Some(*unit))?;
                let error = |(actual, commanded): (&f64, &f64)| {
                    // To a picometre: the difference of two large numbers has noise below that.
                    let um = (unit.convert(*actual, 1.0) - commanded) * 1e3;
                    if um.is_nan() { um } else { (um * 1e6).round() / 1e6 + 0.0 }
                };
                let values = actual.iter().zip(&commanded).map(error).collect();
                notes.push(format!(
                    "{} is {} minus {}",
                    target.name, plan.header, self.layout.columns[*position].header
                ));
                column(&target.name, unit.name, "µm", values)
            }
            ColumnRole::Elapsed { target, unit } => {
                self.convert_elapsed_column(at, target.name.as_str(), *unit, runs, answers, notes)
            }
            ColumnRole::Timestamps { target, form } => {
                let pair = self.resolve_two_part_format(at, form)?;
                let reading = TimeFormat { order: order.unwrap_or(DateOrder::Year), pair };
                let stamps = self.parse_timestamps(at, reading)?;
                let found = clock::compute_elapsed_seconds(
                    &stamps,
                    &self.layout.rows,
                    at,
                    runs,
                    answers.summer_time,
                    self.path,
                )?;
                notes.extend(found.notes);
                let from = match (stamps.iter().flatten().next(), pair) {
                    (Some(Timestamp { day: None, .. }), TwoPartTimeFormat::MinutesSeconds) => {
                        "minutes:seconds"
                    }
                    (Some(Timestamp { day: None, .. }), _) => "time of day",
                    (Some(Timestamp { seconds: None, .. }), _) => "date",
                    _ => "date and time",
                };
                column(&target.name, from, "s from the first", found.values)
            }
        }
    }

    fn positions_mm(&self, at: usize) -> Result<Vec<f64>, ImportError> {
        match &self.plans[at].role {
            ColumnRole::Number { unit, .. } => {
                let values = self.parse_numbers(at, Some(*unit))?;
                Ok(values.into_iter().map(|value| unit.convert(value, 1.0)).collect())
            }
            _ => self.parse_numbers(at, None),
        }
    }

    /// Returns the column of dates that belongs to the times in `at`.
    fn find_date_column(&self, at: usize) -> Option<usize> {
        let dates = (0..self.plans.len()).filter(|other| *other != at);
        dates
            .into_iter()
            .find(|other| matches!(self.plans[*other].role, ColumnRole::AssociatedDate))
    }

    /// Returns how the times in `at` with two numbers are meant: as hours and minutes where dates belong to them.
    fn resolve_two_part_format(
        &self,
        at: usize,
        form: &str,
    ) -> Result<TwoPartTimeFormat, ImportError> {
        if self.find_date_column(at).is_some() {
            return Ok(TwoPartTimeFormat::HoursMinutes);
        }
        let header = &self.layout.columns[at].header;
        clock::detect_two_part_format(&self.layout.rows, at, header, form, self.path)
    }

    fn parse_timestamps(
        &self,
        at: usize,
        reading: TimeFormat,
    ) -> Result<Vec<Option<Timestamp>>, ImportError> {
        let dates = self.find_date_column(at);
        let help = "write 2026-04-03 08:15:00, 08:15:00, or seconds";
        let read = |row: usize, at: usize| {
            let cell = &self.layout.rows[row].cells[at];
            if number::is_missing(&cell.text()) {
                return Ok(None);
            }
            let stamp = clock::parse_timestamp(cell, reading);
            stamp.map(Some).ok_or_else(|| self.cell_error(row, at, "is no time", help))
        };
        let mut first: Option<(bool, bool)> = None;
        let mut stamps = Vec::new();
        for row in 0..self.layout.rows.len() {
            let mut stamp = read(row, at)?;
            if let (Some(dates), Some(time)) = (dates, &mut stamp)
                && time.day.is_none()
            {
                match read(row, dates)? {
                    Some(date) => time.day = date.day,
                    None => return Err(self.cell_error(row, dates, "is no date", help)),
                }
            }
            if let Some(stamp) = stamp {
                // A date alone is its midnight, as workbooks have it.
                let form = (stamp.day.is_some(), stamp.day.is_some() || stamp.seconds.is_some());
                if *first.get_or_insert(form) != form {
                    return Err(self.cell_error(
                        row,
                        at,
                        "is written otherwise than the first time",
                        help,
                    ));
                }
            }
            stamps.push(stamp);
        }
        Ok(stamps)
    }

    fn convert_elapsed_column(
        &self,
        at: usize,
        name: &str,
        unit: Option<Unit>,
        runs: Option<&[f64]>,
        answers: &ImportAnswers,
        notes: &mut Vec<String>,
    ) -> Result<Option<ConvertedColumn>, ImportError> {
        let header = &self.layout.columns[at].header;
        let raw = self.parse_numbers(at, unit)?;
        let there: Vec<f64> = raw.iter().copied().filter(|value| !value.is_nan()).collect();
        let is_own = header == name;
        let unix = clock::detect_unix_time_scale(&there).filter(|_| !is_own);
        let (seconds, from): (Vec<f64>, String) = match (unix, unit) {
            (Some((factor, unix)), None) => {
                let start = there.first().copied().unwrap_or(0.0);
                let seconds = raw
                    .iter()
                    .map(|value| round_to_significant_digits((value - start) * factor))
                    .collect();
                (seconds, format!("Unix time in {unix}"))
            }
            (Some((factor, _)), Some(unit)) if (unit.factor - factor).abs() < 1e-12 => {
                let start = there.first().copied().unwrap_or(0.0);
                let seconds = raw
                    .iter()
                    .map(|value| round_to_significant_digits((value - start) * factor))
                    .collect();
                (seconds, format!("Unix time in {}", unit.name))
            }
            (_, Some(unit)) => {
                (raw.iter().map(|value| unit.convert(*value, 1.0)).collect(), unit.name.into())
            }
            (None, None) => {
                let question = unit_question(&self.layout.columns[at], "", Dimension::Time);
                return Err(ImportError::Open(vec![question]));
            }
        };
        // A counter has no summer time, unless the user says that it has.
        let has_hours = answers.summer_time.is_some();
        let wall = AllowedClockJumps { has_midnight: false, has_hours };
        let found = clock::accumulate_elapsed_seconds(
            &seconds,
            &self.layout.rows,
            at,
            runs,
            wall,
            answers.summer_time,
            self.path,
        )?;
        notes.extend(found.notes);
        // As they were converted, without an hour that is summer time.
        let values = if answers.summer_time == Some(true) { found.values } else { seconds };
        Ok(Some(ConvertedColumn { source: at, name: name.into(), from, to: "s".into(), values }))
    }
}
