//! `trueup program`: the motion programs that measure a machine, and the run files to be filled in.

mod artefact_args;
mod motion_args;

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::{Args, ValueEnum};
use serde_json::json;
use trueup_machine::{Machine, machine_file::LinearAxis};
use trueup_output::escape::shell_quote;
use trueup_program::{
    MeasurementKind, MeasurementOptions, MeasuringInstrument, control, create_plans, template,
};

pub use self::motion_args::MotionArgs;
use crate::{
    CommandOutcome, UserError,
    choice::{by_name, described_choice_parser},
    input_files,
    output::{self, FileTransaction},
    report,
};

/// Writes the program that measures a machine, for your control, and the run file to be filled in.
///
/// Each program stops before anything moves, and says which axis will move, where to, how far and what must be
/// clear. It never moves at rapid, stays inside travel_mm of the machine file less --margin, and moves only the
/// axes that its name and --clearance name. A vertical or tool axis (Z always) moves only in a --range that you
/// give. Run it in the air, with a hand on the feed override, before you trust it with a gauge.
#[derive(Args)]
pub struct ProgramArgs {
    /// The kind of measurement.
    kind: ProgramKind,
    /// The machine file; its travel_mm say how far the axes may go.
    #[arg(long, value_name = "M.toml")]
    machine: PathBuf,
    /// The control that is to run it.
    #[arg(long = "for", value_name = "CONTROL")]
    control: Controller,
    /// The folder for the programs and run files; made if it is not there.
    #[arg(long, alias = "output", value_name = "DIR")]
    out: PathBuf,
    /// These axes only. Default: all whose travel is known.
    #[arg(long, value_name = "x,y,z", value_delimiter = ',', value_parser = by_name(LinearAxis::ALL, LinearAxis::name))]
    axis: Vec<LinearAxis>,
    #[command(flatten)]
    motion: MotionArgs,
    #[command(flatten)]
    artefact: artefact_args::ArtefactArgs,
    /// The feed of the moves before a reading, in mm/min; backlash is measured at each of several. 1000; of a circle
    /// 10 radii a minute, at most 1000; of a touch 60.
    #[arg(long, value_name = "MM/MIN", value_delimiter = ',')]
    feed: Vec<f64>,
    /// How long the axes stand for a reading, in s.
    #[arg(long, value_name = "S", default_value_t = MeasurementOptions::default().dwell_s)]
    dwell_s: f64,
    /// How often. Default: 7 for backlash, 5 for pitch, 3 for straightness and diagonal, 2 for step-diagonal, square, sphere and plate, 6
    /// rounds of heat.
    #[arg(long, value_name = "N")]
    repeats: Option<u32>,
    /// From target to target, in mm; of a plate from ball to ball.
    #[arg(long, value_name = "MM")]
    step_mm: Option<f64>,
    /// The measuring instrument. For backlash, a dial (the default) needs a stop at each place, a
    /// laser none. Default for warmup: a gauge that does not touch; with a dial the spindle stops
    /// for each reading.
    #[arg(long, value_parser = described_choice_parser(MEASURING_INSTRUMENTS))]
    gauge: Option<MeasuringInstrument>,
    /// warmup: the speed. Default: rated_rpm of the machine file.
    #[arg(long, value_name = "R/MIN")]
    rpm: Option<f64>,
    /// warmup: from reading to reading, in s (60; 600 where the spindle stops for each).
    #[arg(long, value_name = "S")]
    every_s: Option<f64>,
    /// warmup: for how long, in s (7200); axis-heat: how long in each round (1200).
    #[arg(long, value_name = "S")]
    heat_s: Option<f64>,
    /// axis-heat: how fast the axis is run warm, in mm/min.
    #[arg(long, value_name = "MM/MIN", default_value_t = MeasurementOptions::default().heat_feed_mm_per_min)]
    heat_feed: f64,
    /// As --range, of each axis asked for.
    #[arg(long, hide = true, value_name = "500:1500", allow_hyphen_values = true)]
    range_mm: Option<String>,
}

#[derive(Clone, Copy, ValueEnum)]
enum ProgramKind {
    /// The play of an axis: the middle and near both ends, seven times each.
    Backlash,
    /// Position errors there and back over uneven targets.
    Pitch,
    /// How the other axes err while one moves.
    Straightness,
    /// The growth of the spindle from cold, read once a minute.
    Warmup,
    /// The growth of an axis that is run warm.
    AxisHeat,
    /// Two axes at once: what all corrections together leave.
    Diagonal,
    /// The four body diagonals in steps of one axis at a time, for a laser: `fit volume`.
    StepDiagonal,
    /// A circle in both directions, in each plane, for a ball bar or another instrument that reads its radius: `fit circle`.
    Circle,
    /// Both faces of a square, by the touch probe of the control (LinuxCNC): `fit volume`.
    Square,
    /// A sphere at one place, at angles of the table and with several styli, by the touch probe (LinuxCNC): `fit volume`.
    Sphere,
    /// A ball plate, by the touch probe (LinuxCNC): `fit volume`.
    Plate,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum Controller {
    /// LinuxCNC.
    #[value(name = "linuxcnc")]
    LinuxCnc,
    /// FANUC, milling.
    Fanuc,
    /// Siemens SINUMERIK 840D sl, 828D.
    Siemens,
    /// HEIDENHAIN Klartext.
    Heidenhain,
}

impl Controller {
    /// As `--for` takes it.
    pub fn name(self) -> String {
        self.to_possible_value().expect("none is hidden").get_name().to_owned()
    }

