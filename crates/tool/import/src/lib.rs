//! Tables as people and instruments write them, as run files.
//!
//! ```text
//! bytes ─► text or workbook ─► table ─► sign of decimals ─► plan of columns ─► values ─► run file
//!          decode, grid,       layout,  cells               meaning, unit,     convert,
//!          workbook, forms     wide                         plan               clock
//! ```
//! No unit, sign of decimals, order of a date or axis is guessed in silence: what can be read in two ways is a
//! [`Question`], which a flag, a terminal or a map of headers answers ([`Answers`], [`map`]).
#![forbid(unsafe_code)]

mod answers;
mod cells;
mod circle;
mod clock;
mod convert;
mod decode;
mod forms;
mod grid;
mod layout;
pub mod map;
mod meaning;
mod number;
mod plan;
mod stamp;
mod unit;
mod wide;
mod words;
mod workbook;

use std::{fmt::Write as _, path::Path};

use trueup_machine::{BadInput, Location, RunFile, run_file::is_known_column};

pub use answers::{Answers, Circle, Question, Refused, Topic};
pub use number::Decimal;
pub use stamp::DateOrder;

/// The largest file that is read, in bytes.
pub const MAX_BYTES: u64 = 256 << 20;

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
pub struct Imported {
    /// The run file.
    pub run: String,
    /// Its number of rows.
    pub rows: usize,
    /// How the file was read: encoding, separator, decimal sign, order of dates.
    pub form: Vec<String>,
    /// The columns of the run file.
    pub columns: Vec<ColumnPreview>,
    /// Columns that were left out, and why.
    pub left_out: Vec<(String, String)>,
    /// Further notes for the user, a sentence each.
    pub notes: Vec<String>,
}

/// Values that a preview shows of each column.
const SAMPLES: usize = 3;

/// Reads `bytes`, the content of `path`, with what the user has said about it.
///
/// # Errors
/// [`Refused::Open`]: questions that only the user can answer. [`Refused::Bad`]: the place and the rule broken.
pub fn import(bytes: &[u8], path: &Path, answers: &Answers) -> Result<Imported, Refused> {
    if let Some(error) = forms::refused(bytes, path) {
        return Err(error.into());
    }
    let mut form = Vec::new();
    let (layout, is_by_comma) = if workbook::is_workbook(bytes) {
        let grid = workbook::read(bytes, answers.sheet.as_deref(), path)?;
        form.push("workbook".to_string());
        (layout::find(&grid, path)?, false)
    } else {
        let (text, encoding) = decode::decode(bytes, answers.encoding.as_deref(), path)?;
        form.push(encoding.to_string());
        match forms::recognise(&text, answers, path)? {
            Some((name, layout)) => {
                form.push(name.to_string());
                (layout, false)
            }
            None => {
                let grid = grid::of_text(&text, path)?;
                form.push(format!("{} between columns", grid.separator));
                let found = layout::find(&grid, path)
                    .map_err(|error| forms::refused_without_table(bytes, path).unwrap_or(error))?;
                (found, grid.is_by_comma)
            }
        }
    };
    let layout = wide::one_reading_a_row(layout)?;
    let (decimal, is_of_use) = cells::decimal(&layout, is_by_comma, answers.decimal, path)?;
    if is_of_use {
        form.push(format!("decimal {}", decimal.name()));
    }
    let answers = &circle::answered(&layout, answers);
    let plans = plan::plan(&layout, answers, path)?;
    let mut converted = convert::convert(&layout, &plans, decimal, answers, path)?;
    if let Some(circle) = &answers.circle {
        circle::place(&mut converted.columns, circle)
            .map_err(|rule| BadInput::new(layout.columns[0].place.clone(), rule))?;
    }
    if let Some(order) = converted.order {
        form.push(format!("dates {}", order.name()));
    }
    let mut left_out: Vec<(String, String)> = Vec::new();
    for plan in &plans {
        if let plan::Role::Ignored(why) = plan.role {
            left_out.push((plan.header.clone(), why.into()));
        }
    }
    // A table of which nothing is understood is no run, whatever its numbers are.
    if !converted.columns.iter().any(|column| is_known_column(&column.name)) {
        if let Some(error) = forms::refused_without_table(bytes, path) {
            return Err(error.into());
        }
        let headers: Vec<&str> =
            layout.columns.iter().take(5).map(|it| it.header.as_str()).collect();
        let rule = format!("no column is one that a run file knows: {}", headers.join(", "));
        let error = BadInput::new(layout.columns[0].place.clone(), rule);
        return Err(error.with_help("Name one, by its header or number: --column 1=x_mm").into());
    }
    let run = written(&converted.columns, layout.rows.len());
    // What is written is a run file, whatever the rules above have missed.
    let parsed =
        RunFile::from_reader(run.as_bytes(), path).map_err(|error| at_source(error, &layout))?;
    let mut notes = layout.notes.clone();
    notes.extend(converted.notes);
    let columns = converted.columns.iter().map(|column| preview(column, &layout)).collect();
    Ok(Imported { rows: parsed.rows(), run, form, columns, left_out, notes })
}

/// Returns true if [`import`] reads `bytes`, with answers or without, and it is no run file with a fault: a workbook, a
/// file of an instrument, or a table whose headers are not those of a run file.
#[must_use]
pub fn is_foreign(bytes: &[u8], path: &Path) -> bool {
    if matches!(import(bytes, path, &Answers::default()), Err(Refused::Bad(_))) {
        return false;
    }
    if workbook::is_workbook(bytes) {
        return true;
    }
    let Ok((text, _)) = decode::decode(bytes, None, path) else { return false };
    let is_of_instrument = !matches!(forms::recognise(&text, &Answers::default(), path), Ok(None));
    let table = grid::of_text(&text, path).and_then(|grid| layout::find(&grid, path));
    let is_other = |column: &layout::Source| {
        let parts = meaning::split(&column.header);
        let unit = unit::parse(if column.unit.is_empty() { &parts.unit } else { &column.unit });
        let meaning = meaning::understand(&column.header, &parts.name, unit);
        let is_meant = !matches!(meaning, meaning::Meaning::Other(_) | meaning::Meaning::Nothing);
        is_meant && !is_known_column(&column.header)
    };
    is_of_instrument || table.is_ok_and(|table| table.columns.iter().any(is_other))
}

/// Returns the run file as text.
fn written(columns: &[convert::Column], rows: usize) -> String {
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
fn at_source(error: BadInput, layout: &layout::Layout) -> BadInput {
    let row = error.place.line.checked_sub(2).and_then(|at| layout.rows.get(at));
    let line = row.map_or(1, |row| row.line);
    BadInput {
        place: Location { line, column: 1, ..error.place },
        others: Vec::new(),
        unlisted: 0,
        ..error
    }
}

fn preview(column: &convert::Column, layout: &layout::Layout) -> ColumnPreview {
    let cells = layout.rows.iter().map(|row| row.cells[column.source].text());
    let there = cells.zip(&column.values).filter(|(_, value)| !value.is_nan());
    ColumnPreview {
        header: layout.columns[column.source].header.clone(),
        name: column.name.clone(),
        unit_before: column.from.clone(),
        unit_after: column.to.clone(),
        samples: there.take(SAMPLES).map(|(text, value)| [text, value.to_string()]).collect(),
    }
}
