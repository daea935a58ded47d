//! A file as rows of cells, each with its place: text that is split by its separator, or the sheet of a workbook.

use std::path::Path;

use trueup_machine::{InputFileError, Location};

use crate::timestamp;

/// The content of a cell.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum CellContent {
    /// Text, which may be a number as people write it.
    Text(String),
    /// A number of a workbook.
    Number(f64),
    /// A date and time of a workbook, in days from 1899-12-30; below 1 a time of day.
    Date(f64),
}

/// A cell and the column of the file in which it begins, from 1.
#[derive(Clone, Debug)]
pub(crate) struct Cell {
    pub(crate) content: CellContent,
    pub(crate) column: usize,
}

impl Cell {
    /// Returns the text of the cell, without blanks around it.
    pub(crate) fn text(&self) -> String {
        match &self.content {
            CellContent::Text(text) => text.trim().to_string(),
            CellContent::Number(value) | CellContent::Date(value) => value.to_string(),
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        matches!(&self.content, CellContent::Text(text) if text.trim().is_empty())
    }
}

/// A row of cells and its line of the file, from 1.
#[derive(Clone, Debug)]
pub(crate) struct CellRow {
    pub(crate) line: usize,
    pub(crate) cells: Vec<Cell>,
}

impl CellRow {
    /// Returns the number of cells that are not empty.
    pub(crate) fn filled_cell_count(&self) -> usize {
        self.cells.iter().filter(|cell| !cell.is_empty()).count()
    }

