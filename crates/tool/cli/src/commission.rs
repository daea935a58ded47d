//! `trueup commission`: from a machine that stands to one that is corrected and accepted, step by step (seed
//! 001, S1–S7), with a test of the sign before anything else.
//!
//! ```text
//!  sign ─► program ─► off (measured) ─► fit ─► load ─► on (measured) ─► accept ─► done
//!                        ▲                                               │ not enough
//!                        └───────────────── the next round ◄─────────────┘
//! ```
//!
//! A spindle is commissioned by a warm-up, an axis by its pitch or its backlash: the steps are the same.
//!
//! The content of the board before the sign test is saved first and put back after it (`before`).
//!
//! Each step is a command of this tool, which the log repeats word by word, so that a colleague can do it by
//! hand. The progress stands in `commission.json`: the same command goes on where it stopped.

mod answers;
mod board_backup;
mod bridge_wait;
mod journal;
mod offset_sign_test;

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use trueup_machine::{
    Machine, MachineFile, RunFile, compile,
    machine_file::{ElongationSource, LinearAxis, Quantity, Spindle},
};
use trueup_program::{MeasurementKind, MeasurementOptions, create_plans};

use self::{
    answers::AnswerSource,
    board_backup::{Interrupted, install_interrupt_handler},
    journal::{Journal, Step},
};
use crate::{
    Cli, CommandOutcome, UserError, input_files, output,
    program::{Controller, MotionArgs},
    report,
};

/// Commissions a spindle or an axis: sign test, programs, measuring, fit, load, acceptance, as often as is
/// needed.
///
/// It requests the measurements, and keeps every run, file and command in one folder. It goes on
/// where it stopped when you give the same command again. Exit 3: it has stopped before the end: an
/// answer is missing, the sign is wrong, or it is not accepted yet.
#[derive(Args)]
pub struct CommissionArgs {
    /// The kind of commissioning. Default: the growth of the spindle that the machine file describes.
    kind: Option<CommissioningKind>,
    /// The axis, for pitch and backlash.
    #[arg(long, value_name = "x|y|z", value_parser = parse_axis)]
    axis: Option<LinearAxis>,
    /// The machine file; it is copied, and never changed.
    #[arg(long, value_name = "M.toml")]
    machine: PathBuf,
    /// Where the bridge is: tcp:HOST:PORT, a serial device, or a CAN interface (can0).
    #[arg(long, value_name = "PORT")]
    port: String,
    /// The control that runs the programs.
    #[arg(long = "for", value_name = "CONTROL")]
    control: Controller,
    /// The folder for everything; made if it is not there.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// This much of the RMS error must be gone, in percent.
    #[arg(long, value_name = "PERCENT", default_value_t = 90.0)]
    require: f64,
    /// The speed of the warm-up in r/min. Default: rated_rpm of the machine file.
    #[arg(long, value_name = "R/MIN")]
    rpm: Option<f64>,
    /// How long the warm-up takes, in s. Default: 7200.
    #[arg(long, value_name = "S")]
    heat_s: Option<f64>,
    #[command(flatten)]
    motion: MotionArgs,
    /// The answers from here on, a line each, if you are not at the terminal.
    #[arg(long, value_name = "FILE")]
    readings: Option<PathBuf>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum CommissioningKind {
    /// The growth of the spindle, from cold.
    Warmup,
    /// The position errors of an axis.
    Pitch,
    /// The play of an axis.
    Backlash,
}

fn parse_axis(name: &str) -> Result<LinearAxis, String> {
    let found = LinearAxis::ALL.into_iter().find(|axis| axis.name() == name);
    found.ok_or_else(|| "must be x, y or z".into())
}

/// The kind of commissioning, with its axis.
#[derive(Clone, Copy)]
enum CommissioningTask {
    Spindle,
    Pitch(LinearAxis),
    Backlash(LinearAxis),
}

impl CommissioningTask {
    /// As it was requested, if the machine file leaves no doubt.
    fn from_args(args: &CommissionArgs, machine: &Machine) -> Result<Self, UserError> {
        let file = args.machine.display();
        let no_axis =
            |kind: &str| UserError(format!("{kind} needs an axis: --axis x, --axis y or --axis z"));
        match (args.kind, args.axis) {
            (Some(CommissioningKind::Pitch), Some(axis)) => Ok(Self::Pitch(axis)),
            (Some(CommissioningKind::Backlash), Some(axis)) => Ok(Self::Backlash(axis)),
            (Some(CommissioningKind::Pitch), None) => Err(no_axis("pitch")),
            (Some(CommissioningKind::Backlash), None) => Err(no_axis("backlash")),
            (Some(CommissioningKind::Warmup) | None, Some(_)) => Err(UserError(
                "an axis is commissioned by its pitch or its backlash: trueup commission pitch --axis …".into(),
            )),
            (Some(CommissioningKind::Warmup), None) => Ok(Self::Spindle),
            (None, None) if machine.spindle == Spindle::default() => Err(UserError(format!(
                "{file} has no [spindle]: choose what to commission: trueup commission warmup, or \
                 pitch or backlash with --axis. Straightness and the heat of an axis are measured and \
                 fitted by hand: trueup program, trueup fit"
            ))),
            (None, None) => Ok(Self::Spindle),
        }
    }

