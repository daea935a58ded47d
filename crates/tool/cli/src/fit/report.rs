//! The output of `trueup fit`.

use std::path::Path;

use anyhow::Result;
use serde_json::{Map, Value, json};
use trueup_fit::{ExcludedRow, FitReport, FitVerdict, ResidualStatistics, report::FitDetailValue};

use super::args::CommonArgs;
use crate::output;

/// Excluded rows that are printed one by one; all of them are in the JSON.
const MAX_LISTED_ROWS: usize = 20;

/// Prints what was found: warnings on standard error, the rest as text or JSON.
pub fn print(report: &FitReport, common: &CommonArgs, written: bool, as_json: bool) -> Result<()> {
    for warning in &report.warnings {
        crate::report::print_warning(warning);
    }
    if as_json {
        return output::print(report_json(report, common, written));
    }
    let mut lines = vec![match &report.verdict {
        FitVerdict::Fitted => format!("{} of {}: fitted", report.kind, report.column),
        FitVerdict::DoNotCompensate(_) => {
            format!("{} of {}: do not compensate", report.kind, report.column)
        }
    }];
    if let FitVerdict::DoNotCompensate(reasons) = &report.verdict {
        lines.extend(reasons.iter().map(|reason| format!("  {reason}")));
    }
    lines.extend(report.unmet.iter().map(|unmet| format!("  not reached: {unmet}")));
    for parameter in &report.parameters {
        lines.push(format!("  {parameter}"));
    }
    lines.extend(report.table.lines().map(|line| format!("  {line}")));
    // The table has them already, under the names of the field.
    let in_table = |name: &str| {
        !report.table.is_empty() && (name.starts_with("iso230_") || name.starts_with("compared"))
    };
    for fact in report.facts.iter().filter(|fact| !in_table(&fact.name)) {
        let value = match &fact.value {
            FitDetailValue::Number(number) => format!("{number:.4}"),
            FitDetailValue::Text(text) => text.clone(),
            FitDetailValue::Numbers(numbers) if numbers.len() <= MAX_LISTED_ROWS => {
                numbers.iter().map(|number| format!("{number:.3}")).collect::<Vec<_>>().join(" ")
            }
            FitDetailValue::Numbers(numbers) => {
                format!("{} values (--json has them)", numbers.len())
            }
        };
        lines.push(format!("  {}: {value}", fact.name));
    }
    let mut spread = |name: &str, spread: Option<ResidualStatistics>| {
        if let Some(ResidualStatistics { rms_um, max_um }) = spread {
            lines.push(format!("{name}: {rms_um:.3} µm RMS, at most {max_um:.3} µm"));
        }
    };
    spread("measured", report.before);
    spread("after the fit", report.in_sample);
    spread(&format!("on held-out rows ({})", report.held_out_by), report.held_out);
    lines.push(format!(
        "{} rows used, {} incomplete, {} excluded as outliers",
        report.rows_used,
        report.rows_incomplete,
        report.excluded.len()
    ));
    lines.extend(excluded_row_lines(&report.excluded));
    lines.push(describe_output(written, &common.output));
    output::print(lines.join("\n"))
}

/// Returns a line for each of the first excluded rows, and how many there are more.
pub fn excluded_row_lines(outliers: &[ExcludedRow]) -> Vec<String> {
    let mut lines: Vec<String> =
        outliers.iter().take(MAX_LISTED_ROWS).map(|row| format!("  {row}")).collect();
    if outliers.len() > MAX_LISTED_ROWS {
        lines.push(format!("  and {} more (--json lists them)", outliers.len() - MAX_LISTED_ROWS));
    }
    lines
}

/// Returns the last line: where it is written.
pub fn describe_output(is_written: bool, output: &Path) -> String {
    match is_written {
        true => format!("written to {}", output.display()),
        false => "nothing is written".into(),
    }
}

/// Returns the rows as they stand in JSON.
pub fn excluded_rows_json(outliers: &[ExcludedRow]) -> Vec<Value> {
    outliers
        .iter()
        .map(|row| {
            json!({
                "file": row.place.file.to_string_lossy(),
                "line": row.place.line,
                "column": row.place.column,
                "measured_um": row.measured_um,
                "reason": row.reason,
            })
        })
        .collect()
}

fn report_json(report: &FitReport, common: &CommonArgs, written: bool) -> Value {
    let spread = |spread: Option<ResidualStatistics>| match spread {
        Some(ResidualStatistics { rms_um, max_um }) => json!({"rms_um": rms_um, "max_um": max_um}),
        None => Value::Null,
    };
    let parameters: Map<String, Value> = report
        .parameters
        .iter()
        .map(|parameter| {
            let value = json!({"value": parameter.value, "ci95": parameter.ci95});
            (parameter.name.clone(), value)
        })
        .collect();
    let facts: Map<String, Value> = report
        .facts
        .iter()
        .map(|fact| {
            let value = match &fact.value {
                FitDetailValue::Number(number) => json!(number),
                FitDetailValue::Numbers(numbers) => json!(numbers),
                FitDetailValue::Text(text) => json!(text),
            };
            (fact.name.clone(), value)
        })
        .collect();
    let (verdict, reasons) = match &report.verdict {
        FitVerdict::Fitted => ("fitted", [].as_slice()),
        FitVerdict::DoNotCompensate(reasons) => ("do-not-compensate", reasons.as_slice()),
    };
    json!({
        "kind": report.kind,
        "column": report.column,
        "verdict": verdict,
        "reasons": reasons,
        "not_reached": report.unmet,
        "parameters": parameters,
        "facts": facts,
        "before": spread(report.before),
        "in_sample": spread(report.in_sample),
        "left_out": spread(report.held_out),
        "left_out_by": report.held_out_by,
        "rows_used": report.rows_used,
        "rows_incomplete": report.rows_incomplete,
        "set_aside": excluded_rows_json(&report.excluded),
        "warnings": report.warnings,
        "output": if written { json!(common.output.to_string_lossy()) } else { Value::Null },
    })
}
