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

mod accept;
mod bridge;
mod check;
mod choice;
mod commission;
mod compare;
mod compile;
mod diagnose;
mod doctor;
mod embedded_images;
mod examples;
mod export;
mod firmware;
mod fit;
mod fleet;
mod gateway;
mod help;
mod import;
mod input_files;
mod learn;
mod linuxcnc;
mod machine_arg;
mod manual;
mod new;
mod next_commands;
mod output;
mod predict;
#[cfg(test)]
mod printed;
mod program;
mod provenance;
mod questionnaire;
mod report;
mod run_reader;
mod schema;
mod serve;
mod show;
mod sign;
mod simulate;
mod summary;
mod trend;
mod trust;
#[cfg(unix)]
mod virtual_board;

use std::{env, ffi::OsString, path::PathBuf, process::ExitCode};

use anyhow::Result;
use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use trueup_client::UnusableInputError;
use trueup_machine::InputFileError;
use trueup_output::escape::needs_escaping;

use report::Verbosity;

/// The version and the commit that this tool was built from.
const VERSION_WITH_COMMIT: &str =
    concat!(env!("CARGO_PKG_VERSION"), " (", env!("TRUEUP_COMMIT"), ")");

/// The heading of the options that every command has.
const GLOBAL_OPTIONS_HEADING: &str = "Options of every command";

/// Errors of a machine tool: what the model predicts, and what the bridge compensates.
#[derive(Parser)]
#[command(name = "trueup", version = VERSION_WITH_COMMIT, propagate_version = true)]
struct Cli {
    /// Print JSON instead of text.
    #[arg(long, global = true, help_heading = GLOBAL_OPTIONS_HEADING)]
    json: bool,
    /// Say errors alone, no warnings.
    #[arg(short, long, global = true, help_heading = GLOBAL_OPTIONS_HEADING)]
    quiet: bool,
    /// Say more: what a machine file will do, before it is used.
    #[arg(short, long, global = true, help_heading = GLOBAL_OPTIONS_HEADING, conflicts_with = "quiet")]
    verbose: bool,
    /// Take the value of this key of the machine file, or this column of a run, although no machine
    /// has it. May be given several times.
    #[arg(long, global = true, help_heading = GLOBAL_OPTIONS_HEADING, value_name = "KEY")]
    accept: Vec<String>,
    #[command(subcommand)]
    command: Command,
}

impl Cli {
    /// Parses a command line as users write it, with its short forms.
    fn parse_command_line(
        words: impl IntoIterator<Item: Into<OsString> + Clone>,
    ) -> Result<Self, clap::Error> {
        let tool = help::with_extended_help(Self::command());
        let words = words.into_iter().map(Into::into).collect();
        let words = machine_arg::with_machine_option(&tool, words);
        Self::from_arg_matches(&tool.try_get_matches_from(words)?)
    }
}

#[derive(Subcommand)]
enum Command {
    Predict(predict::PredictArgs),
    /// Turns a machine file into the calibration that the bridge stores.
    Compile(compile::CompileArgs),
    Check(check::CheckArgs),
    Commission(commission::CommissionArgs),
    Compare(compare::CompareArgs),
    Accept(accept::AcceptArgs),
    Diagnose(diagnose::DiagnoseArgs),
    Doctor(doctor::DoctorArgs),
    Export(export::ExportArgs),
    Fit(fit::FitArgs),
    /// Many machines: jobs in a folder, workers that do them, and what the results say of a series.
    Fleet {
        #[command(subcommand)]
        command: fleet::Command,
    },
    Import(import::ImportArgs),
    Learn(learn::LearnArgs),
    #[command(name = "linuxcnc")]
    LinuxCnc(linuxcnc::LinuxCncArgs),
    /// Prints a calibration back as a machine file.
    ///
    /// Exit 3: it is printed, but does not compile back to the same calibration.
    Show {
        /// The calibration, as `compile` wrote it.
        #[arg(value_name = "CAL.bin")]
        calibration: PathBuf,
    },
    New(new::NewArgs),
    Program(program::ProgramArgs),
    Schema(schema::SchemaArgs),
    Serve(Box<serve::ServeArgs>),
    Sign(sign::SignArgs),
    Simulate(simulate::SimulateArgs),
    Trend(trend::TrendArgs),
    Trust(trust::TrustArgs),
    #[cfg(unix)]
    Virtual(virtual_board::VirtualArgs),
    Firmware(firmware::FirmwareArgs),
    Examples(examples::ExamplesArgs),
    Completions(manual::CompletionsArgs),
    Man(manual::ManArgs),
    /// Brings a bridge to a control that has a PLC: offsets into its registers, positions out of them.
    Gateway {
        #[command(subcommand)]
        command: gateway::Command,
    },
    /// Looks at a bridge, real or virtual, or gives it a calibration.
    Bridge {
        #[command(subcommand)]
        command: bridge::Command,
    },
}

/// How a command that did not fail has ended.
enum CommandOutcome {
    /// All that was asked for is done.
    Done,
    /// Done, but something asked for is not met.
    NotMet,
}

/// An error that the user has to mend and that has no line and column, as `InputFileError` has: of a blob, a folder.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct UserError(String);

