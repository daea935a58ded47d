//! The machine file on a command line: behind `--machine` or as a word of its own, in every command that reads one.
//!
//! `compile` and `export` declare both forms ([`MachineArg`]). In the other commands, some of which have words of their own
//! (`program backlash`), a word that ends with `.toml` is the machine file ([`with_machine_option`]).

use std::{
    ffi::OsString,
    path::{Path, PathBuf},
};

use clap::{Arg, ArgAction, Args, Command};

#[derive(Args)]
#[group(required = true, multiple = false)]
pub struct MachineArg {
    /// The machine file.
    #[arg(value_name = "M.toml")]
    file: Option<PathBuf>,
    /// The same, as other commands take it.
    #[arg(long, value_name = "M.toml")]
    machine: Option<PathBuf>,
}

impl MachineArg {
    /// Where it is.
    pub fn path(&self) -> &Path {
        let given = self.file.as_deref().or(self.machine.as_deref());
        given.expect("the group of the two is required")
    }
}

/// Returns the words of a command line with `--machine` before the machine file. This holds where
/// the command has that option and the line does not give it.
pub fn with_machine_option(tool: &Command, words: Vec<OsString>) -> Vec<OsString> {
    let mut command = tool;
    let (mut file, mut others) = (None, 0);
    let mut takes_value = false;
    for (at, word) in words.iter().enumerate().skip(1) {
        let text = word.to_string_lossy();
        if takes_value {
            takes_value = false;
        } else if text == "--" {
            break;
        } else if text.starts_with('-') && text.len() > 1 {
            if is_machine_option(&text) {
                return words;
            }
            takes_value = !text.contains('=') && expects_value(tool, command, &text);
        } else if let Some(inner) = command.find_subcommand(text.as_ref()) {
            command = inner;
        } else if text.ends_with(".toml") && file.is_none() {
            file = Some(at);
        } else {
            others += 1;
        }
    }
    let has = |name: &str| command.get_arguments().any(|argument| argument.get_id() == name);
    let mut positionals = command.get_positionals();
    let is_declared = positionals.any(|argument| {
        let names = argument.get_value_names().unwrap_or_default();
        names.iter().any(|name| name == "M.toml")
            || matches!(argument.get_action(), ArgAction::Append)
    });
    match file {
        Some(at)
            if has("machine") && !is_declared && others >= required_file_args(command).count() =>
        {
            let mut words = words;
            words.insert(at, "--machine".into());
            words
        }
        _ => words,
    }
}

/// Returns the files that a command requires as words of its own: `import FILE`.
fn required_file_args(command: &Command) -> impl Iterator<Item = &Arg> {
    let positionals = command.get_positionals();
    positionals
        .filter(|argument| argument.is_required_set() && argument.get_possible_values().is_empty())
}

fn is_machine_option(option: &str) -> bool {
    option == "--machine" || option.starts_with("--machine=") || option.starts_with("-m")
}

/// Returns true if the word after an option is its value: after `-o` and `-qo`, not after `-oOUT`.
fn expects_value(tool: &Command, command: &Command, option: &str) -> bool {
    let takes_value = |is_named: &dyn Fn(&Arg) -> bool| {
        let mut all = command.get_arguments().chain(tool.get_arguments());
        all.find(|argument| is_named(argument))
            .is_some_and(|argument| argument.get_action().takes_values())
    };
    if let Some(long) = option.strip_prefix("--") {
        return takes_value(&|argument| argument.get_long() == Some(long));
    }
    let letters = &option[1..];
    let first = letters
        .char_indices()
        .find(|(_, letter)| takes_value(&|argument| argument.get_short() == Some(*letter)));
    first.is_some_and(|(at, letter)| at + letter.len_utf8() == letters.len())
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;
    use crate::{Cli, help};

    /// Every command that has `--machine`, by its words.
    fn with_machine(command: &Command, path: &str, all: &mut Vec<String>) {
        let files = required_file_args(command).map(|_| " x.csv").collect::<String>();
        if command.get_arguments().any(|argument| argument.get_long() == Some("machine")) {
            all.push(path.trim_start().to_owned() + &files);
        }
        for inner in command.get_subcommands() {
            with_machine(inner, &format!("{path} {}", inner.get_name()), all);
        }
    }

    fn words(line: &str) -> Vec<OsString> {
        line.split(' ').map(Into::into).collect()
    }

    #[test]
    fn every_command_takes_the_machine_file_with_and_without_its_option() {
        let tool = help::with_extended_help(Cli::command());
        let mut commands = Vec::new();
        with_machine(&tool, "", &mut commands);
        assert!(commands.len() > 20, "{commands:?}");
        for command in commands {
            let read = |line: String| {
                let error =
                    Cli::parse_command_line(words(&line)).err().map(|error| error.to_string());
                // What else a command requires is not on these lines.
                let error = error.unwrap_or_default();
                assert!(
                    !error.contains("unexpected argument") && !error.contains("invalid value"),
                    "{line}: {error}"
                );
                error.split("Usage").next().unwrap_or_default().to_owned()
            };
            assert_eq!(
                read(format!("trueup {command} m.toml")),
                read(format!("trueup {command} --machine m.toml")),
                "{command}"
            );
        }
    }

    #[test]
    fn only_a_free_word_becomes_the_machine_file() {
        let tool = help::with_extended_help(Cli::command());
        for (line, expected) in [
            ("trueup program m.toml pitch", "trueup program --machine m.toml pitch"),
            (
                "trueup fit warmup -o out.toml m.toml",
                "trueup fit warmup -o out.toml --machine m.toml",
            ),
            ("trueup fit warmup -qo out.toml", "trueup fit warmup -qo out.toml"),
            (
                "trueup fit warmup -oout.toml m.toml",
                "trueup fit warmup -oout.toml --machine m.toml",
            ),
            (
                "trueup --accept x.toml learn m.toml",
                "trueup --accept x.toml learn --machine m.toml",
            ),
            ("trueup learn -m a.toml b.toml", "trueup learn -m a.toml b.toml"),
            ("trueup import t.csv m.toml", "trueup import t.csv --machine m.toml"),
            ("trueup import m.toml", "trueup import m.toml"),
            ("trueup compare a.csv b.csv m.toml", "trueup compare a.csv b.csv --machine m.toml"),
            ("trueup compare m.toml b.csv", "trueup compare m.toml b.csv"),
            ("trueup check a.toml b.toml", "trueup check a.toml b.toml"),
            ("trueup compile m.toml -o m.bin", "trueup compile m.toml -o m.bin"),
            ("trueup simulate --scenario s.toml", "trueup simulate --scenario s.toml"),
            ("trueup simulate s.toml", "trueup simulate s.toml"),
        ] {
            assert_eq!(with_machine_option(&tool, words(line)), words(expected), "{line}");
        }
    }
}
