//! The kinds of cells in a column: numbers with or without a unit, times, words.

use std::path::Path;

use trueup_machine::InputFileError;

use crate::{
    answers::{ImportError, Question, QuestionTopic},
    cell_grid::{Cell, CellContent},
    layout::SourceTable,
    number::{self, DecimalEvidence, DecimalSeparator},
    timestamp, unit, vocabulary,
};

/// The cells of a column, counted.
#[derive(Clone, Debug, Default)]
pub(crate) struct CellCounts {
    pub(crate) numbers: usize,
    pub(crate) stamps: usize,
    pub(crate) directions: usize,
    pub(crate) switches: usize,
    /// Text of another kind.
    pub(crate) others: usize,
    pub(crate) missing: usize,
    /// The unit that stands behind a number.
    pub(crate) unit: Option<String>,
}

impl CellCounts {
    /// Counts the cells of a column.
    pub(crate) fn from_cells<'c>(cells: impl Iterator<Item = &'c Cell>) -> Self {
        let mut counts = Self::default();
        for cell in cells {
            let CellContent::Text(text) = &cell.content else {
                match cell.content {
                    CellContent::Date(_) => counts.stamps += 1,
                    _ => {
                        counts.numbers += 1;
                        counts.directions += usize::from(is_direction_sign(cell));
                    }
                }
                continue;
            };
            if text.trim().is_empty() {
                continue;
            }
            let is_way = vocabulary::parse_direction(text).is_some();
            let is_switch = vocabulary::parse_on_off(text).is_some();
            counts.directions += usize::from(is_way);
            counts.switches += usize::from(is_switch);
            let (digits, unit) = number::split_unit(text);
            if number::decimal_evidence(digits).is_some()
                && (unit.is_empty() || unit::parse(unit).is_some())
            {
                counts.numbers += 1;
                if !unit.is_empty() {
                    counts.unit.get_or_insert_with(|| unit.to_string());
                }
            } else if timestamp::is_timestamp(text) {
                counts.stamps += 1;
            } else if number::is_missing(text) {
                counts.missing += usize::from(!is_way);
            } else {
                counts.others += usize::from(!is_way && !is_switch);
            }
        }
        counts
    }

    /// Returns true if most of the cells are words.
    pub(crate) fn is_mostly_text(&self) -> bool {
        self.others > 0 && self.others >= self.numbers + self.stamps
    }
}

fn is_direction_sign(cell: &Cell) -> bool {
    matches!(cell.content, CellContent::Number(value) if value.abs() == 1.0)
}

/// Returns the sign before the decimals of the file.
///
/// # Errors
/// Numbers contradict each other, or all of them can be read both ways: a question.
pub(crate) fn detect_decimal_separator(
    layout: &SourceTable,
    is_by_comma: bool,
    stated: Option<DecimalSeparator>,
    path: &Path,
) -> Result<(DecimalSeparator, bool), ImportError> {
    let (mut sure, mut open) = (None, None);
    for (row, at) in
        layout.rows.iter().flat_map(|row| (0..row.cells.len()).map(move |at| (row, at)))
    {
        let CellContent::Text(text) = &row.cells[at].content else { continue };
        let (digits, unit) = number::split_unit(text);
        if !(unit.is_empty() || unit::parse(unit).is_some()) {
            continue;
        }
        match number::decimal_evidence(digits) {
            Some(DecimalEvidence::Sure(found)) => {
                let &mut (known, ref first) = sure.get_or_insert((found, digits.to_string()));
                if known != found && stated.is_none() {
                    let rule = format!(
                        "{first} has a decimal {}, {digits} a {}",
                        known.name(),
                        found.name()
                    );
                    let help =
                        "write all numbers one way, or state which one is right: --decimal comma";
                    return Err(InputFileError::new(row.location(path, at), rule)
                        .with_help(help)
                        .into());
                }
            }
            Some(DecimalEvidence::Either(found)) => {
                open.get_or_insert((row.location(path, at), found, digits.to_string()));
            }
            _ => {}
        }
    }
    if let Some(stated) = stated {
        return Ok((stated, true));
    }
    match (sure, open) {
        (Some((known, _)), _) => Ok((known, true)),
        (None, None) => Ok((DecimalSeparator::Point, false)),
        (None, Some((_, DecimalSeparator::Point, _))) if is_by_comma => {
            Ok((DecimalSeparator::Point, true))
        }
        (None, Some((place, found, digits))) => {
            let other = if found == DecimalSeparator::Point {
                DecimalSeparator::Comma
            } else {
                DecimalSeparator::Point
            };
            let small = number::parse(&digits, found).unwrap_or(f64::NAN);
            let large = number::parse(&digits, other).unwrap_or(f64::NAN);
            Err(ImportError::Open(vec![Question {
                place,
                text: format!("{digits} reads as {small} or as {large}"),
                topic: QuestionTopic::Decimal,
                choices: vec![found.name().into(), other.name().into()],
                is_open: false,
            }]))
        }
    }
}

/// Returns the number in a cell and the unit behind it; `None` where there is none.
pub(crate) fn parse_number_with_unit(
    cell: &Cell,
    decimal: DecimalSeparator,
) -> Option<(f64, &str)> {
    match &cell.content {
        CellContent::Number(value) => Some((*value, "")),
        CellContent::Date(_) => None,
        CellContent::Text(text) => {
            let (digits, unit) = number::split_unit(text);
            Some((number::parse(digits, decimal)?, unit))
        }
    }
}
