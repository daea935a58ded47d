//! The figures of ISO 230-2 of an axis as a page, with picture: what is filed after a calibration.

use trueup_machine::machine_file::LinearAxis;
use trueup_page::{
    Chart, ChartSeries, ColourRole, HtmlPage, HtmlTable, Provenance, format_micrometres,
};

use crate::{
    iso230_2::{ApproachStatistics, Iso230Results, TargetResults},
    report::FitReport,
};

/// Returns the page of `axis`; `what` is the fit that it belongs to: "pitch".
#[must_use]
pub fn build_page(
    axis: LinearAxis,
    what: &str,
    report: &FitReport,
    iso230: &Iso230Results,
    origin: &Provenance,
) -> HtmlPage {
    let name = axis.name().to_uppercase();
    let mut page =
        HtmlPage::new(&format!("{name}: accuracy and repeatability of positioning, ISO 230-2"));
    if let Some(both) = &iso230.both {
        page.add_key_figures(&[
            (format_micrometres(both.accuracy_um), "A, bi-directional accuracy".into(), "before"),
            (
                format_micrometres(both.repeatability_um),
                "R, bi-directional repeatability".into(),
                "before",
            ),
            (
                format_micrometres(both.systematic_um),
                "E, bi-directional systematic error".into(),
                "before",
            ),
            (
                format_micrometres(both.mean_error_um),
                "M, mean bi-directional error".into(),
                "before",
            ),
            (format_micrometres(both.reversal_um), "B, reversal error".into(), "before"),
        ]);
    }
    page.add_paragraph(&format!(
        "As measured, before the correction of `fit {what}`. {} targets, at least {} arrivals at each in a direction; the standard requires 5.",
        iso230.targets.len(),
        iso230.fewest_runs
    ));
    page.add_charts(&[render_deviation_chart(&name, iso230)]);
    page.add_heading("The axis");
    page.add_table(&axis_table(iso230));
    page.add_heading("The targets");
    page.add_table(&target_table(iso230));
    if !report.parameters.is_empty() {
        page.add_heading("What is corrected");
        let mut table = HtmlTable::new(&["constant", "value"]);
        for parameter in &report.parameters {
            table.add_row(&[parameter.name.clone(), format!("{}", parameter.value)]);
        }
        page.add_table(&table);
    }
    page.add_list(&report.warnings);
    page.add_note(
        "x̄ is the mean of the deviations (actual minus target) at a target in a direction, s their standard deviation. \
         E: range of the means. R: largest of 4s, of both directions with B. A: range of x̄ ± 2s. M: range of the means of \
         both directions. B: forward minus reverse. The uncertainty of the instrument is not part of these figures.",
    );
    page.add_signature_block();
    page.add_provenance_footer(origin);
    page
}

/// Returns the means of both directions, and two standard deviations around them.
fn render_deviation_chart(name: &str, iso230: &Iso230Results) -> String {
    let of = |direction: fn(&TargetResults) -> Option<ApproachStatistics>,
              spread: f64|
     -> Vec<[f64; 2]> {
        let there = iso230
            .targets
            .iter()
            .filter_map(|target| Some((target.position_mm, direction(target)?)));
        there
            .map(|(mm, statistics)| [mm, statistics.mean_um + spread * statistics.estimator_um])
            .collect()
    };
    let mut series = Vec::new();
    for (arrow, colour, direction) in [
        (
            "forward",
            ColourRole::After,
            (|target| target.forward) as fn(&TargetResults) -> Option<ApproachStatistics>,
        ),
        ("reverse", ColourRole::Before, |target| target.reverse),
    ] {
        let limits = [of(direction, 2.0), of(direction, -2.0)].concat();
        series.push(ChartSeries::dots(&format!("{arrow} ± 2s"), colour, limits));
        series.push(ChartSeries::line(arrow, colour, of(direction, 0.0)));
    }
    Chart {
        title: format!(
            "Mean deviation of {name} at the targets, and two standard deviations on both sides."
        ),
        x: "position, mm".into(),
        y: "deviation, µm".into(),
        series,
    }
    .to_figure()
}

