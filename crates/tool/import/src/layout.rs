//! Where the table stands in its file: titles, header, units, rows, and what is left out around them.

use std::path::Path;

use trueup_machine::{BadInput, Location};

use crate::{
    grid::{Cell, Content, Grid, Row, is_comment},
    meaning::{self, Meaning},
    number, stamp, unit,
};

/// A column as the file has it.
#[derive(Clone, Debug)]
pub(crate) struct Source {
    /// Its header; `column 3` where there is none.
    pub(crate) header: String,
    /// Its unit, from a row of units.
    pub(crate) unit: String,
    /// Its meaning, where the form of the file says so.
    pub(crate) meaning: Option<Meaning>,
    pub(crate) place: Location,
}

/// A table: columns, rows of as many cells, and what was left out.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    pub(crate) columns: Vec<Source>,
    pub(crate) rows: Vec<Row>,
    /// Omissions and assumptions, a sentence each.
    pub(crate) notes: Vec<String>,
}

/// Returns true for a number or a time, with a known unit behind it or none.
pub(crate) fn is_value(cell: &Cell) -> bool {
    let Content::Text(text) = &cell.content else { return true };
    let (digits, unit) = number::split_unit(text);
    let is_number =
        number::evidence(digits).is_some() && (unit.is_empty() || unit::parse(unit).is_some());
    is_number || stamp::is_stamp(text)
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Blank,
    Comment,
    /// One cell of text.
    Remark,
    Text,
    Data,
}

fn kind(row: &Row) -> Kind {
    let Some(first) = row.cells.iter().find(|cell| !cell.is_empty()) else { return Kind::Blank };
    if is_comment(&first.text()) {
        return Kind::Comment;
    }
    let there = row.cells.iter().filter(|cell| !number::is_missing(&cell.text()));
    let (mut filled, mut values) = (0, 0);
    for cell in there {
        filled += 1;
        values += usize::from(is_value(cell));
    }
    match (values, filled) {
        (1.., _) if values * 2 >= filled => Kind::Data,
        (0, _) if row.filled() == 1 => Kind::Remark,
        _ => Kind::Text,
    }
}

/// Rows of a second table that are no accident.
const SECOND_TABLE: usize = 3;

/// Finds the table in `grid`.
///
/// # Errors
/// There is no table of at least two columns, or there are two.
pub(crate) fn find(grid: &Grid, path: &Path) -> Result<Layout, BadInput> {
    let mut kinds: Vec<Kind> = grid.rows.iter().map(kind).collect();
    numbered_header(grid, &mut kinds);
    let blocks = blocks(&grid.rows, &kinds);
    let longest =
        blocks.iter().max_by_key(|block| (block.rows.len(), std::cmp::Reverse(block.rows[0])));
    let Some(block) = longest else {
        return Err(BadInput::new(Location::start_of(path), "has no row of numbers")
            .with_help("the first row names the columns, each row below is one reading"));
    };
    let first = block.rows[0];
    let mut layout = headers(grid, &kinds, first, path)?;
    let head = layout.1;
    let mut notes = Vec::new();
    let text_of = |at: usize| {
        let cells: Vec<String> =
            grid.rows[at].cells.iter().filter(|cell| !cell.is_empty()).map(Cell::text).collect();
        let text = cells.join("  ");
        let short: String = text.chars().take(50).collect();
        format!("line {} is left out: {short}", grid.rows[at].line)
    };
    let taken: Vec<usize> = same_header(&blocks, block, grid, head);
    let header_text =
        |at: usize| -> Vec<String> { grid.rows[at].cells.iter().map(Cell::text).collect() };
    for (at, kind) in kinds.iter().enumerate() {
        let is_head = at >= head && at < first && (at == head || *kind != Kind::Remark);
        let is_again = at > first && head < first && header_text(at) == header_text(head);
        if *kind == Kind::Blank || taken.binary_search(&at).is_ok() || is_head || is_again {
            continue;
        }
        if *kind == Kind::Comment && at > first {
            continue;
        }
        notes.push(text_of(at));
    }
    for other in &blocks {
        let is_large = other.rows.len() >= SECOND_TABLE && grid.rows[other.rows[0]].filled() > 2;
        if is_large && !other.rows.iter().any(|at| taken.binary_search(at).is_ok()) {
            let place = grid.rows[other.rows[0]].place(path, 0);
            return Err(BadInput::new(place, "a second table begins here")
                .with_help("keep one table in the file"));
        }
    }
    layout.0.rows = taken.iter().map(|at| grid.rows[*at].clone()).collect();
    leave_out_statistics(&mut layout.0.rows, &mut notes);
    let mut layout = layout.0;
    if grid.is_open_ended
        && let Some(last) = layout.rows.last()
        && layout.rows.len() > 1
        && grid.rows.last().is_some_and(|row| row.line == last.line)
        && last.cells.len() < layout.columns.len()
    {
        notes.push(format!("line {} is left out: it is cut off", last.line));
        layout.rows.pop();
    }
    layout.notes = notes;
    fit_width(&mut layout, path)?;
    if layout.columns.len() < 2 {
        return Err(BadInput::new(Location::start_of(path), "has only one column of values")
            .with_help("a run needs at least two: where or when, and what was measured"));
    }
    Ok(layout)
}

