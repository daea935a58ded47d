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
    Report, curve, elongation,
    known::{Known, Without, known},
    pitch, straightness, thermal, warmup,
};
use trueup_machine::{
    BadInput, Location, Machine, MachineFile, RunFile,
    applied::{Uncompensated, require_applied_once},
    compile::check_slopes,
    file::{ElongationSource, LinearAxis, Quantity, ThermalMode},
};

pub use args::Fit;

use self::args::{
    Backlash, Common, Elongation, Kind, Measured, Method, Mode, Pitch, Positions, Straightness,
    TableMode, Thermal, Warmup, WarmupSource,
};
use crate::{Outcome, UserError, commands, files, origin, output, runs};

/// The files that were read.
struct Input {
    runs: Vec<Uncompensated<'static>>,
    machine: Option<(PathBuf, String, Machine)>,
}

/// Fits what is asked for.
pub fn run(args: &Fit, as_json: bool) -> Result<Outcome> {
    let common = match &args.kind {
        Kind::Table1(args) => return table1::run(args, as_json),
        Kind::Circle(args) => return circle::run(args, as_json),
        Kind::Volume(args) => return volume::run(args, as_json),
        Kind::Straightness(Straightness { common, .. })
        | Kind::Pitch(Pitch { common, .. })
        | Kind::Backlash(Backlash { common, .. })
        | Kind::Elongation(Elongation { common, .. })
        | Kind::Warmup(Warmup { common })
        | Kind::Thermal(Thermal { common, .. }) => common,
    };
    let input = Input::read(&common.measured)?;
    let bytes: u64 = common.measured.run.iter().map(|path| runs::bytes(path)).sum();
    let spinner = spinner("fitting", bytes);
    let report = match &args.kind {
        Kind::Table1(_) | Kind::Circle(_) | Kind::Volume(_) => unreachable!("has returned"),
        Kind::Straightness(args) => straightness_of(&input, args)?,
        Kind::Pitch(args) => pitch_of(&input, args)?,
        Kind::Backlash(args) => backlash_of(&input, args)?,
        Kind::Elongation(args) => {
            let source = args.source.map(|by| match by {
                WarmupSource::Sensor => ElongationSource::Sensor,
                WarmupSource::Temperature => ElongationSource::Temperature,
            });
            let options = elongation::Options { source, temperature: args.temperature.clone() };
            elongation::fit(&input.runs, input.machine(), &options)?
        }
        Kind::Warmup(_) => warmup::fit(&input.runs, input.machine())?,
        Kind::Thermal(args) => thermal_of(&input, args)?,
    };
    spinner.finish_and_clear();
    // Before the machine file may be written over: the page names what was read.
    if let Some((what, positions)) = args.kind.positions() {
        write_page(&input, common, what, positions, &report)?;
    }
    let written = write(&input, common, &report)?;
    report::print(&report, common, written, as_json)?;
    let is_whole = input.machine.is_some() && !output::is_standard_output(&common.output);
    if written && is_whole && !as_json {
        let folder = common.output.parent().unwrap_or(Path::new(""));
        commands::print(&commands::to_board(&common.output, folder))?;
    }
    let is_met = report.verdict.is_fitted() && report.unmet.is_empty();
    Ok(if is_met { Outcome::Done } else { Outcome::NotMet })
}

impl Input {
    fn read(Measured { run: runs, machine }: &Measured) -> Result<Self> {
        let machine = match machine {
            None => None,
            Some(path) => {
                let text = MachineFile::read_text(path)?;
                let machine = files::parsed(&text, path)?;
                Some((path.clone(), text, machine))
            }
        };
        let of = machine.as_ref().map(|(_, _, machine)| machine);
        let unaided = |run: RunFile| -> Result<Uncompensated<'static>> {
            let (run, notes) = Uncompensated::of(Cow::Owned(run), of, None)?;
            notes.iter().for_each(crate::report::warn);
            Ok(run)
        };
        let runs = files::runs_to_fit(runs, of)?;
        let runs = runs.into_iter().map(unaided).collect::<Result<Vec<_>>>()?;
        for quantity in Quantity::ALL {
            require_applied_once(&runs, of, quantity)?;
        }
        Ok(Self { runs, machine })
    }

    fn machine(&self) -> Option<&Machine> {
        self.machine.as_ref().map(|(_, _, machine)| machine)
    }

    /// Returns the one run; what takes one alone refuses several.
    fn run(&self) -> Result<&Uncompensated<'_>, UserError> {
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
    fn known(
        &self,
        run: &Uncompensated<'_>,
        without: Without,
    ) -> Result<Option<Vec<f64>>, BadInput> {
        let Some(machine) = self.machine() else { return Ok(None) };
        let Some(known) = known(machine, run, without)? else { return Ok(None) };
        if known.is_usable() {
            return Ok(Some(known.um));
        }
        let Known { missing_columns, .. } = known;
        let lacks = if missing_columns.is_empty() {
            String::new()
        } else {
            format!(": the run lacks {}", missing_columns.join(", "))
        };
        crate::report::warn(format_args!(
            "{}: the other sections of the machine file are not subtracted{lacks}",
            run.path().display()
        ));
        Ok(None)
    }
}

