//! A section that is to be written: its name, its keys in their order, and the comments next to them.

/// A section to be written.
#[derive(Clone, Debug, PartialEq)]
pub struct NewSection {
    /// Its dotted name: `axis.x.pitch`.
    name: String,
    /// Lines of comment above it where it is new.
    remarks: Vec<String>,
    /// Its keys in their order.
    entries: Vec<Entry>,
    /// Keys of the user's that stay.
    retained_keys: &'static [&'static str],
}

/// A key with its value.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Entry {
    pub(crate) key: String,
    pub(crate) value: Value,
    /// A comment next to it.
    pub(crate) note: Option<String>,
}

/// The value of a key.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A finite number.
    Number(f64),
    /// A whole number, written without a point.
    Whole(u32),
    /// `true` or `false`.
    Boolean(bool),
    /// A string of any characters.
    Text(String),
    /// An array of finite numbers.
    Numbers(Vec<f64>),
    /// An array of whole numbers.
    Wholes(Vec<u32>),
    /// An array of strings.
    Texts(Vec<String>),
    /// An array of rows of three finite numbers.
    Rows(Vec<[f64; 3]>),
    /// A table of keys and values on one line.
    Inline(Vec<(String, Value)>),
}

impl NewSection {
    /// Returns the section with the dotted name `name`, without keys yet.
    #[must_use]
    pub fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), remarks: Vec::new(), entries: Vec::new(), retained_keys: &[] }
    }

    /// With `key` = `value`.
    #[must_use]
    pub fn with_number(self, key: impl Into<String>, value: f64) -> Self {
        self.with_value(key, Value::Number(value))
    }

    /// With `key` = `value`, a whole number.
    #[must_use]
    pub fn with_integer(self, key: impl Into<String>, value: u32) -> Self {
        self.with_value(key, Value::Whole(value))
    }

    /// With `key` = `text`.
    #[must_use]
    pub fn with_text(self, key: impl Into<String>, text: impl Into<String>) -> Self {
        self.with_value(key, Value::Text(text.into()))
    }

    /// With `key` = an array of `values`.
    #[must_use]
    pub fn with_numbers(self, key: impl Into<String>, values: impl Into<Vec<f64>>) -> Self {
        self.with_value(key, Value::Numbers(values.into()))
    }

    /// With `key` = an array of `rows`.
    #[must_use]
    pub fn with_rows(self, key: impl Into<String>, rows: impl Into<Vec<[f64; 3]>>) -> Self {
        self.with_value(key, Value::Rows(rows.into()))
    }

    /// With `key` = `value`.
    #[must_use]
    pub(crate) fn with_value(mut self, key: impl Into<String>, value: Value) -> Self {
        self.entries.push(Entry { key: key.into(), value, note: None });
        self
    }

    /// With a line of comment above it. In a user's file that has the section already the user's
    /// own comments stand, and this one is not written.
    #[must_use]
    pub fn with_header_comment(mut self, line: impl Into<String>) -> Self {
        self.remarks.push(replace_line_breaks(line.into()));
        self
    }

    /// With a comment next to `key`, which it has. Next to a key of the user's it is not written.
    #[must_use]
    pub(crate) fn with_key_comment(mut self, key: &str, note: impl Into<String>) -> Self {
        let note = replace_line_breaks(note.into());
        if let Some(entry) = self.entries.iter_mut().find(|entry| entry.key == key) {
            entry.note = Some(note);
        }
        self
    }

    /// Keys that the fit does not determine, which stay if the user has written them. All other
    /// keys that are not written here are taken away: they belong to what is replaced.
    #[must_use]
    pub fn with_preserved_keys(mut self, keys: &'static [&'static str]) -> Self {
        self.retained_keys = keys;
        self
    }

    /// Without these keys.
    pub(crate) fn without_keys(mut self, keys: &[&str]) -> Self {
        self.entries.retain(|entry| !keys.contains(&entry.key.as_str()));
        self
    }

    /// With `key`, where it is there, behind all others.
    pub(crate) fn with_key_last(mut self, key: &str) -> Self {
        self.entries.sort_by_key(|entry| entry.key == key);
        self
    }

    /// Gives the section another dotted name.
    pub fn rename(&mut self, name: impl Into<String>) {
        self.name = name.into();
    }

    /// Its dotted name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the number `key`, if it is one of its own.
    #[must_use]
    pub fn number(&self, key: &str) -> Option<f64> {
        match self.value(key) {
            Some(Value::Number(number)) => Some(*number),
            _ => None,
        }
    }

    /// Returns whether it has no key.
    pub(crate) fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Its keys with their values, in their order.
    pub(crate) fn key_values(&self) -> impl Iterator<Item = (&str, &Value)> {
        self.entries.iter().map(|entry| (entry.key.as_str(), &entry.value))
    }

    /// Returns the value of `key`, if it is one of its own.
    pub(crate) fn value(&self, key: &str) -> Option<&Value> {
        self.entries.iter().find(|entry| entry.key == key).map(|entry| &entry.value)
    }

    pub(crate) fn is_preserved(&self, key: &str) -> bool {
        self.retained_keys.contains(&key)
    }

    pub(crate) fn header_comments(&self) -> &[String] {
        &self.remarks
    }

    pub(crate) fn entries(&self) -> &[Entry] {
        &self.entries
    }
}

/// Returns a line break would end a comment.
fn replace_line_breaks(comment: String) -> String {
    comment.replace(['\n', '\r'], " ")
}

/// `value` to this many digits after the point; 0 is never negative.
#[must_use]
pub fn round_to_decimals(value: f64, decimals: i32) -> f64 {
    let scale = 10_f64.powi(decimals);
    let rounded = (value * scale).round() / scale;
    // Beyond the range of exact integers, and for the infinite, rounding says nothing.
    if rounded.is_finite() { rounded + 0.0 } else { value }
}