    /// Checks, before the sign test, that its program can be made.
    fn check_program_available(
        self,
        args: &CommissionArgs,
        machine: &Machine,
    ) -> Result<(), UserError> {
        let kind = match self {
            Self::Spindle => MeasurementKind::Warmup,
            Self::Pitch(_) => MeasurementKind::Pitch,
            Self::Backlash(_) => MeasurementKind::Backlash,
        };
        let options = MeasurementOptions {
            axes: self.axis().into_iter().collect(),
            spindle_rpm: args.rpm,
            heat_s: args.heat_s,
            ..args.motion.to_options()?
        };
        let refused = |rule| UserError(format!("{}: {rule}", args.machine.display()));
        create_plans(kind, machine, &options).map(drop).map_err(refused)
    }

    /// Returns the program that measures it.
    fn program_name(self) -> &'static str {
        match self {
            Self::Spindle => "warmup",
            Self::Pitch(_) => "pitch",
            Self::Backlash(_) => "backlash",
        }
    }

    fn axis(self) -> Option<LinearAxis> {
        match self {
            Self::Spindle => None,
            Self::Pitch(axis) | Self::Backlash(axis) => Some(axis),
        }
    }

    /// Returns what is measured.
    fn quantity(self) -> &'static str {
        self.axis().map_or(Quantity::Elongation, Quantity::from_axis).name()
    }

    /// In one word and a letter, for the journal.
    fn name(self) -> String {
        match self.axis() {
            None => self.program_name().into(),
            Some(axis) => format!("{} {}", self.program_name(), axis.name()),
        }
    }
}

/// Goes on from step to step.
pub fn run(args: &CommissionArgs, as_json: bool) -> Result<CommandOutcome> {
    // Its product is the folder, and the board.
    trueup_output::enable_best_effort_output();
    let text = MachineFile::read_text(&args.machine)?;
    let machine = input_files::parse_machine(&text, &args.machine)?;
    let subject = CommissioningTask::from_args(args, &machine)?;
    subject.check_program_available(args, &machine)?;
    output::create_folder(&args.out)?;
    let retained = args.out.join("machine.toml");
    match fs::read_to_string(&retained) {
        Ok(before) if before != text => {
            return Err(UserError(format!(
                "{}: was begun with another machine file; give another folder",
                args.out.display()
            ))
            .into());
        }
        Ok(_) => {}
        Err(_) => output::write_atomically(&retained, &[], |out| out.write_all(text.as_bytes()))?,
    }
    install_interrupt_handler()?;
    let journal = Journal::open(&args.out, &subject.name())?;
    let answers = AnswerSource::from_file(args.readings.as_deref())?;
    let mut work = CommissioningSession { args, subject, machine, journal, answers, as_json };
    loop {
        let step = work.journal.next;
        if step == Step::Done {
            output::print(format_args!("accepted; all of it is in {}", args.out.display()))?;
            return Ok(CommandOutcome::Done);
        }
        work.journal.log(&format!("round {}: {}", work.journal.round, step.title()))?;
        let done = match work.run_step(step) {
            Err(error) if error.is::<Interrupted>() => None,
            done => done?,
        };
        match done {
            Some(next) => work.journal.advance_to(next)?,
            None => {
                output::print(format_args!(
                    "stopped at \"{}\"; the same command goes on from here",
                    work.journal.next.title()
                ))?;
                return Ok(CommandOutcome::NotMet);
            }
        }
    }
}

struct CommissioningSession<'a> {
    args: &'a CommissionArgs,
    subject: CommissioningTask,
    machine: Machine,
    journal: Journal,
    answers: AnswerSource,
    as_json: bool,
}

