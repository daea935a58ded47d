//! One table of a TOML file, read strictly: a key that is unknown, missing, or of the wrong type is
//! an error that names the key and its place.
//!
//! A derived deserialiser would be shorter, but it gives one place for a whole table where the rule
//! is broken by one value, and it knows no "did you mean".

use std::{collections::BTreeSet, fmt::Display, path::Path};

use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

use crate::location::{InputFileError, KeyLocations, Location, format_suggestion, truncate_text};

/// The longest array that is read: 4096 points of a pitch table 1 mm apart are four metres, and
/// more than this is more than the board could store.
pub(crate) const MAX_ARRAY_LENGTH: usize = 4096;

/// A TOML file and where its keys stand.
pub(crate) struct TomlDocument<'t> {
    file: &'t Path,
    text: &'t str,
    table: DeTable<'t>,
    places: KeyLocations,
}

/// The rule that a run file in the place of a machine file breaks.
const NOT_A_MACHINE_FILE: &str = "is a table of values, and a machine file is needed here";

/// Returns true if the first line that says something is a header of columns: no key, no section.
fn has_column_header(text: &str) -> bool {
    let mut lines = text.lines().map(str::trim);
    let first = lines.find(|line| !line.is_empty() && !line.starts_with('#'));
    first.is_some_and(|line| line.contains([',', ';', '\t']) && !line.contains(['=', '[']))
}

impl<'t> TomlDocument<'t> {
    /// `text` is the whole content of `file`, without a byte order mark.
    pub(crate) fn parse(text: &'t str, file: &'t Path) -> Result<Self, InputFileError> {
        let table = DeTable::parse(text).map_err(|error| {
            if has_column_header(text) {
                return InputFileError::new(Location::start_of_file(file), NOT_A_MACHINE_FILE)
                    .with_help("--machine takes the machine file, --run the run file");
            }
            let offset = error.span().map_or(0, |span| span.start);
            let rule = format!("not valid TOML: {}", error.message());
            InputFileError::new(Location::from_byte_offset(file, text, offset), rule)
        })?;
        let table = table.into_inner();
        let mut places = KeyLocations::new(file);
        record_table_locations(&mut places, "", &table, &LineIndex::new(text));
        Ok(Self { file, text, table, places })
    }

    /// Returns the file itself as a section.
    pub(crate) fn root(&self) -> Section<'_> {
        Section { document: self, table: &self.table, name: String::new() }
    }

    /// Returns the place of every key.
    pub(crate) fn into_locations(self) -> KeyLocations {
        self.places
    }
}

/// Where the lines of a text begin: a table of thousands of numbers has thousands of places, and
/// to count the lines before each of them would take the square of the file's length.
struct LineIndex<'t> {
    text: &'t str,
    /// The byte at which each line begins; the first is 0.
    starts: Vec<usize>,
}

impl<'t> LineIndex<'t> {
    /// `text` has no byte order mark.
    fn new(text: &'t str) -> Self {
        let after_breaks = text.match_indices('\n').map(|(at, _)| at + 1);
        Self { text, starts: std::iter::once(0).chain(after_breaks).collect() }
    }

    /// Line and column, both from 1, of the byte at `offset`.
    fn line_and_column(&self, offset: usize) -> (usize, usize) {
        let line = self.starts.partition_point(|&start| start <= offset);
        let start = line.checked_sub(1).and_then(|before| self.starts.get(before)).unwrap_or(&0);
        let column = self.text.get(*start..offset).map_or(0, |before| before.chars().count()) + 1;
        (line, column)
    }
}

fn record_table_locations(
    places: &mut KeyLocations,
    name: &str,
    table: &DeTable<'_>,
    lines: &LineIndex<'_>,
) {
    for (key, value) in table {
        let dotted = dotted_key(name, key.get_ref());
        record_value_location(places, &dotted, value, lines);
        if value.get_ref().is_table() {
            places.insert(dotted, lines.line_and_column(key.span().start));
        }
    }
}

fn record_value_location(
    places: &mut KeyLocations,
    dotted: &str,
    value: &Spanned<DeValue<'_>>,
    lines: &LineIndex<'_>,
) {
    places.insert(dotted.to_string(), lines.line_and_column(value.span().start));
    match value.get_ref() {
        DeValue::Table(inner) => record_table_locations(places, dotted, inner, lines),
        DeValue::Array(elements) => {
            for (index, element) in elements.iter().enumerate() {
                record_value_location(places, &format!("{dotted}[{index}]"), element, lines);
            }
        }
        _ => {}
    }
}

