//! `report.html`: the answer for a person at the machine. One file, no script, nothing to load.

use std::fmt::Write as _;

use crate::{
    answer::{
        Diagnosis,
        figure::{Colour, Points, picture},
        report::{Finding, Report, Verdict},
    },
    data::Data,
};

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;max-width:54rem;margin:2rem auto;\
padding:0 1rem;color:#222}h1,h2,h3{line-height:1.2}table{border-collapse:collapse}td,th{padding:\
.2rem .8rem .2rem 0;text-align:left;vertical-align:top;border-bottom:1px solid #ddd}.verdict{\
padding:.8rem 1rem;background:#eef3fa;border-left:6px solid #1e5aaa}.grid{display:flex;flex-wrap:\
wrap}.b{color:#be5a28}.a{color:#1e5aaa}svg{max-width:100%;height:auto}";

pub(crate) fn html(diagnosis: &Diagnosis, machine_name: &str) -> String {
    let report = &diagnosis.report;
    let mut out = String::new();
    let title = format!("Diagnosis of {}", escaped(machine_name));
    let _ = write!(
        out,
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title>\
         <style>{STYLE}</style></head><body>\n<h1>{title}</h1>\n"
    );
    let _ = writeln!(
        out,
        "<div class=\"verdict\"><h2>{}</h2><p>{}</p></div>",
        report.verdict.name(),
        escaped(&verdict_sentence(diagnosis))
    );
    let _ = write!(
        out,
        "<h2>What was believed, and what the machine does</h2>\n<p>{} rows of <b>{}</b> were \
         compared. The machine file as it is leaves <span class=\"b\">{:.2} µm RMS</span> (largest \
         {:.2} µm){}. One reading has a noise of {:.2} µm: nothing can become better than that.</p>\n",
        report.rows_used,
        escaped(&report.quantity),
        report.before.rms_um,
        report.before.max_um,
        if report.findings.is_empty() {
            String::new()
        } else {
            format!(
                ", the extended one <span class=\"a\">{:.2} µm RMS</span> (largest {:.2} µm)",
                report.after.rms_um, report.after.max_um
            )
        },
        report.noise_um
    );
    pictures(diagnosis, &mut out);
    if !report.findings.is_empty() {
        out.push_str("<h2>Causes</h2>\n");
    }
    for finding in &report.findings {
        cause(finding, &mut out);
    }
    let _ = write!(
        out,
        "<h2>The gain on data that nothing was fitted to</h2>\n<table><tr><th></th><th>before</th>\
         <th>after</th><th>of it corrected by the board</th></tr><tr><td>RMS</td><td>{:.3} µm</td>\
         <td>{:.3} µm</td><td>{:.3} µm</td></tr></table>\n",
        report.before.holdout_rms_um,
        report.after.holdout_rms_um,
        report.after.compensated_holdout_rms_um
    );
    inputs(diagnosis, &mut out);
    if !report.reasons.is_empty() {
        out.push_str("<h2>Why this verdict</h2>\n<ul>\n");
        for reason in &report.reasons {
            let _ = writeln!(out, "<li>{}</li>", escaped(reason));
        }
        out.push_str("</ul>\n");
    }
    if !report.rejected.is_empty() {
        out.push_str(
            "<h2>Tried, and not taken</h2>\n<table><tr><th>cause</th><th>column</th><th>would \
             leave</th><th>left out</th><th>why not</th></tr>\n",
        );
        for rejected in &report.rejected {
            let left = rejected.left_out_um.map_or(String::new(), |um| format!("{um:.3} µm"));
            let _ = writeln!(
                out,
                "<tr><td>{}</td><td>{}</td><td>{:.3} µm</td><td>{left}</td><td>{}</td></tr>",
                rejected.cause,
                escaped(rejected.column.as_deref().unwrap_or("")),
                rejected.rms_um,
                escaped(&rejected.reason)
            );
        }
        out.push_str("</table>\n");
    }
    out.push_str("</body></html>\n");
    out
}

/// The verdict in a sentence.
pub(crate) fn verdict_sentence(diagnosis: &Diagnosis) -> String {
    let report = &diagnosis.report;
    let causes: Vec<&str> = report.findings.iter().map(|it| it.cause.as_str()).collect();
    match report.verdict {
        Verdict::Clean => clean_sentence(report),
        Verdict::TooLittleData => {
            "These rows are too few to tell an error that matters from noise.".into()
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
            let left_out: Vec<&str> = report.left_out.iter().map(|it| it.cause.as_str()).collect();
            format!(
                "What explains the runs makes the hold-out worse. Left out of extended.toml: {}.",
                left_out.join(", ")
            )
        }
        Verdict::DoNotCompensate => {
            "The machine does not repeat. A correction would make it worse: mend it first.".into()
        }
    }
}

fn clean_sentence(report: &Report) -> String {
    let found = format!(
        " An error above {:.2} µm RMS that repeats would have been found with 95 %.",
        report.detectable_um
    );
    let wandering = report.wandering.map_or("", |_| " that wanders slowly");
    format!(
        "Nothing is left but noise{wandering}.{} The machine file stays.",
        if report.detectable_um.is_finite() { found.as_str() } else { "" }
    )
}

fn pictures(diagnosis: &Diagnosis, out: &mut String) {
    let data = &diagnosis.data;
    let (x_name, x) = main_axis(data);
    let rows: Vec<usize> =
        (0..data.rows).filter(|&row| data.used[row] && !diagnosis.aside[row]).collect();
    let pick = |values: &[f64]| -> Vec<f64> { rows.iter().map(|&row| values[row]).collect() };
    let x = pick(&x);
    let measured = pick(&data.measured);
    let (before, after) = (pick(&diagnosis.before), pick(&diagnosis.after));
    let left = |p: &[f64]| -> Vec<f64> { measured.iter().zip(p).map(|(m, p)| m - p).collect() };
    let (left_before, left_after) = (left(&before), left(&after));
    let dots = |y, colour| Points { x: &x, y, colour, is_line: false };
    out.push_str(
        "<p>Measured (grey) and predicted before (<span class=\"b\">brown</span>) and \
                  after (<span class=\"a\">blue</span>):</p>\n",
    );
    out.push_str(&picture(
        &x_name,
        "µm",
        &[
            dots(&measured, Colour::Measured),
            dots(&before, Colour::Before),
            dots(&after, Colour::After),
        ],
        false,
    ));
    out.push_str("<p>What is left, measured minus predicted:</p>\n");
    out.push_str(&picture(
        &x_name,
        "µm",
        &[dots(&left_before, Colour::Before), dots(&left_after, Colour::After)],
        false,
    ));
}

/// A value of a cause for people: numbers to so many decimals, a list or a table as lines that wrap.
fn readable(value: &serde_json::Value, decimals: usize) -> String {
    use serde_json::Value;
    match value {
        Value::Null => String::new(),
        Value::Number(number) => format!("{:.decimals$}", number.as_f64().unwrap_or(f64::NAN)),
        Value::Array(items) => {
            let between = if items.iter().any(Value::is_object) { "<br>" } else { ", " };
            items.iter().map(|item| readable(item, 3)).collect::<Vec<_>>().join(between)
        }
        Value::Object(members) => {
            let known = members.iter().filter(|(_, value)| !value.is_null());
            let named = known.map(|(name, it)| format!("{}: {}", escaped(name), readable(it, 3)));
            named.collect::<Vec<_>>().join("<br>")
        }
        Value::String(text) => escaped(text),
        Value::Bool(_) => value.to_string(),
    }
}

/// What the pictures are over: time, else the position, else the row.
fn main_axis(data: &Data) -> (String, Vec<f64>) {
    let moving = data.own_position().filter(|_| data.run.is_some() || data.time_s.is_none());
    if let (Some(mm), Some(axis)) = (moving, data.quantity.axis()) {
        return (format!("{}, mm", axis.name()), mm.to_vec());
    }
    if let Some(times) = &data.time_s {
        return ("time, h".into(), times.iter().map(|t| t / 3600.0).collect());
    }
    ("row".into(), (0..data.rows).map(|row| row as f64 + 1.0).collect())
}

fn inputs(diagnosis: &Diagnosis, out: &mut String) {
    let data = &diagnosis.data;
    let rows: Vec<usize> =
        (0..data.rows).filter(|&row| data.used[row] && !diagnosis.aside[row]).collect();
    let left =
        |p: &[f64]| -> Vec<f64> { rows.iter().map(|&row| data.measured[row] - p[row]).collect() };
    let (before, after) = (left(&diagnosis.before), left(&diagnosis.after));
    let mut names: Vec<String> =
        ["time_s", "run", "x_mm", "y_mm", "z_mm", "spindle_rpm", "load_n"].map(String::from).into();
    names.extend(data.temperatures.iter().map(|(name, _)| name.clone()));
    names.extend(data.others.iter().map(|(name, _)| name.clone()));
    let mut all = String::new();
    let mut draw = |name: &str, x: &[f64]| {
        let lists = [
            Points { x, y: &before, colour: Colour::Before, is_line: false },
            Points { x, y: &after, colour: Colour::After, is_line: false },
        ];
        let _ = writeln!(all, "<div>{}</div>", picture(name, "left, µm", &lists, true));
    };
    for name in names {
        if let Some(values) = crate::columns::named(data, &name) {
            let x: Vec<f64> = rows.iter().map(|&row| values[row]).collect();
            draw(&name, &x);
        }
    }
    if let Some(direction) = data.own_direction() {
        let x: Vec<f64> = rows.iter().map(|&row| direction[row]).collect();
        draw("direction", &x);
    }
    let _ = write!(
        out,
        "<h2>What is left, against everything that was recorded</h2>\n<div class=\"grid\">{all}\
         </div>\n"
    );
}

fn cause(finding: &Finding, out: &mut String) {
    let state = match (finding.claimed, finding.compensated) {
        (true, true) => "compensated",
        (true, false) => "reported, not compensated",
        (false, true) => "compensated, but the cause is not settled",
        (false, false) => "not settled, not compensated",
    };
    let _ = write!(
        out,
        "<h3>{}{} <small>({state})</small></h3>\n<p>{}</p>\n",
        finding.cause,
        finding.column.as_ref().map_or(String::new(), |column| format!(": {}", escaped(column))),
        escaped(&finding.sentence)
    );
    out.push_str("<table>\n");
    for (name, parameter) in &finding.parameters {
        let value = &parameter["value"];
        let ci95 = &parameter["ci95"];
        let number = |value: &serde_json::Value| {
            value.as_f64().map_or_else(|| value.to_string(), |number| format!("{number:.5}"))
        };
        let interval = match (ci95.get(0).and_then(serde_json::Value::as_f64), ci95.get(1)) {
            (Some(low), Some(high)) => format!("95 %: {low:.5} … {}", number(high)),
            _ => String::new(),
        };
        let _ = writeln!(
            out,
            "<tr><td>{name}</td><td>{}</td><td>{interval}</td></tr>",
            readable(value, 5)
        );
    }
    let gain = &finding.gain;
    let _ = writeln!(
        out,
        "<tr><td>left out</td><td>{:.3} → {:.3} µm</td><td>{:.0} % less (95 %: {:.0} … {:.0} %)\
         </td></tr></table>",
        gain.left_out_before_um,
        gain.left_out_after_um,
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
            escaped(&rivals.join(", "))
        );
    }
    let _ = writeln!(out, "<p><b>To measure next:</b> {}</p>", escaped(&finding.next_test));
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
