//! `trueup`, the host tool.
//!
//! Commands and exit codes only: what is computed, and what is worth a test of its own, is in
//! the library crates. Results go to standard output, progress and warnings to
//! standard error.
//!
//! | exit code | meaning |
//! |---|---|
//! | 0 | done |
//! | 1 | not done, for a reason outside the input: no connection, a full disk |
//! | 2 | bad input, with its place and the rule broken |
//! | 3 | done, but something asked for is not met (each command says what) |

mod bridge;
mod compile;
mod diagnose;
mod export;
mod fit;
mod linuxcnc;
mod output;
mod predict;
mod runs;
mod show;
mod simulate;

use std::{path::PathBuf, process::ExitCode};

use anyhow::Result;
use clap::{Args, Parser, Subcommand};
use trueup_client::Unusable;
use trueup_machine::BadInput;

/// Errors of a machine tool: what the model predicts, and what the bridge compensates.
#[derive(Parser)]
#[command(name = "trueup", version, propagate_version = true)]
struct Cli {
    /// Print JSON instead of text.
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Adds to each row of a run what the model and the bridge's arithmetic say.
    Predict(Predict),
    /// Turns a machine file into the calibration that the bridge stores.
    Compile(Compile),
    Diagnose(diagnose::Diagnose),
    Export(export::Export),
    Fit(fit::Fit),
    #[command(name = "linuxcnc")]
    LinuxCnc(linuxcnc::LinuxCnc),
    /// Prints a calibration back as a machine file.
    ///
    /// Exit 3: it is printed, but does not compile back to the same calibration.
    Show {
        /// The calibration.
        #[arg(value_name = "CAL.bin")]
        calibration: PathBuf,
    },
    Simulate(simulate::Simulate),
    /// Looks at a bridge, real or virtual, or gives it a calibration.
    Bridge {
        #[command(subcommand)]
        command: BridgeCommand,
    },
}

#[derive(Args)]
struct Predict {
    /// The machine file.
    #[arg(long, value_name = "M.toml")]
    machine: PathBuf,
    /// The run file.
    #[arg(long, value_name = "RUN.csv")]
    run: PathBuf,
    /// Where to write the run with the predictions.
    #[arg(short, long, value_name = "OUT.csv")]
    output: PathBuf,
}

#[derive(Args)]
struct Compile {
    /// The machine file.
    #[arg(value_name = "M.toml")]
    machine: PathBuf,
    /// Where to write the calibration.
    #[arg(short, long, value_name = "CAL.bin")]
    output: PathBuf,
}

#[derive(Subcommand)]
enum BridgeCommand {
    /// Asks the bridge who it is, what it runs on, and how it is.
    ///
    /// Exit 3: it answers, but no heartbeat or no offsets came.
    Info {
        #[command(flatten)]
        port: Port,
    },
    /// Loads a calibration, reads it back, and starts the board anew with it.
    ///
    /// Nothing is loaded while offsets are being followed: let the CNC disengage first.
    /// Exit 3: it is stored, but the board does not run on it.
    Load {
        /// The calibration, as `compile` writes it.
        #[arg(value_name = "CAL.bin")]
        calibration: PathBuf,
        #[command(flatten)]
        port: Port,
        /// Leave the board running on the calibration it has; the new one is used from its next
        /// start.
        #[arg(long)]
        keep_running: bool,
    },
    /// Prints the offsets and the temperatures once a second, until Ctrl-C. It only listens: nothing
    /// is engaged by it.
    ///
    /// Exit 3: frames were damaged or out of order, or a second passed without offsets.
    Monitor {
        #[command(flatten)]
        port: Port,
        /// Stop after this many lines.
        #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
        count: Option<u64>,
        /// Write every frame down, as `candump -l` does, and a run file for `diagnose`: to
        /// `FILE.log` and `FILE.csv`, or to `bridge.log` and `bridge.csv` in a folder.
        #[arg(long, value_name = "DIR|FILE.log")]
        record: Option<PathBuf>,
        /// The machine file: it names the temperatures of the run file, and makes sensor counts of
        /// the elongation.
        #[arg(long, value_name = "M.toml", requires = "record")]
        machine: Option<PathBuf>,
    },
}

#[derive(Args)]
struct Port {
    /// Where the bridge is: tcp:HOST:PORT, a serial device, or a CAN interface (can0).
    #[arg(long, value_name = "PORT")]
    port: String,
}

/// How a command that did not fail has ended.
enum Outcome {
    /// All that was asked for is done.
    Done,
    /// Done, but something asked for is not met.
    NotMet,
}

/// What the user has to mend and has no line and column, as `BadInput` has: a blob, a folder.
#[derive(Debug)]
struct Mend(String);

impl std::fmt::Display for Mend {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Mend {}

fn main() -> ExitCode {
    let cli = Cli::parse();
    match run(&cli) {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::NotMet) => ExitCode::from(3),
        Err(error) if error.is::<BadInput>() || error.is::<Mend>() || error.is::<Unusable>() => {
            // Alone on its line and without a word before it, so that `file:line:column` is a link.
            eprintln!("{error}");
            ExitCode::from(2)
        }
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(1)
        }
    }
}

fn run(cli: &Cli) -> Result<Outcome> {
    match &cli.command {
        Command::Predict(Predict { machine, run, output }) => {
            predict::run(machine, run, output, cli.json)
        }
        Command::Compile(Compile { machine, output }) => compile::run(machine, output, cli.json),
        Command::Diagnose(args) => diagnose::run(args, cli.json),
        Command::Export(args) => export::run(args, cli.json),
        Command::Fit(args) => fit::run(args, cli.json),
        Command::LinuxCnc(args) => linuxcnc::run(args),
        Command::Show { calibration } => show::run(calibration, cli.json),
        Command::Simulate(args) => simulate::run(args, cli.json),
        Command::Bridge { command: BridgeCommand::Info { port } } => {
            bridge::info::run(&port.port, cli.json)
        }
        Command::Bridge { command: BridgeCommand::Load { calibration, port, keep_running } } => {
            bridge::load::run(calibration, &port.port, *keep_running, cli.json)
        }
        Command::Bridge { command: BridgeCommand::Monitor { port, count, record, machine } } => {
            let record = record.as_deref().map(|record| (record, machine.as_deref()));
            bridge::monitor::run(&port.port, *count, record, cli.json)
        }
    }
}
