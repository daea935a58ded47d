//! Tables as people and instruments write them, as run files.
//!
//! ```text
//! bytes ─► text or workbook ─► table ─► sign of decimals ─► plan of columns ─► values ─► run file
//!          decode, grid,       layout,  cells               meaning, unit,     convert,
//!          workbook, forms     wide                         plan               clock
//! ```
//! No unit, sign of decimals, order of a date or axis is guessed in silence: what can be read in two ways is a
//! [`Question`], which a flag, a terminal or a map of headers answers ([`ImportAnswers`], [`header_map`]).
#![forbid(unsafe_code)]

mod answers;
mod cell_grid;
mod cell_kinds;
mod circle;
mod clock;
mod column_mapping;
mod column_meaning;
mod convert;
mod decode;
mod formats;
pub mod header_map;
mod layout;
mod number;
mod timestamp;
mod unit;
mod vocabulary;
mod wide_table;
mod workbook;

use std::{fmt::Write as _, path::Path};

use trueup_machine::{InputFileError, Location, RunFile, run_file::is_known_column};

pub use answers::{CircleGeometry, ImportAnswers, ImportError, Question, QuestionTopic};
pub use number::DecimalSeparator;
pub use timestamp::DateOrder;

/// The largest file that is read, in bytes.
pub const MAX_IMPORT_FILE_BYTES: u64 = 256 << 20;

/// A column as it was understood.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnPreview {
    /// Its header in the file.
    pub header: String,
    /// Its name in the run file.
    pub name: String,
    /// Its unit in the file.
    pub unit_before: String,
    /// Its unit in the run file.
    pub unit_after: String,
    /// The first values, as they are written and as they become.
    pub samples: Vec<[String; 2]>,
}

/// A file that was read.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportedRun {
    /// The run file.
    pub run: String,
    /// Its number of rows.
    pub rows: usize,
    /// How the file was read: encoding, separator, decimal sign, order of dates.
    pub form: Vec<String>,
    /// The columns of the run file.
    pub columns: Vec<ColumnPreview>,
    /// Columns that were not imported, and why.
    pub skipped: Vec<(String, String)>,
    /// Further notes for the user, a sentence each.
    pub notes: Vec<String>,
}

/// Values that a preview shows of each column.
const PREVIEW_SAMPLE_COUNT: usize = 3;

/// Reads `bytes`, the content of `path`, with what the user has stated about it.
///
/// # Errors
/// [`ImportError::Open`]: questions that only the user can answer. [`ImportError::Bad`]: the place and the rule broken.
pub fn import(
    bytes: &[u8],
    path: &Path,
    answers: &ImportAnswers,
) -> Result<ImportedRun, ImportError> {
    if let Some(error) = formats::unsupported_format_error(bytes, path) {
        return Err(error.into());
    }
    let mut form = Vec::new();
    let (layout, is_by_comma) = if workbook::is_workbook(bytes) {
        let grid = workbook::read(bytes, answers.sheet.as_deref(), path)?;
        form.push("workbook".to_string());
        (layout::find_table(&grid, path)?, false)
    } else {
        let (text, encoding) = decode::decode(bytes, answers.encoding.as_deref(), path)?;
        form.push(encoding.to_string());
        match formats::parse_known_format(&text, answers, path)? {
            Some((name, layout)) => {
                form.push(name.to_string());
                (layout, false)
            }
            None => {
                let grid = cell_grid::from_text(&text, path)?;
                form.push(format!("{} between columns", grid.separator));
                let found = layout::find_table(&grid, path)
                    .map_err(|error| formats::detect_cycle_log(bytes, path).unwrap_or(error))?;
                (found, grid.is_by_comma)
            }
        }
    };
    let layout = wide_table::into_long_format(layout)?;
    let (decimal, is_of_use) =
        cell_kinds::detect_decimal_separator(&layout, is_by_comma, answers.decimal, path)?;
    if is_of_use {
        form.push(format!("decimal {}", decimal.name()));
    }
    let answers = &circle::with_deviation_answer(&layout, answers);
    let plans = column_mapping::map_columns(&layout, answers, path)?;
    let mut converted = convert::convert(&layout, &plans, decimal, answers, path)?;
    if let Some(circle) = &answers.circle {
        circle::convert_angles_to_positions(&mut converted.columns, circle)
            .map_err(|rule| InputFileError::new(layout.columns[0].place.clone(), rule))?;
    }
    if let Some(order) = converted.order {
        form.push(format!("dates {}", order.name()));
    }
    let mut omitted: Vec<(String, String)> = Vec::new();
    for plan in &plans {
        if let column_mapping::ColumnRole::Ignored(why) = plan.role {
            omitted.push((plan.header.clone(), why.into()));
        }
    }
    // A table of which nothing is understood is no run, whatever its numbers are.
    if !converted.columns.iter().any(|column| is_known_column(&column.name)) {
        if let Some(error) = formats::detect_cycle_log(bytes, path) {
            return Err(error.into());
        }
        let headers: Vec<&str> =
            layout.columns.iter().take(5).map(|column| column.header.as_str()).collect();
        let rule = format!("no column is one that a run file knows: {}", headers.join(", "));
        let error = InputFileError::new(layout.columns[0].place.clone(), rule);
        return Err(error.with_help("Name one, by its header or number: --column 1=x_mm").into());
    }
    let run = format_run_file(&converted.columns, layout.rows.len());
    // What is written is a run file, whatever the rules above have missed.
    let parsed = RunFile::from_reader(run.as_bytes(), path)
        .map_err(|error| map_error_to_source(error, &layout))?;
    let mut notes = layout.notes.clone();
    notes.extend(converted.notes);
    let columns = converted.columns.iter().map(|column| preview_column(column, &layout)).collect();
    Ok(ImportedRun { rows: parsed.row_count(), run, form, columns, skipped: omitted, notes })
}

