//! The kinds of cells in a column: numbers with or without a unit, times, words.

use std::path::Path;

use trueup_machine::BadInput;

use crate::{
    answers::{Question, Refused, Topic},
    grid::{Cell, Content},
    layout::Layout,
    number::{self, Decimal, Evidence},
    stamp, unit, words,
};

/// The cells of a column, counted.
#[derive(Clone, Debug, Default)]
pub(crate) struct Counts {
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

impl Counts {
    /// Counts the cells of a column.
    pub(crate) fn of<'c>(cells: impl Iterator<Item = &'c Cell>) -> Self {
        let mut counts = Self::default();
        for cell in cells {
            let Content::Text(text) = &cell.content else {
                match cell.content {
                    Content::Date(_) => counts.stamps += 1,
                    _ => {
                        counts.numbers += 1;
                        counts.directions += usize::from(is_sign(cell));
                    }
                }
                continue;
            };
            if text.trim().is_empty() {
                continue;
            }
            let is_way = words::direction(text).is_some();
            let is_switch = words::switch(text).is_some();
            counts.directions += usize::from(is_way);
            counts.switches += usize::from(is_switch);
            let (digits, unit) = number::split_unit(text);
            if number::evidence(digits).is_some()
                && (unit.is_empty() || unit::parse(unit).is_some())
            {
                counts.numbers += 1;
                if !unit.is_empty() {
                    counts.unit.get_or_insert_with(|| unit.to_string());
                }
            } else if stamp::is_stamp(text) {
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
    pub(crate) fn is_text(&self) -> bool {
        self.others > 0 && self.others >= self.numbers + self.stamps
    }
}

fn is_sign(cell: &Cell) -> bool {
    matches!(cell.content, Content::Number(value) if value.abs() == 1.0)
}

/// Returns the sign before the decimals of the file.
///
/// # Errors
/// Numbers contradict each other, or all of them can be read both ways: a question.
pub(crate) fn decimal(
    layout: &Layout,
    is_by_comma: bool,
    stated: Option<Decimal>,
    path: &Path,
) -> Result<(Decimal, bool), Refused> {
    let (mut sure, mut open) = (None, None);
    for (row, at) in
        layout.rows.iter().flat_map(|row| (0..row.cells.len()).map(move |at| (row, at)))
    {
        let Content::Text(text) = &row.cells[at].content else { continue };
        let (digits, unit) = number::split_unit(text);
        if !(unit.is_empty() || unit::parse(unit).is_some()) {
            continue;
        }
        match number::evidence(digits) {
            Some(Evidence::Sure(found)) => {
                let &mut (known, ref first) = sure.get_or_insert((found, digits.to_string()));
                if known != found && stated.is_none() {
                    let rule = format!(
                        "{first} has a decimal {}, {digits} a {}",
                        known.name(),
                        found.name()
                    );
                    let help =
                        "write all numbers one way, or say which one is right: --decimal comma";
                    return Err(BadInput::new(row.place(path, at), rule).with_help(help).into());
                }
            }
            Some(Evidence::Either(found)) => {
                open.get_or_insert((row.place(path, at), found, digits.to_string()));
            }
            _ => {}
        }
    }
    if let Some(stated) = stated {
        return Ok((stated, true));
    }
    match (sure, open) {
        (Some((known, _)), _) => Ok((known, true)),
        (None, None) => Ok((Decimal::Point, false)),
        (None, Some((_, Decimal::Point, _))) if is_by_comma => Ok((Decimal::Point, true)),
        (None, Some((place, found, digits))) => {
            let other = if found == Decimal::Point { Decimal::Comma } else { Decimal::Point };
            let small = number::parse(&digits, found).unwrap_or(f64::NAN);
            let large = number::parse(&digits, other).unwrap_or(f64::NAN);
            Err(Refused::Open(vec![Question {
                place,
                text: format!("{digits} reads as {small} or as {large}"),
                topic: Topic::Decimal,
                choices: vec![found.name().into(), other.name().into()],
                is_open: false,
            }]))
        }
    }
}

/// Returns the number in a cell and the unit behind it; `None` where there is none.
pub(crate) fn number_in(cell: &Cell, decimal: Decimal) -> Option<(f64, &str)> {
    match &cell.content {
        Content::Number(value) => Some((*value, "")),
        Content::Date(_) => None,
        Content::Text(text) => {
            let (digits, unit) = number::split_unit(text);
            Some((number::parse(digits, decimal)?, unit))
        }
    }
}
