//! `report.html`: the answer for a person at the machine. One file, no script, nothing to load.

use std::fmt::Write as _;

use trueup_page::{
    HtmlPage, NEXT_COMMANDS_HEADING, Provenance, commands_html, escape_html, format_micrometres,
    format_three_digits, format_with_interval,
};

use crate::{
    MISSING_INPUTS_INSTRUCTION,
    diagnosis::{
        Diagnosis,
        report::{DiagnosisReport, Finding, OmittedCause, Verdict, format_expected_reduction},
        report_plots::{write_prediction_plot, write_residual_plots},
    },
};

pub(crate) fn render_html(
    diagnosis: &Diagnosis,
    machine_name: &str,
    origin: &Provenance,
    next: &[String],
) -> String {
    let report = &diagnosis.report;
    let mut out = String::new();
    write_verdict(diagnosis, next, &mut out);
    let _ = write!(
        out,
        "<h2>What was believed, and what the machine does</h2>\n<p>{} rows of <b>{}</b> were \
         compared. The machine file as it is leaves <span class=\"before\">{} RMS</span> (largest {}){}. \
         {}</p>\n",
        report.rows_used,
        escape_html(&report.quantity),
        format_micrometres(report.before.rms_um),
        format_micrometres(report.before.max_um),
        if report.findings.is_empty() {
            String::new()
        } else {
            format!(
                "; with every cause below taken off, also what no board corrects, <span class=\"after\">{} RMS</span> \
                 (largest {}) are left",
                format_micrometres(report.after.rms_um),
                format_micrometres(report.after.max_um)
            )
        },
        noise_sentence(diagnosis)
    );
    write_prediction_plot(diagnosis, &mut out);
    if !report.findings.is_empty() {
        out.push_str("<h2>Causes</h2>\n");
    }
    for finding in &report.findings {
        write_finding(finding, &mut out);
    }
    write_error_comparison(diagnosis, &mut out);
    if !report.missing_inputs.is_empty() {
        let (what, lines) = (
            capitalise(MISSING_INPUTS_INSTRUCTION),
            escape_html(&report.missing_inputs.join("\n")),
        );
        let _ = writeln!(out, "<p>{what}:</p>\n<pre>{lines}</pre>");
    }
    write_list(&report.hints, &mut out);
    if report.holdout_used {
        out.push_str(
            "<p class=\"note\">The hold-out has chosen what is handed out: these are no longer figures \
             of data that nothing was chosen by.</p>\n",
        );
    }
    write_residual_plots(diagnosis, &mut out);
    if !report.rejected.is_empty() {
        out.push_str(
            "<h2>Tried, and not taken</h2>\n<div class=\"table\"><table><tr><th>cause</th><th>column</th><th>would \
             leave</th><th>held out</th><th>why not</th></tr>\n",
        );
        for rejected in &report.rejected {
            let left = rejected.left_out_um.map_or(String::new(), format_micrometres);
            let _ = writeln!(
                out,
                "<tr><td>{}</td><td>{}</td><td>{}</td><td>{left}</td><td>{}</td></tr>",
                rejected.cause,
                escape_html(rejected.column.as_deref().unwrap_or("")),
                format_micrometres(rejected.rms_um),
                escape_html(&rejected.reason)
            );
        }
        out.push_str("</table></div>\n");
    }
    let mut page = HtmlPage::new(&format!("Diagnosis of {machine_name}"));
    page.add_raw_html(&out);
    page.add_provenance_footer(origin);
    page.to_html()
}

/// Before and after: after is always with extended.toml on the board.
fn write_error_comparison(diagnosis: &Diagnosis, out: &mut String) {
    let report = &diagnosis.report;
    out.push_str("<h2>Before and after</h2>\n");
    if !diagnosis.has_corrections() {
        out.push_str("<p>Nothing is corrected: after is as before.</p>\n");
        return;
    }
    out.push_str(
        "<p>Before: the machine file as it is. After: extended.toml on the board, in its own arithmetic.</p>\n\
         <div class=\"table\"><table><tr><th>RMS</th><th>before</th><th>after</th></tr>",
    );
    for (of, before_um, after_um) in diagnosis.rms_errors_before_and_after() {
        let _ = write!(
            out,
            "<tr><td>{of}</td><td class=\"before\">{}</td><td class=\"after\">{}</td></tr>",
            format_micrometres(before_um),
            format_micrometres(after_um)
        );
    }
    let _ = writeln!(
        out,
        "</table></div>\n<p>The largest of these rows, after: {}.</p>\n<p>{}</p>",
        format_micrometres(report.after.compensated_max_um),
        escape_html(&expected_error_sentence(report))
    );
}

fn capitalise(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map(|first| first.to_uppercase().chain(letters).collect()).unwrap_or_default()
}

