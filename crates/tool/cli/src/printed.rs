//! Every command that a page, a table of a page or a message of the tool prints is one that the tool takes. That they also do what
//! the page says is for the tests that run them (`tests/cli/printed.rs`, `tests/cli/tutorial.rs`).

use std::{fs, path::Path};

use clap::error::ErrorKind;

use crate::Cli;

/// A printed command, and where it stands.
struct DocumentedCommand {
    place: String,
    line: String,
    /// It stands in a block of its own, to be copied whole; else it may be no more than the name of a command.
    is_whole: bool,
}

/// The files below `folder` with this extension.
fn collect_files(folder: &Path, extension: &str, found: &mut Vec<std::path::PathBuf>) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let is_omitted =
            ["target", "tests", "examples", "book.out"].iter().any(|folder| path.ends_with(folder));
        if path.is_dir() && !is_omitted {
            collect_files(&path, extension, found);
        } else if path.extension().is_some_and(|actual| actual == extension) {
            found.push(path);
        }
    }
}

/// Returns the commands of a page: the lines of its blocks, and what stands between backticks.
fn extract_commands(place: &str, text: &str) -> Vec<DocumentedCommand> {
    let mut all = Vec::new();
    let mut is_code = false;
    let mut before = String::new();
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            is_code = !is_code;
            continue;
        }
        let printed = |line: &str, is_whole| DocumentedCommand {
            place: place.into(),
            line: line.into(),
            is_whole,
        };
        if !is_code {
            all.extend(inline_trueup_commands(line).map(|span| printed(span, false)));
            continue;
        }
        // A line goes on behind a backslash.
        let line = std::mem::take(&mut before) + line.trim();
        if let Some(part) = line.strip_suffix('\\') {
            before = part.into();
            continue;
        }
        let command = line.strip_prefix("$ ").unwrap_or(&line);
        if command.starts_with("trueup ") {
            all.push(printed(command, true));
        }
    }
    all
}

fn inline_trueup_commands(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2).filter(|part| part.starts_with("trueup "))
}

/// Returns the words of a line without the text about it: a comment, a redirection, what follows two spaces.
fn split_command_words(line: &str) -> Vec<String> {
    let line = line.split("  ").next().unwrap_or_default();
    let line = line.split(" #").next().unwrap_or_default();
    let line = line.split(" > ").next().unwrap_or_default();
    line.split_whitespace().map(|word| word.trim_matches('\'').to_owned()).collect()
}

/// Why the tool does not take a command; `None`: it does.
fn rejection_reason(it: &DocumentedCommand) -> Option<String> {
    let mut words = split_command_words(&it.line);
    // Alternatives (`pitch|backlash`): the first. Words that stand for others (`M.toml`, `KIND`) are taken as they are.
    for word in &mut words {
        let first = word.split('|').next().map(str::to_owned);
        *word = first.unwrap_or_default();
    }
    let is_open = words.iter().any(|word| word.contains('…') || word == "...");
    words.retain(|word| !word.contains('…') && word != "...");
    let error = Cli::parse_command_line(&words).err()?;
    let stands_for_others = |word: &String| {
        word.len() > 1
            && word.chars().all(|character| character.is_ascii_uppercase() || character == '_')
    };
    let is_taken = match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => true,
        ErrorKind::MissingRequiredArgument
        | ErrorKind::MissingSubcommand
        | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => !it.is_whole || is_open,
        // An option that is named alone has no value.
        ErrorKind::InvalidValue | ErrorKind::ValueValidation => {
            words.iter().any(stands_for_others)
                || !it.is_whole && error.to_string().contains("value is required")
        }
        ErrorKind::InvalidSubcommand => words.iter().any(stands_for_others),
        _ => false,
    };
    (!is_taken).then(|| error.to_string())
}

#[test]
fn every_command_that_is_printed_is_one_that_the_tool_takes() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let mut pages = Vec::new();
    for folder in ["docs", "integrations", "data"] {
        collect_files(&root.join(folder), "md", &mut pages);
        collect_files(&root.join(folder), "toml", &mut pages);
    }
    pages.push(root.join("README.md"));
    let mut sources = Vec::new();
    collect_files(&root.join("crates"), "rs", &mut sources);
    let read = |path: &Path| fs::read_to_string(path).unwrap_or_default();
    let name = |path: &Path| path.strip_prefix(&root).unwrap_or(path).display().to_string();
    let mut all: Vec<DocumentedCommand> =
        pages.iter().flat_map(|path| extract_commands(&name(path), &read(path))).collect();
    let of_pages = all.len();
    for path in &sources {
        // What stands in the text of a message; a `{}` is filled in when it is printed.
        for line in read(path).lines() {
            let found = inline_trueup_commands(line).filter(|span| !span.contains('{'));
            all.extend(found.map(|line| DocumentedCommand {
                place: name(path),
                line: line.into(),
                is_whole: false,
            }));
        }
    }
    let whole = all.iter().filter(|command| command.is_whole).count();
    assert!(
        of_pages > 150 && whole > 20 && all.len() > of_pages + 20,
        "{of_pages}, {whole}, {}",
        all.len()
    );
    let refused: Vec<String> = all
        .iter()
        .filter_map(|command| {
            Some(format!("{}: {}: {}", command.place, command.line, rejection_reason(command)?))
        })
        .collect();
    assert!(refused.is_empty(), "{}", refused.join("\n"));
}
