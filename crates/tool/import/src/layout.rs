//! Where the table stands in its file: titles, header, units, rows, and what is ignored around them.

use std::path::Path;

use trueup_machine::{InputFileError, Location};

use crate::{
    cell_grid::{Cell, CellContent, CellGrid, CellRow, is_comment},
    column_meaning::{self, ColumnMeaning},
    number, timestamp, unit,
};

/// A column as the file has it.
#[derive(Clone, Debug)]
pub(crate) struct SourceColumn {
    /// Its header; `column 3` where there is none.
    pub(crate) header: String,
    /// Its unit, from a row of units.
    pub(crate) unit: String,
    /// Its meaning, where the form of the file says so.
    pub(crate) meaning: Option<ColumnMeaning>,
    pub(crate) place: Location,
}

/// A table: columns, rows of as many cells, and what was ignored.
#[derive(Clone, Debug)]
pub(crate) struct SourceTable {
    pub(crate) columns: Vec<SourceColumn>,
    pub(crate) rows: Vec<CellRow>,
    /// Omissions and assumptions, a sentence each.
    pub(crate) notes: Vec<String>,
}

/// Returns true for a number or a time, with a known unit behind it or none.
pub(crate) fn is_value(cell: &Cell) -> bool {
    let CellContent::Text(text) = &cell.content else { return true };
    let (digits, unit) = number::split_unit(text);
    let is_number = number::decimal_evidence(digits).is_some()
        && (unit.is_empty() || unit::parse(unit).is_some());
    is_number || timestamp::is_timestamp(text)
}

#[derive(Clone, Copy, PartialEq)]
enum RowKind {
    Blank,
    Comment,
    /// One cell of text.
    Remark,
    Text,
    Data,
}

fn classify_row(row: &CellRow) -> RowKind {
    let Some(first) = row.cells.iter().find(|cell| !cell.is_empty()) else { return RowKind::Blank };
    if is_comment(&first.text()) {
        return RowKind::Comment;
    }
    let there = row.cells.iter().filter(|cell| !number::is_missing(&cell.text()));
    let (mut filled, mut values) = (0, 0);
    for cell in there {
        filled += 1;
        values += usize::from(is_value(cell));
    }
    match (values, filled) {
        (1.., _) if values * 2 >= filled => RowKind::Data,
        (0, _) if row.filled_cell_count() == 1 => RowKind::Remark,
        _ => RowKind::Text,
    }
}

/// Rows of a second table that are no accident.
const MIN_SECOND_TABLE_ROWS: usize = 3;

/// Finds the table in `grid`.
///
/// # Errors
/// There is no table of at least two columns, or there are two.
pub(crate) fn find_table(grid: &CellGrid, path: &Path) -> Result<SourceTable, InputFileError> {
    let mut kinds: Vec<RowKind> = grid.rows.iter().map(classify_row).collect();
    reclassify_numeric_header(grid, &mut kinds);
    let blocks = find_blocks(&grid.rows, &kinds);
    let longest =
        blocks.iter().max_by_key(|block| (block.rows.len(), std::cmp::Reverse(block.rows[0])));
    let Some(block) = longest else {
        return Err(InputFileError::new(Location::start_of_file(path), "has no row of numbers")
            .with_help("the first row names the columns, each row below is one reading"));
    };
    let first = block.rows[0];
    let mut layout = find_headers(grid, &kinds, first, path)?;
    let head = layout.1;
    let mut notes = Vec::new();
    let text_of = |at: usize| {
        let cells: Vec<String> =
            grid.rows[at].cells.iter().filter(|cell| !cell.is_empty()).map(Cell::text).collect();
        let text = cells.join("  ");
        let short: String = text.chars().take(50).collect();
        format!("line {} is skipped: {short}", grid.rows[at].line)
    };
    let taken: Vec<usize> = collect_rows_under_header(&blocks, block, grid, head);
    let header_text =
        |at: usize| -> Vec<String> { grid.rows[at].cells.iter().map(Cell::text).collect() };
    for (at, kind) in kinds.iter().enumerate() {
        let is_head = at >= head && at < first && (at == head || *kind != RowKind::Remark);
        let is_again = at > first && head < first && header_text(at) == header_text(head);
        if *kind == RowKind::Blank || taken.binary_search(&at).is_ok() || is_head || is_again {
            continue;
        }
        if *kind == RowKind::Comment && at > first {
            continue;
        }
        notes.push(text_of(at));
    }
    for other in &blocks {
        let is_large = other.rows.len() >= MIN_SECOND_TABLE_ROWS
            && grid.rows[other.rows[0]].filled_cell_count() > 2;
        if is_large && !other.rows.iter().any(|at| taken.binary_search(at).is_ok()) {
            let place = grid.rows[other.rows[0]].location(path, 0);
            return Err(InputFileError::new(place, "a second table begins here")
                .with_help("keep one table in the file"));
        }
    }
    layout.0.rows = taken.iter().map(|at| grid.rows[*at].clone()).collect();
    drop_statistics_rows(&mut layout.0.rows, &mut notes);
    let mut layout = layout.0;
    if grid.is_open_ended
        && let Some(last) = layout.rows.last()
        && layout.rows.len() > 1
        && grid.rows.last().is_some_and(|row| row.line == last.line)
        && last.cells.len() < layout.columns.len()
    {
        notes.push(format!("line {} is skipped: it is cut off", last.line));
        layout.rows.pop();
    }
    layout.notes = notes;
    normalise_row_widths(&mut layout, path)?;
    if layout.columns.len() < 2 {
        return Err(InputFileError::new(
            Location::start_of_file(path),
            "has only one column of values",
        )
        .with_help("a run needs at least two: where or when, and what was measured"));
    }
    Ok(layout)
}

