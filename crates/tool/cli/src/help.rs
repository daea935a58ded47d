//! Examples for the `--help` of each command, and the short forms of options, each in one place: so that no
//! command is forgotten (a test checks each), and a letter means the same in all of them.

use clap::{Arg, Command};

/// Options that have a short form, whichever command has them. `-q` and `-v` are every command's own.
const SHORT_OPTIONS: &[(&str, char)] = &[
    ("machine", 'm'),
    ("run", 'r'),
    ("port", 'p'),
    ("for", 'f'),
    ("format", 'f'),
    ("out", 'o'),
    ("output", 'o'),
    ("axis", 'a'),
    ("scenario", 's'),
    ("yes", 'y'),
    ("name", 'n'),
    ("kind", 'k'),
    ("travel", 't'),
    ("control", 'c'),
];

/// By the words of a command, what its help ends with: lines that run in a folder of `trueup examples`, in the order of the
/// groups. A command that is not here has its own.
const COMMAND_EXAMPLES: &[(&str, &str)] = &[
    ("compile", "trueup compile mill/mill.toml -o mill.bin"),
    (
        "compare",
        "trueup compare mill/years/2024-11-04-backlash-x.csv mill/years/2025-11-03-backlash-x.csv --limit-um 5 --out comparison",
    ),
    (
        "accept",
        "trueup accept --off mill/warmup-off.csv --on mill/warmup-on.csv --machine mill/mill.toml --require 90 --out acceptance",
    ),
    (
        "diagnose",
        "trueup diagnose --machine mill/mill.toml --run mill/warmup-off.csv --out diagnosis",
    ),
    ("export", "trueup export gantry.toml --format siemens-840d -o tables"),
    (
        "fit",
        "trueup fit backlash --run mill/backlash-x.csv --machine mill/mill.toml -o fitted.toml",
    ),
    (
        "fit straightness",
        "trueup fit straightness --run mill/straightness-x.csv --axis z --machine mill/mill.toml --tolerance-um 2 -o fitted.toml",
    ),
    (
        "fit pitch",
        "trueup fit pitch --run mill/pitch-x.csv --axis x --machine mill/mill.toml -o fitted.toml",
    ),
    (
        "fit backlash",
        "trueup fit backlash --run mill/backlash-x.csv --axis x --machine mill/mill.toml -o fitted.toml",
    ),
    (
        "fit elongation",
        "trueup fit elongation --run mill/warmup-off.csv --machine mill/mill.toml -o fitted.toml",
    ),
    (
        "fit warmup",
        "trueup fit warmup --run mill/warmup-off.csv --machine mill/mill.toml -o fitted.toml",
    ),
    (
        "fit thermal",
        "trueup fit thermal --run mill/axis-heat-x.csv --axis x --machine mill/mill.toml -o fitted.toml",
    ),
    (
        "fit circle",
        "trueup fit circle --run mill/circle-ccw.csv --run mill/circle-cw.csv --machine mill/mill.toml -o fitted.toml --out circle",
    ),
    (
        "fit volume",
        "trueup fit volume --run mill/balls.csv --machine mill/volume.toml -o fitted.toml --instrument-um 1 --scale-um-per-m 1",
    ),
    (
        "fit table1",
        "trueup fit table1 --run mill/straightness-x.csv --run mill/straightness-y.csv --run mill/diagonal-xy.csv --axis z -o table1.html",
    ),
    (
        "fleet submit",
        "trueup fleet submit --dir shop --machine mill/mill.toml --run mill/warmup-off.csv --name M-0007 --date 2026-11-22",
    ),
    ("fleet worker", "trueup fleet worker --dir shop --threads 2 --until-empty"),
    ("fleet status", "trueup fleet status --dir shop"),
    ("fleet diagnose", "trueup fleet diagnose --dir shop --out series"),
    (
        "fleet server",
        "trueup fleet server --dir fleet-server --listen 127.0.0.1:4222 --mqtt 127.0.0.1:1883",
    ),
    ("fleet records", "trueup fleet records --nats nats://127.0.0.1:4222 > records.jsonl"),
    ("linuxcnc", "trueup linuxcnc --port tcp:127.0.0.1:7700 --machine machine.toml"),
    (
        "linuxcnc check",
        "trueup linuxcnc check linuxcnc/trueup_sim.ini --machine linuxcnc/trueup_gantry.toml",
    ),
    (
        "linuxcnc setup",
        "trueup linuxcnc setup machine.ini --by joint --port /dev/ttyUSB0 --machine mill/mill.toml",
    ),
    ("linuxcnc component", "trueup linuxcnc component --install"),
    ("linuxcnc keep", "trueup linuxcnc keep --file trueup_heat.bin"),
    ("linuxcnc status", "trueup linuxcnc status machine.ini"),
    ("show", "trueup show mill.bin > shown.toml"),
    (
        "program",
        "trueup program backlash --machine mill/mill.toml --for siemens --range z=-120:-20 -o measure\n  \
         trueup program circle --machine mill/mill.toml --for fanuc -o measure\n  \
         trueup program plate --machine mill/mill.toml --for linuxcnc --range z=-290:-10 --at x=60,y=60,z=-250 --ball 20 --stylus 6 --step-mm 90 --balls 5x3 -o measure",
    ),
    (
        "sign",
        "trueup sign --new key.pem\n  trueup sign mill.bin --key key.pem\n  trueup sign mill.bin --check key.pub.pem",
    ),
    ("simulate", "trueup simulate --scenario scenario-warmup.toml --seed 1 -o day.csv"),
    ("trend", "trueup trend mill/years --limit-um 2 --out trend"),
    ("firmware", "trueup firmware images"),
    ("examples", "trueup examples examples"),
    ("completions", "trueup completions bash > ~/.local/share/bash-completion/completions/trueup"),
    ("man", "trueup man pages"),
    ("gateway modbus", "trueup gateway modbus --port /dev/ttyUSB0 --listen 0.0.0.0:502"),
    ("gateway s7", "trueup gateway s7 --port /dev/ttyUSB0 --plc 192.168.0.1 --db 100"),
    ("bridge disengage", "trueup bridge disengage --port /dev/ttyUSB0"),
    ("bridge forget-reference", "trueup bridge forget-reference --port /dev/ttyUSB0"),
    ("bridge list", "trueup bridge list"),
    ("bridge info", "trueup bridge info --port /dev/ttyUSB0"),
    ("bridge load", "trueup bridge load mill.bin --port /dev/ttyUSB0"),
    ("bridge update", "trueup bridge update trueup-stm32f405.update --port /dev/ttyUSB0"),
    ("bridge monitor", "trueup bridge monitor --port /dev/ttyUSB0"),
    ("bridge save", "trueup bridge save board.json --port /dev/ttyUSB0"),
    ("bridge pending", "trueup bridge pending --port /dev/ttyUSB0"),
    ("bridge restore", "trueup bridge restore board.json --port /dev/ttyUSB0"),
    (
        "serve",
        "trueup serve --port /dev/ttyUSB0 --name mill-7 --spool spool --mqtt mqtt://127.0.0.1:1883",
    ),
    ("learn", "trueup learn --machine mill/mill.toml --run mill/warmup-off.csv -o learned.toml"),
    (
        "trust",
        "trueup trust --machine mill/mill.toml --calibrated mill/warmup-off.csv --run mill/warmup-on.csv",
    ),
    (
        "commission",
        "trueup commission --machine mill/mill.toml --port /dev/ttyUSB0 --for siemens --rpm 6000 --out commissioning",
    ),
];

