//! Every command of this program that a document, the build server or a workflow names is one that it understands: otherwise a
//! reader types it and gets an error.

use std::{fs, path::PathBuf};

use clap::{CommandFactory as _, Parser as _, error::ErrorKind};
use trueup_emulator::{process, setup};

use super::Cli;

/// A command ends at the first of these: the end of a code span, a comment, a variable, a line that goes on, a pipe.
const ENDS: [char; 10] = ['`', '"', '#', '$', '\\', '|', '&', ';', '…', '\n'];

/// Returns the text files that name commands, with their paths below the project's root.
fn documents() -> Vec<(String, String)> {
    let root = setup::project_root();
    let mut git = std::process::Command::new("git");
    git.args(["ls-files", "*.md", "*.yml", ".ci/run"]).current_dir(&root);
    let listed = process::capture_stdout(&mut git).unwrap();
    // The changelog names commands of the past too.
    let current = listed.lines().filter(|path| *path != "CHANGELOG.md");
    current
        .map(|path| (path.to_owned(), fs::read_to_string(root.join(PathBuf::from(path))).unwrap()))
        .collect()
}

/// Returns the aliases of cargo that are commands of this program, `xtask` itself among them.
fn cargo_aliases() -> Vec<String> {
    let config = fs::read_to_string(setup::project_root().join(".cargo/config.toml")).unwrap();
    let ours = config.lines().filter(|line| line.contains("--bin xtask --"));
    ours.filter_map(|line| Some(line.split_once(" = ")?.0.to_owned())).collect()
}

/// Returns the words of each command of this program in `text`, as typed behind `cargo xtask`. What is in brackets may be
/// left out, so it is one more word; a letter N stands for a number.
fn commands(text: &str, aliases: &[String]) -> Vec<Vec<String>> {
    let mut commands = Vec::new();
    for (place, cargo) in text.match_indices("cargo ") {
        let before = text[..place].chars().next_back().unwrap_or('\n');
        let rest = text[place + cargo.len()..].split(ENDS).next().unwrap_or_default();
        let rest = rest.replace(['[', ']'], "");
        let words: Vec<String> = rest
            .split_whitespace()
            .filter(|word| *word != "--")
            .map(|word| if word == "N" { "1".into() } else { word.into() })
            .collect();
        let is_ours = words.first().is_some_and(|word| aliases.contains(word));
        if is_ours && matches!(before, '`' | '\n' | ' ') {
            commands.push(words.into_iter().filter(|word| word != "xtask").collect());
        }
    }
    commands
}

#[test]
fn every_command_in_a_document_is_understood() {
    let (mut seen, aliases) = (0, cargo_aliases());
    for (path, text) in documents() {
        for words in commands(&text, &aliases) {
            // `cargo xtask` alone: the list of commands.
            if words.is_empty() {
                continue;
            }
            let typed = ["cargo xtask".to_owned()].into_iter().chain(words.clone());
            if let Err(error) = Cli::try_parse_from(typed) {
                // A sentence may name a command without what it needs.
                let is_name =
                    words.len() == 1 && error.kind() == ErrorKind::MissingRequiredArgument;
                assert!(is_name, "{path}: cargo xtask {}: {error}", words.join(" "));
            }
            seen += 1;
        }
    }
    assert!(seen > 60, "{seen} commands in all documents");
}

#[test]
fn words_of_a_command_end_where_a_reader_sees_its_end() {
    let text = "`cargo xtask volumes [--volumes 100]`, then\ncargo demo -- --seed N  # another\n`cargo build`, supercargo xtask x";
    let expected: [&[&str]; 2] = [&["volumes", "--volumes", "100"], &["demo", "--seed", "1"]];
    assert_eq!(commands(text, &cargo_aliases()), expected);
}

#[test]
fn options_of_the_commands_do_not_contradict() {
    Cli::command().debug_assert();
}
