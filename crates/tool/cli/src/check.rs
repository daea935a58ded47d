//! `trueup check`: what machine files and runs will do, and what in them is unlikely to be meant.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use serde_json::{Value, json};
use trueup_machine::{
    InputFileError, Machine, MachineFile, RunFile,
    check::{self, AxisSummary, MachineSummary, Warning},
    preprocessing::preprocess_run,
    run_file::is_known_column,
};

use crate::{CommandOutcome, input_files, output, report, run_reader, summary};

/// Says what machine files and run files will do, and what in them looks wrong.
///
/// A run is held against the machine file that is given with it.
///
/// Exit 3: something looks wrong. Exit 2: a value is impossible.
#[derive(Args)]
#[command(after_help = "Examples:
  trueup check mill/mill.toml
  trueup check mill/mill.toml mill/pitch-x.csv mill/warmup-off.csv
  trueup check mill/*.csv --machine mill/mill.toml --json")]
pub struct CheckArgs {
    /// Machine files (.toml) and run files.
    #[arg(value_name = "FILE", required_unless_present = "machine")]
    files: Vec<PathBuf>,
    /// The machine file that the runs are compared with; by default the only one among FILE. Without FILE it
    /// is checked itself.
    #[arg(long, value_name = "M.toml")]
    machine: Option<PathBuf>,
}

/// Checks each file.
pub fn run(args: &CheckArgs, as_json: bool) -> Result<CommandOutcome> {
    let is_named = |path: &PathBuf| args.files.is_empty() && args.machine.as_ref() == Some(path);
    let is_machine =
        |path: &&PathBuf| path.extension().is_some_and(|kind| kind == "toml") || is_named(path);
    let files = match &args.machine {
        Some(machine) if args.files.is_empty() => std::slice::from_ref(machine),
        _ => &args.files[..],
    };
    let (machines, run_files): (Vec<_>, Vec<_>) = files.iter().partition(is_machine);
    let only = match &machines[..] {
        [path] => Some(*path),
        _ => None,
    };
    let adjacent = match args.machine.as_ref().or(only) {
        Some(path) if !run_files.is_empty() => Some(MachineFile::read(path)?),
        _ => None,
    };
    let mut messages = Vec::new();
    let mut refused = Vec::new();
    let mut caveats = 0;
    for path in files {
        let (mut warnings, summary) = if is_machine(&path) {
            let machine = MachineFile::read(path)?;
            refused.extend(check::combine_rejected_findings(
                &check::list_implausible_values(&machine),
                &input_files::accepted_keys(),
            ));
            check_machine(path, &machine, as_json)?
        } else {
            let (run, mut reported) = preprocess_run(run_reader::read(path)?, adjacent.as_ref());
            refused.extend(check::combine_rejected_findings(
                &check::find_implausible_columns(&run, adjacent.as_ref(), &[]),
                &input_files::accepted_keys(),
            ));
            let (warnings, summary) = check_run(path, &run, adjacent.as_ref(), as_json)?;
            report::print_remarks(&check::run_remarks(&run));
            reported.extend(warnings);
            (reported, summary)
        };
        // Said once, as an error.
        let listed: Vec<InputFileError> =
            refused.iter().cloned().flat_map(InputFileError::into_single_errors).collect();
        warnings.retain(|warning| listed.iter().all(|error| error.place != warning.place));
        caveats += warnings.len();
        if as_json {
            let object = |warning: &Warning| {
                report::message_json(
                    "warning",
                    &warning.what,
                    Some(&warning.place),
                    Some(&warning.help),
                )
            };
            let warnings: Vec<Value> = warnings.iter().map(object).collect();
            messages.push(json!({
                "file": path.to_string_lossy(), "does": summary, "warnings": warnings
            }));
        } else {
            warnings.iter().for_each(report::print_located_warning);
        }
    }
    if as_json {
        output::print(Value::from(messages))?;
    }
    if let Some(refused) = InputFileError::combine(refused) {
        return Err(refused.into());
    }
    if !as_json {
        output::print(match caveats {
            0 => "nothing looks wrong".to_string(),
            1 => "1 thing looks wrong".to_string(),
            caveats => format!("{caveats} things look wrong"),
        })?;
    }
    Ok(if caveats == 0 { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

fn check_machine(path: &Path, machine: &Machine, as_json: bool) -> Result<(Vec<Warning>, Value)> {
    let mut warnings = check::machine_warnings(machine);
    let summary = MachineSummary::from_machine(machine);
    // Without [inputs] it is a file to predict with, and no board is meant.
    if let (Err(error), true) = (&summary.bytes, machine.inputs.is_some()) {
        warnings.push(Warning {
            place: error.place.clone(),
            what: format!("no board can run this: {}", error.rule),
            help: error.help.clone().unwrap_or_else(|| "`trueup compile` refuses it".into()),
        });
    }
    if !as_json {
        output::print(format_args!(
            "{}: {}",
            path.display(),
            summary::summary_text(machine, &summary)
        ))?;
    }
    Ok((warnings, summary_json(machine, &summary)))
}

fn summary_json(machine: &Machine, summary: &MachineSummary) -> Value {
    let axis = |axis: &AxisSummary| {
        let parts =
            axis.parts.iter().map(|part| json!({"key": part.key, "largest_um": part.largest_um}));
        let parts: Vec<Value> = parts.collect();
        json!({
            "axis": axis.axis.name(),
            "largest_um": axis.max_total_error_um(),
            "limit_um": axis.limit_um,
            "parts": parts,
        })
    };
    json!({
        "machine": machine.name,
        "kind": machine.kind.name(),
        "axes": summary.axes.iter().map(axis).collect::<Vec<Value>>(),
        "slew_um_per_s": summary.slew_um_per_s,
        "slowest_rapid_mm_per_min": summary.slowest_rapid_mm_per_min,
        "jumps_pass": summary.jumps_pass.iter().map(|axis| axis.name()).collect::<Vec<_>>(),
        "um_per_count": summary.sensor.map(|sensor| sensor.um_per_count),
        "um_per_code": summary.sensor.map(|sensor| sensor.um_per_code),
        "sensor_range_um": summary.sensor.map(|sensor| sensor.range_um),
        "board_bytes": summary.bytes.as_ref().ok(),
        "board_refuses": summary.bytes.as_ref().err().map(ToString::to_string),
        "board_bytes_most": summary.most_bytes,
    })
}

fn check_run(
    path: &Path,
    run: &RunFile,
    machine: Option<&Machine>,
    as_json: bool,
) -> Result<(Vec<Warning>, Value)> {
    let names = run.columns().iter().map(|column| column.name.as_str());
    let (known, others): (Vec<&str>, Vec<&str>) = names.partition(|name| is_known_column(name));
    if !as_json {
        let mut words =
            format!("{}: {} rows of {}", path.display(), run.row_count(), known.join(", "));
        if !others.is_empty() {
            words += &format!("; kept as possible explanations: {}", others.join(", "));
        }
        output::print(words)?;
    }
    let suggestions = check::suggest_condition_columns(run, machine);
    if !as_json {
        suggestions
            .iter()
            .try_for_each(|suggestion| output::print(format_args!("  {suggestion}")))?;
    }
    let does = json!({
        "rows": run.row_count(), "known_columns": known, "other_columns": others,
        "suggestions": suggestions,
    });
    Ok((check::run_warnings(run, machine), does))
}