/// A header with numbers in it, `Position; 1; 2; 3`, has a word where the row below has a number.
fn reclassify_numeric_header(grid: &CellGrid, kinds: &mut [RowKind]) {
    let Some(first) = kinds.iter().position(|kind| *kind == RowKind::Data) else { return };
    let Some(below) = grid.rows[first + 1..].iter().find(|row| classify_row(row) != RowKind::Blank)
    else {
        return;
    };
    let is_word = |(cell, below): (&Cell, &Cell)| {
        !number::is_missing(&cell.text()) && !is_value(cell) && is_value(below)
    };
    let is_pass = |cell: &Cell| !is_value(cell) || cell.text().parse::<u8>().is_ok();
    let cells = &grid.rows[first].cells;
    let has_word = cells.iter().zip(&below.cells).any(is_word);
    if has_word && cells.iter().all(is_pass) && classify_row(below) == RowKind::Data {
        kinds[first] = RowKind::Text;
    }
}

/// Rows of numbers one after the other.
struct RowBlock {
    rows: Vec<usize>,
    /// The most cells that one of its rows fills.
    widest: usize,
}

fn find_blocks(rows: &[CellRow], kinds: &[RowKind]) -> Vec<RowBlock> {
    let mut blocks: Vec<RowBlock> = Vec::new();
    let mut is_open = false;
    for (at, kind) in kinds.iter().enumerate() {
        match kind {
            RowKind::Data => {
                // Two cells above a wider table are a title: `Datum;03.04.2026`.
                let filled = rows[at].filled_cell_count();
                let is_wider =
                    |block: &&mut RowBlock| block.widest <= 2 && filled > block.widest + 1;
                match blocks.last_mut().filter(|block| is_open && !is_wider(block)) {
                    Some(block) => {
                        block.rows.push(at);
                        block.widest = block.widest.max(filled);
                    }
                    None => blocks.push(RowBlock { rows: vec![at], widest: filled }),
                }
                is_open = true;
            }
            RowKind::Text => is_open = false,
            RowKind::Blank | RowKind::Comment | RowKind::Remark => {}
        }
    }
    blocks
}

/// Returns the rows of `block`, and of the blocks that stand under the same header again.
fn collect_rows_under_header(
    blocks: &[RowBlock],
    block: &RowBlock,
    grid: &CellGrid,
    head: usize,
) -> Vec<usize> {
    let first = block.rows[0];
    let texts = |at: usize| -> Vec<String> { grid.rows[at].cells.iter().map(Cell::text).collect() };
    let mut rows = Vec::new();
    for other in blocks {
        let start = other.rows[0];
        let is_same = start == first
            || (head < first
                && (1..=first - head)
                    .any(|above| start >= above && texts(start - above) == texts(head)));
        if is_same {
            rows.extend(&other.rows);
        }
    }
    rows
}

/// Returns the number of cells up to the last one that is not empty.
fn used_cell_count(row: &CellRow) -> usize {
    row.cells.iter().rposition(|cell| !cell.is_empty()).map_or(0, |last| last + 1)
}