/// Returns true if [`import`] reads `bytes`, with answers or without, and it is no run file with a fault: a workbook, a
/// file of an instrument, or a table whose headers are not those of a run file.
#[must_use]
pub fn is_foreign_format(bytes: &[u8], path: &Path) -> bool {
    if matches!(import(bytes, path, &ImportAnswers::default()), Err(ImportError::Bad(_))) {
        return false;
    }
    if workbook::is_workbook(bytes) {
        return true;
    }
    let Ok((text, _)) = decode::decode(bytes, None, path) else { return false };
    let is_of_instrument =
        !matches!(formats::parse_known_format(&text, &ImportAnswers::default(), path), Ok(None));
    let table = cell_grid::from_text(&text, path).and_then(|grid| layout::find_table(&grid, path));
    let is_other = |column: &layout::SourceColumn| {
        let parts = column_meaning::split_header(&column.header);
        let unit = unit::parse(if column.unit.is_empty() { &parts.unit } else { &column.unit });
        let meaning = column_meaning::classify_column(&column.header, &parts.name, unit);
        let is_meant = !matches!(
            meaning,
            column_meaning::ColumnMeaning::Other(_) | column_meaning::ColumnMeaning::Nothing
        );
        is_meant && !is_known_column(&column.header)
    };
    is_of_instrument || table.is_ok_and(|table| table.columns.iter().any(is_other))
}

/// Returns the run file as text.
fn format_run_file(columns: &[convert::ConvertedColumn], rows: usize) -> String {
    let mut text = columns.iter().map(|column| column.name.as_str()).collect::<Vec<_>>().join(",");
    text.push('\n');
    for row in 0..rows {
        for (at, column) in columns.iter().enumerate() {
            if at > 0 {
                text.push(',');
            }
            let value = column.values[row];
            if !value.is_nan() {
                // Writing to a String cannot fail.
                _ = write!(text, "{value}");
            }
        }
        text.push('\n');
    }
    text
}

/// Returns an error of the run file at the row of the table that it came from.
fn map_error_to_source(error: InputFileError, layout: &layout::SourceTable) -> InputFileError {
    let row = error.place.line.checked_sub(2).and_then(|at| layout.rows.get(at));
    let line = row.map_or(1, |row| row.line);
    InputFileError {
        place: Location { line, column: 1, ..error.place },
        others: Vec::new(),
        unlisted: 0,
        ..error
    }
}

fn preview_column(
    column: &convert::ConvertedColumn,
    layout: &layout::SourceTable,
) -> ColumnPreview {
    let cells = layout.rows.iter().map(|row| row.cells[column.source].text());
    let there = cells.zip(&column.values).filter(|(_, value)| !value.is_nan());
    ColumnPreview {
        header: layout.columns[column.source].header.clone(),
        name: column.name.clone(),
        unit_before: column.from.clone(),
        unit_after: column.to.clone(),
        samples: there
            .take(PREVIEW_SAMPLE_COUNT)
            .map(|(text, value)| [text, value.to_string()])
            .collect(),
    }
}
