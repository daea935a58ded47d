//! An error in a scenario file, and its place: `file:line:column: rule`.
//!
//! A value of the wrong type has its place from the TOML reader; a value out of its range is found
//! later, by its key, which is then looked up in the text.

use std::path::PathBuf;

use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

/// An error in a scenario.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}:{line}:{column}: {rule}", .file.display())]
pub struct ScenarioError {
    /// The file as the user named it.
    pub file: PathBuf,
    /// Line, the first is 1.
    pub line: usize,
    /// Column in characters, the first is 1.
    pub column: usize,
    /// The rule that is broken, with the name and the value at fault.
    pub rule: String,
}

/// The values of these keys, each next to the name of its field, which is that of the key.
macro_rules! keys {
    ($of:ident: $($key:ident),* $(,)?) => { [$((stringify!($key), $of.$key)),*] };
}

pub(crate) use keys;

/// A rule that is broken by a key of a section.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct RuleViolation {
    /// The dotted key: `spindle.length_m`.
    pub(crate) key: String,
    /// The rest of the sentence after it.
    pub(crate) rule: String,
}

impl RuleViolation {
    /// `rule` goes on after the key: "must be above 0, not −1".
    pub(crate) fn new(key: &str, rule: String) -> Self {
        Self { key: key.to_string(), rule }
    }

    /// None of these may be below 0.
    pub(crate) fn require_non_negative(values: &[(&str, f64)]) -> Result<(), Self> {
        match values.iter().find(|(_, value)| *value < 0.0) {
            Some((key, value)) => Err(Self::new(key, format!("must not be below 0, not {value}"))),
            None => Ok(()),
        }
    }

    /// `value` is a share.
    pub(crate) fn require_fraction(key: &str, value: f64) -> Result<(), Self> {
        Self::require_fractions(&[(key, value)])
    }

    /// These are shares.
    pub(crate) fn require_fractions(values: &[(&str, f64)]) -> Result<(), Self> {
        match values.iter().find(|(_, value)| !(0.0..=1.0).contains(value)) {
            Some((key, value)) => Err(Self::new(key, format!("must be from 0 to 1, not {value}"))),
            None => Ok(()),
        }
    }

    /// Returns the same rule, its key in `section`.
    pub(crate) fn in_section(self, section: &str) -> Self {
        Self { key: format!("{section}.{}", self.key), ..self }
    }
}

/// Line and column, both from 1, of the byte at `offset`.
pub(crate) fn line_and_column(text: &str, offset: usize) -> (usize, usize) {
    let mut end = offset.min(text.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    let before = &text[..end];
    let start = before.rfind('\n').map_or(0, |at| at + 1);
    (before.matches('\n').count() + 1, before[start..].chars().count() + 1)
}

/// Where the dotted `key` stands, else the nearest section around it: `segment[2].axis`.
pub(crate) fn find_key_offset(document: &DeTable<'_>, key: &str) -> usize {
    let mut offset = 0;
    let mut table = document;
    for part in key.split('.') {
        let (name, index) = match part.split_once('[') {
            Some((name, index)) => (name, index.trim_end_matches(']').parse::<usize>().ok()),
            None => (part, None),
        };
        let Some((there, value)) = table.iter().find(|(there, _)| there.get_ref() == name) else {
            break;
        };
        offset = there.span().start;
        let value = match (index, value.get_ref()) {
            (Some(index), DeValue::Array(elements)) => match elements.get(index) {
                Some(element) => {
                    offset = element.span().start;
                    element
                }
                None => break,
            },
            _ => value,
        };
        match value.get_ref() {
            DeValue::Table(inner) => table = inner,
            _ => break,
        }
    }
    offset
}

/// Returns the first number that is infinite or not a number: its place and its key.
pub(crate) fn find_non_finite(section: &str, table: &DeTable<'_>) -> Option<(usize, String)> {
    table.iter().find_map(|(key, value)| {
        let dot = if section.is_empty() { "" } else { "." };
        find_non_finite_value(&format!("{section}{dot}{}", key.get_ref()), value)
    })
}

fn find_non_finite_value(key: &str, value: &Spanned<DeValue<'_>>) -> Option<(usize, String)> {
    match value.get_ref() {
        DeValue::Table(inner) => find_non_finite(key, inner),
        DeValue::Array(elements) => elements.iter().enumerate().find_map(|(index, element)| {
            find_non_finite_value(&format!("{key}[{index}]"), element)
        }),
        DeValue::Float(float) => {
            let is_finite = float.as_str().replace('_', "").parse().is_ok_and(f64::is_finite);
            (!is_finite).then(|| (value.span().start, key.to_string()))
        }
        _ => None,
    }
}