/// Returns the columns, and the row in which the header stands (`first` where there is none).
fn find_headers(
    grid: &CellGrid,
    kinds: &[RowKind],
    first: usize,
    path: &Path,
) -> Result<(SourceTable, usize), InputFileError> {
    let width = used_cell_count(&grid.rows[first]);
    let mut above = (0..first).rev().filter(|at| kinds[*at] != RowKind::Blank);
    let is_header = |at: &usize| {
        let row = &grid.rows[*at];
        matches!(kinds[*at], RowKind::Text | RowKind::Comment | RowKind::Remark)
            && row.filled_cell_count() * 2 >= width.min(used_cell_count(row)).max(2)
            && used_cell_count(row) * 2 >= width
            && !row
                .cells
                .iter()
                .any(|cell| matches!(cell.content, CellContent::Number(_) | CellContent::Date(_)))
    };
    let nearest = above.next();
    let next = above.next().filter(is_header);
    let is_units = |at: usize| {
        let mut named = 0;
        let all = grid.rows[at].cells.iter().all(|cell| {
            let text = cell.text();
            let text = text.trim_start_matches('#').trim();
            let is_unit = unit::parse(text).is_some() || column_meaning::is_clock_format(text);
            named += usize::from(is_unit);
            is_unit || number::is_missing(text) || (text.starts_with('[') && text.ends_with(']'))
        });
        all && named > 0
    };
    let (head, units) = match (nearest, next) {
        (Some(units), Some(head)) if is_units(units) && !is_units(head) => {
            (Some(head), Some(units))
        }
        (head, _) => (head.filter(is_header), None),
    };
    let text = |row: Option<usize>, column: usize| {
        let cell = row.and_then(|at| grid.rows[at].cells.get(column));
        cell.map(Cell::text).unwrap_or_default().trim_start_matches('#').trim().to_string()
    };
    // Where commas are between columns a field too many may be a decimal comma.
    let least = if grid.is_by_comma { 0 } else { width };
    let count = head.map_or(width, |at| used_cell_count(&grid.rows[at]).max(least));
    let columns = (0..count).map(|column| {
        let header = text(head, column).split_whitespace().collect::<Vec<_>>().join(" ");
        SourceColumn {
            header: if header.is_empty() { format!("column {}", column + 1) } else { header },
            unit: text(units, column).trim_matches(['[', ']', '(', ')']).to_string(),
            meaning: None,
            place: grid.rows[head.unwrap_or(first)].location(path, column),
        }
    });
    let columns: Vec<SourceColumn> = columns.collect();
    for (at, column) in columns.iter().enumerate() {
        if let Some(before) = columns[..at].iter().position(|other| other.header == column.header) {
            let rule =
                format!("two columns are called {}: {} and {}", column.header, before + 1, at + 1);
            return Err(
                InputFileError::new(column.place.clone(), rule).with_help("give one another name")
            );
        }
    }
    Ok((SourceTable { columns, rows: Vec::new(), notes: Vec::new() }, head.unwrap_or(first)))
}

/// Leaves out rows at the end that are no readings: `Mittelwert`, `max`.
fn drop_statistics_rows(rows: &mut Vec<CellRow>, notes: &mut Vec<String>) {
    const STATISTICS_KEYWORDS: [&str; 18] = [
        "mittelwert",
        "mittel",
        "mean",
        "average",
        "avg",
        "summe",
        "sum",
        "total",
        "min",
        "max",
        "minimum",
        "maximum",
        "std",
        "stdev",
        "spannweite",
        "range",
        "moyenne",
        "median",
    ];
    while let Some(last) = rows.last()
        && let Some(cell) = last.cells.iter().find(|cell| !cell.is_empty() && !is_value(cell))
    {
        let text = cell.text();
        let word = text.trim_end_matches([':', '.']).to_lowercase();
        if !STATISTICS_KEYWORDS.contains(&word.as_str()) {
            break;
        }
        notes.push(format!("line {} is skipped: {text}", last.line));
        rows.pop();
    }
}

/// Gives each row as many cells as there are columns, and leaves out columns that are empty.
fn normalise_row_widths(layout: &mut SourceTable, path: &Path) -> Result<(), InputFileError> {
    let width = layout.columns.len();
    let mut short = 0;
    for row in &mut layout.rows {
        if row.cells.len() > width {
            let extra = row.cells[width..].iter().position(|cell| !cell.is_empty());
            if let Some(extra) = extra {
                let rule = format!("the row has {} fields, the header {width}", row.cells.len());
                return Err(InputFileError::new(row.location(path, width + extra), rule).with_help(
                    "is the decimal comma the separator too? Save with ; or tab between the columns",
                ));
            }
            row.cells.truncate(width);
        }
        short += usize::from(row.cells.len() < width);
        let column = row.cells.last().map_or(1, |cell| cell.column + cell.text().chars().count());
        row.cells.resize(width, Cell { content: CellContent::Text(String::new()), column });
    }
    let is_used: Vec<bool> =
        (0..width).map(|at| layout.rows.iter().any(|row| !row.cells[at].is_empty())).collect();
    if short > 0 && short < layout.rows.len() {
        layout.notes.push(format!(
            "{short} rows are shorter than the header: their last values are missing"
        ));
    }
    for (column, is_used) in layout.columns.iter().zip(&is_used) {
        if !is_used && !column.header.starts_with("column ") {
            layout.notes.push(format!("{} is skipped: it is empty", column.header));
        }
    }
    let mut keep = is_used.iter();
    layout.columns.retain(|_| *keep.next().unwrap_or(&true));
    for row in &mut layout.rows {
        let mut keep = is_used.iter();
        row.cells.retain(|_| *keep.next().unwrap_or(&true));
    }
    Ok(())
}
