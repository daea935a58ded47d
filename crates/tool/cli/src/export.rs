//! `trueup export`: a machine file into what another control loads, with a report of how well.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::Result;
use clap::Args;
use serde_json::{Value, json};
use trueup_export::{
    ExportFormat, ExportOptions, ExportReport, ExportedTable, LengthUnit, OmittedSection, export,
    fanuc::FanucSeries,
};

use crate::{
    CommandOutcome, UserError,
    choice::described_choice_parser,
    input_files,
    machine_arg::MachineArg,
    output::{self, FileTransaction},
};

/// Turns a machine file into what another control loads, reads it back, and says how well it fits.
///
/// Exit 3: exported, but something was omitted or thinned, or differs by more than the control's rounding.
#[derive(Args)]
pub struct ExportArgs {
    #[command(flatten)]
    machine: MachineArg,
    /// The control that is to read the files.
    #[arg(long, value_parser = described_choice_parser(EXPORT_FORMATS))]
    format: ExportFormat,
    /// The folder for the files and report.txt; made if it is not there. Files of the same names
    /// are replaced.
    #[arg(long, value_name = "DIR")]
    output: PathBuf,
    /// The control's unit of length (Siemens, LinuxCNC).
    #[arg(long, default_value = "mm", value_parser = described_choice_parser(LENGTH_UNITS))]
    units: LengthUnit,
    /// The reference points, in mm: there Siemens and FANUC need a value of 0.
    #[arg(long, value_name = "x=0,y=0,z=0", value_delimiter = ',', allow_hyphen_values = true)]
    reference: Vec<String>,
    /// The travel of an axis, in mm. Default: the range of the model's tables.
    #[arg(long, value_name = "x=0:1000", value_delimiter = ',', allow_hyphen_values = true)]
    travel: Vec<String>,
    /// How near to the model the points of a curve keep the lines between them.
    #[arg(long, value_name = "UM", default_value_t = 0.1)]
    tolerance_um: f64,
    /// The most points of a table, where the control has fewer than its kind (828D: 200).
    #[arg(long, value_name = "N")]
    max_points: Option<usize>,
    /// FANUC's detection unit.
    #[arg(long, value_name = "UM", default_value_t = 1.0)]
    unit_um: f64,
    /// FANUC: 0 for the old Series 0, whose parameters are keyed in by hand; 0i for 0i and later.
    #[arg(long, value_name = "0", value_parser = ["0", "0i"], default_value = "0i")]
    series: String,
    /// Temperatures for the Siemens setting data. Default: each axis is at its reference.
    #[arg(long, value_name = "temp_x_c=30", value_delimiter = ',', allow_hyphen_values = true)]
    temperature: Vec<String>,
    /// The tool's growth for the Siemens setting data.
    #[arg(long, value_name = "UM", default_value_t = 0.0, allow_hyphen_values = true)]
    elongation_um: f64,
}

const EXPORT_FORMATS: [(ExportFormat, &str, &str); 5] = [
    (ExportFormat::Siemens840d, "siemens-840d", "Siemens SINUMERIK 840D sl"),
    (ExportFormat::Fanuc, "fanuc", "FANUC, stored pitch error compensation"),
    (ExportFormat::Heidenhain, "heidenhain", "HEIDENHAIN, .COM and .CMA"),
    (ExportFormat::LinuxCnc, "linuxcnc", "LinuxCNC, COMP_FILE"),
    (ExportFormat::Isg, "isg", "TwinCAT CNC (ISG kernel), volumetric compensation"),
];

const LENGTH_UNITS: [(LengthUnit, &str, &str); 2] = [
    (LengthUnit::Millimetres, "mm", "Positions and corrections in mm"),
    (LengthUnit::Inches, "inch", "Positions and corrections in inches of 25.4 mm"),
];

