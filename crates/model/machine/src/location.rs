//! Where in a user's file something is wrong, and which rule it breaks.
//!
//! Every complaint about a file is one line, `file:line:column: rule`, the form that editors and
//! terminals turn into a link.

use std::{
    collections::BTreeMap,
    fmt::{self, Display},
    path::{Path, PathBuf},
};

use trueup_output::escape::escape_line;

/// A place in a text file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Location {
    /// The file as the user named it.
    pub file: PathBuf,
    /// Line, the first is 1.
    pub line: usize,
    /// Column in characters (not bytes), the first is 1; a byte order mark does not count.
    pub column: usize,
}

impl Location {
    /// Returns the first character of `file`: for what is wrong with the file as a whole.
    #[must_use]
    pub fn start_of_file(file: &Path) -> Self {
        Self { file: file.to_path_buf(), line: 1, column: 1 }
    }

    /// Returns the place of the byte at `offset` in `text`, the whole content of `file`.
    ///
    /// An offset inside a character is that character's; one beyond the end is the end.
    #[must_use]
    pub fn from_byte_offset(file: &Path, text: &str, offset: usize) -> Self {
        let (line, column) = line_and_column(text, offset);
        Self { file: file.to_path_buf(), line, column }
    }
}

impl Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}", self.file.display(), self.line, self.column)
    }
}

/// Line and column, both from 1, of the byte at `offset` in `text`.
fn line_and_column(text: &str, offset: usize) -> (usize, usize) {
    let mut end = offset.min(text.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    let before = &text[..end];
    let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
    let in_line = &before[line_start..];
    let in_line = if line_start == 0 { strip_byte_order_mark(in_line) } else { in_line };
    (before.matches('\n').count() + 1, in_line.chars().count() + 1)
}

/// `text` without the byte order mark that some editors put first.
pub(crate) fn strip_byte_order_mark(text: &str) -> &str {
    text.strip_prefix('\u{feff}').unwrap_or(text)
}

/// A fault in a user's file. It is shown in one line, whatever the user's text in the rule contains; without help
/// and others.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", escape_line(&format!("{}: {}", .place, .rule)))]
pub struct InputFileError {
    /// Where.
    pub place: Location,
    /// The rule that is broken, with the name and the value at fault.
    pub rule: String,
    /// The remedy, a sentence without its full stop, where there is more to say than the rule.
    pub help: Option<String>,
    /// The other faults of the same file, in the order of its lines, fewer than [`MAX_LISTED_ERRORS`]; none
    /// of them has others.
    pub others: Vec<InputFileError>,
    /// How much more is wrong with it than that.
    pub unlisted: usize,
}

/// Faults of a file that are reported with their lines, at most: more than a screen of them is not read.
pub const MAX_LISTED_ERRORS: usize = 20;

impl InputFileError {
    /// `rule` is broken at `place`.
    #[must_use]
    pub fn new(place: Location, rule: impl Into<String>) -> Self {
        Self { place, rule: rule.into(), help: None, others: Vec::new(), unlisted: 0 }
    }

    /// Returns the same, with what to do about it.
    #[must_use]
    pub fn with_help(self, help: impl Into<String>) -> Self {
        Self { help: Some(help.into()), ..self }
    }

    /// Returns all of these as one: the first in the file, with the others; `None` where there are none.
    #[must_use]
    pub fn combine(errors: impl IntoIterator<Item = Self>) -> Option<Self> {
        let mut unlisted = 0;
        let counted = errors.into_iter().inspect(|error| unlisted += error.unlisted);
        let mut errors: Vec<Self> = counted.flat_map(Self::into_single_errors).collect();
        errors.sort_by_key(|error| (error.place.line, error.place.column));
        unlisted += errors.len().saturating_sub(MAX_LISTED_ERRORS);
        let mut errors = errors.into_iter().take(MAX_LISTED_ERRORS);
        let first = errors.next()?;
        Some(Self { others: errors.collect(), unlisted, ..first })
    }

    /// It, and each of the others that are listed, alone.
    pub fn into_single_errors(mut self) -> impl Iterator<Item = Self> {
        let others = std::mem::take(&mut self.others);
        self.unlisted = 0;
        std::iter::once(self).chain(others)
    }
}

/// Where each key of a file stands, so that a value found wrong long after reading has its place.
///
/// Keys are dotted, `spindle.sensor.k0_um`; elements of an array are `machine.tool_direction[0]`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct KeyLocations {
    file: PathBuf,
    line_and_column: BTreeMap<String, (usize, usize)>,
}

impl KeyLocations {
    /// No key is known yet.
    #[must_use]
    pub fn new(file: &Path) -> Self {
        Self { file: file.to_path_buf(), line_and_column: BTreeMap::new() }
    }

