//! The keys of the machine file: what a key is, and how one is declared.

use super::plausible_range::PlausibleRange;

/// A key of a section.
#[derive(Clone, Copy, Debug)]
pub struct Key {
    /// Its name; `<name>` stands for any word.
    pub name: &'static str,
    /// The form of its value.
    pub form: ValueType,
    /// Whether it must.
    pub need: Requirement,
    /// Its unit; empty where there is none.
    pub unit: &'static str,
    /// Its meaning, a sentence without its full stop.
    pub meaning: &'static str,
    /// A value, as TOML; empty for a section.
    pub example: &'static str,
    /// The range that its numbers should have, or those of its section that have none of their own.
    pub(crate) range: Option<PlausibleRange>,
    /// Whether it is not written where it has its default.
    pub(crate) is_quiet: bool,
    /// Whether its table is written on one line.
    pub(crate) is_inline: bool,
}

/// The form of a key's value.
#[derive(Clone, Copy, Debug)]
pub enum ValueType {
    /// Any string.
    Text,
    /// `true` or `false`.
    Boolean,
    /// One of these strings.
    Choice(&'static [&'static str]),
    /// The name of a temperature column, `temp_<name>_c`.
    Column,
    /// Any finite number.
    Number,
    /// A number above 0.
    Positive,
    /// A number of 0 or above.
    NotNegative,
    /// A whole number from the first to the second.
    Whole(u32, u32),
    /// Numbers, 1 to 4096.
    Numbers,
    /// A number, or several.
    NumberOrNumbers,
    /// Three numbers.
    Vector,
    /// Rows of three numbers, 1 to 4096.
    Rows,
    /// Strings of these.
    Choices(&'static [&'static str]),
    /// A table with these keys.
    Table(&'static [Key]),
    /// Any number of tables with the keys of their cause.
    Terms,
}

/// Whether a key must be there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Requirement {
    /// It must.
    Required,
    /// Without it there is none.
    Optional,
    /// Without it it is this, as TOML.
    Default(&'static str),
}

pub(crate) const fn key(
    name: &'static str,
    form: ValueType,
    unit: &'static str,
    meaning: &'static str,
) -> Key {
    Key {
        name,
        form,
        need: Requirement::Optional,
        unit,
        meaning,
        example: "",
        range: None,
        is_quiet: false,
        is_inline: false,
    }
}

pub(crate) const fn section(
    name: &'static str,
    keys: &'static [Key],
    meaning: &'static str,
) -> Key {
    key(name, ValueType::Table(keys), "", meaning)
}

impl Key {
    /// Returns it with a narrower form.
    pub(crate) const fn with_value_type(self, form: ValueType) -> Self {
        Self { form, ..self }
    }

    pub(crate) const fn required(self) -> Self {
        Self { need: Requirement::Required, ..self }
    }

    pub(crate) const fn with_default(self, default: &'static str) -> Self {
        Self { need: Requirement::Default(default), example: default, ..self }
    }

    pub(crate) const fn with_example_value(self, example: &'static str) -> Self {
        Self { example, ..self }
    }

    pub(crate) const fn with_range(self, range: PlausibleRange) -> Self {
        Self { range: Some(range), ..self }
    }

    /// Returns it as one that is not written where it has its default.
    pub(crate) const fn omit_default(self) -> Self {
        Self { is_quiet: true, ..self }
    }

    /// Returns it as a table that is written on one line.
    pub(crate) const fn inline(self) -> Self {
        Self { is_inline: true, ..self }
    }
}
