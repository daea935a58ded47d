//! How errors and warnings are printed, on standard error: as cargo does it, `error:`, the place, the line
//! with a caret, and `help:`. In colour where a terminal shows it and `NO_COLOR` does not forbid it; with
//! `--json` each is an object on a line of its own. With `-q` warnings are not printed.
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
use trueup_machine::{InputFileError, Location, check::Warning};
use trueup_output::escape::{escape_line, needs_escaping};

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

static VERBOSITY: OnceLock<Verbosity> = OnceLock::new();

/// Sets, once at the start, the form and the extent of the messages.
pub fn set_verbosity(verbosity: Verbosity) {
    // A second time cannot be: there is one command line.
    _ = VERBOSITY.set(verbosity);
}

/// Returns the form and the extent of the messages.
pub fn verbosity() -> Verbosity {
    VERBOSITY.get().copied().unwrap_or_default()
}

/// Whether warnings about a file are of no use to the user just now.
static ARE_WARNINGS_SUPPRESSED: AtomicBool = AtomicBool::new(false);

/// Returns what `command` comes to; warnings about its files are printed only if it is `of_use`.
pub fn with_warnings_enabled<T>(of_use: bool, command: impl FnOnce() -> T) -> T {
    ARE_WARNINGS_SUPPRESSED.store(!of_use, Ordering::Relaxed);
    let done = command();
    ARE_WARNINGS_SUPPRESSED.store(false, Ordering::Relaxed);
    done
}

/// Each error of a file, and how many there are where there is more than one, or more than are listed.
pub fn print_input_file_error(error: InputFileError) {
    let unlisted = error.unlisted;
    let errors: Vec<InputFileError> = error.into_single_errors().collect();
    for InputFileError { place, rule, help, .. } in &errors {
        print_message(Level::ERROR, rule, Some(place), help.as_deref());
    }
    if unlisted > 0 {
        self::print_error(format_args!("and {unlisted} more in this file"));
    } else if errors.len() > 1 && !verbosity().json {
        trueup_output::write_diagnostic(format_args!("{} errors", errors.len()));
    }
}

/// An error without a line of a file.
pub fn print_error(text: impl Display) {
    print_message(Level::ERROR, &text.to_string(), None, None);
}

/// A warning without a line of a file.
pub fn print_warning(text: impl Display) {
    if !verbosity().quiet {
        print_message(Level::WARNING, &text.to_string(), None, None);
    }
}

/// A warning with its line.
pub fn print_located_warning(Warning { place, what, help }: &Warning) {
    let help = Some(help.as_str()).filter(|help| !help.is_empty());
    print_message(Level::WARNING, what, Some(place), help);
}

/// Prints the warnings about `file`, each on one line, and where there is more to read about it.
pub fn print_brief_warnings(file: &Path, warnings: &[Warning]) {
    if verbosity().quiet || ARE_WARNINGS_SUPPRESSED.load(Ordering::Relaxed) {
        return;
    }
    for Warning { place, what, help } in warnings {
        if verbosity().json {
            print_message(Level::WARNING, what, Some(place), Some(help));
        } else {
            let text = escape_line(&format!("{place}: {what}"));
            trueup_output::write_styled_diagnostic(format_args!(
                "{}: {text}",
                highlight("warning")
            ));
        }
    }
    if !warnings.is_empty() && !verbosity().json {
        trueup_output::write_diagnostic(format_args!(
            "  `trueup check {}` says what to do about it",
            escape_line(&file.to_string_lossy())
        ));
    }
}

/// Prints the remarks on a file that need nothing done, each on one line.
pub fn print_remarks(remarks: &[Warning]) {
    if verbosity().quiet || ARE_WARNINGS_SUPPRESSED.load(Ordering::Relaxed) {
        return;
    }
    for Warning { place, what, help } in remarks {
        if verbosity().json {
            trueup_output::write_diagnostic(message_json("note", what, Some(place), Some(help)));
        } else {
            trueup_output::write_diagnostic(escape_line(&format!("note: {place}: {what}. {help}")));
        }
    }
}

/// Prints details beyond the result, where the user has requested them by `-v`.
pub fn print_details(words: impl FnOnce() -> String) {
    if verbosity().verbose && !verbosity().json {
        trueup_output::write_diagnostic(words());
    }
}

fn print_message(level: Level<'_>, text: &str, place: Option<&Location>, help: Option<&str>) {
    if verbosity().json {
        let word = if level == Level::ERROR { "error" } else { "warning" };
        trueup_output::write_diagnostic(message_json(word, text, place, help));
        return;
    }
    let text = escape_line(text);
    let source = place.and_then(read_source_line);
    let title = level.primary_title(text.as_str());
    let mut group = Group::with_title(title);
    if let Some(place) = place {
        let path = escape_line(&place.file.to_string_lossy());
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
    let help = help.map(escape_line);
    if let Some(help) = &help {
        group = group.element(Level::HELP.message(help.as_str()));
    }
    let renderer = if is_colour_enabled() { Renderer::styled() } else { Renderer::plain() };
    trueup_output::write_styled_diagnostic(renderer.render(&[group]));
}

/// Returns a message as `--json` prints it.
pub fn message_json(
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
fn is_colour_enabled() -> bool {
    let is_forbidden = env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    trueup_output::is_stderr_terminal() && !is_forbidden
}

fn highlight(word: &str) -> String {
    if is_colour_enabled() { format!("\u{1b}[1m\u{1b}[33m{word}\u{1b}[0m") } else { word.into() }
}

/// The longest line that is shown, in bytes.
const MAX_LINE_BYTES: u64 = 1 << 16;

/// Returns the line of a place, and the bytes in it that are at fault; `None` where the file is not to be read
/// again: a pipe, a line without an end, bytes that are no text.
fn read_source_line(place: &Location) -> Option<(String, std::ops::Range<usize>)> {
    if !place.file.metadata().ok()?.is_file() {
        return None;
    }
    let mut file = BufReader::new(File::open(&place.file).ok()?);
    let mut line = Vec::new();
    for _ in 0..place.line {
        line.clear();
        let read = (&mut file).take(MAX_LINE_BYTES).read_until(b'\n', &mut line).ok()?;
        if read as u64 == MAX_LINE_BYTES {
            return None;
        }
    }
    let text = String::from_utf8(line).ok()?;
    let text = text.trim_start_matches('\u{feff}').trim_end_matches(['\n', '\r']);
    // What would move the caret from its place, or the terminal's cursor.
    if text.is_empty() || text.chars().any(needs_escaping) {
        return None;
    }
    let start = text.char_indices().nth(place.column.checked_sub(1)?);
    let start = start.map_or(text.len(), |(start, _)| start);
    let is_table = place.file.extension().is_some_and(|extension| extension == "csv");
    let separator = is_table.then_some(if text.contains(';') { ';' } else { ',' });
    let length = token_length(&text[start..], separator);
    Some((text.to_string(), start..start + length))
}

/// Returns the length in bytes of the value that `text` begins with: a field of a table with this separator, else
/// a word, a string or what is in brackets.
fn token_length(text: &str, separator: Option<char>) -> usize {
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
            assert_eq!(token_length(text, None), length, "{text}");
        }
        assert_eq!(token_length("2,5;x", Some(';')), 3);
    }
}