/// Returns what the tool may expect, in a sentence: the noise of the gauge is none of it.
fn expected_error_sentence(report: &DiagnosisReport) -> String {
    let at_tool = &report.at_tool;
    let readings = report.held_out.as_ref().map_or(String::new(), |held_out| {
        format!("A gauge on another day like these: {}. ", held_out.sentence())
    });
    format!(
        "{readings}At the tool, which has no noise of a gauge: {} RMS with the extended file on the board, in the \
         place of {} ({}).",
        format_micrometres(at_tool.after_um),
        format_micrometres(at_tool.before_um),
        format_expected_reduction(at_tool.reduction_floor95, at_tool.reduction)
    )
}

/// Returns what the noise of a reading is known from: repeats measure it, a row and its neighbour only bound it.
fn noise_sentence(diagnosis: &Diagnosis) -> String {
    let um = format_micrometres(diagnosis.report.noise_um);
    if diagnosis.noise_is_measured {
        format!("Repeats of one reading scatter by {um}: no model becomes better than that.")
    } else {
        format!("The scatter from row to row that no input explains is {um}.")
    }
}

/// The verdict in its colour, why it is so, and what must be known next to it.
fn write_verdict(diagnosis: &Diagnosis, next: &[String], out: &mut String) {
    let report = &diagnosis.report;
    let _ = writeln!(
        out,
        "<div class=\"card verdict {}\"><h2>{}</h2><p>{}</p><p class=\"soft\">Verdict: {}</p>",
        verdict_css_class(report.verdict),
        verdict_heading(report.verdict),
        escape_html(&verdict_sentence(diagnosis)),
        report.verdict.name()
    );
    write_list(&report.reasons, out);
    out.push_str(&commands_html(NEXT_COMMANDS_HEADING, next));
    out.push_str("</div>\n");
    write_list(&report.notes, out);
    let not_in = |finding: &&Finding| !finding.compensated;
    let left_out: Vec<String> = report
        .findings
        .iter()
        .filter(not_in)
        .map(|finding| {
            let column =
                finding.column.as_ref().map_or(String::new(), |column| format!(" {column}"));
            let dropped = |cause: &&OmittedCause| {
                cause.cause == finding.cause && cause.column == finding.column
            };
            let why = match (report.left_out.iter().find(dropped), finding.claimed) {
                (Some(_), _) => "the hold-out becomes worse by it",
                (None, true) => "a board cannot, or must not, correct it",
                (None, false) => "what fits as well corrects otherwise, or no board may correct it",
            };
            format!("{}{column}: {why}", finding.cause)
        })
        .collect();
    if !left_out.is_empty() {
        out.push_str("<p>The board does not correct:</p>\n");
        write_list(&left_out, out);
    }
}

/// Returns the verdict as a heading.
fn verdict_heading(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Clean => "The machine behaves as its file states",
        Verdict::Explained => "What the machine file gets wrong is explained",
        Verdict::PartlyExplained => "Part of what the machine file gets wrong is explained",
        Verdict::Unexplained => "The machine file is wrong, and the cause is not known",
        Verdict::DoNotCompensate => "Do not correct this machine: mend it first",
        Verdict::DoesNotTransfer => "What explains these runs does not hold on another day",
        Verdict::FallsShort => "The hold-out gains less than was promised",
        Verdict::TooLittleData => "There are too few readings for an answer",
    }
}

/// Green: nothing is to be done, or it is done; amber: something is open; red: not to be used.
fn verdict_css_class(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Clean | Verdict::Explained => "good",
        Verdict::PartlyExplained | Verdict::Unexplained | Verdict::TooLittleData => "open",
        Verdict::DoNotCompensate | Verdict::DoesNotTransfer | Verdict::FallsShort => "bad",
    }
}

fn write_list(sentences: &[String], out: &mut String) {
    if sentences.is_empty() {
        return;
    }
    out.push_str("<ul>\n");
    for sentence in sentences {
        let _ = writeln!(out, "<li>{}</li>", escape_html(sentence));
    }
    out.push_str("</ul>\n");
}

/// Returns the verdict in a sentence.
pub(crate) fn verdict_sentence(diagnosis: &Diagnosis) -> String {
    let report = &diagnosis.report;
    let causes: Vec<&str> = report.findings.iter().map(|cause| cause.cause.as_str()).collect();
    match report.verdict {
        Verdict::Clean => clean_verdict_sentence(report),
        Verdict::TooLittleData => {
            "These rows are too few to separate an error that matters from noise.".into()
        }
        Verdict::Explained => {
            format!("What the machine file gets wrong has a cause: {}.", causes.join(", "))
        }
        Verdict::PartlyExplained => format!(
            "Part of what the machine file gets wrong has a cause ({}); something is still open.",
            causes.join(", ")
        ),
        Verdict::Unexplained => {
            "The machine does something that the model does not know and that no cause here fits."
                .into()
        }
        Verdict::DoesNotTransfer => {
            let left_out: Vec<&str> = report.left_out.iter().map(|cause| cause.cause.as_str()).collect();
            format!(
                "The terms that explain the runs make the hold-out worse. Not in extended.toml: {}.",
                left_out.join(", ")
            )
        }
        Verdict::FallsShort => {
            "What was found gains less on the hold-out than these runs promise: do not rely on it there.".into()
        }
        Verdict::DoNotCompensate => {
            "The machine does not repeat. A correction would make it worse: mend it first.".into()
        }
    }
}

