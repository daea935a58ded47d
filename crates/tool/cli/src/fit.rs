//! `trueup fit`: from measured runs to a section of the machine file.

mod args;
mod circle;
mod report;
mod table1;
mod volume;

use std::{
    borrow::Cow,
    path::{Path, PathBuf},
};

use anyhow::Result;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use trueup_fit::{
    FitReport, elongation,
    partial_prediction::{ExcludedSection, PartialPrediction, predict_other_sections},
    pitch, straightness, straightness_report, thermal, warmup,
};
use trueup_machine::{
    InputFileError, Location, Machine, MachineFile, RunFile,
    applied_offsets::{UncompensatedRun, require_unit_factor},
    compile::check_slopes,
    machine_file::{LinearAxis, Quantity},
};

pub use args::FitArgs;

use self::args::{
    BacklashArgs, CommonArgs, ElongationArgs, FitInputArgs, FitKind, PitchArgs, PositionArgs,
    StraightnessArgs, ThermalArgs, WarmupArgs,
};
use crate::{
    CommandOutcome, UserError, input_files, next_commands, output, provenance, run_reader,
};

/// The files that were read.
struct FitInput {
    runs: Vec<UncompensatedRun<'static>>,
    machine: Option<(PathBuf, String, Machine)>,
}

/// Fits what is requested.
pub fn run(args: &FitArgs, as_json: bool) -> Result<CommandOutcome> {
    let common = match &args.kind {
        FitKind::Table1(args) => return table1::run(args, as_json),
        FitKind::Circle(args) => return circle::run(args, as_json),
        FitKind::Volume(args) => return volume::run(args, as_json),
        FitKind::Straightness(StraightnessArgs { common, .. })
        | FitKind::Pitch(PitchArgs { common, .. })
        | FitKind::Backlash(BacklashArgs { common, .. })
        | FitKind::Elongation(ElongationArgs { common, .. })
        | FitKind::Warmup(WarmupArgs { common })
        | FitKind::Thermal(ThermalArgs { common, .. }) => common,
    };
    let input = FitInput::read(&common.measured)?;
    let bytes: u64 = common.measured.run.iter().map(|path| run_reader::file_size(path)).sum();
    let spinner = create_spinner("fitting", bytes);
    let report = match &args.kind {
        FitKind::Table1(_) | FitKind::Circle(_) | FitKind::Volume(_) => {
            unreachable!("has returned")
        }
        FitKind::Straightness(args) => run_straightness_fit(&input, args)?,
        FitKind::Pitch(args) => run_pitch_fit(&input, args)?,
        FitKind::Backlash(args) => run_backlash_fit(&input, args)?,
        FitKind::Elongation(args) => {
            let options = elongation::ElongationFitOptions {
                source: args.source,
                temperature: args.temperature.clone(),
            };
            elongation::fit_elongation(&input.runs, input.machine(), &options)?
        }
        FitKind::Warmup(_) => warmup::fit(&input.runs, input.machine())?,
        FitKind::Thermal(args) => run_thermal_fit(&input, args)?,
    };
    spinner.finish_and_clear();
    // Before the machine file may be written over: the page names what was read.
    if let Some((what, positions)) = args.kind.position_args() {
        write_iso230_page(&input, common, what, positions, &report)?;
    }
    let written = write_machine_file(&input, common, &report)?;
    report::print(&report, common, written, as_json)?;
    let is_whole = input.machine.is_some() && !output::is_standard_output(&common.output);
    if written && is_whole && !as_json {
        let folder = common.output.parent().unwrap_or(Path::new(""));
        next_commands::print_next_commands(&next_commands::deployment_commands(
            &common.output,
            folder,
        ))?;
    }
    let is_met = report.verdict.is_usable() && report.unmet.is_empty();
    Ok(if is_met { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

/// Returns the machine file with its path and text.
fn read_machine_with_source(path: &Path) -> Result<(PathBuf, String, Machine), InputFileError> {
    let text = MachineFile::read_text(path)?;
    let machine = input_files::parse_machine(&text, path)?;
    Ok((path.to_owned(), text, machine))
}

impl FitInput {
    fn read(FitInputArgs { run: runs, machine }: &FitInputArgs) -> Result<Self> {
        let machine = machine.as_deref().map(read_machine_with_source).transpose()?;
        let of = machine.as_ref().map(|(_, _, machine)| machine);
        let unaided = |run: RunFile| -> Result<UncompensatedRun<'static>> {
            let (run, notes) = UncompensatedRun::from_run(Cow::Owned(run), of, None)?;
            notes.iter().for_each(crate::report::print_warning);
            Ok(run)
        };
        let runs = input_files::read_runs_for_fit(runs, of)?;
        let runs = runs.into_iter().map(unaided).collect::<Result<Vec<_>>>()?;
        for quantity in Quantity::ALL {
            require_unit_factor(&runs, of, quantity)?;
        }
        Ok(Self { runs, machine })
    }

    fn machine(&self) -> Option<&Machine> {
        self.machine.as_ref().map(|(_, _, machine)| machine)
    }

    /// Returns the one run; what takes one alone refuses several.
    fn single_run(&self) -> Result<&UncompensatedRun<'_>, UserError> {
        match &self.runs[..] {
            [run] => Ok(run),
            runs => Err(UserError(format!(
                "--run is given {} times: this fit takes one run file (repeats stand in its \
                 column run)",
                runs.len()
            ))),
        }
    }

    /// Returns what the rest of the machine file says of `run`, with a warning where it cannot.
    fn predict_known_errors_um(
        &self,
        run: &UncompensatedRun<'_>,
        without: ExcludedSection,
    ) -> Result<Option<Vec<f64>>, InputFileError> {
        let Some(machine) = self.machine() else { return Ok(None) };
        let Some(known) = predict_other_sections(machine, run, without)? else { return Ok(None) };
        if known.has_known_rows() {
            return Ok(Some(known.um));
        }
        let PartialPrediction { missing_columns, .. } = known;
        let lacks = if missing_columns.is_empty() {
            String::new()
        } else {
            format!(": the run lacks {}", missing_columns.join(", "))
        };
        crate::report::print_warning(format_args!(
            "{}: the other sections of the machine file are not subtracted{lacks}",
            run.path().display()
        ));
        Ok(None)
    }
}

fn run_straightness_fit(input: &FitInput, args: &StraightnessArgs) -> Result<FitReport> {
    let options =
        straightness::StraightnessFitOptions { method: args.method, ..args.curve.to_options() };
    let run = input.single_run()?;
    let known = |curve: &straightness::StraightnessCurve| {
        input.predict_known_errors_um(
            run,
            ExcludedSection::Straightness { error: curve.error, along: curve.along },
        )
    };
    Ok(straightness_report::fit_curve(
        run,
        args.curve.error.quantity().as_deref(),
        known,
        &options,
    )?)
}

fn run_pitch_fit(input: &FitInput, args: &PitchArgs) -> Result<FitReport> {
    let of = |options| pitch::PitchFitOptions { ways: args.ways, step_mm: args.step_mm, ..options };
    let axis = resolve_axis(&input.runs, args.positions.error.quantity().as_deref())?;
    if let Some(dual) = input.machine().and_then(|machine| machine.axes[axis.index()].dual.clone())
    {
        let options = |run: &UncompensatedRun<'_>| -> Result<pitch::PitchFitOptions> {
            Ok(of(position_fit_options(input, &args.positions, run, axis)?))
        };
        return pitch::fit_both_drives(&input.runs, axis, &dual, options);
    }
    let (run, axis, options) = position_fit_inputs(input, &args.positions)?;
    Ok(pitch::fit(run, axis, &of(options))?.report)
}

