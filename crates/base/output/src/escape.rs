//! Text from outside (file names, columns, machine files, devices on a line) as it may be shown: what would move a
//! terminal's cursor, colour it, or reorder a line is written out, as `\u{1b}`. Letters of every script stay.

use std::fmt::{self, Display, Write as _};

/// Returns true for a character that is shown escaped: a control character (C0, DEL, C1), a line or paragraph
/// separator, and what changes the direction of a line.
#[must_use]
pub fn needs_escaping(c: char) -> bool {
    c.is_control()
        || matches!(c,
            '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// Returns the text with every unsafe character escaped, line breaks included: for a value inside a line.
#[must_use]
pub fn escape_line(text: &str) -> String {
    EscapedText { text, keep: &[] }.to_string()
}

/// Returns the text with every unsafe character escaped except line breaks and tabs: for a text of several lines.
#[must_use]
pub fn escape_except_line_breaks(text: &str) -> String {
    EscapedText { text, keep: &['\n', '\t'] }.to_string()
}

/// Returns the text as a shell takes it for one word: quoted where it has more than letters, digits and `=_-./:,+`. On
/// Windows the quotation marks are double, which both of its shells take, and a backslash is plain.
///
/// ```
/// use trueup_output::escape::shell_quote;
/// assert_eq!(shell_quote("run.csv"), "run.csv");
/// # #[cfg(unix)]
/// assert_eq!(shell_quote("Messuhr [µm]=µm"), "'Messuhr [µm]=µm'");
/// ```
#[must_use]
pub fn shell_quote(text: &str) -> String {
    shell_quote_for_platform(text, cfg!(windows))
}

fn shell_quote_for_platform(text: &str, is_windows: bool) -> String {
    let plain = if is_windows { r"=_-./:,+\" } else { "=_-./:,+" };
    match !text.is_empty() && text.chars().all(|c| c.is_alphanumeric() || plain.contains(c)) {
        true => text.into(),
        // No name of a file has a double quotation mark there.
        false if is_windows => format!("\"{text}\""),
        false => format!("'{}'", text.replace('\'', "'\\''")),
    }
}

struct EscapedText<'t> {
    text: &'t str,
    keep: &'t [char],
}

impl Display for EscapedText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for c in self.text.chars() {
            match needs_escaping(c) && !self.keep.contains(&c) {
                true => write!(f, "{}", c.escape_default())?,
                false => f.write_char(c)?,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_one_word_in_the_shells_of_both_systems() {
        assert_eq!(shell_quote_for_platform("a b's.csv", false), r"'a b'\''s.csv'");
        assert_eq!(
            shell_quote_for_platform(r"found\extended.toml", false),
            r"'found\extended.toml'"
        );
        assert_eq!(shell_quote_for_platform(r"found\extended.toml", true), r"found\extended.toml");
        assert_eq!(shell_quote_for_platform(r"C:\my runs\r.csv", true), r#""C:\my runs\r.csv""#);
    }

    #[test]
    fn what_moves_a_cursor_or_turns_a_line_is_written_out_and_letters_stay() {
        for (text, shown) in [
            ("a\nb\u{1b}[31m", r"a\nb\u{1b}[31m"),
            ("\u{9b}2J\u{7f}\u{85}", r"\u{9b}2J\u{7f}\u{85}"),
            ("a\u{202e}b\u{2066}c\u{200f}\u{61c}", r"a\u{202e}b\u{2066}c\u{200f}\u{61c}"),
            ("\u{2028}\u{200e}\u{2069}\u{202a}", r"\u{2028}\u{200e}\u{2069}\u{202a}"),
            ("µm äöü 測定 Ω ±\u{200d}", "µm äöü 測定 Ω ±\u{200d}"),
        ] {
            assert_eq!(escape_line(text), shown);
        }
        assert_eq!(escape_except_line_breaks("a\n\tb\r\u{7}"), "a\n\tb\\r\\u{7}");
    }
}
