//! The page of the demonstration: first what is wrong and what to do, then pictures, then tables.

use trueup_diagnose::{Diagnosis, Verdict, report::Finding};
use trueup_page::{Bars, Chart, Colour, Page, Series, Table, micrometres, significant, time_unit};

use crate::{act_one::ActOne, act_two::ActTwo, say};

/// A difference of BIC from which two causes are clearly distinguished.
const CLEAR: f64 = 6.0;
/// A table shows no more rows than that.
const MAX_ROWS: usize = 40;

/// Returns the page of one act or both.
#[must_use]
pub fn page(one: &ActOne, two: Option<&ActTwo>) -> String {
    let mut page =
        Page::new(&format!("What is wrong with {}, and what a bridge makes of it", one.machine));
    of_act_one(&mut page, one);
    if let Some(two) = two {
        of_act_two(&mut page, two);
    }
    page.html()
}

/// Returns the picture of act two alone, for a page of text: the error at the tool on another day.
#[must_use]
pub fn picture_of_act_two(two: &ActTwo) -> String {
    second_day(two).standalone()
}

fn of_act_two(page: &mut Page, two: &ActTwo) {
    let it = &two.outcome;
    page.heading(&format!("A hidden fault, seed {}", it.seed));
    page.text(&format!(
        "Chance has broken a virtual machine tool ({}), and the diagnosis is not told how. The bridge ran a \
         shift with the file that its user believes; its own record beside a gauge was diagnosed, the \
         extended file loaded over the line, and the machine ran another day.",
        it.machine
    ));
    page.figures(&[
        (micrometres(it.tool_rms_before_um), "RMS error at the tool, as it was".into(), "before"),
        (micrometres(it.tool_rms_after_um), "with what was found".into(), "after"),
        (
            format!("{:.0} %", 100.0 * it.reduction),
            format!("less; promised: {:.0} %", 100.0 * it.promised_reduction),
            "",
        ),
    ]);
    verdict(page, &two.diagnosis);
    page.pictures(&[second_day(two).figure(), envelope(two).figure()]);
    page.subheading("The envelope opened");
    let mut table = Table::new(&["hidden", "size", "named by", "found", "value", "95 %"]);
    for fault in &it.faults {
        let mut cells =
            vec![fault.fault.to_string(), format!("{:.1}", fault.ratio), fault.causes.join(" or ")];
        let finding = it.findings.iter().find(|it| fault.causes.contains(&it.cause.as_str()));
        cells.extend(match finding {
            None => ["not found".to_string(), "–".into(), "–".into()],
            Some(finding) => {
                let first = finding.parameters.iter().find(|(_, it)| it["ci95"][0].is_number());
                let number =
                    |value: &serde_json::Value| value.as_f64().map_or("–".into(), significant);
                let (value, interval) = first.map_or(("–".into(), "–".into()), |(name, it)| {
                    let ends = [0, 1].map(|end| number(&it["ci95"][end]));
                    (format!("{name} {}", number(&it["value"])), ends.join(" … "))
                });
                [say::name(finding), value, interval]
            }
        });
        table.row(&cells);
    }
    page.table(&table);
    page.note("Size: RMS of what the fault does, over that of the noise.");
    page.text(&it.judgement());
    causes(page, &it.findings);
    page.note(&format!(
        "The machine's clock ran {:.0} times as fast as the board's, and the time constants in the \
         calibration were as much shorter; {:.0} s of board time. Each fault is at least three times the \
         noise, and the nearest rival law is worse by {:.0} (difference of BIC), reckoned from what the \
         faults really do. This repeats it: cargo demo -- --seed {}",
        it.faster, it.board_s, it.gap, it.seed
    ));
    page.list(&two.notes);
}

fn second_day(two: &ActTwo) -> Chart {
    let (x, seconds) = time_axis(&two.second_day);
    let points = |of: usize| two.second_day.iter().map(|row| [row[0] / seconds, row[of]]).collect();
    Chart {
        title: "Error at the tool on another day".into(),
        x,
        y: "error, µm".into(),
        series: vec![
            Series::dots("as it was", Colour::Before, points(1)),
            Series::dots("with what was found", Colour::After, points(2)),
        ],
    }
}

fn envelope(two: &ActTwo) -> Chart {
    let (x, seconds) = time_axis(&two.envelope);
    let points = |of: usize| two.envelope.iter().map(|row| [row[0] / seconds, row[of]]).collect();
    Chart {
        title: "What was hidden in the first day, and what was found of it".into(),
        x,
        y: "µm".into(),
        series: vec![
            Series::dots("hidden", Colour::Truth, points(1)),
            Series::dots("found", Colour::After, points(2)),
        ],
    }
}

fn time_axis(rows: &[[f64; 3]]) -> (String, f64) {
    let (unit, seconds) = time_unit(rows.last().map_or(0.0, |row| row[0]));
    (format!("time, {unit}"), seconds)
}