fn run_backlash_fit(input: &FitInput, args: &BacklashArgs) -> Result<FitReport> {
    let (run, axis, options) = position_fit_inputs(input, &args.positions)?;
    let options = pitch::PitchFitOptions { feed_mm_per_min: args.feed, ..options };
    Ok(pitch::fit_backlash(run, axis, &options)?.report)
}

/// Writes the figures of ISO 230-2 as a page next to what was fitted, where the readings give any.
fn write_iso230_page(
    input: &FitInput,
    common: &CommonArgs,
    what: &str,
    args: &PositionArgs,
    report: &FitReport,
) -> Result<()> {
    // Two drives of an axis have a run each.
    if output::is_standard_output(&common.output) || input.runs.len() != 1 {
        return Ok(());
    }
    let (run, axis, options) = self::position_fit_inputs(input, args)?;
    // Of readings without repeats at targets, or at several feeds, the standard knows no figures.
    let Some(iso230) = pitch::fit(run, axis, &options).ok().and_then(|fit| fit.iso230) else {
        return Ok(());
    };
    let measured = &common.measured;
    let inputs: Vec<&Path> =
        measured.run.iter().chain(&measured.machine).map(PathBuf::as_path).collect();
    let page = pitch::build_page(
        axis,
        what,
        report,
        &iso230,
        &provenance::provenance_from_files(&inputs)?,
    );
    let path = common.output.with_extension("html");
    output::write_atomically(&path, &inputs, |out| out.write_all(page.to_html().as_bytes()))?;
    trueup_output::write_diagnostic(format_args!("figures of ISO 230-2: {}", path.display()));
    Ok(())
}

/// Returns the one run, whose error it is, and the options of both fits of positions.
fn position_fit_inputs<'a>(
    input: &'a FitInput,
    args: &PositionArgs,
) -> Result<(&'a UncompensatedRun<'a>, LinearAxis, pitch::PitchFitOptions)> {
    let run = input.single_run()?;
    let axis = resolve_axis(&input.runs, args.error.quantity().as_deref())?;
    Ok((run, axis, position_fit_options(input, args, run, axis)?))
}

