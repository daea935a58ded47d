//! The page of the demonstration: first what is wrong and what to do, then pictures, then tables.

use trueup_diagnose::{Diagnosis, Verdict, report::Finding};
use trueup_page::{
    BarChart, Chart, ChartSeries, ColourRole, HtmlPage, HtmlTable, choose_time_unit,
    format_micrometres, format_three_digits,
};

use crate::{
    console_text,
    hidden_fault_demo::HiddenFaultResult,
    measured_run_demo::{MeasuredRunResult, ReadingResult},
};

/// A difference of BIC from which two causes are clearly distinguished.
const STRONG_EVIDENCE_BIC_DIFFERENCE: f64 = 6.0;
/// A table shows no more rows than that.
const MAX_TABLE_ROWS: usize = 40;

/// Returns the page of one act or both.
#[must_use]
pub fn render_page(one: &MeasuredRunResult, two: Option<&HiddenFaultResult>) -> String {
    let mut page = HtmlPage::new(&format!(
        "What is wrong with {}, and what a bridge makes of it",
        one.machine
    ));
    add_measured_run_section(&mut page, one);
    if let Some(two) = two {
        add_hidden_fault_section(&mut page, two);
    }
    page.to_html()
}

/// Returns the picture of act two alone, for a page of text: the error at the tool on another day.
#[must_use]
pub fn render_hidden_fault_svg(two: &HiddenFaultResult) -> String {
    second_day_chart(two).to_standalone_svg()
}

fn add_hidden_fault_section(page: &mut HtmlPage, two: &HiddenFaultResult) {
    let it = &two.outcome;
    page.add_heading(&format!("A hidden fault, seed {}", it.seed));
    page.add_paragraph(&format!(
        "Chance has broken a virtual machine tool ({}), and the diagnosis does not know how. The bridge ran a \
         shift with the file that its user believes; its own record next to a gauge was diagnosed, the \
         extended file loaded over the line, and the machine ran another day.",
        it.machine
    ));
    page.add_key_figures(&[
        (
            format_micrometres(it.tool_rms_before_um),
            "RMS error at the tool, as it was".into(),
            "before",
        ),
        (format_micrometres(it.tool_rms_after_um), "with what was found".into(), "after"),
        (
            format!("{:.0} %", 100.0 * it.reduction),
            format!("less; promised: {:.0} %", 100.0 * it.promised_reduction),
            "",
        ),
    ]);
    add_verdict(page, &two.diagnosis);
    page.add_charts(&[
        second_day_chart(two).to_figure(),
        true_and_predicted_effect_chart(two).to_figure(),
    ]);
    page.add_subheading("The envelope opened");
    let mut table = HtmlTable::new(&["hidden", "size", "named by", "found", "value", "95 %"]);
    for fault in &it.faults {
        let mut cells =
            vec![fault.fault.to_string(), format!("{:.1}", fault.ratio), fault.causes.join(" or ")];
        let finding =
            it.findings.iter().find(|finding| fault.causes.contains(&finding.cause.as_str()));
        cells.extend(match finding {
            None => ["not found".to_string(), "–".into(), "–".into()],
            Some(finding) => {
                let first = finding
                    .parameters
                    .iter()
                    .find(|(_, parameter)| parameter["ci95"][0].is_number());
                let number = |value: &serde_json::Value| {
                    value.as_f64().map_or("–".into(), format_three_digits)
                };
                let (value, interval) =
                    first.map_or(("–".into(), "–".into()), |(name, parameter)| {
                        let ends = [0, 1].map(|end| number(&parameter["ci95"][end]));
                        (format!("{name} {}", number(&parameter["value"])), ends.join(" … "))
                    });
                [console_text::format_finding_name(finding), value, interval]
            }
        });
        table.add_row(&cells);
    }
    page.add_table(&table);
    page.add_note("Size: RMS of what the fault does, over that of the noise.");
    page.add_paragraph(&it.describe_outcome());
    add_findings(page, &it.findings);
    page.add_note(&format!(
        "The machine's clock ran {:.0} times as fast as the board's, and the time constants in the \
         calibration were as much shorter; {:.0} s of board time. Each fault is at least three times the \
         noise, and the nearest rival law is worse by {:.0} (difference of BIC), reckoned from what the \
         faults really do. This repeats it: cargo demo -- --seed {}",
        it.faster, it.board_s, it.gap, it.seed
    ));
    page.add_list(&two.notes);
}

fn second_day_chart(two: &HiddenFaultResult) -> Chart {
    let (x, seconds) = choose_time_axis(&two.second_day);
    let points = |of: usize| two.second_day.iter().map(|row| [row[0] / seconds, row[of]]).collect();
    Chart {
        title: "Error at the tool on another day".into(),
        x,
        y: "error, µm".into(),
        series: vec![
            ChartSeries::dots("as it was", ColourRole::Before, points(1)),
            ChartSeries::dots("with what was found", ColourRole::After, points(2)),
        ],
    }
}

fn true_and_predicted_effect_chart(two: &HiddenFaultResult) -> Chart {
    let (x, seconds) = choose_time_axis(&two.envelope);
    let points = |of: usize| two.envelope.iter().map(|row| [row[0] / seconds, row[of]]).collect();
    Chart {
        title: "What was hidden in the first day, and what was found of it".into(),
        x,
        y: "µm".into(),
        series: vec![
            ChartSeries::dots("hidden", ColourRole::Truth, points(1)),
            ChartSeries::dots("found", ColourRole::After, points(2)),
        ],
    }
}