    pub fn to_control(self) -> control::Control {
        match self {
            Self::LinuxCnc => control::Control::LinuxCnc,
            Self::Fanuc => control::Control::Fanuc,
            Self::Siemens => control::Control::Siemens,
            Self::Heidenhain => control::Control::Heidenhain,
        }
    }
}

const MEASURING_INSTRUMENTS: [(MeasuringInstrument, &str, &str); 2] = [
    (MeasuringInstrument::Dial, "dial", "An indicator at one place"),
    (MeasuringInstrument::Laser, "laser", "A laser interferometer along the whole way"),
];

/// Writes the programs of a kind.
pub fn run(args: &ProgramArgs, as_json: bool) -> Result<CommandOutcome> {
    let machine = input_files::read_machine(&args.machine)?;
    let kind = match args.kind {
        ProgramKind::Backlash => MeasurementKind::Backlash,
        ProgramKind::Pitch => MeasurementKind::Pitch,
        ProgramKind::Straightness => MeasurementKind::Straightness,
        ProgramKind::Warmup => MeasurementKind::Warmup,
        ProgramKind::AxisHeat => MeasurementKind::AxisHeat,
        ProgramKind::Diagonal => MeasurementKind::Diagonal,
        ProgramKind::StepDiagonal => MeasurementKind::StepDiagonal,
        ProgramKind::Circle => MeasurementKind::Circle,
        ProgramKind::Square => MeasurementKind::Square,
        ProgramKind::Sphere => MeasurementKind::Sphere,
        ProgramKind::Plate => MeasurementKind::Plate,
    };
    let control = args.control.to_control();
    let refused = |why| UserError(format!("{}: {why}", args.machine.display()));
    control.check_machine(&machine).map_err(refused)?;
    let (mut plans, notes) =
        create_plans(kind, &machine, &measurement_options_from_args(args, &machine)?)
            .map_err(refused)?;
    notes.iter().for_each(report::print_warning);
    output::create_folder(&args.out)?;
    let mut written = Vec::new();
    let inputs = [args.machine.as_path()];
    let mut set = FileTransaction::new(&inputs);
    let mut lines = Vec::new();
    for plan in &mut plans {
        plan.then = complete_commands(&plan.then, args);
        let (name, text) = control::generate_program(plan, control).map_err(refused)?;
        let templates = template::run_file_templates(plan);
        let runs: Vec<&str> = templates.iter().map(|(name, _)| name.as_str()).collect();
        let readings = plan.readings().len();
        let minutes = plan.min_duration_s() / 60.0;
        written.push(json!({
            "program": name, "runs": runs, "readings": readings, "least_minutes": minutes,
            "extent_mm": plan.extent_mm(), "then": plan.then,
        }));
        if !as_json {
            let extent = plan.extent_mm();
            let ways = ["x", "y", "z"].iter().zip(extent).filter_map(|(axis, extent)| {
                extent.map(|[low, high]| format!(", {axis} {low} to {high} mm"))
            });
            let ways: String = ways.collect();
            lines.push(format!(
                "{name}: {readings} readings, at least {minutes:.0} min{ways}; fill in {}",
                runs.join(", "),
            ));
            lines.extend(plan.then.iter().map(|line| format!("  then: {line}")));
        }
        for (name, text) in [(name, text)].into_iter().chain(templates.iter().cloned()) {
            output::check_run_overwrite(&args.out.join(&name), &text)?;
            set.add_text(&args.out.join(name), &text)?;
        }
    }
    set.commit()?;
    lines.iter().try_for_each(output::print)?;
    if as_json {
        output::print(json!({ "output": args.out.to_string_lossy(), "programs": written }))?;
    }
    Ok(CommandOutcome::Done)
}

/// Returns the commands of a plan as they can be typed: with the folder of their files, the machine file, and where to
/// write. The lines after a fit take the fitted file.
fn complete_commands(then: &[String], args: &ProgramArgs) -> Vec<String> {
    let word = |path: &Path| shell_quote(&path.to_string_lossy()).to_string();
    let mut machine = args.machine.clone();
    let mut lines = Vec::new();
    for line in then {
        let words = line.split(' ').map(|part| match part.ends_with(".csv") {
            true => word(&args.out.join(part)),
            false => part.to_string(),
        });
        let words: Vec<String> = words.collect();
        let with = format!("{} --machine {}", words.join(" "), word(&machine));
        if words[1] == "fit" {
            machine = args.machine.with_extension("fitted.toml");
            lines.push(format!("{with} -o {}", word(&machine)));
        } else {
            lines.push(format!("{with} --out {}", word(&args.out.join("acceptance"))));
        }
    }
    lines
}

fn measurement_options_from_args(
    args: &ProgramArgs,
    machine: &Machine,
) -> Result<MeasurementOptions, UserError> {
    let mut options = MeasurementOptions {
        axes: args.axis.clone(),
        feeds_mm_per_min: args.feed.clone(),
        dwell_s: args.dwell_s,
        repeats: args.repeats,
        step_mm: args.step_mm,
        gauge: args.gauge,
        spindle_rpm: args.rpm,
        every_s: args.every_s,
        heat_s: args.heat_s,
        heat_feed_mm_per_min: args.heat_feed,
        ..args.motion.to_options()?
    };
    args.artefact.apply_to(&mut options)?;
    if let Some(text) = &args.range_mm {
        let ends = motion_args::parse_range(text).ok_or_else(|| {
            UserError(format!("--range-mm {text}: must be like 500:1500, the smaller first"))
        })?;
        // It names no axis: Z, which may plunge, has to be requested by name.
        let is_meant = |axis: LinearAxis| match options.axes.is_empty() {
            true => axis != LinearAxis::Z && machine.axes[axis.index()].travel_mm.is_some(),
            false => options.axes.contains(&axis),
        };
        for axis in LinearAxis::ALL.into_iter().filter(|axis| is_meant(*axis)) {
            options.range_mm[axis.index()].get_or_insert(ends);
        }
    }
    Ok(options)
}