fn clean_verdict_sentence(report: &DiagnosisReport) -> String {
    let found = if report.detectable_um.is_finite() {
        format!(
            "An error above {} RMS that repeats would have been found with 95 %.",
            format_micrometres(report.detectable_um)
        )
    } else {
        "The smallest error that would have been found is not known: one as large as the residual could hide in it."
            .into()
    };
    let wandering = report.wandering.map_or("", |_| " that wanders slowly");
    format!("Nothing is left but noise{wandering}. {found} The machine file stays.")
}

/// Returns a value of a cause for people: numbers in three digits, a list or a table as lines that wrap.
fn format_value(value: &serde_json::Value) -> String {
    use serde_json::Value;
    match value {
        Value::Null => String::new(),
        Value::Number(number) => format_three_digits(number.as_f64().unwrap_or(f64::NAN)),
        Value::Array(items) => {
            let between = if items.iter().any(Value::is_object) { "<br>" } else { ", " };
            items.iter().map(format_value).collect::<Vec<_>>().join(between)
        }
        Value::Object(members) => {
            let known = members.iter().filter(|(_, value)| !value.is_null());
            let named = known
                .map(|(name, value)| format!("{}: {}", escape_html(name), format_value(value)));
            named.collect::<Vec<_>>().join("<br>")
        }
        Value::String(text) => escape_html(text),
        Value::Bool(_) => value.to_string(),
    }
}

fn write_finding(finding: &Finding, out: &mut String) {
    let state = match (finding.claimed, finding.compensated) {
        (true, true) => "compensated",
        (true, false) => "reported, not compensated",
        (false, true) => "compensated, but the cause is not settled",
        (false, false) => "not settled, not compensated",
    };
    let _ = write!(
        out,
        "<h3>{}</h3>\n<p class=\"soft\">Cause: {}{}; {state}</p>\n",
        escape_html(&finding.sentence),
        finding.cause,
        finding
            .column
            .as_ref()
            .map_or(String::new(), |column| format!(" of {}", escape_html(column)))
    );
    out.push_str("<div class=\"table\"><table>\n");
    for (name, parameter) in &finding.parameters {
        let value = &parameter["value"];
        let ci95 = &parameter["ci95"];
        let end = |number: usize| ci95.get(number).and_then(serde_json::Value::as_f64);
        let (value, interval) = match (value.as_f64(), end(0), end(1)) {
            (Some(value), Some(low), Some(high)) => {
                let [value, low, high] = format_with_interval(value, [low, high]);
                (value, format!("95 %: {low} … {high}"))
            }
            _ => (format_value(value), String::new()),
        };
        let _ = writeln!(out, "<tr><td>{name}</td><td>{value}</td><td>{interval}</td></tr>");
        if let Some(written) = parameter.get("written") {
            let written = format_value(written);
            let _ = writeln!(
                out,
                "<tr><td>{name}</td><td>{written}</td><td>written: fitted without the terms that \
                 are not written</td></tr>"
            );
        }
    }
    let gain = &finding.gain;
    let _ = writeln!(
        out,
        "<tr><td>held out</td><td>{} → {}</td><td>{:.0} % less (95 %: {:.0} … {:.0} %)\
         </td></tr></table></div>",
        format_micrometres(gain.left_out_before_um),
        format_micrometres(gain.left_out_after_um),
        100.0 * gain.reduction,
        100.0 * gain.ci95[0],
        100.0 * gain.ci95[1]
    );
    if !finding.rivals.is_empty() {
        let rivals: Vec<String> = finding
            .rivals
            .iter()
            .map(|rival| {
                let column = rival.column.as_ref().map_or(String::new(), |c| format!(" {c}"));
                format!("{}{column} ({:+.1})", rival.cause, rival.score_gap)
            })
            .collect();
        let _ = writeln!(
            out,
            "<p>In its place (how much worse, 6 and more is a clear difference): {}.</p>",
            escape_html(&rivals.join(", "))
        );
    }
    let _ = writeln!(out, "<p><b>To measure next:</b> {}</p>", escape_html(&finding.next_test));
}