fn axis_table(iso230: &Iso230Results) -> HtmlTable {
    let mut table = HtmlTable::new(&["in µm", "forward ↑", "reverse ↓", "both"]);
    let cell = |value: Option<f64>| value.map_or_else(|| "–".into(), format_micrometres);
    let (forward, reverse, both) = (&iso230.forward, &iso230.reverse, &iso230.both);
    let rows = [
        (
            "A, accuracy",
            [
                forward.map(|forward| forward.accuracy_um),
                reverse.map(|reverse| reverse.accuracy_um),
                both.map(|both| both.accuracy_um),
            ],
        ),
        (
            "R, repeatability",
            [
                forward.map(|forward| forward.repeatability_um),
                reverse.map(|reverse| reverse.repeatability_um),
                both.map(|both| both.repeatability_um),
            ],
        ),
        (
            "E, systematic error",
            [
                forward.map(|forward| forward.systematic_um),
                reverse.map(|reverse| reverse.systematic_um),
                both.map(|both| both.systematic_um),
            ],
        ),
        ("M, mean bi-directional error", [None, None, both.map(|both| both.mean_error_um)]),
        ("B, reversal error", [None, None, both.map(|both| both.reversal_um)]),
        ("B̄, mean reversal error", [None, None, both.map(|both| both.mean_reversal_um)]),
    ];
    for (name, values) in rows {
        let [forward, reverse, both] = values.map(cell);
        table.add_row(&[name.to_string(), forward, reverse, both]);
    }
    table
}

fn target_table(iso230: &Iso230Results) -> HtmlTable {
    let mut table = HtmlTable::new(&["mm", "n↑", "x̄↑ µm", "s↑ µm", "n↓", "x̄↓ µm", "s↓ µm", "B µm"]);
    let three = |approach: Option<ApproachStatistics>| match approach {
        Some(it) => [
            it.runs.to_string(),
            format_micrometres(it.mean_um),
            format_micrometres(it.estimator_um),
        ],
        None => ["0".into(), "–".into(), "–".into()],
    };
    for target in &iso230.targets {
        let mut cells = vec![target.position_mm.to_string()];
        cells.extend(three(target.forward));
        cells.extend(three(target.reverse));
        cells.push(
            target.both.map_or_else(|| "–".into(), |both| format_micrometres(both.reversal_um)),
        );
        table.add_row(&cells);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::iso230_2::TargetReadings;

    #[test]
    fn the_page_has_the_figures_of_both_directions_the_picture_and_the_origin() {
        let target = |position_mm: f64, up: [f64; 2], down: [f64; 2]| TargetReadings {
            position_mm,
            forward_um: up.to_vec(),
            reverse_um: down.to_vec(),
        };
        let targets =
            [target(0.0, [0.0, 0.0], [4.0, 4.0]), target(100.0, [6.0, 6.0], [10.0, 10.0])];
        let iso230 = Iso230Results::from_targets(&targets).expect("it has figures");
        let origin =
            Provenance { version: "1.2".into(), date: "2026-11-26".into(), files: Vec::new() };
        let report = FitReport::new("pitch", "measured_dx_um");
        let html = build_page(LinearAxis::X, "pitch", &report, &iso230, &origin).to_html();
        // No scatter: A and E are the range of the means, 10 µm, M that of the mid-points, 6 µm, R is B, 4 µm.
        for part in [
            "<b class=\"before\">10 µm</b>A,",
            ">6 µm</b>M,",
            ">4 µm</b>R,",
            ">4 µm</b>B,",
            "<svg",
            "trueup 1.2",
        ] {
            let part = part.replace("10 µm", &format_micrometres(10.0));
            let part = part.replace("6 µm", &format_micrometres(6.0));
            let part = part.replace("4 µm", &format_micrometres(4.0));
            assert!(html.contains(&part), "{part}: {html}");
        }
    }
}