fn dotted_key(section: &str, key: &str) -> String {
    if section.is_empty() { key.to_string() } else { format!("{section}.{key}") }
}

/// Returns whether a run-file column of this name is a temperature: `temp_<name>_c`.
#[must_use]
pub fn is_temperature_column(name: &str) -> bool {
    name.strip_prefix("temp_")
        .and_then(|rest| rest.strip_suffix("_c"))
        .is_some_and(|inner| !inner.is_empty())
}

/// One table of the file.
pub(crate) struct Section<'d> {
    document: &'d TomlDocument<'d>,
    table: &'d DeTable<'d>,
    /// Its dotted name; empty for the file itself.
    name: String,
}

impl<'d> Section<'d> {
    /// `key` of this section breaks a rule; `rule` goes on after the key: "must not be 0".
    pub(crate) fn key_error(&self, key: &str, rule: impl Display) -> InputFileError {
        self.document.places.key_error(&dotted_key(&self.name, key), rule)
    }

    /// Refuses every key that is not `known`.
    ///
    /// Must come before anything is read, or a misspelt key would be reported as a missing one.
    pub(crate) fn reject_unknown_keys(&self, known: &[&str]) -> Result<(), InputFileError> {
        match self.keys().into_iter().find(|key| !known.contains(key)) {
            Some(key) => Err(self.unknown_key_error(key, known.iter().copied())),
            None => Ok(()),
        }
    }

