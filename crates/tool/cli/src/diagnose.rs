//! `trueup diagnose`: what the simulation gets wrong, its cause, and the machine file with it.

mod next_run;

use std::{
    env,
    io::Write as _,
    path::{Path, PathBuf},
    time::Duration,
};

use anyhow::{Context as _, Result};
use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use trueup_diagnose::{
    Diagnosis, DiagnosisOptions, MISSING_INPUTS_INSTRUCTION, ReadingMethod, Verdict,
    diagnose_with_options,
};
use trueup_machine::{
    InputFileError, Machine, MachineFile,
    compile::{check_slopes, compile},
    machine_file::Quantity,
};
use trueup_output::escape::escape_line;
use trueup_page::{Provenance, format_micrometres, format_three_digits};

use crate::{
    CommandOutcome,
    choice::{by_name, described_choice_parser},
    input_files, next_commands,
    output::{self, FileTransaction},
    provenance, report,
};

/// Shows what the machine file gets wrong, names the cause, and writes the machine file with it.
///
/// Exit 3: a residual has no cause, or the data do not settle it; or the machine does not repeat.
/// Also: what explains the runs makes the hold-out worse, or there are too few data.
#[derive(Args)]
pub struct DiagnoseArgs {
    #[command(flatten)]
    input: DiagnosisInput,
    /// Also plan the shortest run, of the spindle or of the axis, that distinguishes open causes.
    /// Writes next.csv to be filled in, next.json, and the program for this control.
    #[arg(long, value_name = "CONTROL")]
    next: Option<crate::program::Controller>,
    /// How the readings of the next run get into its rows: a person takes at most one in 30 s.
    #[arg(long, default_value = "hand", value_parser = described_choice_parser(READING_METHODS), requires = "next")]
    gauge: ReadingMethod,
    #[command(flatten)]
    motion: crate::program::MotionArgs,
    /// The folder for diagnosis.json, report.html, extended.toml and residuals.csv.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Input and options of a diagnosis.
#[derive(Args)]
pub struct DiagnosisInput {
    /// The machine file: what is believed.
    #[arg(long, value_name = "M.toml")]
    pub machine: PathBuf,
    /// A run file; more than one are compared with each other.
    #[arg(long = "run", value_name = "A.csv", required = true)]
    pub runs: Vec<PathBuf>,
    /// A record of the same machine with the bridge disengaged: with one of an engaged bridge it shows how the CNC applies the offset.
    #[arg(long, value_name = "OFF.csv")]
    pub off: Vec<PathBuf>,
    /// The CNC was seen to apply the offset once (accept: applied_factor 1): a record of an engaged bridge decides alone.
    #[arg(long)]
    pub applied_once: bool,
    /// A run that nothing is fitted to: it measures what the extension brings.
    #[arg(long, value_name = "H.csv")]
    pub holdout: Vec<PathBuf>,
    /// The quantity to compare, where the runs measure several.
    #[arg(long, value_parser = by_name(Quantity::ALL, Quantity::name))]
    pub quantity: Option<Quantity>,
    /// The size of an error that matters, in µm RMS; by default what is left.
    #[arg(long, value_name = "UM", value_parser = parse_positive)]
    pub matters_um: Option<f64>,
    /// The expanded uncertainty of the measuring instrument, in µm (95 %), in the place of the machine file's.
    #[arg(long, value_name = "UM", value_parser = parse_positive)]
    pub instrument_um: Option<f64>,
}

impl DiagnosisInput {
    /// Returns the paths of all runs: those that are fitted to, with the bridge disengaged, and held out. They are read
    /// together, since what a column is shows in all of them.
    pub fn run_paths(&self) -> Vec<PathBuf> {
        [&*self.runs, &*self.off, &*self.holdout].concat()
    }
}

const READING_METHODS: [(ReadingMethod, &str, &str); 2] = [
    (ReadingMethod::Hand, "hand", "A person, who writes it down"),
    (ReadingMethod::Auto, "auto", "A program records it"),
];

pub fn parse_positive(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value: &f64| value.is_finite() && *value > 0.0);
    value.ok_or_else(|| "must be a number above 0".into())
}