/// Returns the options of a fit of positions, of one run.
fn position_fit_options(
    input: &FitInput,
    args: &PositionArgs,
    run: &UncompensatedRun<'_>,
    axis: LinearAxis,
) -> Result<pitch::PitchFitOptions> {
    let feedback = input.machine().map(|machine| machine.axes[axis.index()].feedback);
    Ok(pitch::PitchFitOptions {
        runs: args.repeats.clone(),
        feedback: feedback.unwrap_or_default(),
        known_um: input.predict_known_errors_um(run, ExcludedSection::Position(axis))?,
        ..pitch::PitchFitOptions::default()
    })
}

fn run_thermal_fit(input: &FitInput, args: &ThermalArgs) -> Result<FitReport> {
    let axis = resolve_axis(&input.runs, args.error.quantity().as_deref())?;
    let mut known_um = Vec::new();
    for run in &input.runs {
        match input.predict_known_errors_um(run, ExcludedSection::Thermal(axis))? {
            Some(um) => known_um.extend(um),
            None => known_um.extend(vec![0.0; run.row_count()]),
        }
    }
    let options = thermal::ThermalFitOptions {
        mode: args.mode,
        temperature: args.temperature.clone(),
        table_rows: args.table.map(usize::from),
        known_um: Some(known_um),
    };
    Ok(thermal::fit(&input.runs, axis, input.machine(), &options)?)
}

/// Returns the axis of `quantity`, else the only one whose error the runs measure.
fn resolve_axis(
    runs: &[UncompensatedRun<'_>],
    quantity: Option<&str>,
) -> Result<LinearAxis, InputFileError> {
    let start = || Location::start_of_file(runs[0].path());
    if let Some(quantity) = quantity {
        let axis = LinearAxis::ALL.into_iter().find(|axis| quantity == format!("d{}", axis.name()));
        let rule = format!("--quantity must be dx or dy or dz, not {quantity:?}");
        return axis.ok_or_else(|| InputFileError::new(start(), rule));
    }
    let measured: Vec<LinearAxis> = LinearAxis::ALL
        .into_iter()
        .filter(|axis| runs[0].column(&format!("measured_d{}_um", axis.name())).is_some())
        .collect();
    match measured[..] {
        [axis] => Ok(axis),
        [] => runs[0].require_column("measured_dx_um").map(|_| LinearAxis::X),
        _ => {
            let names: Vec<String> =
                measured.iter().map(|axis| format!("d{}", axis.name())).collect();
            let rule = format!(
                "the run measures {}: choose one with --axis or --quantity",
                names.join(", ")
            );
            Err(InputFileError::new(start(), rule))
        }
    }
}

fn write_machine_file(input: &FitInput, common: &CommonArgs, report: &FitReport) -> Result<bool> {
    if report.edit.is_empty() || !report.verdict.is_usable() {
        return Ok(false);
    }
    let text = match &input.machine {
        Some((path, source, _)) => report.edit.apply(source, path)?,
        None => report.edit.to_toml(),
    };
    check_output_text(input.machine(), &text, &common.output)?;
    // The machine file itself may be written over: that is what a user means who names it twice.
    let inputs: Vec<&Path> = common.measured.run.iter().map(PathBuf::as_path).collect();
    output::write_atomically(&common.output, &inputs, |out| out.write_all(text.as_bytes()))?;
    Ok(true)
}

/// Says, before `text` is written, what in it is unlikely, and that `compile` will refuse it for a slope;
/// refuses what is impossible. `text` is a machine file, or sections of one.
fn check_output_text(machine: Option<&Machine>, text: &str, path: &Path) -> Result<()> {
    const MINIMAL_MACHINE_HEADER: &str = "[machine]\nname = \"sections\"\nkind = \"3-axis\"\n";
    let machine = match machine {
        Some(before) => input_files::check_machine_before_write(text, path, Some(before))?,
        None => input_files::check_machine_before_write(
            &format!("{MINIMAL_MACHINE_HEADER}{text}"),
            path,
            None,
        )?,
    };
    if let Err(InputFileError { rule, .. }) = check_slopes(&machine) {
        crate::report::print_warning(format_args!(
            "trueup compile will refuse {}: {rule}",
            path.display()
        ));
    }
    Ok(())
}

/// Returns a spinner with the time that has passed, if there is a terminal: a fit does not know how far it is.
fn create_spinner(what: &'static str, bytes: u64) -> ProgressBar {
    if bytes < run_reader::MIN_PROGRESS_BAR_BYTES / 8 || !trueup_output::is_stderr_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{spinner} {msg} {elapsed}");
    let spinner = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr())
        .with_style(style.expect("the template is a constant"))
        .with_message(what);
    spinner.enable_steady_tick(std::time::Duration::from_millis(200));
    spinner
}