    /// `key` is none of the `known` keys of the format.
    pub(crate) fn unknown_key_error<'k>(
        &self,
        key: &str,
        known: impl IntoIterator<Item = &'k str>,
    ) -> InputFileError {
        let offset = self.table.get_key_value(key).map_or(0, |(key, _)| key.span().start);
        let place = Location::from_byte_offset(self.document.file, self.document.text, offset);
        let name = truncate_text(&dotted_key(&self.name, key));
        InputFileError::new(place, format!("unknown key {name}{}", format_suggestion(key, known)))
    }

    /// Returns the names of all keys, in the order of the file.
    pub(crate) fn keys(&self) -> Vec<&'d str> {
        let in_order: BTreeSet<(usize, &str)> =
            self.table.keys().map(|key| (key.span().start, key.get_ref().as_ref())).collect();
        in_order.into_iter().map(|(_, key)| key).collect()
    }

    /// Returns the first of `keys` that is there.
    pub(crate) fn first_present_key<'k>(
        &self,
        keys: impl IntoIterator<Item = &'k &'k str>,
    ) -> Option<&'k str> {
        keys.into_iter().copied().find(|key| self.table.get(*key).is_some())
    }

    /// Where `key` stands, or would.
    pub(crate) fn location(&self, key: &str) -> Location {
        self.document.places.locate(&dotted_key(&self.name, key))
    }

    /// Returns what `read` makes of this section with these `keys` of another one in it.
    pub(crate) fn read_with_keys_from<T>(
        &self,
        other: &Section<'_>,
        keys: &[&str],
        read: impl FnOnce(&Section<'_>) -> T,
    ) -> T {
        let mut table = self.table.clone();
        let added = keys.iter().filter_map(|key| other.table.get_key_value(*key));
        table.extend(added.map(|(key, value)| (key.clone(), value.clone())));
        read(&Section { document: self.document, table: &table, name: self.name.clone() })
    }

    /// `value` if it is there.
    ///
    /// # Errors
    /// The key is missing: at the place of the section.
    pub(crate) fn required<T>(&self, key: &str, value: Option<T>) -> Result<T, InputFileError> {
        value.ok_or_else(|| self.key_error(key, "is missing"))
    }

    /// Returns the table `key`.
    pub(crate) fn section(&self, key: &str) -> Result<Option<Section<'d>>, InputFileError> {
        match self.table.get(key).map(Spanned::get_ref) {
            None => Ok(None),
            Some(DeValue::Table(table)) => Ok(Some(Section {
                document: self.document,
                table,
                name: dotted_key(&self.name, key),
            })),
            Some(other) => Err(self.wrong_type_error(key, "a table", other)),
        }
    }

    /// Returns the tables of the array of tables `key`; none where it is missing.
    pub(crate) fn sections(&self, key: &str) -> Result<Vec<Section<'d>>, InputFileError> {
        let Some(value) = self.table.get(key).map(Spanned::get_ref) else { return Ok(Vec::new()) };
        let DeValue::Array(elements) = value else {
            return Err(self.wrong_type_error(key, "an array of tables ([[term]])", value));
        };
        let table = |(index, element): (usize, &'d Spanned<DeValue<'d>>)| {
            let name = format!("{key}[{index}]");
            match element.get_ref() {
                DeValue::Table(table) => Ok(Section {
                    document: self.document,
                    table,
                    name: dotted_key(&self.name, &name),
                }),
                other => Err(self.wrong_type_error(&name, "a table", other)),
            }
        };
        elements.iter().enumerate().map(table).collect()
    }

    /// Returns the boolean `key`.
    pub(crate) fn boolean(&self, key: &str) -> Result<Option<bool>, InputFileError> {
        match self.table.get(key).map(Spanned::get_ref) {
            None => Ok(None),
            Some(DeValue::Boolean(value)) => Ok(Some(*value)),
            Some(other) => Err(self.wrong_type_error(key, "true or false", other)),
        }
    }

    /// Returns the string `key`.
    pub(crate) fn text(&self, key: &str) -> Result<Option<&'d str>, InputFileError> {
        match self.table.get(key).map(Spanned::get_ref) {
            None => Ok(None),
            Some(DeValue::String(text)) => Ok(Some(text)),
            Some(other) => Err(self.wrong_type_error(key, "a string", other)),
        }
    }

    /// Returns the string `key`, which must be one of `choices`.
    pub(crate) fn choice<T: Copy>(
        &self,
        key: &str,
        choices: &[(&str, T)],
    ) -> Result<Option<T>, InputFileError> {
        let Some(text) = self.text(key)? else { return Ok(None) };
        if let Some((_, choice)) = choices.iter().find(|(name, _)| *name == text) {
            return Ok(Some(*choice));
        }
        let names = || choices.iter().map(|(name, _)| *name);
        let listed = names().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(" or ");
        let suggestion = format_suggestion(text, names());
        let rule = format!("must be {listed}, not \"{}\"{suggestion}", truncate_text(text));
        Err(self.key_error(key, rule))
    }

    /// Returns the name of a temperature column `key`.
    pub(crate) fn temperature_column(&self, key: &str) -> Result<Option<&'d str>, InputFileError> {
        match self.text(key)? {
            Some(column) if !is_temperature_column(column) => {
                let rule =
                    format!("must name a column temp_<name>_c, not \"{}\"", truncate_text(column));
                Err(self.key_error(key, rule))
            }
            column => Ok(column),
        }
    }

    /// Returns the number `key`, written as integer or float; never infinite or NaN.
    pub(crate) fn number(&self, key: &str) -> Result<Option<f64>, InputFileError> {
        self.table
            .get(key)
            .map(|value| self.finite_number_from_value(key, value.get_ref()))
            .transpose()
    }

    /// Returns the number `key`, which must be above 0.
    pub(crate) fn positive_number(&self, key: &str) -> Result<Option<f64>, InputFileError> {
        match self.number(key)? {
            Some(value) if value <= 0.0 => {
                Err(self.key_error(key, format!("must be above 0, not {value}")))
            }
            other => Ok(other),
        }
    }

    /// Returns the number `key`, which must be 0 or above.
    pub(crate) fn non_negative_number(&self, key: &str) -> Result<Option<f64>, InputFileError> {
        match self.number(key)? {
            Some(value) if value < 0.0 => {
                Err(self.key_error(key, format!("must not be negative, but is {value}")))
            }
            other => Ok(other),
        }
    }

    /// Returns the whole number `key` in `least..=most`.
    pub(crate) fn integer(
        &self,
        key: &str,
        least: u32,
        most: u32,
    ) -> Result<Option<u32>, InputFileError> {
        let Some(value) = self.table.get(key).map(Spanned::get_ref) else { return Ok(None) };
        let DeValue::Integer(digits) = value else {
            return Err(self.wrong_type_error(key, "a whole number", value));
        };
        match i64::from_str_radix(digits.as_str(), digits.radix())
            .ok()
            .and_then(|value| u32::try_from(value).ok())
        {
            Some(value) if (least..=most).contains(&value) => Ok(Some(value)),
            _ => Err(self.key_error(key, format!("must be from {least} to {most}, not {digits}"))),
        }
    }

    /// Returns the array `key` of exactly three numbers.
    pub(crate) fn vector(&self, key: &str) -> Result<Option<[f64; 3]>, InputFileError> {
        let Some(value) = self.table.get(key).map(Spanned::get_ref) else { return Ok(None) };
        self.vector_from_value(key, value).map(Some)
    }

    /// Returns the array `key` of 1 to [`MAX_ARRAY_LENGTH`] numbers.
    pub(crate) fn numbers(&self, key: &str) -> Result<Option<Vec<f64>>, InputFileError> {
        let number =
            |element: &str, value: &DeValue<'_>| self.finite_number_from_value(element, value);
        self.read_elements(key, "an array of numbers", number)
    }

    /// Returns the same, or one number alone.
    pub(crate) fn number_or_numbers(&self, key: &str) -> Result<Option<Vec<f64>>, InputFileError> {
        match self.table.get(key).map(Spanned::get_ref) {
            Some(DeValue::Array(_)) | None => self.numbers(key),
            Some(_) => Ok(self.number(key)?.map(|number| vec![number])),
        }
    }

    /// Returns the array `key` of 1 to [`MAX_ARRAY_LENGTH`] rows of exactly three numbers.
    pub(crate) fn rows(&self, key: &str) -> Result<Option<Vec<[f64; 3]>>, InputFileError> {
        let row = |element: &str, value: &DeValue<'_>| self.vector_from_value(element, value);
        self.read_elements(key, "an array of rows", row)
    }

    /// Returns the array `key`, each element read by `read` under its own name.
    fn read_elements<T>(
        &self,
        key: &str,
        requested: &str,
        read: impl Fn(&str, &DeValue<'_>) -> Result<T, InputFileError>,
    ) -> Result<Option<Vec<T>>, InputFileError> {
        let Some(value) = self.table.get(key).map(Spanned::get_ref) else { return Ok(None) };
        let DeValue::Array(elements) = value else {
            return Err(self.wrong_type_error(key, requested, value));
        };
        if !(1..=MAX_ARRAY_LENGTH).contains(&elements.len()) {
            let rule =
                format!("must have 1 to {MAX_ARRAY_LENGTH} elements, not {}", elements.len());
            return Err(self.key_error(key, rule));
        }
        elements
            .iter()
            .enumerate()
            .map(|(index, element)| read(&format!("{key}[{index}]"), element.get_ref()))
            .collect::<Result<_, _>>()
            .map(Some)
    }

    fn vector_from_value(
        &self,
        key: &str,
        value: &DeValue<'_>,
    ) -> Result<[f64; 3], InputFileError> {
        let DeValue::Array(elements) = value else {
            return Err(self.wrong_type_error(key, "an array of three numbers", value));
        };
        if elements.len() != 3 {
            return Err(
                self.key_error(key, format!("must have 3 elements, not {}", elements.len()))
            );
        }
        let mut vector = [0.0; 3];
        for (index, (component, element)) in vector.iter_mut().zip(elements.iter()).enumerate() {
            *component =
                self.finite_number_from_value(&format!("{key}[{index}]"), element.get_ref())?;
        }
        Ok(vector)
    }

    /// Returns the array `key` of strings.
    pub(crate) fn strings(&self, key: &str) -> Result<Option<Vec<&'d str>>, InputFileError> {
        let Some(value) = self.table.get(key).map(Spanned::get_ref) else { return Ok(None) };
        let DeValue::Array(elements) = value else {
            return Err(self.wrong_type_error(key, "an array of strings", value));
        };
        let text = |(index, element): (usize, &'d Spanned<DeValue<'d>>)| match element.get_ref() {
            DeValue::String(text) => Ok(text.as_ref()),
            other => Err(self.wrong_type_error(&format!("{key}[{index}]"), "a string", other)),
        };
        elements.iter().enumerate().map(text).collect::<Result<_, _>>().map(Some)
    }

    fn finite_number_from_value(
        &self,
        key: &str,
        value: &DeValue<'_>,
    ) -> Result<f64, InputFileError> {
        let number = match value {
            // Any integer of the file is taken as the nearest f64, as it would be with ".0".
            DeValue::Integer(digits) => i128::from_str_radix(digits.as_str(), digits.radix())
                .map_or(f64::INFINITY, |integer| integer as f64),
            DeValue::Float(digits) => digits.as_str().parse().unwrap_or(f64::NAN),
            other => return Err(self.wrong_type_error(key, "a number", other)),
        };
        if number.is_finite() {
            Ok(number)
        } else {
            Err(self.key_error(key, "must be a finite number"))
        }
    }

    fn wrong_type_error(&self, key: &str, requested: &str, there: &DeValue<'_>) -> InputFileError {
        let there = match there {
            DeValue::String(_) => "a string",
            DeValue::Integer(_) => "an integer",
            DeValue::Float(_) => "a float",
            DeValue::Boolean(_) => "a boolean",
            DeValue::Datetime(_) => "a date",
            DeValue::Array(_) => "an array",
            DeValue::Table(_) => "a table",
        };
        self.key_error(key, format!("must be {requested}, not {there}"))
    }
}