fn straightness_of(input: &Input, args: &Straightness) -> Result<Report> {
    let options = straightness::Options {
        method: match args.method {
            Method::LeastSquares => straightness::Method::LeastSquares,
            Method::Paper => straightness::Method::Paper,
        },
        ..args.curve.options()
    };
    let run = input.run()?;
    let known = |curve: &straightness::StraightnessCurve| {
        input.known(run, Without::Straightness { error: curve.error, along: curve.along })
    };
    Ok(curve::fit(run, args.curve.error.quantity().as_deref(), known, &options)?)
}

fn pitch_of(input: &Input, args: &Pitch) -> Result<Report> {
    let ways = match args.ways {
        TableMode::Automatic => pitch::TableMode::Automatic,
        TableMode::One => pitch::TableMode::One,
        TableMode::Both => pitch::TableMode::Both,
    };
    let of = |options| pitch::Options { ways, step_mm: args.step_mm, ..options };
    let axis = axis_of(&input.runs, args.positions.error.quantity().as_deref())?;
    if let Some(dual) = input.machine().and_then(|machine| machine.axes[axis.index()].dual.clone())
    {
        let options = |run: &Uncompensated<'_>| -> Result<pitch::Options> {
            Ok(of(position_options(input, &args.positions, run, axis)?))
        };
        return pitch::fit_both(&input.runs, axis, &dual, options);
    }
    let (run, axis, options) = positions(input, &args.positions)?;
    Ok(pitch::fit(run, axis, &of(options))?.report)
}

fn backlash_of(input: &Input, args: &Backlash) -> Result<Report> {
    let (run, axis, options) = positions(input, &args.positions)?;
    let options = pitch::Options { feed_mm_per_min: args.feed, ..options };
    Ok(pitch::fit_backlash(run, axis, &options)?.report)
}

/// Writes the figures of ISO 230-2 as a page next to what was fitted, where the readings give any.
fn write_page(
    input: &Input,
    common: &Common,
    what: &str,
    args: &Positions,
    report: &Report,
) -> Result<()> {
    // Two drives of an axis have a run each.
    if output::is_standard_output(&common.output) || input.runs.len() != 1 {
        return Ok(());
    }
    let (run, axis, options) = self::positions(input, args)?;
    // Of readings without repeats at targets, or at several feeds, the standard knows no figures.
    let Some(iso230) = pitch::fit(run, axis, &options).ok().and_then(|it| it.iso230) else {
        return Ok(());
    };
    let measured = &common.measured;
    let inputs: Vec<&Path> =
        measured.run.iter().chain(&measured.machine).map(PathBuf::as_path).collect();
    let page = pitch::page(axis, what, report, &iso230, &origin::of(&inputs)?);
    let path = common.output.with_extension("html");
    output::write_whole(&path, &inputs, |out| out.write_all(page.html().as_bytes()))?;
    trueup_output::diagnostic(format_args!("figures of ISO 230-2: {}", path.display()));
    Ok(())
}

/// Returns the one run, whose error it is, and what both fits of positions are asked for.
fn positions<'a>(
    input: &'a Input,
    args: &Positions,
) -> Result<(&'a Uncompensated<'a>, LinearAxis, pitch::Options)> {
    let run = input.run()?;
    let axis = axis_of(&input.runs, args.error.quantity().as_deref())?;
    Ok((run, axis, position_options(input, args, run, axis)?))
}

