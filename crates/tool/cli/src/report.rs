//! How errors and warnings are said, on standard error: as cargo does it, `error:`, the place, the line
//! with a caret, and `help:`. In colour where a terminal shows it and `NO_COLOR` does not forbid it; with
//! `--json` each is an object on a line of its own. With `-q` warnings are not said.
//!
//! ```text
//! error: limits.slew_um_per_s must be above 0, not -3
//!   --> m.toml:24:17
//!    |
//! 24 | slew_um_per_s = -3.0
//!    |                 ^^^^
//!    |
//!    = help: …
//! ```

use std::{
    env,
    fmt::Display,
    fs::File,
    io::{BufRead as _, BufReader, Read as _},
    path::Path,
    sync::{
        OnceLock,
        atomic::{AtomicBool, Ordering},
    },
};

use annotate_snippets::{AnnotationKind, Group, Level, Origin, Renderer, Snippet};
use serde_json::json;
use trueup_machine::{BadInput, Location, check::Warning};
use trueup_output::escape::{is_unsafe, one_line};

/// The form and the extent of the messages to the user.
#[derive(Clone, Copy, Debug, Default)]
pub struct Verbosity {
    /// In objects.
    pub json: bool,
    /// Of errors alone.
    pub quiet: bool,
    /// Of more than is usual.
    pub verbose: bool,
}

static MANNER: OnceLock<Verbosity> = OnceLock::new();

/// Sets, once at the start, the form and the extent of the messages.
pub fn set(manner: Verbosity) {
    // A second time cannot be: there is one command line.
    _ = MANNER.set(manner);
}

/// Returns the form and the extent of the messages.
pub fn manner() -> Verbosity {
    MANNER.get().copied().unwrap_or_default()
}

/// Whether warnings about a file are of no use to the user just now.
static NO_DOUBTS: AtomicBool = AtomicBool::new(false);

/// Returns what `command` comes to; what it doubts in its files is said only if it is `of_use`.
pub fn with_warnings<T>(of_use: bool, command: impl FnOnce() -> T) -> T {
    NO_DOUBTS.store(!of_use, Ordering::Relaxed);
    let done = command();
    NO_DOUBTS.store(false, Ordering::Relaxed);
    done
}

/// Each error of a file, and how many there are where there is more than one, or more than are listed.
pub fn bad_input(error: BadInput) {
    let unlisted = error.unlisted;
    let errors: Vec<BadInput> = error.one_by_one().collect();
    for BadInput { place, rule, help, .. } in &errors {
        say(Level::ERROR, rule, Some(place), help.as_deref());
    }
    if unlisted > 0 {
        self::error(format_args!("and {unlisted} more in this file"));
    } else if errors.len() > 1 && !manner().json {
        trueup_output::diagnostic(format_args!("{} errors", errors.len()));
    }
}

/// An error without a line of a file.
pub fn error(text: impl Display) {
    say(Level::ERROR, &text.to_string(), None, None);
}

/// A warning without a line of a file.
pub fn warn(text: impl Display) {
    if !manner().quiet {
        say(Level::WARNING, &text.to_string(), None, None);
    }
}

/// A warning with its line.
pub fn warning(Warning { place, what, help }: &Warning) {
    let help = Some(help.as_str()).filter(|help| !help.is_empty());
    say(Level::WARNING, what, Some(place), help);
}

/// Prints the warnings about `file`, each on one line, and where there is more to read about it.
pub fn in_short(file: &Path, warnings: &[Warning]) {
    if manner().quiet || NO_DOUBTS.load(Ordering::Relaxed) {
        return;
    }
    for Warning { place, what, help } in warnings {
        if manner().json {
            say(Level::WARNING, what, Some(place), Some(help));
        } else {
            let text = one_line(&format!("{place}: {what}"));
            trueup_output::styled(format_args!("{}: {text}", painted("warning")));
        }
    }
    if !warnings.is_empty() && !manner().json {
        trueup_output::diagnostic(format_args!(
            "  `trueup check {}` says what to do about it",
            one_line(&file.to_string_lossy())
        ));
    }
}

/// Prints the remarks on a file that need nothing done, each on one line.
pub fn remarks(remarks: &[Warning]) {
    if manner().quiet || NO_DOUBTS.load(Ordering::Relaxed) {
        return;
    }
    for Warning { place, what, help } in remarks {
        if manner().json {
            trueup_output::diagnostic(object("note", what, Some(place), Some(help)));
        } else {
            trueup_output::diagnostic(one_line(&format!("note: {place}: {what}. {help}")));
        }
    }
}