fn choose_time_axis(rows: &[[f64; 3]]) -> (String, f64) {
    let (unit, seconds) = choose_time_unit(rows.last().map_or(0.0, |row| row[0]));
    (format!("time, {unit}"), seconds)
}

fn add_measured_run_section(page: &mut HtmlPage, one: &MeasuredRunResult) {
    add_verdict(page, &one.diagnosis);
    page.add_key_figures(&[
        (
            format_micrometres(one.before.rms_um),
            "RMS error, the machine file as it is".into(),
            "before",
        ),
        (
            format_micrometres(one.after.rms_um),
            "RMS error, extended, on readings that nothing was fitted to".into(),
            "after",
        ),
        (format_micrometres(one.after.max_um), "the largest of these".into(), "after"),
    ]);
    page.add_note(&format!(
        "Read from {} frames of the board as a CNC reads them, {} damaged or lost, in {:.0} s of board time.",
        one.frames[0], one.frames[1], one.board_s
    ));
    page.add_list(&one.notes);
    page.add_charts(&render_measured_run_charts(one));
    add_findings(page, &one.diagnosis.report.findings);
    let mut table = HtmlTable::new(&[
        "measured, µm",
        "bridge as it is",
        "error left",
        "extended",
        "error left",
    ]);
    for row in one.rows.iter().step_by(one.rows.len().div_ceil(MAX_TABLE_ROWS).max(1)) {
        table.add_row(&[
            format!("{:.1}", row.dial_um),
            format!("{:.2}", row.bridge_um),
            format!("{:+.2}", row.residual_um()),
            format!("{:.2}", row.calibrated_um),
            format!("{:+.2}", row.extended_residual_um()),
        ]);
    }
    page.add_heading("Reading by reading");
    page.add_table(&table);
}

/// Adds the verdict and what to do, in a card of its colour.
pub(crate) fn add_verdict(page: &mut HtmlPage, diagnosis: &Diagnosis) {
    let report = &diagnosis.report;
    let state = match report.verdict {
        Verdict::Clean | Verdict::Explained => "good",
        Verdict::PartlyExplained | Verdict::Unexplained | Verdict::TooLittleData => "open",
        Verdict::DoNotCompensate | Verdict::DoesNotTransfer | Verdict::FallsShort => "bad",
    };
    let mut sentences = vec![diagnosis.sentence()];
    sentences.extend(report.findings.iter().map(|finding| finding.sentence.clone()));
    sentences.extend(report.hints.iter().cloned());
    let mut heading = report.verdict.name().replace('-', " ");
    heading[..1].make_ascii_uppercase();
    page.add_card(state, &heading, &sentences);
}

fn render_measured_run_charts(one: &MeasuredRunResult) -> Vec<String> {
    let (x, at) = &one.over;
    let series = |name: &str, colour, of: fn(&ReadingResult) -> f64| {
        let points = at.iter().zip(&one.rows).map(|(at, row)| [*at, of(row)]).collect();
        ChartSeries::dots(name, colour, points)
    };
    let chart = |title: &str, y: &str, series| {
        Chart { title: title.into(), x: x.clone(), y: y.into(), series }.to_figure()
    };
    vec![
        chart(
            "Error that the bridge leaves",
            "error, µm",
            vec![
                series("as it is", ColourRole::Before, ReadingResult::residual_um),
                series("extended", ColourRole::After, ReadingResult::extended_residual_um),
            ],
        ),
        chart(
            "What was measured, and what the bridge says",
            "µm",
            vec![
                series("measured", ColourRole::Measured, |row| row.dial_um),
                series("as it is", ColourRole::Before, |row| row.bridge_um),
                series("extended", ColourRole::After, |row| row.calibrated_um),
            ],
        ),
    ]
}

/// Each finding with its values, its rivals as bars, and the measurement that comes next.
pub(crate) fn add_findings(page: &mut HtmlPage, findings: &[Finding]) {
    for finding in findings {
        let open = if finding.claimed { "" } else { " (not settled)" };
        page.add_subheading(&format!("{}{open}", console_text::format_finding_name(finding)));
        page.add_list(&finding.evidence);
        let mut table = HtmlTable::new(&["", "value", "95 %"]);
        for (name, parameter) in &finding.parameters {
            if let Some(value) = parameter["value"].as_f64() {
                let end = |index: usize| {
                    parameter["ci95"][index].as_f64().map_or("–".into(), format_three_digits)
                };
                table.add_row(&[
                    name.clone(),
                    format_three_digits(value),
                    format!("{} … {}", end(0), end(1)),
                ]);
            }
        }
        page.add_table(&table);
        let mut bars: Vec<(String, f64)> = finding
            .rivals
            .iter()
            .map(|rival| {
                let column =
                    rival.column.as_ref().map_or(String::new(), |column| format!(" {column}"));
                (format!("{}{column}", rival.cause), rival.score_gap)
            })
            .collect();
        bars.sort_by(|a, b| a.1.total_cmp(&b.1));
        bars.truncate(5);
        let title = "How much worse another cause explains the same readings (difference of BIC; from 6 \
                     on it is clear)";
        page.add_charts(&[BarChart {
            title: title.into(),
            bars,
            clear: STRONG_EVIDENCE_BIC_DIFFERENCE,
        }
        .to_figure()]);
        page.add_paragraph(&format!("To measure next: {}", finding.next_test));
    }
}