/// Returns what a fit of positions is asked for, of one run.
fn position_options(
    input: &Input,
    args: &Positions,
    run: &Uncompensated<'_>,
    axis: LinearAxis,
) -> Result<pitch::Options> {
    let feedback = input.machine().map(|machine| machine.axes[axis.index()].feedback);
    Ok(pitch::Options {
        runs: args.repeats.clone(),
        feedback: feedback.unwrap_or_default(),
        known_um: input.known(run, Without::Position(axis))?,
        ..pitch::Options::default()
    })
}

fn thermal_of(input: &Input, args: &Thermal) -> Result<Report> {
    let axis = axis_of(&input.runs, args.error.quantity().as_deref())?;
    let mut known_um = Vec::new();
    for run in &input.runs {
        match input.known(run, Without::Thermal(axis))? {
            Some(um) => known_um.extend(um),
            None => known_um.extend(vec![0.0; run.rows()]),
        }
    }
    let options = thermal::Options {
        mode: args.mode.map(|mode| match mode {
            Mode::Constant => ThermalMode::Constant,
            Mode::Position => ThermalMode::Position,
            Mode::Both => ThermalMode::Both,
        }),
        temperature: args.temperature.clone(),
        table_rows: args.table.map(usize::from),
        known_um: Some(known_um),
    };
    Ok(thermal::fit(&input.runs, axis, input.machine(), &options)?)
}

/// Returns the axis of `quantity`, else the only one whose error the runs measure.
fn axis_of(runs: &[Uncompensated<'_>], quantity: Option<&str>) -> Result<LinearAxis, BadInput> {
    let start = || Location::start_of(runs[0].path());
    if let Some(quantity) = quantity {
        let axis = LinearAxis::ALL.into_iter().find(|axis| quantity == format!("d{}", axis.name()));
        let rule = format!("--quantity must be dx or dy or dz, not {quantity:?}");
        return axis.ok_or_else(|| BadInput::new(start(), rule));
    }
    let measured: Vec<LinearAxis> = LinearAxis::ALL
        .into_iter()
        .filter(|axis| runs[0].column(&format!("measured_d{}_um", axis.name())).is_some())
        .collect();
    match measured[..] {
        [axis] => Ok(axis),
        [] => runs[0].require("measured_dx_um").map(|_| LinearAxis::X),
        _ => {
            let names: Vec<String> =
                measured.iter().map(|axis| format!("d{}", axis.name())).collect();
            let rule = format!(
                "the run measures {}: choose one with --axis or --quantity",
                names.join(", ")
            );
            Err(BadInput::new(start(), rule))
        }
    }
}

fn write(input: &Input, common: &Common, report: &Report) -> Result<bool> {
    if report.edit.is_empty() || !report.verdict.is_fitted() {
        return Ok(false);
    }
    let text = match &input.machine {
        Some((path, source, _)) => report.edit.apply(source, path)?,
        None => report.edit.to_toml(),
    };
    warn_of_text(input.machine(), &text, &common.output)?;
    // The machine file itself may be written over: that is what a user means who names it twice.
    let inputs: Vec<&Path> = common.measured.run.iter().map(PathBuf::as_path).collect();
    output::write_whole(&common.output, &inputs, |out| out.write_all(text.as_bytes()))?;
    Ok(true)
}

/// Says, before `text` is written, what in it is unlikely, and that `compile` will refuse it for a slope;
/// refuses what is impossible. `text` is a machine file, or sections of one.
fn warn_of_text(machine: Option<&Machine>, text: &str, path: &Path) -> Result<()> {
    const HEAD: &str = "[machine]\nname = \"sections\"\nkind = \"3-axis\"\n";
    let machine = match machine {
        Some(before) => files::to_be_written(text, path, Some(before))?,
        None => files::to_be_written(&format!("{HEAD}{text}"), path, None)?,
    };
    if let Err(BadInput { rule, .. }) = check_slopes(&machine) {
        crate::report::warn(format_args!("trueup compile will refuse {}: {rule}", path.display()));
    }
    Ok(())
}

/// Returns a spinner with the time that has passed, if there is a terminal: a fit does not know how far it is.
fn spinner(what: &'static str, bytes: u64) -> ProgressBar {
    if bytes < runs::LONG_RUN_BYTES / 8 || !trueup_output::is_error_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{spinner} {msg} {elapsed}");
    let spinner = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr())
        .with_style(style.expect("the template is a constant"))
        .with_message(what);
    spinner.enable_steady_tick(std::time::Duration::from_millis(200));
    spinner
}
