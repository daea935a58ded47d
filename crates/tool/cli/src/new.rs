//! `trueup new`: a machine file to begin with, from flags or, on a terminal, from questions.

use std::{
    io::{IsTerminal as _, stdin},
    path::{Path, PathBuf},
};

use anyhow::Result;
use clap::Args;
use serde_json::json;
use trueup_machine::{
    InputFileError, MachineFile,
    machine_file::{Feedback, LinearAxis, MachineKind, RotaryAxis},
    template::{CncControl, MachineTemplate, SensorDataSheet},
};

use crate::{
    CommandOutcome, UserError,
    choice::{by_name, named},
    input_files, output, questionnaire, report,
};

/// Writes a machine file to begin with: commented, and it compiles as it is.
///
/// On a terminal what no flag says is asked for; otherwise, or with --yes, the defaults are taken.
#[derive(Args)]
#[command(after_help = "Examples:
  trueup new
  trueup new -o mill.toml
  trueup new -o mill.toml --yes --name mill --travel x=0:600 --travel y=0:400 --travel z=-300:0 \\
      --sensor-um-per-v 50 --sensor-zero-v 1.54 --thermometer screw --control siemens
  trueup new -o lathe.toml --yes --kind lathe --travel x=0:150 --travel z=-400:0
  trueup new -o - --yes --kind head-head --head-axes c,a      on standard output")]
pub struct NewArgs {
    /// Where to write the machine file; `-` is standard output, without it the file is named after the machine. A file that
    /// is there is left alone.
    #[arg(long, value_name = "M.toml")]
    output: Option<PathBuf>,
    /// The machine's name.
    #[arg(long)]
    name: Option<String>,
    /// Which rotary axes carry the tool (head) and which the workpiece (table), or a lathe.
    #[arg(long, value_parser = by_name(MACHINE_KINDS, MachineKind::name))]
    kind: Option<MachineKind>,
    /// The rotary axes that carry the spindle, from the frame to the tool: c,a.
    #[arg(long, value_delimiter = ',', value_name = "AXES", value_parser = by_name(RotaryAxis::ALL, RotaryAxis::name))]
    head_axes: Option<Vec<RotaryAxis>>,
    /// An axis and the ends of its travel in mm, once for each: x=0:600. X of a lathe is a radius.
    #[arg(long, value_name = "AXIS=FROM:TO", value_parser = parse_axis_travel, allow_hyphen_values = true)]
    travel: Vec<(LinearAxis, [f64; 2])>,
    /// Where the positions are measured.
    #[arg(long, value_parser = by_name(Feedback::ALL, Feedback::name))]
    feedback: Option<Feedback>,
    /// The rapid traverse in mm/min.
    #[arg(long, value_name = "MM_PER_MIN", value_parser = questionnaire::parse_positive)]
    rapid: Option<f64>,
    /// The displacement sensor's µm for one volt, from its data sheet; without it there is none.
    #[arg(long, value_name = "UM", value_parser = questionnaire::parse_nonzero, allow_hyphen_values = true)]
    sensor_um_per_v: Option<f64>,
    /// The voltage at the sensor when the machine is cold, in V; by default half of its range.
    #[arg(long, value_name = "V", value_parser = questionnaire::parse_finite)]
    sensor_zero_v: Option<f64>,
    /// The sensor's output at the end of its range, in V; by default 10.
    #[arg(long, value_name = "V", value_parser = questionnaire::parse_positive)]
    sensor_volts: Option<f64>,
    /// A PT100 and where it is, once for each: screw.
    #[arg(long, value_name = "WHERE", value_parser = questionnaire::parse_column_word)]
    thermometer: Vec<String>,
    /// The control that gets the offsets.
    #[arg(long, value_parser = named(CNC_CONTROLS))]
    control: Option<CncControl>,
    /// Ask nothing.
    #[arg(long)]
    yes: bool,
}

const MACHINE_KINDS: [MachineKind; 5] = [
    MachineKind::ThreeAxis,
    MachineKind::HeadHead,
    MachineKind::HeadTable,
    MachineKind::TableTable,
    MachineKind::Lathe,
];

const CNC_CONTROLS: [(CncControl, &str); 4] = [
    (CncControl::LinuxCnc, "linuxcnc"),
    (CncControl::Siemens, "siemens"),
    (CncControl::Fanuc, "fanuc"),
    (CncControl::Heidenhain, "heidenhain"),
];

fn parse_axis_travel(text: &str) -> Result<(LinearAxis, [f64; 2]), String> {
    let (axis, range) = text.split_once('=').ok_or("must be an axis and its ends: x=0:600")?;
    let axis = LinearAxis::ALL
        .into_iter()
        .find(|candidate| candidate.name() == axis.trim().to_lowercase());
    Ok((axis.ok_or("the axis must be x, y or z")?, questionnaire::parse_travel(range)?))
}

