//! `trueup fit volume`: the errors of the volume as text and JSON.

use std::path::Path;

use anyhow::Result;
use serde_json::{Value, json};
use trueup_fit::volume::{
    self, VolumeFitOptions, VolumeReport, identifiability::ErrorAssessment, reading::ReadingKind,
};
use trueup_machine::{MachineFile, compile::compile};

use super::{args::VolumeArgs, check_output_text, report};
use crate::{CommandOutcome, input_files, output, provenance};

/// Fits, writes and prints.
pub fn run(args: &VolumeArgs, as_json: bool) -> Result<CommandOutcome> {
    let text = MachineFile::read_text(&args.machine)?;
    let machine = input_files::parse_machine(&text, &args.machine)?;
    let runs = input_files::read_runs_for_fit(&args.run, Some(&machine))?;
    let options = VolumeFitOptions {
        instrument_um: args.instrument_um,
        scale_um_per_m: args.scale_um_per_m,
        artefact_um: args.artefact_um,
    };
    let report = volume::fit(&runs, &machine, &options)?;
    report.warnings.iter().for_each(crate::report::print_warning);
    let is_written = !report.edit.is_empty();
    let inputs: Vec<&Path> =
        args.run.iter().chain([&args.machine]).map(std::path::PathBuf::as_path).collect();
    let page = volume::build_page(&report, &provenance::provenance_from_files(&inputs)?).to_html();
    // The machine file itself may be written over: that is what a user means who names it twice.
    let runs: Vec<&Path> = args.run.iter().map(std::path::PathBuf::as_path).collect();
    let mut set = output::FileTransaction::new(&runs);
    if is_written {
        let text = report.edit.apply(&text, &args.machine)?;
        check_output_text(Some(&machine), &text, &args.output)?;
        warn_compile_refusal(&text, &args.output);
        set.add_text(&args.output, &text)?;
    }
    if !output::is_standard_output(&args.output) {
        set.add_text(&args.output.with_extension("html"), &page)?;
    }
    set.commit()?;
    if as_json {
        output::print(volume_json(&report, is_written.then_some(args.output.as_path())))?;
    } else {
        output::print(volume_text(&report, &args.output))?;
    }
    Ok(if is_written { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

/// Says that no board takes the file, where that is so: the file is right all the same.
fn warn_compile_refusal(text: &str, path: &Path) {
    let compiled = MachineFile::parse(text, path).map(|machine| compile(&machine).map(drop));
    if let Ok(Err(error)) = compiled {
        crate::report::print_warning(format_args!(
            "trueup compile will refuse {}: {error}",
            path.display()
        ));
    }
}

fn volume_text(report: &VolumeReport, output: &Path) -> String {
    let known = report.known.iter().filter(|assessment| assessment.is_known).count();
    let acting = report.known.iter().filter(|assessment| assessment.acts).count();
    let mut lines = vec![format!("volume: {known} of {acting} errors are known")];
    for kind in ReadingKind::ALL {
        if let Some(um) = report.noise_um[kind.index()] {
            let count = report.readings[kind.index()];
            lines.push(format!("  {count} readings, {}: noise {um:.2} µm", kind.name()));
        }
    }
    lines.extend(report.known.iter().map(error_line));
    let held_out = report.held_out;
    if held_out.readings > 0 {
        lines.push(format!(
            "held-out readings: {:.2} µm RMS with the file as it is, {:.2} µm with the constants of the others",
            held_out.before_um, held_out.after_um
        ));
    }
    lines.extend(report::excluded_row_lines(&report.excluded));
    if report.edit.is_empty() {
        lines.push(rejection_reason(report).into());
    }
    lines.push(report::describe_output(!report.edit.is_empty(), output));
    lines.join("\n")
}

/// Returns why nothing is written.
fn rejection_reason(report: &VolumeReport) -> &'static str {
    match (report.held_out.readings, report.has_significant_improvement()) {
        (0, _) => {
            "no reading could be held out: each set-up has fewer than 12. Measure more places in one set-up"
        }
        (_, false) => {
            "no correction is better on held-out readings by more than the standard error"
        }
        (_, true) => "no error is large enough",
    }
}

fn error_line(it: &ErrorAssessment) -> String {
    let unit = it.error.unit();
    let mut line = format!("  {:<5}", it.error.to_string());
    if !it.acts {
        return line + "does not move the tip here";
    }
    let what = if it.error.motion_axis().is_some() { "range " } else { "" };
    line += &format!("{what}{:.2} ± {:.2} {unit}", it.size, it.half_width);
    if !it.is_known {
        line += "; not known by itself";
        if !it.confused_with.is_empty() {
            line += &format!(": looks the same as {}", it.confused_with.join(", "));
        }
        line += &format!("\n         next: {}", it.next_test);
    }
    line
}

fn volume_json(report: &VolumeReport, output: Option<&Path>) -> Value {
    let error = |assessment: &ErrorAssessment| {
        json!({
            "error": assessment.error.to_string(),
            "key": assessment.error.machine_file_key(),
            "unit": assessment.error.unit(),
            "along": assessment.error.motion_axis().map(|axis| axis.name()),
            "acts": assessment.acts,
            "known": assessment.is_known,
            "claimed": assessment.is_known && assessment.is_there,
            "compensated": report.written.contains(&assessment.error),
            "size": assessment.size,
            "half_width95": assessment.half_width,
            "open": assessment.open,
            "confused_with": assessment.confused_with,
            "next_test": assessment.next_test,
        })
    };
    let kinds = ReadingKind::ALL.iter().filter_map(|kind| {
        let um = report.noise_um[kind.index()]?;
        let readings = report.readings[kind.index()];
        Some(json!({"kind": kind.name(), "readings": readings, "noise_um": um}))
    });
    json!({
        "schema": 1,
        "kind": "volume",
        "errors": report.known.iter().map(error).collect::<Vec<_>>(),
        "readings": kinds.collect::<Vec<_>>(),
        "held_out": {
            "readings": report.held_out.readings,
            "before_um": report.held_out.before_um,
            "after_um": report.held_out.after_um,
        },
        "set_aside": report::excluded_rows_json(&report.excluded),
        "warnings": report.warnings,
        "output": output.map(Path::to_string_lossy),
    })
}