/// Returns the lines that are examples.
#[cfg(test)]
pub fn lines() -> impl Iterator<Item = &'static str> {
    COMMAND_EXAMPLES.iter().flat_map(|(_, lines)| lines.lines().map(str::trim))
}

/// The commands by what they are for, in the order of the work.
const COMMAND_GROUPS: &[(&str, &[&str])] = &[
    ("Measure", &["new", "program", "import", "check", "simulate"]),
    ("Understand", &["fit", "diagnose", "predict", "compare"]),
    (
        "Correct",
        &[
            "commission",
            "compile",
            "show",
            "bridge",
            "accept",
            "export",
            "gateway",
            "linuxcnc",
            "virtual",
        ],
    ),
    ("Watch", &["learn", "trust", "trend", "serve"]),
    ("This tool", &["doctor", "examples", "schema", "firmware", "sign", "completions", "man"]),
];
/// The heading of a command that is in no group.
const OTHER_GROUP_HEADING: &str = "More";

/// Returns the tool with its examples and short forms, its commands in groups.
pub fn with_extended_help(tool: Command) -> Command {
    let tool = with_examples_and_shorts(tool, "");
    let groups = grouped_commands_text(&tool);
    tool.help_template(format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{groups}Options of every command:\n{{options}}{{after-help}}\n"
    ))
}

