//! A line of a run file split into its fields, each with the column in which it begins.
//!
//! The `csv` crate does not report in which column of its line a field begins, and its line numbers
//! lag behind after CRLF and empty lines.

use std::borrow::Cow;

/// Returns the separator of a file by its header: the more frequent of `,` and `;`.
pub(super) fn detect_separator(header: &str) -> char {
    let mut quoted = false;
    let (mut commas, mut semicolons) = (0, 0);
    for c in header.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' if !quoted => commas += 1,
            ';' if !quoted => semicolons += 1,
            _ => {}
        }
    }
    if semicolons > commas { ';' } else { ',' }
}

/// Returns the separator that a line `sep=;` before the header states, as Excel writes it.
pub(super) fn parse_separator_line(line: &str) -> Option<char> {
    let stated = line.trim_start_matches('\u{feff}').trim().trim_matches('"');
    match stated.strip_prefix("sep=")?.chars().collect::<Vec<char>>()[..] {
        [separator @ (',' | ';')] => Some(separator),
        _ => None,
    }
}

/// One field of a line.
pub(super) struct Field<'l> {
    /// Without quotes.
    pub(super) text: Cow<'l, str>,
    /// Where its first character other than a blank stands, from 1.
    pub(super) column: usize,
}

/// A quoted field that does not end as it must.
pub(super) struct QuoteError {
    /// In which column it begins, from 1.
    pub(super) column: usize,
    pub(super) rule: &'static str,
}

/// The fields of a line, in order; after an error there are no more.
pub(super) struct Fields<'l> {
    /// The part that is not yet split; `None` after the last field.
    rest: Option<&'l str>,
    separator: char,
    /// The column at which `rest` begins, from 1.
    column: usize,
}

impl<'l> Fields<'l> {
    pub(super) fn new(line: &'l str, separator: char) -> Self {
        Self { rest: Some(line), separator, column: 1 }
    }

    /// `length` bytes of `rest` are this field's; the separator after them, if any, is passed over.
    fn take_field(&mut self, rest: &'l str, length: usize) -> &'l str {
        let (field, after) = rest.split_at(length);
        self.rest = after.strip_prefix(self.separator);
        self.column += field.chars().count() + 1;
        field
    }
}

impl<'l> Iterator for Fields<'l> {
    type Item = Result<Field<'l>, QuoteError>;

    fn next(&mut self) -> Option<Self::Item> {
        let rest = self.rest.take()?;
        let content = rest.trim_start_matches(' ');
        let blanks = rest.len() - content.len();
        let column = self.column + blanks;
        let Some(quoted) = content.strip_prefix('"') else {
            let length = rest.find(self.separator).unwrap_or(rest.len());
            // A field of blanks alone has no content to point at.
            let column = if blanks < length { column } else { self.column };
            let text = Cow::Borrowed(self.take_field(rest, length).trim());
            return Some(Ok(Field { text, column }));
        };
        let Some(end) = find_closing_quote(quoted) else {
            return Some(Err(QuoteError {
                column,
                rule: "a quoted field must end on its own line",
            }));
        };
        let text = &quoted[..end];
        let after = blanks + 1 + end + 1;
        let length = rest[after..].find(self.separator).map_or(rest.len(), |at| after + at);
        if !rest[after..length].trim().is_empty() {
            let column = self.column + rest[..after].chars().count();
            let rule = "a quoted field must be followed by a separator or the end of the line";
            return Some(Err(QuoteError { column, rule }));
        }
        self.take_field(rest, length);
        let text =
            if text.contains('"') { Cow::Owned(text.replace("\"\"", "\"")) } else { text.into() };
        Some(Ok(Field { text, column }))
    }
}

/// Where the quote stands that ends a field whose opening quote is already passed; a doubled quote
/// is a quote of the text.
fn find_closing_quote(text: &str) -> Option<usize> {
    let mut from = 0;
    loop {
        let at = from + text[from..].find('"')?;
        if !text[at + 1..].starts_with('"') {
            return Some(at);
        }
        from = at + 2;
    }
}
