//! `trueup fit circle`: the causes of circles as text, JSON and page.

use std::path::{Path, PathBuf};

use anyhow::Result;
use serde_json::{Map, Value, json};
use trueup_fit::{
    ResidualStatistics,
    circle::{
        self, CircleFinding, CircleReport, CircleResult, CircleVerdict, CircularDeviations,
        html_report::finding_title,
    },
};

use super::{args::CircleArgs, check_output_text, read_machine_with_source, report};
use crate::{CommandOutcome, input_files, output, provenance};

/// Fits, writes and prints.
pub fn run(args: &CircleArgs, as_json: bool) -> Result<CommandOutcome> {
    let measured = &args.common.measured;
    let machine = measured.machine.as_deref().map(read_machine_with_source).transpose()?;
    let of_file = machine.as_ref().map(|(_, _, machine)| machine);
    let runs = input_files::read_runs_for_fit(&measured.run, of_file)?;
    let report = circle::analyse_circles(&runs, of_file)?;
    report.warnings.iter().for_each(crate::report::print_warning);

    let inputs: Vec<&Path> =
        measured.run.iter().chain(&measured.machine).map(PathBuf::as_path).collect();
    let page =
        circle::build_circle_page(&report, &provenance::provenance_from_files(&inputs)?).to_html();
    let output = &args.common.output;
    let is_written = !report.edit.is_empty();
    let json = report_json(&report, is_written.then_some(output));
    // The machine file itself may be written over: that is what a user means who names it twice.
    let runs: Vec<&Path> = measured.run.iter().map(PathBuf::as_path).collect();
    let mut set = output::FileTransaction::new(&runs);
    if is_written {
        let text = match &machine {
            Some((path, source, _)) => report.edit.apply(source, path)?,
            None => report.edit.to_toml(),
        };
        check_output_text(of_file, &text, output)?;
        set.add_text(output, &text)?;
    }
    match &args.out {
        Some(folder) => {
            std::fs::create_dir_all(folder)?;
            set.add_text(&folder.join("report.html"), &page)?;
            set.add_text(&folder.join("circle.json"), &format!("{json:#}\n"))?;
        }
        None if output::is_standard_output(output) => {}
        None => set.add_text(&output.with_extension("html"), &page)?,
    }
    set.commit()?;
    if as_json {
        output::print(json)?;
    } else {
        output::print(circle_text(&report, output))?;
    }
    let is_met = report.verdict != CircleVerdict::Unexplained;
    Ok(if is_met { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

fn circle_text(report: &CircleReport, output: &Path) -> String {
    let mut lines = vec![format!("circle: {}", report.verdict.name())];
    for it in &report.circles {
        let record = &it.record;
        let [u, v] = record.centre_mm;
        lines.push(format!(
            "{}: radius {:.3} mm about ({u:.3}, {v:.3}) mm, {} readings",
            record.plane.name().to_uppercase(),
            record.radius_mm,
            record.rows.len()
        ));
        lines.push(format!("  {}", format_deviations(&it.figures)));
        for finding in &it.findings {
            let state = match (finding.claimed, finding.compensated) {
                (true, true) => "written",
                (true, false) => "not written",
                (false, _) => "not claimed",
            };
            let name = finding_title(finding);
            lines.push(format!("  {name} ({state}): {:.2} µm RMS", finding.rms_um));
            lines.extend(finding.parameters.iter().map(|parameter| format!("    {parameter}")));
            lines.extend(finding.evidence.iter().map(|evidence| format!("    {evidence}")));
            if !finding.alternatives.is_empty() {
                lines.push(format!("    or: {}", finding.alternatives.join(", ")));
            }
            if !finding.next_test.is_empty() {
                lines.push(format!("    next: {}", finding.next_test));
            }
        }
        let ResidualStatistics { rms_um, max_um } = it.before;
        lines.push(format!("  about the centre: {rms_um:.3} µm RMS, at most {max_um:.3} µm"));
        let ResidualStatistics { rms_um, max_um } = it.after;
        lines.push(format!("  without the causes: {rms_um:.3} µm RMS, at most {max_um:.3} µm"));
        if let Some(um) = it.structure_um {
            lines.push(format!("  structure is left: {um:.2} µm RMS that no cause explains"));
        }
        lines.extend(report::excluded_row_lines(&it.excluded));
    }
    lines.extend(report.written.iter().map(|written| format!("  {written}")));
    lines.push(report::describe_output(!report.edit.is_empty(), output));
    lines.join("\n")
}

fn format_deviations(figures: &CircularDeviations) -> String {
    let mut messages = Vec::new();
    let mut add = |name: &str, um: Option<f64>| {
        messages.extend(um.map(|um| format!("{name} {um:.2}")));
    };
    add("G ccw", figures.g_um[0]);
    add("G cw", figures.g_um[1]);
    add("G(b)", figures.g_both_um);
    add("H", figures.h_um);
    add("F max ccw", figures.f_max_um[0]);
    add("F min ccw", figures.f_min_um[0]);
    add("F max cw", figures.f_max_um[1]);
    add("F min cw", figures.f_min_um[1]);
    add("D", figures.d_um);
    format!("ISO 230-4, µm: {}", messages.join(", "))
}

fn report_json(report: &CircleReport, output: Option<&PathBuf>) -> Value {
    let findings = report.circles.iter().flat_map(|circle| &circle.findings).map(finding_json);
    json!({
        "schema": 1,
        "kind": "circle",
        "verdict": report.verdict.name(),
        "findings": findings.collect::<Vec<_>>(),
        "planes": report.circles.iter().map(circle_json).collect::<Vec<_>>(),
        "written": report.written,
        "warnings": report.warnings,
        "output": output.map(|path| path.to_string_lossy()),
    })
}

fn finding_json(it: &CircleFinding) -> Value {
    let parameters: Map<String, Value> = it
        .parameters
        .iter()
        .map(|parameter| {
            (parameter.name.clone(), json!({"value": parameter.value, "ci95": parameter.ci95}))
        })
        .collect();
    json!({
        "cause": it.cause.name(),
        "plane": it.plane.name(),
        "axis": it.axis.map(|axis| axis.name()),
        "along": it.along.map(|axis| axis.name()),
        "claimed": it.claimed,
        "compensated": it.compensated,
        "parameters": parameters,
        "rms_um": it.rms_um,
        "evidence": it.evidence,
        "alternatives": it.alternatives,
        "next_test": it.next_test,
    })
}

fn circle_json(it: &CircleResult) -> Value {
    let spread = |statistics: ResidualStatistics| json!({"rms_um": statistics.rms_um, "max_um": statistics.max_um});
    let both = |[ccw, cw]: [Option<f64>; 2]| json!({"ccw": ccw, "cw": cw});
    let record = &it.record;
    let figures = &it.figures;
    json!({
        "plane": record.plane.name(),
        "centre_mm": record.centre_mm,
        "radius_mm": record.radius_mm,
        "rows": record.rows.len(),
        "feed_mm_per_min": record.median_feed_mm_per_min(),
        "noise_um": it.noise_um,
        "before": spread(it.before),
        "after": spread(it.after),
        "structure_um": it.structure_um,
        "iso230_4": {
            "g_um": both(figures.g_um),
            "g_both_um": figures.g_both_um,
            "h_um": figures.h_um,
            "f_max_um": both(figures.f_max_um),
            "f_min_um": both(figures.f_min_um),
            "d_um": figures.d_um,
        },
        "causes": it.findings.iter().filter(|finding| finding.claimed).map(finding_title).collect::<Vec<_>>(),
        "set_aside": report::excluded_rows_json(&it.excluded),
    })
}
