//! The page of the demonstration: first what is wrong and what to do, then pictures, then tables.

use trueup_diagnose::{Diagnosis, Verdict, report::Finding};
use trueup_page::{Bars, Chart, Colour, Page, Series, Table, micrometres};

use crate::{act_one::ActOne, say};

/// A difference of BIC from which two causes are clearly told apart.
const CLEAR: f64 = 6.0;
/// A table shows no more rows than that.
const MOST_ROWS: usize = 40;

/// The page.
#[must_use]
pub fn page(one: &ActOne) -> String {
    let mut page =
        Page::new(&format!("What is wrong with {}, and what a bridge makes of it", one.machine));
    of_act_one(&mut page, one);
    page.html()
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
        Table::new(&["measured", "bridge, as it is", "off by", "bridge, extended", "off by"]);
    for row in one.rows.iter().step_by(one.rows.len().div_ceil(MOST_ROWS).max(1)) {
        table.row(&[
            format!("{:.1} µm", row.dial_um),
            format!("{:.2} µm", row.bridge_um),
            format!("{:+.2} µm", row.bridge_um - row.dial_um),
            format!("{:.2} µm", row.calibrated_um),
            format!("{:+.2} µm", row.calibrated_um - row.dial_um),
        ]);
    }
    page.heading("Reading by reading");
    page.table(&table);
}

/// What is wrong and what to do, in a card of its colour.
pub(crate) fn verdict(page: &mut Page, diagnosis: &Diagnosis) {
    let report = &diagnosis.report;
    let state = match report.verdict {
        Verdict::Clean | Verdict::Explained => "good",
        Verdict::PartlyExplained | Verdict::Unexplained | Verdict::TooLittleData => "open",
        Verdict::DoNotCompensate | Verdict::DoesNotTransfer => "bad",
    };
    let mut sentences = vec![diagnosis.sentence()];
    sentences.extend(report.findings.iter().map(|it| it.sentence.clone()));
    sentences.extend(report.hints.iter().cloned());
    page.card(state, report.verdict.name(), &sentences);
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
                let end =
                    |index: usize| parameter["ci95"][index].as_f64().map_or("–".into(), short);
                table.row(&[name.clone(), short(value), format!("{} … {}", end(0), end(1))]);
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

/// A value in four digits that mean something.
pub(crate) fn short(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let decimals = (3.0 - value.abs().log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{value:.decimals$}")
}