fn of_act_one(page: &mut Page, one: &ActOne) {
    verdict(page, &one.diagnosis);
    page.figures(&[
        (micrometres(one.before.rms_um), "RMS error, the machine file as it is".into(), "before"),
        (
            micrometres(one.after.rms_um),
            "RMS error, extended, on readings that nothing was fitted to".into(),
            "after",
        ),
        (micrometres(one.after.max_um), "the largest of these".into(), "after"),
    ]);
    page.note(&format!(
        "Read from {} frames of the board as a CNC reads them, {} damaged or lost, in {:.0} s of board time.",
        one.frames[0], one.frames[1], one.board_s
    ));
    page.list(&one.notes);
    page.pictures(&pictures(one));
    causes(page, &one.diagnosis.report.findings);
    let mut table =
        Table::new(&["measured, µm", "bridge as it is", "off by", "extended", "off by"]);
    for row in one.rows.iter().step_by(one.rows.len().div_ceil(MAX_ROWS).max(1)) {
        table.row(&[
            format!("{:.1}", row.dial_um),
            format!("{:.2}", row.bridge_um),
            format!("{:+.2}", row.bridge_um - row.dial_um),
            format!("{:.2}", row.calibrated_um),
            format!("{:+.2}", row.calibrated_um - row.dial_um),
        ]);
    }
    page.heading("Reading by reading");
    page.table(&table);
}

/// Adds the verdict and what to do, in a card of its colour.
pub(crate) fn verdict(page: &mut Page, diagnosis: &Diagnosis) {
    let report = &diagnosis.report;
    let state = match report.verdict {
        Verdict::Clean | Verdict::Explained => "good",
        Verdict::PartlyExplained | Verdict::Unexplained | Verdict::TooLittleData => "open",
        Verdict::DoNotCompensate | Verdict::DoesNotTransfer | Verdict::FallsShort => "bad",
    };
    let mut sentences = vec![diagnosis.sentence()];
    sentences.extend(report.findings.iter().map(|it| it.sentence.clone()));
    sentences.extend(report.hints.iter().cloned());
    let mut heading = report.verdict.name().replace('-', " ");
    heading[..1].make_ascii_uppercase();
    page.card(state, &heading, &sentences);
}

fn pictures(one: &ActOne) -> Vec<String> {
    let (x, at) = &one.over;
    let series = |name: &str, colour, of: fn(&crate::act_one::Row) -> f64| {
        let points = at.iter().zip(&one.rows).map(|(at, row)| [*at, of(row)]).collect();
        Series::dots(name, colour, points)
    };
    let chart = |title: &str, y: &str, series| {
        Chart { title: title.into(), x: x.clone(), y: y.into(), series }.figure()
    };
    vec![
        chart(
            "Error that the bridge leaves",
            "error, µm",
            vec![
                series("as it is", Colour::Before, |row| row.dial_um - row.bridge_um),
                series("extended", Colour::After, |row| row.dial_um - row.calibrated_um),
            ],
        ),
        chart(
            "What was measured, and what the bridge says",
            "µm",
            vec![
                series("measured", Colour::Measured, |row| row.dial_um),
                series("as it is", Colour::Before, |row| row.bridge_um),
                series("extended", Colour::After, |row| row.calibrated_um),
            ],
        ),
    ]
}

/// Each finding with its values, its rivals as bars, and the measurement that comes next.
pub(crate) fn causes(page: &mut Page, findings: &[Finding]) {
    for finding in findings {
        let open = if finding.claimed { "" } else { " (not settled)" };
        page.subheading(&format!("{}{open}", say::name(finding)));
        page.list(&finding.evidence);
        let mut table = Table::new(&["", "value", "95 %"]);
        for (name, parameter) in &finding.parameters {
            if let Some(value) = parameter["value"].as_f64() {
                let end = |index: usize| {
                    parameter["ci95"][index].as_f64().map_or("–".into(), significant)
                };
                table.row(&[name.clone(), significant(value), format!("{} … {}", end(0), end(1))]);
            }
        }
        page.table(&table);
        let mut bars: Vec<(String, f64)> = finding
            .rivals
            .iter()
            .map(|rival| {
                let column = rival.column.as_ref().map_or(String::new(), |it| format!(" {it}"));
                (format!("{}{column}", rival.cause), rival.score_gap)
            })
            .collect();
        bars.sort_by(|a, b| a.1.total_cmp(&b.1));
        bars.truncate(5);
        let title = "How much worse another cause explains the same readings (difference of BIC; from 6 \
                     on it is clear)";
        page.pictures(&[Bars { title: title.into(), bars, clear: CLEAR }.figure()]);
        page.text(&format!("To measure next: {}", finding.next_test));
    }
}