    pub(crate) fn location(&self, path: &Path, cell: usize) -> Location {
        let column = self.cells.get(cell).map_or(1, |cell| cell.column);
        Location { file: path.to_path_buf(), line: self.line, column }
    }
}

/// A table as it stands in the file.
#[derive(Clone, Debug)]
pub(crate) struct CellGrid {
    pub(crate) rows: Vec<CellRow>,
    /// The separator of the fields, in words; empty for a workbook.
    pub(crate) separator: String,
    /// Fields are separated by a comma, so an unquoted number has no decimal comma.
    pub(crate) is_by_comma: bool,
    /// The last line has no end: it may have been cut.
    pub(crate) is_open_ended: bool,
}

/// Separators that may stand between fields, the likeliest first.
const FIELD_SEPARATORS: [char; 5] = ['\t', ';', ',', '|', ' '];

/// Lines that the separator is chosen by.
const SEPARATOR_SAMPLE_LINES: usize = 200;

/// Splits `text` into rows of cells.
///
/// # Errors
/// A quoted field has no end.
pub(crate) fn from_text(text: &str, path: &Path) -> Result<CellGrid, InputFileError> {
    let (stated, skipped) = match text.lines().next().and_then(parse_separator_line) {
        Some(separator) => (Some(separator), 1),
        None => (None, 0),
    };
    let separator = stated.unwrap_or_else(|| detect_separator(text));
    let mut rows = split_rows(text, separator, path)?;
    rows.retain(|row| row.line > skipped);
    if separator == ' ' {
        join_header_cells(&mut rows, text);
    }
    let is_open_ended = !text.ends_with(['\n', '\r']);
    let name = match separator {
        '\t' => "tab".to_string(),
        ' ' => "blanks".to_string(),
        other => format!("\"{other}\""),
    };
    Ok(CellGrid { rows, separator: name, is_by_comma: separator == ',', is_open_ended })
}

/// Joins cells of text where blanks separate the columns: `Actual value` and `Position [mm]` are one header each. A
/// line with more cells than the lines of numbers is taken by gaps of two blanks, or with its units behind the words,
/// where that gives as many cells as they have.
fn join_header_cells(rows: &mut [CellRow], text: &str) {
    let is_of_numbers = |row: &&CellRow| {
        row.cells.len() > 1 && row.cells.iter().all(|cell| is_number_or_time(&cell.text()))
    };
    let mut counts = std::collections::BTreeMap::new();
    for row in rows.iter().filter(is_of_numbers) {
        *counts.entry(row.cells.len()).or_insert(0) += 1;
    }
    let Some((&columns, _)) = counts.iter().max_by_key(|(_, count)| **count) else { return };
    let lines: Vec<&str> = text.lines().collect();
    for row in rows.iter_mut().filter(|row| row.cells.len() > columns) {
        let Some(line) = lines.get(row.line - 1) else { continue };
        let is_unit = |cell: &Cell| cell.text().starts_with(['[', '(']);
        let gap_before = |cell: &Cell| {
            line.chars().take(cell.column - 1).collect::<Vec<_>>().ends_with(&[' ', ' '])
        };
        let by_gaps = |cell: &Cell| !gap_before(cell);
        for is_joined in [&by_gaps as &dyn Fn(&Cell) -> bool, &is_unit] {
            let mut joined: Vec<Cell> = Vec::new();
            for cell in &row.cells {
                match joined.last_mut() {
                    Some(last) if is_joined(cell) => {
                        last.content =
                            CellContent::Text(format!("{} {}", last.text(), cell.text()));
                    }
                    _ => joined.push(cell.clone()),
                }
            }
            if joined.len() == columns {
                row.cells = joined;
                break;
            }
        }
    }
}

/// Returns the separator of a line `sep=;`.
fn parse_separator_line(line: &str) -> Option<char> {
    let rest = line.trim_matches(['"', ' ', '\r']).strip_prefix("sep=")?;
    let mut chars = rest.chars();
    match (chars.next(), chars.next()) {
        (Some(separator), None) => Some(separator),
        (None, None) => Some('\t'),
        _ => None,
    }
}

/// Returns the separator that makes most of the fields numbers, in rows of one length.
fn detect_separator(text: &str) -> char {
    let lines: Vec<&str> =
        text.lines().filter(|line| !line.trim().is_empty() && !is_comment(line)).collect();
    let from = lines.len().saturating_sub(SEPARATOR_SAMPLE_LINES) / 2;
    let lines = &lines[from..lines.len().min(from + SEPARATOR_SAMPLE_LINES)];
    // Nothing but a separator: no number, date or unit has one.
    let is_in_most = |separator: &char| {
        lines.iter().filter(|line| split_fields(line, *separator).len() > 1).count() * 2
            > lines.len()
    };
    if let Some(separator) = ['\t', ';', '|'].iter().find(|separator| is_in_most(separator)) {
        return *separator;
    }
    let mut best = (';', 0.0);
    for separator in FIELD_SEPARATORS {
        let counts: Vec<(usize, usize)> = lines
            .iter()
            .map(|line| {
                let fields = split_fields(line, separator);
                let filled = fields.iter().filter(|field| !field.trim().is_empty()).count();
                (filled, fields.iter().filter(|field| is_number_or_time(field)).count())
            })
            .collect();
        let score: f64 = counts
            .iter()
            .filter(|(filled, _)| *filled > 1)
            .map(|&(filled, values)| (values * values) as f64 / filled as f64)
            .sum();
        if score > best.1 * 1.001 {
            best = (separator, score);
        }
    }
    if best.1 > 0.0 {
        return best.0;
    }
    // No numbers: by the header.
    let first = lines.first().copied().unwrap_or_default();
    FIELD_SEPARATORS.into_iter().find(|separator| first.contains(*separator)).unwrap_or(';')
}

/// Returns the fields of a line without its quotes, for the choice of the separator only.
fn split_fields(line: &str, separator: char) -> Vec<String> {
    let mut fields = vec![String::new()];
    let mut is_quoted = false;
    for c in line.trim_end().chars() {
        if c == '"' {
            is_quoted = !is_quoted;
        } else if c == separator && !is_quoted {
            fields.push(String::new());
        } else if let Some(field) = fields.last_mut() {
            field.push(c);
        }
    }
    if separator == ' ' {
        fields.retain(|field| !field.is_empty());
    }
    fields
}

/// Returns true for what is a number or a time in some writing.
fn is_number_or_time(field: &str) -> bool {
    let field = field.trim();
    if timestamp::is_timestamp(field) {
        return true;
    }
    let of_value = |c: char| c.is_ascii_digit() || "+-.,:/eETZ'\u{a0}\u{2212}".contains(c);
    field.starts_with(|c: char| c.is_ascii_digit() || "+-.\u{2212}".contains(c))
        && field.contains(|c: char| c.is_ascii_digit())
        && field.matches(',').count() < 2
        && field.split(' ').filter(|word| !word.is_empty()).count() <= 2
        && field.split(' ').all(|word| word.chars().all(of_value))
        // `5.3 1.2`: two values.
        && (!field.contains(' ') || field.contains(':'))
}

/// Returns true for a line that is a comment.
pub(crate) fn is_comment(line: &str) -> bool {
    let line = line.trim_start();
    line.starts_with('#') || line.starts_with('%') || line.starts_with("//")
}

fn split_rows(text: &str, separator: char, path: &Path) -> Result<Vec<CellRow>, InputFileError> {
    let mut rows = Vec::new();
    let mut line = 1;
    let mut rest = text;
    while !rest.is_empty() {
        let first_line = line;
        let mut cells = Vec::new();
        let mut column = 1;
        loop {
            let field = next_field(rest, separator);
            let Some(field) = field else {
                let place = Location { file: path.to_path_buf(), line: first_line, column };
                return Err(InputFileError::new(place, "a quoted field has no end")
                    .with_help("write the closing quote, or leave the quotes out"));
            };
            let is_blank = separator == ' ' && field.text.trim().is_empty();
            if !is_blank {
                cells.push(Cell { content: CellContent::Text(field.text), column });
            }
            line += field.lines;
            column += field.width + 1;
            rest = &rest[field.length..];
            if !field.is_last {
                continue;
            }
            break;
        }
        line += 1;
        if cells.is_empty() {
            cells.push(Cell { content: CellContent::Text(String::new()), column: 1 });
        }
        rows.push(CellRow { line: first_line, cells });
    }
    Ok(rows)
}

struct DelimitedField {
    text: String,
    /// In bytes, with the separator or line end after it.
    length: usize,
    /// In characters, without.
    width: usize,
    /// Line ends inside its quotes.
    lines: usize,
    is_last: bool,
}

/// Returns the field that `rest` begins with; `None` for a quote without an end.
fn next_field(rest: &str, separator: char) -> Option<DelimitedField> {
    let is_end = |c: char| c == separator || c == '\n' || c == '\r';
    let blanks = rest.len() - rest.trim_start_matches([' ', '\t']).len();
    let is_quoted = separator != ' ' && rest[blanks..].starts_with('"');
    let (text, after, lines) = if is_quoted {
        let inner = &rest[blanks + 1..];
        let mut from = 0;
        let end = loop {
            let at = from + inner[from..].find('"')?;
            if !inner[at + 1..].starts_with('"') {
                break at;
            }
            from = at + 2;
        };
        let after = blanks + 1 + end + 1;
        let more = rest[after..].find(is_end).unwrap_or(rest.len() - after);
        let text = inner[..end].replace("\"\"", "\"");
        // `1" 2`: the quote is an inch.
        let text = if rest[after..after + more].trim().is_empty() {
            text
        } else {
            rest[..after + more].to_string()
        };
        (text, after + more, inner[..end].matches('\n').count())
    } else {
        let end = rest.find(is_end).unwrap_or(rest.len());
        (rest[..end].to_string(), end, 0)
    };
    let width = rest[..after].chars().count();
    let tail = &rest[after..];
    let (ending, is_last) = if tail.is_empty() {
        (0, true)
    } else if tail.starts_with("\r\n") {
        (2, true)
    } else if tail.starts_with(['\n', '\r']) {
        (1, true)
    } else {
        (separator.len_utf8(), false)
    };
    Some(DelimitedField { text, length: after + ending, width, lines, is_last })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(text: &str) -> Vec<Vec<String>> {
        let grid = from_text(text, Path::new("a.csv")).expect("a table");
        grid.rows.iter().map(|row| row.cells.iter().map(Cell::text).collect()).collect()
    }

    #[test]
    fn the_separator_is_the_one_that_makes_numbers() {
        for (text, first) in [
            ("a;b\n1,5;2,5\n3,5;4\n", vec!["a", "b"]),
            ("a,b\n1.5,2.5\n", vec!["a", "b"]),
            ("a\tb\n1,5\t2,5\n", vec!["a", "b"]),
            ("sep=|\na|b\n1|2\n", vec!["a", "b"]),
            ("a b\n0,0 1,5\n1,0  2,5\n", vec!["a", "b"]),
            ("Pos [mm] Ist [mm]\n0,0 1,5\n1,0 2,5\n", vec!["Pos [mm]", "Ist [mm]"]),
            (
                "No  Setpoint   Actual value\n1   0.0  0.5\n2  1.0    2.5\n",
                vec!["No", "Setpoint", "Actual value"],
            ),
            ("a;b, c\n08:15;\"1,5\"\n", vec!["a", "b, c"]),
            ("\"a\nx\";b;;\n1;2;;\n", vec!["a\nx", "b", "", ""]),
        ] {
            assert_eq!(cells(text)[0], first, "{text}");
        }
    }

    #[test]
    fn lines_and_columns_are_those_of_the_file() {
        let grid =
            from_text("sep=;\r\n\"a\nb\";c\r\n1;22;3\r\n", Path::new("a.csv")).expect("a table");
        let row = &grid.rows[1];
        assert_eq!((row.line, row.cells[2].column), (4, 6));
        let error = from_text("a;b\n\"1;2\n", Path::new("a.csv")).expect_err("no end");
        assert_eq!((error.place.line, error.place.column), (2, 1));
    }
}
