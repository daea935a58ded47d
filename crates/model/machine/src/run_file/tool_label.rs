//! Labels in the column `tool`: text where every other column has a number.
//!
//! A label is kept as a number that no tool has: below 0, the same for the same label in every file.
//! `[spindle.tools]` of the machine file says which number of the CNC it is.

use crate::tool_column::{TOOL_COLUMN, label_code};

/// The longest label, in characters.
const MAX_LABEL_CHARACTERS: usize = 64;

/// Returns whether cells of this column may be labels.
pub(super) fn can_have_labels(column: &str) -> bool {
    column == TOOL_COLUMN
}

/// Reads a cell of the column: the number of a tool, or a label.
pub(super) fn parse(cell: &str, number: Result<f64, String>) -> Result<f64, String> {
    match number {
        Ok(value) if value.is_nan() => Ok(value),
        Ok(value) if value.fract() == 0.0 && (0.0..=65535.0).contains(&value) => Ok(value),
        Ok(value) => {
            Err(format!("must be a whole number from 0 to 65535, or the tool's label, not {value}"))
        }
        Err(rule) if !is_label(cell) => Err(rule),
        Err(_) => Ok(label_code(cell)),
    }
}

/// Returns whether it is a word: it has a letter, and no comma, which would be that of a decimal.
fn is_label(cell: &str) -> bool {
    cell.contains(char::is_alphabetic)
        && cell.chars().count() <= MAX_LABEL_CHARACTERS
        && !cell.chars().any(|character| character.is_control() || character == ',')
        && cell.parse::<f64>().is_err()
}