/// Prints details beyond the result, where the user has asked for them by `-v`.
pub fn in_detail(words: impl FnOnce() -> String) {
    if manner().verbose && !manner().json {
        trueup_output::diagnostic(words());
    }
}

fn say(level: Level<'_>, text: &str, place: Option<&Location>, help: Option<&str>) {
    if manner().json {
        let word = if level == Level::ERROR { "error" } else { "warning" };
        trueup_output::diagnostic(object(word, text, place, help));
        return;
    }
    let text = one_line(text);
    let source = place.and_then(line_at);
    let title = level.primary_title(text.as_str());
    let mut group = Group::with_title(title);
    if let Some(place) = place {
        let path = one_line(&place.file.to_string_lossy());
        group = match source {
            Some((line, span)) => group.element(
                Snippet::source(line)
                    .path(path)
                    .line_start(place.line)
                    .annotation(AnnotationKind::Primary.span(span)),
            ),
            None => group.element(Origin::path(path).line(place.line).char_column(place.column)),
        };
    }
    let help = help.map(one_line);
    if let Some(help) = &help {
        group = group.element(Level::HELP.message(help.as_str()));
    }
    let renderer = if is_coloured() { Renderer::styled() } else { Renderer::plain() };
    trueup_output::styled(renderer.render(&[group]));
}

/// Returns a message as `--json` prints it.
pub fn object(
    level: &str,
    text: &str,
    place: Option<&Location>,
    help: Option<&str>,
) -> serde_json::Value {
    json!({
        "level": level,
        "message": text,
        "file": place.map(|place| place.file.to_string_lossy()),
        "line": place.map(|place| place.line),
        "column": place.map(|place| place.column),
        "help": help,
    })
}

/// Returns whether standard error shows colours, and may.
fn is_coloured() -> bool {
    let is_forbidden = env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    trueup_output::is_error_terminal() && !is_forbidden
}

fn painted(word: &str) -> String {
    if is_coloured() { format!("\u{1b}[1m\u{1b}[33m{word}\u{1b}[0m") } else { word.into() }
}

/// The longest line that is shown, in bytes.
const LONGEST_LINE: u64 = 1 << 16;

/// Returns the line of a place, and the bytes in it that are at fault; `None` where the file is not to be read
/// again: a pipe, a line without an end, bytes that are no text.
fn line_at(place: &Location) -> Option<(String, std::ops::Range<usize>)> {
    if !place.file.metadata().ok()?.is_file() {
        return None;
    }
    let mut file = BufReader::new(File::open(&place.file).ok()?);
    let mut line = Vec::new();
    for _ in 0..place.line {
        line.clear();
        let read = (&mut file).take(LONGEST_LINE).read_until(b'\n', &mut line).ok()?;
        if read as u64 == LONGEST_LINE {
            return None;
        }
    }
    let text = String::from_utf8(line).ok()?;
    let text = text.trim_start_matches('\u{feff}').trim_end_matches(['\n', '\r']);
    // What would move the caret from its place, or the terminal's cursor.
    if text.is_empty() || text.chars().any(is_unsafe) {
        return None;
    }
    let start = text.char_indices().nth(place.column.checked_sub(1)?);
    let start = start.map_or(text.len(), |(start, _)| start);
    let is_table = place.file.extension().is_some_and(|extension| extension == "csv");
    let separator = is_table.then_some(if text.contains(';') { ';' } else { ',' });
    let length = token(&text[start..], separator);
    Some((text.to_string(), start..start + length))
}

/// Returns the length in bytes of the value that `text` begins with: a field of a table with this separator, else
/// a word, a string or what is in brackets.
fn token(text: &str, separator: Option<char>) -> usize {
    let until = |ends: &[char]| text.find(ends).unwrap_or(text.len());
    let length = match text.chars().next() {
        _ if separator.is_some() => until(separator.as_slice()),
        Some(quote @ ('"' | '\'')) => text[1..].find(quote).map_or(text.len(), |end| end + 2),
        Some('[' | '{') => {
            text.split(" #").next().map_or(text.len(), |value| value.trim_end().len())
        }
        _ => until(&[' ', ',', ']', '}', '#', '=']),
    };
    // Nothing to point at is the end of the line.
    length.max(text.chars().next().map_or(0, char::len_utf8))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_caret_is_under_the_value_at_fault() {
        for (text, length) in [
            ("-3.0 # slow", 4),
            ("\"a b\", 2", 5),
            ("[0, 1] # all", 6),
            ("x]", 1),
            ("µm]", 3),
            ("", 0),
        ] {
            assert_eq!(token(text, None), length, "{text}");
        }
        assert_eq!(token("2,5;x", Some(';')), 3);
    }
}
