//! Examples for the `--help` of each command, in one place, so that none is forgotten (a test asks each).

use clap::Command;

/// By the words of a command, what its help ends with. A command that is not here has its own.
const EXAMPLES: &[(&str, &str)] = &[
    ("compile", "trueup compile machine.toml -o machine.bin"),
    ("compare", "trueup compare before.csv after.csv --limit-um 5 --out comparison"),
    (
        "accept",
        "trueup accept --off off.csv --on on.csv --machine machine.toml --require 90 --out acceptance",
    ),
    (
        "diagnose",
        "trueup diagnose --machine machine.toml --run monday.csv --run tuesday.csv --out diagnosis",
    ),
    ("export", "trueup export machine.toml --format siemens-840d -o tables"),
    ("fit", "trueup fit backlash --run measured.csv --machine machine.toml -o fitted.toml"),
    (
        "fit straightness",
        "trueup fit straightness --run measured.csv --machine machine.toml --tolerance-um 9 -o fitted.toml",
    ),
    (
        "fit pitch",
        "trueup fit pitch --run measured.csv --machine machine.toml --quantity dx -o fitted.toml",
    ),
    (
        "fit backlash",
        "trueup fit backlash --run measured.csv --machine machine.toml -o fitted.toml",
    ),
    (
        "fit elongation",
        "trueup fit elongation --run measured.csv --machine machine.toml -o fitted.toml",
    ),
    ("fit warmup", "trueup fit warmup --run measured.csv --machine machine.toml -o fitted.toml"),
    ("fit thermal", "trueup fit thermal --run measured.csv --machine machine.toml -o fitted.toml"),
    (
        "fit table1",
        "trueup fit table1 --run z_of_x.csv --run z_of_y.csv --run diagonal.csv -o table1.html",
    ),
    ("linuxcnc", "trueup linuxcnc --port tcp:127.0.0.1:7700 --machine machine.toml"),
    ("show", "trueup show machine.bin > shown.toml"),
    ("program", "trueup program backlash --machine machine.toml --for siemens -o measure"),
    ("simulate", "trueup simulate --scenario scenario.toml --seed 1 -o run.csv"),
    ("trend", "trueup trend measured --limit-um 2 --out trend"),
    ("firmware", "trueup firmware images"),
    ("examples", "trueup examples examples"),
    ("completions", "trueup completions bash > ~/.local/share/bash-completion/completions/trueup"),
    ("man", "trueup man pages"),
    ("gateway modbus", "trueup gateway modbus --port /dev/ttyUSB0 --listen 0.0.0.0:502"),
    ("gateway s7", "trueup gateway s7 --port /dev/ttyUSB0 --plc 192.168.0.1 --db 100"),
    ("bridge info", "trueup bridge info --port /dev/ttyUSB0"),
    ("bridge load", "trueup bridge load machine.bin --port /dev/ttyUSB0"),
    ("bridge monitor", "trueup bridge monitor --port /dev/ttyUSB0"),
    ("bridge save", "trueup bridge save board.tar --port /dev/ttyUSB0"),
    ("bridge restore", "trueup bridge restore board.tar --port /dev/ttyUSB0"),
    ("learn", "trueup learn --machine machine.toml --run record.csv -o learned.toml"),
    ("trust", "trueup trust --machine machine.toml --calibrated then.csv --run now.csv"),
    (
        "commission",
        "trueup commission --machine machine.toml --port /dev/ttyUSB0 --for siemens --out commissioning",
    ),
];

/// The lines that are examples.
#[cfg(test)]
pub fn lines() -> impl Iterator<Item = &'static str> {
    EXAMPLES.iter().map(|(_, line)| *line)
}

/// The tool with its examples.
pub fn with_examples(tool: Command) -> Command {
    named(tool, "")
}

fn named(command: Command, path: &str) -> Command {
    let example = EXAMPLES.iter().find(|(name, _)| *name == path);
    let command = match example {
        Some((_, line)) if command.get_after_help().is_none() => {
            command.after_help(format!("Example:\n  {line}"))
        }
        _ => command,
    };
    command.mut_subcommands(|inner| {
        let path = format!("{path} {}", inner.get_name());
        named(inner, path.trim_start())
    })
}