/// Writes the file.
pub fn run(args: &NewArgs, as_json: bool) -> Result<CommandOutcome> {
    let requests =
        !args.yes && !as_json && stdin().is_terminal() && trueup_output::is_stdout_terminal();
    let template = template_from_flags(args)?;
    // Before anything is asked: answers are not to be lost.
    let is_name_missing = requests && args.output.is_none() && args.name.is_none();
    if !is_name_missing {
        check_new_file_path(&output_path(args, &template.name))?;
    }
    let check_name =
        |name: &str| check_new_file_path(&output_path(args, name)).map_err(|error| error.0);
    let template = match requests {
        true => questionnaire::run_questionnaire(
            template,
            &answered_questions_from_flags(args),
            &check_name,
        )?,
        false => template,
    };
    let path = output_path(args, &template.name);
    let is_stdout = output::is_standard_output(&path);
    let name = if is_stdout { "machine.toml".into() } else { path.to_string_lossy() };
    let text = template.to_toml(&name);
    // What cannot be, and no flag alone could show: a head with three axes, two thermometers of a name.
    MachineFile::parse(&text, &path).map_err(|InputFileError { rule, .. }| UserError(rule))?;
    input_files::check_machine_before_write(&text, &path, None)?;
    output::write_atomically(&path, &[], |out| out.write_all(text.as_bytes()))?;
    if as_json {
        output::print(json!({"output": name, "machine": template.name}))?;
    } else {
        output::print(format_args!("{name}: written; its last lines say what comes next"))?;
    }
    if template.axes.is_empty() {
        report::print_warning(
            "no axis was named: write [axis.x] with its travel_mm before you measure",
        );
    }
    Ok(CommandOutcome::Done)
}

/// Returns where the file goes: where the flag says, else in this folder, named after the machine.
fn output_path(args: &NewArgs, machine: &str) -> PathBuf {
    args.output.clone().unwrap_or_else(|| {
        let is_plain = |c: char| c.is_alphanumeric() || c == '-' || c == '_';
        let stem: String = machine.chars().map(|c| if is_plain(c) { c } else { '-' }).collect();
        format!("{}.toml", stem.to_lowercase()).into()
    })
}

/// Fails if a file cannot be written without harm to another one.
fn check_new_file_path(path: &Path) -> Result<(), UserError> {
    if output::is_standard_output(path) {
        return Ok(());
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let rule = match folder {
        _ if path.exists() => "is there already, and is left alone",
        Some(folder) if !folder.is_dir() => "its folder is not there",
        _ => return Ok(()),
    };
    Err(UserError(format!("{}: {rule}", path.display())))
}

/// Returns what needs no question.
fn answered_questions_from_flags(args: &NewArgs) -> questionnaire::AnsweredQuestions {
    questionnaire::AnsweredQuestions {
        name: args.name.is_some(),
        kind: args.kind.is_some(),
        head_axes: args.head_axes.is_some(),
        axes: !args.travel.is_empty(),
        feedback: args.feedback.is_some(),
        rapid: args.rapid.is_some(),
        sensor: args.sensor_um_per_v.is_some(),
        thermometers: !args.thermometer.is_empty(),
        control: args.control.is_some(),
    }
}

fn template_from_flags(args: &NewArgs) -> Result<MachineTemplate, UserError> {
    let kind = args.kind.unwrap_or(MachineKind::ThreeAxis);
    let mut axes = args.travel.clone();
    axes.sort_by_key(|(axis, _)| *axis);
    if let Some(pair) = axes.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        return Err(UserError(format!("--travel {} is given twice", pair[0].0.name())));
    }
    if kind == MachineKind::Lathe && axes.iter().any(|(axis, _)| *axis == LinearAxis::Y) {
        return Err(UserError("--travel y: a lathe is asked for X (radius) and Z; write [axis.y] yourself if it has one".into()));
    }
    let twice =
        |name: &&String| args.thermometer.iter().filter(|candidate| candidate == name).count() > 1;
    if let Some(name) = args.thermometer.iter().find(twice) {
        return Err(UserError(format!("--thermometer {name} is given twice")));
    }
    Ok(MachineTemplate {
        name: args.name.clone().unwrap_or_else(|| "machine".into()),
        kind,
        head_axes: args.head_axes.clone().unwrap_or_else(|| questionnaire::default_head_axes(kind)),
        axes,
        feedback: args.feedback.unwrap_or(Feedback::Screw),
        rapid_mm_per_min: args.rapid,
        sensor: args.sensor_um_per_v.map(|um_per_v| sensor_data_sheet(args, um_per_v)),
        thermometers: args.thermometer.clone(),
        control: args.control.unwrap_or(CncControl::LinuxCnc),
    })
}

fn sensor_data_sheet(args: &NewArgs, um_per_v: f64) -> SensorDataSheet {
    let volts_full_scale = args.sensor_volts.unwrap_or(10.0);
    let zero_v = args.sensor_zero_v.unwrap_or(volts_full_scale / 2.0);
    SensorDataSheet { volts_full_scale, um_per_v, zero_v }
}