pub fn run(args: &DiagnoseArgs, as_json: bool) -> Result<CommandOutcome> {
    let input = &args.input;
    let source = MachineFile::read_text(&input.machine)?;
    let machine = with_instrument_uncertainty_um(
        input_files::parse_machine(&source, &input.machine)?,
        input.instrument_um,
    );
    let mut runs = input_files::read_runs_lenient(&input.run_paths(), &machine)?;
    let holdout = runs.split_off(input.runs.len() + input.off.len());
    output::create_folder(&args.out)?;

    let bar = create_progress_bar();
    let options = DiagnosisOptions {
        quantity: input.quantity,
        matters_um: input.matters_um,
        is_applied_once: input.applied_once,
    };
    let diagnosis =
        diagnose_with_options(&machine, &runs, &holdout, options, &mut |what, share| {
            bar.set_message(what.to_string());
            if !share.is_nan() {
                bar.set_position((share * 100.0) as u64);
            }
        });
    bar.finish_and_clear();
    let diagnosis = diagnosis?;
    for note in &diagnosis.report.notes {
        report::print_warning(note);
    }
    let mut inputs: Vec<&Path> = vec![&input.machine];
    let paths = input.run_paths();
    inputs.extend(paths.iter().map(PathBuf::as_path));
    let made = render_diagnosis_files(
        &diagnosis,
        (&source, &input.machine),
        &provenance::provenance_from_files(&inputs)?,
        &args.out,
    )?;
    warn_compile_refusal(&diagnosis, (&source, &input.machine), &args.out)?;
    let mut set = FileTransaction::new(&inputs);
    set.add_texts(&args.out, made)?;
    set.add(&args.out.join(RESIDUALS_FILE), |out| diagnosis.write_residuals(out))?;
    set.commit()?;
    print(args, &diagnosis, as_json)?;
    if let Some(control) = args.next {
        next_run::write_next_run_plan(&diagnosis, &machine, control, args, as_json)?;
    }
    Ok(if diagnosis.report.verdict.is_resolved() {
        CommandOutcome::Done
    } else {
        CommandOutcome::NotMet
    })
}

/// Returns a bar that shows itself once the search takes more than a moment.
fn create_progress_bar() -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:30} {percent} % {msg}")
        .expect("the template is a constant");
    let bar = ProgressBar::with_draw_target(Some(100), ProgressDrawTarget::stderr_with_hz(4))
        .with_style(style);
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}

/// Returns the machine with the instrument that is stated in the place of the machine file's.
pub fn with_instrument_uncertainty_um(machine: Machine, instrument_um: Option<f64>) -> Machine {
    Machine { instrument_um: instrument_um.or(machine.instrument_um), ..machine }
}

/// The file of each row, next to those of [`render_diagnosis_files`].
pub const RESIDUALS_FILE: &str = "residuals.csv";

/// Returns the files of a diagnosis of the machine file `source` at a path, as they are written to the folder `out`.
pub fn render_diagnosis_files(
    diagnosis: &Diagnosis,
    (source, path): (&str, &Path),
    origin: &Provenance,
    out: &Path,
) -> Result<Vec<(&'static str, String)>> {
    let extended = diagnosis.render_extended_toml(source, path)?;
    let believed = MachineFile::parse(source, path)?;
    input_files::check_machine_before_write(
        &extended,
        &out.join("extended.toml"),
        Some(&believed),
    )?;
    let html = diagnosis.render_html(&believed.name, origin, &next_commands(out, diagnosis));
    Ok(vec![
        ("diagnosis.json", diagnosis.to_json()? + "\n"),
        ("report.html", html),
        ("extended.toml", extended),
    ])
}

/// Says what a board will not take of a diagnosis that was written to `folder`.
fn warn_compile_refusal(
    diagnosis: &Diagnosis,
    (source, path): (&str, &Path),
    folder: &Path,
) -> Result<()> {
    let believed = MachineFile::parse(source, path)?;
    let target = folder.join("extended.toml");
    let written = MachineFile::parse(&diagnosis.render_extended_toml(source, path)?, &target)?;
    if let Some(InputFileError { rule, .. }) = find_compile_error(&believed, &written) {
        report::print_warning(format_args!(
            "trueup compile will refuse {}: {rule}",
            target.display()
        ));
    }
    let lines = &diagnosis.report.missing_inputs;
    if !lines.is_empty() {
        trueup_output::write_diagnostic(format_args!(
            "help: {MISSING_INPUTS_INSTRUCTION}\n{}",
            lines.join("\n")
        ));
    }
    Ok(())
}

/// Why `compile` will refuse `extended`: a correction is too steep, or something else that is not in
/// `believed`. A machine file that it refuses already, as one without `[inputs]`, shows no more.
fn find_compile_error(believed: &Machine, extended: &Machine) -> Option<InputFileError> {
    let too_steep = check_slopes(extended).err();
    too_steep.or_else(|| compile(believed).ok().and_then(|_| compile(extended).err()))
}

/// Prints `text` in red, where it is read on a screen.
fn print_in_red(text: &str) -> Result<()> {
    let is_plain = env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    if is_plain || !trueup_output::is_stdout_terminal() {
        return output::print(text);
    }
    let mut out = trueup_output::StdoutWriter;
    let written =
        writeln!(out, "\u{1b}[31m{}\u{1b}[0m", escape_line(text)).and_then(|()| out.flush());
    written.context("standard output cannot be written")
}