impl CommissioningSession<'_> {
    /// Does a step; the one after it, or `None`: it is not done.
    fn run_step(&mut self, step: Step) -> Result<Option<Step>> {
        let round = self.journal.round;
        let (believed, fitted) =
            (self.file_path_for_round(round - 1, "toml"), self.file_path_for_round(round, "toml"));
        Ok(match step {
            Step::Sign => self.run_sign_test()?.then_some(Step::Program),
            Step::Program => self.write_program()?.then_some(Step::Off),
            Step::Off => {
                self.wait_until_disengaged()?;
                let question = match self.subject {
                    CommissioningTask::Spindle => {
                        "run warmup from cold, without compensation".into()
                    }
                    axis => format!("run {}, without compensation", axis.program_name()),
                };
                self.request_measured_run("off", &question)?.then_some(Step::Fit)
            }
            Step::Fit => {
                let run = self.path(&format!("off-{round}.csv"));
                let mut words = vec![
                    "fit",
                    self.fit_subcommand_name(),
                    "--run",
                    &run,
                    "--machine",
                    &believed,
                    "-o",
                    &fitted,
                ];
                if self.subject.axis().is_some() {
                    words.extend(["--quantity", self.subject.quantity()]);
                }
                self.run_command(&words)?.then_some(Step::Load)
            }
            Step::Load => {
                let blob = self.file_path_for_round(round, "bin");
                self.check_board_identity()?;
                self.wait_until_disengaged()?;
                let is_done = self.run_command(&["compile", &fitted, "-o", &blob])?
                    && self.run_command(&[
                        "bridge",
                        "load",
                        &blob,
                        "--yes",
                        "--port",
                        &self.args.port,
                    ])?;
                is_done.then_some(Step::On)
            }
            Step::On => {
                let question = match self.subject {
                    CommissioningTask::Spindle => {
                        "let the machine cool down, engage, run warmup again".into()
                    }
                    axis => format!("engage, run {} again", axis.program_name()),
                };
                self.request_measured_run("on", &question)?.then_some(Step::Accept)
            }
            Step::Accept => self.run_acceptance_test(&fitted)?,
            Step::Done => Some(Step::Done),
        })
    }

    /// Returns a path in the folder, as a command takes it.
    fn path(&self, name: &str) -> String {
        self.args.out.join(name).to_string_lossy().into_owned()
    }

    /// Returns the machine file or calibration of a round; that of round 0 is the user's.
    fn file_path_for_round(&self, round: u32, kind: &str) -> String {
        self.path(&if round == 0 {
            format!("machine.{kind}")
        } else {
            format!("machine-{round}.{kind}")
        })
    }

    /// Returns the kind of `fit` that makes its section.
    fn fit_subcommand_name(&self) -> &'static str {
        match (self.subject, self.machine.spindle.source) {
            (
                CommissioningTask::Spindle,
                Some(ElongationSource::Sensor | ElongationSource::Temperature),
            ) => "elongation",
            (subject, _) => subject.program_name(),
        }
    }

    /// Runs a command of this tool and writes it down; whether it has done all that was requested.
    fn run_command(&mut self, words: &[&str]) -> Result<bool> {
        self.journal.log(&format!("  trueup {}", words.join(" ")))?;
        let json = self.as_json.then_some("--json");
        let all = ["trueup"].into_iter().chain(json).chain(words.iter().copied());
        let cli = Cli::parse_command_line(all).context("a command of this tool")?;
        // A file of the sign test's pretends on purpose.
        let is_pretended = self.journal.next == Step::Sign;
        let done = report::with_warnings_enabled(!is_pretended, || crate::run(&cli));
        match done {
            Ok(CommandOutcome::Done) => Ok(true),
            Ok(CommandOutcome::NotMet) => {
                self.journal.log("  not all of it is met")?;
                Ok(false)
            }
            Err(error) => {
                // It is shown at the end, as every command's.
                self.journal.append(&format!("  {error:#}"))?;
                Err(error)
            }
        }
    }

    /// 10 µm are given by a calibration of their own, and measured.
    fn run_sign_test(&mut self) -> Result<bool> {
        let axis = self.subject.axis();
        let test = offset_sign_test::sign_test_machine(&self.machine, axis)?;
        let (file, blob) = (self.path("sign.toml"), self.path("sign.bin"));
        output::write_atomically(Path::new(&file), &[], |out| {
            out.write_all(test.to_toml().as_bytes())
        })?;
        if !self.run_command(&["compile", &file, "-o", &blob])? {
            return Ok(false);
        }
        self.wait_until_disengaged()?;
        let Some(held) = self.back_up_board(compile(&test)?.crc())? else { return Ok(false) };
        let tested = self.measure_sign_test(&blob);
        // Also if it was interrupted, or has failed.
        let back = self.restore_board(&held);
        match (tested, back) {
            (Err(error), Err(left)) => Err(left.context(format!("{error:#}"))),
            (tested, back) => back.and(tested),
        }
    }

    /// Loads the calibration of the sign test and requests the reading, once what the board held is saved.
    fn measure_sign_test(&mut self, blob: &str) -> Result<bool> {
        let axis = self.subject.axis();
        let port = self.args.port.clone();
        if !self.run_command(&["bridge", "load", blob, "--yes", "--port", &port])? {
            return Ok(false);
        }
        self.journal.log(&offset_sign_test::setup_instructions(&self.machine, axis))?;
        let direction = offset_sign_test::error_direction(&self.machine, axis);
        bridge_wait::wait_for_output(&port, |output| {
            offset_sign_test::is_offset_correct(output, direction)
        })?;
        let Some(answer) =
            self.answers.prompt(&offset_sign_test::reading_prompt(&self.machine, axis))?
        else {
            return Ok(false);
        };
        // In half of Europe the point is a comma.
        let Ok(moved_um) = answer.trim().replace(',', ".").parse::<f64>() else {
            self.journal.log(&format!("  \"{answer}\" is not a reading in µm"))?;
            return Ok(false);
        };
        let verdict = offset_sign_test::evaluate_sign_test(moved_um);
        self.journal.log(&format!("  measured {moved_um:+.1} µm: {}", verdict.message()))?;
        Ok(verdict.is_correct())
    }

    fn write_program(&mut self) -> Result<bool> {
        let (machine, out) = (self.path("machine.toml"), self.path("program"));
        let rpm = self.args.rpm.map(|rpm| rpm.to_string());
        let heat_s = self.args.heat_s.map(|heat_s| heat_s.to_string());
        let control = self.args.control.name();
        let mut words =
            vec!["program", self.subject.program_name(), "--machine", &machine, "--for", &control];
        words.extend(["--out", &out]);
        words.extend(self.subject.axis().iter().flat_map(|axis| ["--axis", axis.name()]));
        words.extend(rpm.iter().flat_map(|rpm| ["--rpm", rpm.as_str()]));
        words.extend(heat_s.iter().flat_map(|heat_s| ["--heat-s", heat_s.as_str()]));
        let motion = self.args.motion.command_words();
        words.extend(motion.iter().map(String::as_str));
        self.run_command(&words)
    }

    /// Requests a run that was measured, and stores it.
    fn request_measured_run(&mut self, which: &str, question: &str) -> Result<bool> {
        let question = format!("{question}; the filled-in run file");
        let Some(answer) = self.answers.prompt(&question)? else { return Ok(false) };
        let from = PathBuf::from(answer.trim());
        let run = input_files::read_run(&from, None)?;
        let column = format!("measured_{}_um", self.subject.quantity());
        let readings = count_readings(&run, &column);
        if readings == 0 {
            let what = format!("  {}: no {column} is filled in", from.display());
            self.journal.log(&what)?;
            return Ok(false);
        }
        let retained = self.path(&format!("{which}-{}.csv", self.journal.round));
        let bytes = fs::read(&from).with_context(|| format!("while reading {}", from.display()))?;
        output::write_atomically(Path::new(&retained), &[], |out| out.write_all(&bytes))?;
        self.journal.log(&format!("  {}, {readings} readings", from.display()))?;
        Ok(true)
    }

    /// Compares the runs without and with offsets. If the gain is not enough, the next round begins; the command ends,
    /// so that it is read.
    fn run_acceptance_test(&mut self, fitted: &str) -> Result<Option<Step>> {
        let round = self.journal.round;
        let [off, on] = ["off", "on"].map(|which| self.path(&format!("{which}-{round}.csv")));
        let (out, require) = (self.path(&format!("accept-{round}")), self.args.require.to_string());
        let words = [
            "accept",
            "--off",
            &off,
            "--on",
            &on,
            "--require",
            &require,
            "--machine",
            fitted,
            "--out",
            &out,
            "--quantity",
            self.subject.quantity(),
        ];
        if self.run_command(&words)? {
            self.journal.log("accepted")?;
            return Ok(Some(Step::Done));
        }
        self.journal.start_next_round()?;
        Ok(None)
    }

    fn wait_until_disengaged(&mut self) -> Result<()> {
        bridge_wait::wait_until_disengaged(&self.args.port, || {
            trueup_output::write_diagnostic(
                "disengage at the CNC: nothing is loaded while offsets are followed",
            );
        })
    }
}

/// Returns how many readings a column of a run has.
fn count_readings(run: &RunFile, column: &str) -> usize {
    let measured = run.column(column).unwrap_or_default();
    measured.iter().filter(|um| !um.is_nan()).count()
}
