//! Workbooks (xlsx, xls, xlsb, ods) as rows of cells.

use std::{io::Cursor, path::Path};

use calamine::{Data, Range, Reader as _, open_workbook_auto_from_rs};
use trueup_machine::{InputFileError, Location};

use crate::{
    answers::{ImportError, Question, QuestionTopic},
    cell_grid::{Cell, CellContent, CellGrid, CellRow},
    layout,
};

/// Returns true for bytes that begin as a workbook: a zip archive, or an OLE container.
pub(crate) fn is_workbook(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PK\x03\x04") || bytes.starts_with(b"\xd0\xcf\x11\xe0")
}

/// The most that a workbook's parts may be unpacked, in bytes, by what its archive states.
const MAX_UNPACKED_BYTES: u64 = 1 << 30;

/// Reads the sheet `name`, or the only one with a table.
///
/// # Errors
/// It is no workbook, is protected, has no table, no sheet of this name, or several tables: a question.
pub(crate) fn read(bytes: &[u8], name: Option<&str>, path: &Path) -> Result<CellGrid, ImportError> {
    let bad = |rule: String| InputFileError::new(Location::start_of_file(path), rule);
    if unpacked_size(bytes) > MAX_UNPACKED_BYTES {
        return Err(bad("unpacks to more than 1 GiB".into()).into());
    }
    let help = "save it without a password as xlsx or ods, or as csv";
    let mut book = open_workbook_auto_from_rs(Cursor::new(bytes)).map_err(|_| {
        bad("is no workbook that can be read (xlsx, xls, xlsb, ods)".into()).with_help(help)
    })?;
    let names = book.sheet_names();
    if let Some(name) = name {
        let known = names.iter().find(|candidate| candidate.to_lowercase() == name.to_lowercase());
        let Some(known) = known else {
            let rule = format!("there is no sheet {name}");
            return Err(bad(rule).with_help(format!("there are: {}", names.join(", "))).into());
        };
        let range =
            book.worksheet_range(known).map_err(|error| bad(format!("sheet {known}: {error}")))?;
        return Ok(convert_range(&range));
    }
    let mut tables: Vec<(String, CellGrid)> = Vec::new();
    for name in &names {
        // A sheet of a chart has no cells.
        let Ok(range) = book.worksheet_range(name) else { continue };
        let grid = convert_range(&range);
        if layout::find_table(&grid, path).is_ok() {
            tables.push((name.clone(), grid));
        }
    }
    match tables.len() {
        1 => Ok(tables.remove(0).1),
        0 => {
            // The first sheet says why it has none.
            let range = names.first().and_then(|name| book.worksheet_range(name).ok());
            Ok(range.map_or_else(|| convert_range(&Range::empty()), |range| convert_range(&range)))
        }
        _ => Err(ImportError::Open(vec![Question {
            place: Location::start_of_file(path),
            text: "more than one sheet has a table".into(),
            topic: QuestionTopic::Sheet,
            choices: tables.into_iter().map(|(name, _)| name).collect(),
            is_open: false,
        }])),
    }
}

fn convert_range(range: &Range<Data>) -> CellGrid {
    let (first_row, first_column) = range.start().unwrap_or((0, 0));
    let rows = range.rows().enumerate().map(|(row, cells)| {
        let cells: Vec<Cell> = cells
            .iter()
            .enumerate()
            .map(|(at, data)| Cell {
                content: convert_cell(data),
                column: at + first_column as usize + 1,
            })
            .collect();
        CellRow { line: row + first_row as usize + 1, cells }
    });
    CellGrid {
        rows: rows.collect(),
        separator: String::new(),
        is_by_comma: false,
        is_open_ended: false,
    }
}

fn convert_cell(data: &Data) -> CellContent {
    match data {
        Data::Int(value) => CellContent::Number(*value as f64),
        Data::Float(value) => CellContent::Number(*value),
        Data::String(text) => CellContent::Text(text.clone()),
        Data::Bool(value) => CellContent::Text(if *value { "on" } else { "off" }.into()),
        Data::DateTime(moment) => CellContent::Date(moment.as_f64()),
        Data::DateTimeIso(text) => CellContent::Text(text.clone()),
        Data::DurationIso(text) => {
            CellContent::Text(convert_iso_duration(text).unwrap_or_else(|| text.clone()))
        }
        // As the spreadsheet shows it: a missing value.
        Data::Error(_) => CellContent::Text("#n/a".into()),
        Data::Empty => CellContent::Text(String::new()),
    }
}

/// `PT08H15M30.5S` as `08:15:30.5`.
fn convert_iso_duration(text: &str) -> Option<String> {
    let rest = text.strip_prefix("PT")?;
    let (hours, rest) = rest.split_once('H')?;
    let (minutes, rest) = rest.split_once('M')?;
    let seconds = rest.strip_suffix('S')?.replace(',', ".");
    Some(format!("{hours}:{minutes}:{seconds}"))
}

/// Returns the size of all parts of a zip archive by its directory; 0 where there is none.
fn unpacked_size(bytes: &[u8]) -> u64 {
    const CENTRAL_DIRECTORY_SIGNATURE: &[u8] = b"PK\x01\x02";
    let Some(end) = bytes.windows(4).rposition(|window| window == b"PK\x05\x06") else { return 0 };
    let number = |at: usize, length: usize| -> Option<u64> {
        let bytes = bytes.get(at..at + length)?;
        Some(bytes.iter().rev().fold(0, |sum, byte| (sum << 8) | u64::from(*byte)))
    };
    let Some(mut at) = number(end + 16, 4).and_then(|at| usize::try_from(at).ok()) else {
        return 0;
    };
    let mut sum = 0_u64;
    while bytes.get(at..at + 4) == Some(CENTRAL_DIRECTORY_SIGNATURE) {
        let field = |offset: usize, length: usize| number(at + offset, length).unwrap_or(0);
        sum = sum.saturating_add(field(24, 4));
        let names = field(28, 2) + field(30, 2) + field(32, 2);
        at += 46 + usize::try_from(names).unwrap_or(usize::MAX / 2);
    }
    sum
}