/// Of the names in the table of before and after.
const NAME_COLUMN_WIDTH: usize = 42;

/// Returns the lines to be typed next; none where what was found must not go to a board.
fn next_commands(out: &Path, diagnosis: &Diagnosis) -> Vec<String> {
    let verdict = diagnosis.report.verdict;
    let is_safe = matches!(verdict, Verdict::Explained | Verdict::PartlyExplained);
    match is_safe && diagnosis.has_corrections() {
        true => next_commands::deployment_commands(&out.join("extended.toml"), out),
        false => Vec::new(),
    }
}

fn print(args: &DiagnoseArgs, diagnosis: &Diagnosis, as_json: bool) -> Result<()> {
    if as_json {
        return output::print(diagnosis.to_json()?);
    }
    let report = &diagnosis.report;
    let verdict = format!("{}: {}", report.verdict.name(), diagnosis.sentence());
    if matches!(report.verdict, Verdict::DoesNotTransfer | Verdict::FallsShort) {
        print_in_red(&verdict)?;
    } else {
        output::print(verdict)?;
    }
    if !report.verdict.is_resolved() {
        for reason in &report.reasons {
            output::print(format_args!("  {reason}"))?;
        }
    }
    for finding in &report.findings {
        let column = finding.column.as_ref().map_or(String::new(), |column| format!(" {column}"));
        let state = if finding.claimed { "" } else { " (not settled)" };
        output::print(format_args!("  {}{column}{state}: {}", finding.cause, finding.sentence))?;
        for (name, parameter) in &finding.parameters {
            if let Some(written) = parameter.get("written").and_then(serde_json::Value::as_f64) {
                output::print(format_args!(
                    "    written: {name} = {}",
                    format_three_digits(written)
                ))?;
            }
        }
        output::print(format_args!("    next: {}", finding.next_test))?;
    }
    let not_fitted = match report.holdout_used {
        true => "on the hold-out, which has chosen",
        false => "on rows not used for the fit",
    };
    let left = |rms_um: f64, holdout_rms_um: f64| {
        format!(
            "{} RMS ({} {not_fitted})",
            format_micrometres(rms_um),
            format_micrometres(holdout_rms_um)
        )
    };
    let (before, explained) = (&report.before, &report.after);
    let explained = match report.findings.is_empty() {
        true => String::new(),
        false => format!(
            "; with every cause taken off {}",
            left(explained.rms_um, explained.holdout_rms_um)
        ),
    };
    output::print(format_args!(
        "{}, {} rows: as the file is {}{explained}; noise {}",
        report.quantity,
        report.rows_used,
        left(before.rms_um, before.holdout_rms_um),
        format_micrometres(report.noise_um)
    ))?;
    if diagnosis.has_corrections() {
        output::print("corrected by the board, RMS before and after:")?;
        for (of, before_um, after_um) in diagnosis.rms_errors_before_and_after() {
            let [before, after] = [before_um, after_um].map(format_micrometres);
            output::print(format_args!("  {of:NAME_COLUMN_WIDTH$} {before:>9} {after:>9}"))?;
        }
        output::print(format_args!(
            "  the largest of these rows, after: {}",
            format_micrometres(report.after.compensated_max_um)
        ))?;
        if let Some(held_out) = &report.held_out {
            output::print(format_args!(
                "promised of a reading, on days within these ranges: {}",
                held_out.sentence()
            ))?;
        }
    }
    next_commands::print_next_commands(&next_commands(&args.out, diagnosis))?;
    output::print(format_args!("{}", args.out.join("report.html").display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_board_cannot_run_is_reported_where_the_believed_file_could_be_compiled() {
        let read = |text: &str| {
            let file = format!("[machine]\nname = \"m\"\nkind = \"3-axis\"\n{text}");
            MachineFile::parse(&file, Path::new("m.toml")).expect("the test's own file")
        };
        let heat = "[[term]]\ncause = \"extra-heat-path\"\nquantity = \"dz\"\ncolumn = \"temp_bed_c\"\n\
                    um_per_c = 2.0\ntime_constant_s = 600.0\nreference_c = 20.0\n";
        let connected = "[inputs]\ntemp_bed_c = { channel = 0, kind = \"pt100\" }\n";
        assert_eq!(find_compile_error(&read(""), &read("")), None);
        let refusal = find_compile_error(&read(""), &read(heat))
            .expect("no thermometer of that name is connected");
        assert!(refusal.rule.contains("temp_bed_c"), "{}", refusal.rule);
        assert_eq!(
            find_compile_error(&read(connected), &read(&format!("{connected}{heat}"))),
            None
        );
    }
}