/// A header with numbers in it, `Position; 1; 2; 3`, has a word where the row below has a number.
fn numbered_header(grid: &Grid, kinds: &mut [Kind]) {
    let Some(first) = kinds.iter().position(|kind| *kind == Kind::Data) else { return };
    let Some(below) = grid.rows[first + 1..].iter().find(|row| kind(row) != Kind::Blank) else {
        return;
    };
    let is_word = |(cell, below): (&Cell, &Cell)| {
        !number::is_missing(&cell.text()) && !is_value(cell) && is_value(below)
    };
    let is_pass = |cell: &Cell| !is_value(cell) || cell.text().parse::<u8>().is_ok();
    let cells = &grid.rows[first].cells;
    let has_word = cells.iter().zip(&below.cells).any(is_word);
    if has_word && cells.iter().all(is_pass) && kind(below) == Kind::Data {
        kinds[first] = Kind::Text;
    }
}

/// Rows of numbers one after the other.
struct Block {
    rows: Vec<usize>,
    /// The most cells that one of its rows fills.
    widest: usize,
}

fn blocks(rows: &[Row], kinds: &[Kind]) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let mut is_open = false;
    for (at, kind) in kinds.iter().enumerate() {
        match kind {
            Kind::Data => {
                // Two cells above a wider table are a title: `Datum;03.04.2026`.
                let filled = rows[at].filled();
                let is_wider = |block: &&mut Block| block.widest <= 2 && filled > block.widest + 1;
                match blocks.last_mut().filter(|block| is_open && !is_wider(block)) {
                    Some(block) => {
                        block.rows.push(at);
                        block.widest = block.widest.max(filled);
                    }
                    None => blocks.push(Block { rows: vec![at], widest: filled }),
                }
                is_open = true;
            }
            Kind::Text => is_open = false,
            Kind::Blank | Kind::Comment | Kind::Remark => {}
        }
    }
    blocks
}

/// Returns the rows of `block`, and of the blocks that stand under the same header again.
fn same_header(blocks: &[Block], block: &Block, grid: &Grid, head: usize) -> Vec<usize> {
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
fn used(row: &Row) -> usize {
    row.cells.iter().rposition(|cell| !cell.is_empty()).map_or(0, |last| last + 1)
}

/// Returns the columns, and the row in which the header stands (`first` where there is none).
fn headers(
    grid: &Grid,
    kinds: &[Kind],
    first: usize,
    path: &Path,
) -> Result<(Layout, usize), BadInput> {
    let width = used(&grid.rows[first]);
    let mut above = (0..first).rev().filter(|at| kinds[*at] != Kind::Blank);
    let is_header = |at: &usize| {
        let row = &grid.rows[*at];
        matches!(kinds[*at], Kind::Text | Kind::Comment | Kind::Remark)
            && row.filled() * 2 >= width.min(used(row)).max(2)
            && used(row) * 2 >= width
            && !row
                .cells
                .iter()
                .any(|cell| matches!(cell.content, Content::Number(_) | Content::Date(_)))
    };
    let nearest = above.next();
    let next = above.next().filter(is_header);
    let is_units = |at: usize| {
        let mut named = 0;
        let all = grid.rows[at].cells.iter().all(|cell| {
            let text = cell.text();
            let text = text.trim_start_matches('#').trim();
            let is_unit = unit::parse(text).is_some() || meaning::is_clock_form(text);
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
    let count = head.map_or(width, |at| used(&grid.rows[at]).max(least));
    let columns = (0..count).map(|column| {
        let header = text(head, column).split_whitespace().collect::<Vec<_>>().join(" ");
        Source {
            header: if header.is_empty() { format!("column {}", column + 1) } else { header },
            unit: text(units, column).trim_matches(['[', ']', '(', ')']).to_string(),
            meaning: None,
            place: grid.rows[head.unwrap_or(first)].place(path, column),
        }
    });
    let columns: Vec<Source> = columns.collect();
    for (at, column) in columns.iter().enumerate() {
        if let Some(before) = columns[..at].iter().position(|it| it.header == column.header) {
            let rule =
                format!("two columns are called {}: {} and {}", column.header, before + 1, at + 1);
            return Err(
                BadInput::new(column.place.clone(), rule).with_help("give one another name")
            );
        }
    }
    Ok((Layout { columns, rows: Vec::new(), notes: Vec::new() }, head.unwrap_or(first)))
}

/// Leaves out rows at the end that are no readings: `Mittelwert`, `max`.
fn leave_out_statistics(rows: &mut Vec<Row>, notes: &mut Vec<String>) {
    const WORDS: [&str; 18] = [
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
        if !WORDS.contains(&word.as_str()) {
            break;
        }
        notes.push(format!("line {} is left out: {text}", last.line));
        rows.pop();
    }
}

/// Gives each row as many cells as there are columns, and leaves out columns that are empty.
fn fit_width(layout: &mut Layout, path: &Path) -> Result<(), BadInput> {
    let width = layout.columns.len();
    let mut short = 0;
    for row in &mut layout.rows {
        if row.cells.len() > width {
            let extra = row.cells[width..].iter().position(|cell| !cell.is_empty());
            if let Some(extra) = extra {
                let rule = format!("the row has {} fields, the header {width}", row.cells.len());
                return Err(BadInput::new(row.place(path, width + extra), rule).with_help(
                    "is the decimal comma the separator too? Save with ; or tab between the columns",
                ));
            }
            row.cells.truncate(width);
        }
        short += usize::from(row.cells.len() < width);
        let column = row.cells.last().map_or(1, |cell| cell.column + cell.text().chars().count());
        row.cells.resize(width, Cell { content: Content::Text(String::new()), column });
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
            layout.notes.push(format!("{} is left out: it is empty", column.header));
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