fn main() -> ExitCode {
    let cli = match Cli::parse_command_line(env::args_os()) {
        Ok(cli) => cli,
        Err(error) => return print_clap_error(&error),
    };
    report::set_verbosity(Verbosity { json: cli.json, quiet: cli.quiet, verbose: cli.verbose });
    input_files::set_accepted_keys(&cli.accept);
    let code = report_outcome(run(&cli));
    trueup_output::flush_queues();
    code
}

/// Prints help, or what is wrong with the command line.
fn print_clap_error(error: &clap::Error) -> ExitCode {
    let text = error.render();
    let is_help = !error.use_stderr();
    let is_terminal = match is_help {
        true => trueup_output::is_stdout_terminal(),
        false => trueup_output::is_stderr_terminal(),
    };
    // A terminal gets clap's colours, unless the command line could bring some of its own.
    let is_plain = !text.to_string().chars().any(|c| c != '\n' && needs_escaping(c));
    let text = text.to_string();
    let printed = match (is_help, is_terminal && is_plain) {
        (_, true) => error.print(),
        (true, false) => trueup_output::write_result(text.trim_end()),
        (false, false) => {
            trueup_output::write_diagnostic(text.trim_end());
            Ok(())
        }
    };
    match (printed, u8::try_from(error.exit_code())) {
        (Err(why), _) if is_help => {
            report::print_error(format_args!("standard output cannot be written: {why}"));
            ExitCode::FAILURE
        }
        (_, code) => code.map_or(ExitCode::FAILURE, ExitCode::from),
    }
}

/// Reports why a command has failed, and gives its exit status.
fn report_outcome(ended: Result<CommandOutcome>) -> ExitCode {
    match ended {
        Ok(CommandOutcome::Done) => ExitCode::SUCCESS,
        Ok(CommandOutcome::NotMet) => ExitCode::from(3),
        Err(error) => match error.downcast::<InputFileError>() {
            Ok(error) => {
                report::print_input_file_error(error);
                ExitCode::from(2)
            }
            Err(error) if error.is::<UserError>() || error.is::<UnusableInputError>() => {
                report::print_error(error);
                ExitCode::from(2)
            }
            Err(error) => {
                report::print_error(format_args!("{error:#}"));
                ExitCode::from(1)
            }
        },
    }
}

fn run(cli: &Cli) -> Result<CommandOutcome> {
    match &cli.command {
        Command::Predict(args) => predict::run(args, cli.json),
        Command::Compile(args) => compile::run(args, cli.json),
        Command::Check(args) => check::run(args, cli.json),
        Command::Commission(args) => commission::run(args, cli.json),
        Command::Compare(args) => compare::run(args, cli.json),
        Command::Accept(args) => accept::run(args, cli.json),
        Command::Diagnose(args) => diagnose::run(args, cli.json),
        Command::Doctor(args) => doctor::run(args, cli.json),
        Command::Export(args) => export::run(args, cli.json),
        Command::Fit(args) => fit::run(args, cli.json),
        Command::Fleet { command } => fleet::run(command, cli.json),
        Command::Import(args) => import::run(args, cli.json),
        Command::Learn(args) => learn::run(args, cli.json),
        Command::LinuxCnc(args) => linuxcnc::run(args, cli.json),
        Command::Show { calibration } => show::run(calibration, cli.json),
        Command::Program(args) => program::run(args, cli.json),
        Command::New(args) => new::run(args, cli.json),
        Command::Schema(args) => schema::run(args),
        Command::Serve(args) => serve::run(args),
        Command::Sign(args) => sign::run(args),
        Command::Simulate(args) => simulate::run(args, cli.json),
        Command::Trend(args) => trend::run(args, cli.json),
        Command::Trust(args) => trust::run(args, cli.json),
        #[cfg(unix)]
        Command::Virtual(args) => virtual_board::run(args),
        Command::Firmware(args) => firmware::run(args, cli.json),
        Command::Examples(args) => examples::run(args, cli.json),
        Command::Completions(args) => {
            manual::print_completions(args, help::with_extended_help(Cli::command()))
        }
        Command::Man(args) => {
            manual::write_man_pages(args, help::with_extended_help(Cli::command()), cli.json)
        }
        Command::Gateway { command } => gateway::run(command),
        Command::Bridge { command } => bridge::run(command, cli.json),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn each(command: &clap::Command, path: &str, with: &mut dyn FnMut(&str, &clap::Command)) {
        for inner in command.get_subcommands() {
            let path = format!("{path} {}", inner.get_name());
            if !inner.has_subcommands() {
                with(path.trim(), inner);
            }
            each(inner, &path, with);
        }
    }

    #[test]
    fn every_help_ends_with_an_example() {
        let mut requested = 0;
        each(&help::with_extended_help(Cli::command()), "", &mut |path, command| {
            let after = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            assert!(after.contains("trueup "), "{path} has no example: {after}");
            requested += 1;
        });
        assert!(requested > 25, "{requested}");
    }

    #[test]
    fn every_example_is_a_line_that_the_tool_takes() {
        for line in help::lines() {
            let words = line.split(" > ").next().unwrap_or_default().split(' ');
            let taken = Cli::parse_command_line(words);
            assert!(
                taken.is_ok(),
                "{line}: {}",
                taken.err().map(|error| error.to_string()).unwrap_or_default()
            );
        }
    }
}