/// Exports the machine file into the folder.
pub fn run(args: &ExportArgs, as_json: bool) -> Result<CommandOutcome> {
    let file = args.machine.path();
    let machine = input_files::read_machine(file)?;
    let options = parse_options(args)?;
    let export = export(&machine, args.format, &options)
        .map_err(|refused| UserError(format!("{}: {refused}", file.display())))?;

    let folder = &args.output;
    fs::create_dir_all(folder).map_err(|error| {
        UserError(format!("{}: the folder cannot be created: {error}", folder.display()))
    })?;
    let report = report_json(&export.report, &export.files, folder);
    let text = format!("{}\n", export.report);
    let companions = [("report.txt", text), ("report.json", format!("{report:#}\n"))];
    let files = export.files.iter().map(|file| (file.name.as_str(), &file.text));
    let inputs = [file];
    let mut set = FileTransaction::new(&inputs);
    for (name, text) in files.chain(companions.iter().map(|(name, text)| (*name, text))) {
        set.add_text(&folder.join(name), text)?;
    }
    set.commit()?;
    if as_json {
        output::print(report)?;
    } else {
        let names: Vec<&str> = export.files.iter().map(|file| file.name.as_str()).collect();
        let folder = folder.display();
        output::print(format_args!(
            "{}\n{folder}: {}, report.txt, report.json",
            export.report,
            names.join(", ")
        ))?;
    }
    Ok(if export.report.is_complete() { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

fn parse_options(args: &ExportArgs) -> Result<ExportOptions, UserError> {
    let mut options = ExportOptions {
        units: args.units,
        tolerance_um: require_positive("--tolerance-um", args.tolerance_um)?,
        unit_um: require_positive("--unit-um", args.unit_um)?,
        fanuc: if args.series == "0" { FanucSeries::Zero } else { FanucSeries::I },
        most_points: args.max_points,
        elongation_um: require_finite("--elongation-um", args.elongation_um)?,
        ..ExportOptions::default()
    };
    if args.max_points.is_some_and(|points| points < 2) {
        return Err(UserError("--max-points must be at least 2: a table has two ends".to_string()));
    }
    for entry in &args.reference {
        let (axis, value) = split_axis_assignment("--reference", entry)?;
        options.reference_mm[axis] = parse_number("--reference", value)?;
    }
    for entry in &args.travel {
        let (axis, range) = split_axis_assignment("--travel", entry)?;
        let wrong =
            || UserError(format!("--travel {entry}: must be like x=0:1000, the smaller first"));
        let (first, last) = range.split_once(':').ok_or_else(wrong)?;
        let (first, last) = (parse_number("--travel", first)?, parse_number("--travel", last)?);
        if first >= last {
            return Err(wrong());
        }
        options.travel_mm[axis] = Some((first, last));
    }
    options.temperatures_c = parse_temperatures(&args.temperature)?;
    Ok(options)
}

fn parse_temperatures(entries: &[String]) -> Result<BTreeMap<String, f64>, UserError> {
    let each = entries.iter().map(|entry| {
        let (name, value) = entry
            .split_once('=')
            .ok_or_else(|| UserError(format!("--temperature {entry}: must be like temp_x_c=30")))?;
        Ok((name.trim().to_string(), parse_number("--temperature", value)?))
    });
    each.collect()
}

fn split_axis_assignment<'e>(option: &str, entry: &'e str) -> Result<(usize, &'e str), UserError> {
    let named = entry.split_once('=').and_then(|(name, value)| {
        let axis = ["x", "y", "z"].iter().position(|axis| name.trim() == *axis)?;
        Some((axis, value))
    });
    named.ok_or_else(|| UserError(format!("{option} {entry}: must begin with x=, y= or z=")))
}

fn parse_number(option: &str, text: &str) -> Result<f64, UserError> {
    let value =
        text.trim().parse().map_err(|_| UserError(format!("{option}: {text} is not a number")))?;
    require_finite(option, value)
}

fn require_finite(option: &str, value: f64) -> Result<f64, UserError> {
    if value.is_finite() { Ok(value) } else { Err(UserError(format!("{option} must be finite"))) }
}

fn require_positive(option: &str, value: f64) -> Result<f64, UserError> {
    if value > 0.0 {
        require_finite(option, value)
    } else {
        Err(UserError(format!("{option} must be above 0, not {value}")))
    }
}

fn report_json(
    report: &ExportReport,
    files: &[trueup_export::ExportedFile],
    folder: &Path,
) -> Value {
    let table = |table: &ExportedTable| {
        json!({
            "file": table.file,
            "name": table.name,
            "section": table.section,
            "points": table.points,
            "first": table.range.0,
            "last": table.range.1,
            "spacing": table.spacing,
            "constant_um": table.constant_um,
            "largest_difference_um": table.largest.um,
            "largest_difference_at": table.largest.at,
            "loss": table.loss,
        })
    };
    let omitted = |OmittedSection { section, reason }: &OmittedSection| json!({ "section": section, "reason": reason });
    json!({
        "format": report.format.name(),
        "machine": report.machine,
        "output": folder.to_string_lossy(),
        "files": files.iter().map(|file| &file.name).collect::<Vec<_>>(),
        "units": report.options.units.name(),
        "reference_mm": report.options.reference_mm,
        "tables": report.tables.iter().map(table).collect::<Vec<_>>(),
        "left_out": report.omitted.iter().map(omitted).collect::<Vec<_>>(),
        "notes": report.notes,
        "whole": report.is_complete(),
        "largest_difference_um": report.max_difference_um(),
    })
}