    /// Notes that `key` stands at this line and column, both from 1.
    pub(crate) fn insert(&mut self, key: String, line_and_column: (usize, usize)) {
        self.line_and_column.insert(key, line_and_column);
    }

    /// Returns whether `key` stands in the file.
    pub(crate) fn contains(&self, key: &str) -> bool {
        self.line_and_column.contains_key(key)
    }

    /// Returns the place of `key`, else of the nearest section around it, else the start of the file: a
    /// value that came by default has no place of its own.
    #[must_use]
    pub fn locate(&self, key: &str) -> Location {
        let mut around = key;
        loop {
            if let Some(&(line, column)) = self.line_and_column.get(around) {
                return Location { file: self.file.clone(), line, column };
            }
            match around.rfind(['.', '[']) {
                Some(end) => around = &around[..end],
                None => return Location::start_of_file(&self.file),
            }
        }
    }

    /// `key` breaks a rule; `rule` goes on after the key: "must not be 0".
    #[must_use]
    pub fn key_error(&self, key: &str, rule: impl Display) -> InputFileError {
        InputFileError::new(self.locate(key), format!("{key} {rule}"))
    }
}

/// At most 40 characters of a user's text, to quote in a rule.
pub(crate) fn truncate_text(text: &str) -> String {
    const MAX_QUOTED_CHARACTERS: usize = 40;
    match text.char_indices().nth(MAX_QUOTED_CHARACTERS) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_string(),
    }
}

/// Returns the candidate that `wrong` was probably meant to be, as an end of a sentence, or nothing.
pub(crate) fn format_suggestion<'a>(
    wrong: &str,
    candidates: impl IntoIterator<Item = &'a str>,
) -> String {
    // 0.75 finds a forgotten letter or unit and keeps words apart that only share a suffix.
    const MIN_NAME_SIMILARITY: f64 = 0.75;
    candidates
        .into_iter()
        .map(|candidate| (strsim::jaro_winkler(wrong, candidate), candidate))
        .filter(|(likeness, _)| *likeness >= MIN_NAME_SIMILARITY)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map_or_else(String::new, |(_, best)| format!("; did you mean {best}?"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(text: &str, offset: usize) -> (usize, usize) {
        let place = Location::from_byte_offset(Path::new("m.toml"), text, offset);
        (place.line, place.column)
    }

    #[test]
    fn lines_and_columns_start_at_one() {
        assert_eq!(at("", 0), (1, 1));
        assert_eq!(at("ab\ncd", 0), (1, 1));
        assert_eq!(at("ab\ncd", 2), (1, 3));
        assert_eq!(at("ab\ncd", 3), (2, 1));
        assert_eq!(at("ab\r\ncd", 5), (2, 2));
    }

    #[test]
    fn columns_count_characters_not_bytes() {
        assert_eq!(at("µ°x", "µ°".len()), (1, 3));
        assert_eq!(at("µ", 1), (1, 1));
    }

    #[test]
    fn a_byte_order_mark_has_no_column() {
        assert_eq!(at("\u{feff}ab", 3), (1, 1));
        assert_eq!(at("\u{feff}ab", 4), (1, 2));
        assert_eq!(at("\u{feff}ab\ncd", 7), (2, 2));
    }

    #[test]
    fn beyond_the_end_is_the_end() {
        assert_eq!(at("ab\n", 99), (2, 1));
    }

    #[test]
    fn a_complaint_is_one_line_even_if_the_user_wrote_line_breaks() {
        let place = Location { file: "a b.toml".into(), line: 3, column: 7 };
        let bad = InputFileError::new(place, "\"x\ny\r\" is unknown");
        assert_eq!(bad.to_string(), "a b.toml:3:7: \"x\\ny\\r\" is unknown");
    }

    #[test]
    fn a_key_that_is_not_there_has_the_place_of_its_section() {
        let mut places = KeyLocations::new(Path::new("m.toml"));
        places.insert("limits".into(), (2, 2));
        assert_eq!(places.locate("limits.max_um.x").line, 2);
        assert_eq!(places.locate("limits.max_um.x").column, 2);
        assert_eq!(places.locate("spindle.source"), Location::start_of_file(Path::new("m.toml")));
    }

    #[test]
    fn a_suggestion_needs_a_likeness() {
        let known = ["zero_counts", "um_per_count", "k0_um"];
        assert_eq!(format_suggestion("zero_count", known), "; did you mean zero_counts?");
        assert_eq!(format_suggestion("um_per_counts", known), "; did you mean um_per_count?");
        assert_eq!(format_suggestion("colour", known), "");
    }
}