/// Returns the commands with their first sentence, by groups.
fn grouped_commands_text(tool: &Command) -> String {
    let line = |command: &Command| {
        let about = command.get_about().map(ToString::to_string).unwrap_or_default();
        let about = about.lines().next().unwrap_or_default();
        let about = about.split(". ").next().unwrap_or_default().trim_end_matches('.');
        format!("  {:<12} {about}\n", command.get_name())
    };
    let is_grouped = |name: &str| COMMAND_GROUPS.iter().any(|(_, names)| names.contains(&name));
    let mut text = String::new();
    for (group, names) in COMMAND_GROUPS {
        let there = names.iter().filter_map(|name| tool.find_subcommand(name));
        text += &format!("{group}:\n{}\n", there.map(line).collect::<String>());
    }
    let others = tool.get_subcommands().filter(|subcommand| !is_grouped(subcommand.get_name()));
    let others: String = others.map(line).collect();
    if !others.is_empty() {
        text += &format!("{OTHER_GROUP_HEADING}:\n{others}\n");
    }
    text
}

fn with_examples_and_shorts(command: Command, path: &str) -> Command {
    let shorts: Vec<_> = command
        .get_arguments()
        .filter_map(|argument| find_short_option(&command, argument))
        .collect();
    let command = command.mut_args(|option| with_short_option(option, &shorts));
    let example = COMMAND_EXAMPLES.iter().find(|(name, _)| *name == path);
    let command = match example {
        Some((_, line)) if command.get_after_help().is_none() => {
            command.after_help(format!("Example:\n  {line}"))
        }
        _ => command,
    };
    command.mut_subcommands(|inner| {
        let path = format!("{path} {}", inner.get_name());
        with_examples_and_shorts(inner, path.trim_start())
    })
}

/// Returns the name and the letter of an option; a folder next to a file of its own has none.
fn find_short_option(command: &Command, option: &Arg) -> Option<&'static (&'static str, char)> {
    let has =
        |name: &str| command.get_arguments().any(|argument| argument.get_long() == Some(name));
    let long = option.get_long()?;
    SHORT_OPTIONS.iter().find(|(name, _)| *name == long && !(long == "out" && has("output")))
}

fn with_short_option(option: Arg, shorts: &[&(&str, char)]) -> Arg {
    let short = shorts.iter().find(|(long, _)| option.get_long() == Some(*long));
    match short {
        Some((_, letter)) if option.get_short().is_none() => option.short(*letter),
        _ => option,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Cli;
    use clap::CommandFactory as _;

    /// Every command that has an option of the table, by its path.
    fn each(command: &Command, path: &str, with: &mut dyn FnMut(&Command, &str, &Arg)) {
        command.get_arguments().for_each(|option| with(command, path, option));
        for inner in command.get_subcommands() {
            each(inner, &format!("{path} {}", inner.get_name()), with);
        }
    }

    #[test]
    fn every_command_is_in_a_group_of_the_help() {
        let tool = with_extended_help(Cli::command());
        let help = tool.clone().render_help().to_string();
        for command in tool.get_subcommands() {
            let name = command.get_name();
            assert!(help.contains(&format!("\n  {name:<12} ")), "{name}: {help}");
        }
        let places: Vec<Option<usize>> =
            COMMAND_GROUPS.iter().map(|(group, _)| help.find(&format!("\n{group}:"))).collect();
        assert!(places.iter().all(Option::is_some) && places.is_sorted(), "{help}");
        assert!(help.contains("Options of every command:"), "{help}");
    }

    #[test]
    fn a_letter_means_the_same_in_every_command() {
        let tool = with_extended_help(Cli::command());
        // No letter stands twice in a command.
        tool.clone().debug_assert();
        let mut counted = 0;
        each(&tool, "", &mut |command, path, option| {
            let Some(long) = option.get_long() else { return };
            let requested = find_short_option(command, option).map(|(_, letter)| *letter);
            if let Some(letter) = option.get_short() {
                let is_global = ["quiet", "verbose", "help", "version"].contains(&long);
                assert!(is_global || Some(letter) == requested, "{path} -{letter} is --{long}");
            }
            assert!(requested.is_none() || option.get_short() == requested, "{path} --{long}");
            counted += usize::from(requested.is_some());
        });
        assert!(counted > 40, "{counted}");
    }
}
