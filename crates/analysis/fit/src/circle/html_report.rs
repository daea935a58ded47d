//! The page of circles: for each plane the polar plot, the figures of ISO 230-4, and the causes.

use std::f64::consts::TAU;

use trueup_machine::machine_file::LinearAxis;
use trueup_page::{
    ChartSeries, ColourRole, HtmlPage, HtmlTable, PolarPlot, Provenance, format_micrometres,
};

use super::{CircleFinding, CircleReport, CircleResult, CircleVerdict};

/// Returns the page of a report.
#[must_use]
pub fn build_circle_page(report: &CircleReport, origin: &Provenance) -> HtmlPage {
    let mut page = HtmlPage::new("Circles and their causes, ISO 230-4");
    let (state, heading) = match report.verdict {
        CircleVerdict::Clean => ("good", "Clean: nothing but set-up and noise"),
        CircleVerdict::Explained => ("good", "Explained"),
        CircleVerdict::PartlyExplained => ("open", "Partly explained"),
        CircleVerdict::Unexplained => {
            ("bad", "Unexplained: nothing is claimed, and something is left")
        }
    };
    let description: Vec<String> = report.circles.iter().map(summarise_circle).collect();
    page.add_card(state, heading, &description);
    for circle in &report.circles {
        add_circle(&mut page, circle);
    }
    if !report.written.is_empty() {
        page.add_heading("Written into the machine file");
        page.add_list(&report.written);
    }
    page.add_list(&report.warnings);
    page.add_note(
        "G: range of the radii about the centre of least squares, in one direction and in both, G(b). H: largest difference of \
         both directions at an angle. F: deviation from the nominal radius. D: mean radius of both directions minus the nominal \
         one. The uncertainty of the instrument is not part of these figures.",
    );
    page.add_signature_block();
    page.add_provenance_footer(origin);
    page
}

/// Returns a circle and its causes in a sentence.
#[must_use]
pub(crate) fn summarise_circle(circle: &CircleResult) -> String {
    let named = |is_claimed: bool| -> Vec<String> {
        let own = circle.findings.iter().filter(|finding| finding.claimed == is_claimed);
        own.map(finding_title).collect()
    };
    let (claimed, open) = (named(true), named(false));
    let mut message = format!("{}: ", circle.record.plane.name().to_uppercase());
    message += &if claimed.is_empty() { "no cause is claimed".into() } else { claimed.join(", ") };
    if !open.is_empty() {
        message += &format!("; not claimed: {}", open.join(", "));
    }
    if let Some(um) = circle.structure_um {
        message += &format!("; structure of {um:.2} µm RMS is left");
    }
    message
}

/// Returns a cause with its axis: `backlash of x`.
#[must_use]
pub fn finding_title(finding: &CircleFinding) -> String {
    let name = finding.cause.name();
    match (finding.axis.map(LinearAxis::name), finding.along.map(LinearAxis::name)) {
        (Some(axis), Some(along)) => format!("{name} of {axis} along {along}"),
        (Some(axis), None) => format!("{name} of {axis}"),
        _ => name.into(),
    }
}

fn add_circle(page: &mut HtmlPage, circle: &CircleResult) {
    let record = &circle.record;
    let [u, v] = record.plane.axes().map(|axis| axis.name().to_uppercase());
    page.add_heading(&format!("{u}{v}, radius {:.3} mm", record.radius_mm));
    if let (Some(g), Some(h)) = (circle.figures.g_both_um, circle.figures.h_um) {
        page.add_key_figures(&[
            (format_micrometres(g), "G(b), bi-directional circular deviation".into(), "before"),
            (format_micrometres(h), "H, circular hysteresis".into(), "before"),
            (format_micrometres(circle.before.rms_um), "RMS about the centre".into(), "before"),
            (format_micrometres(circle.after.rms_um), "RMS without the causes".into(), "after"),
        ]);
    }
    page.add_charts(&[render_polar_plot(circle, [u, v])]);
    page.add_table(&build_deviation_table(circle));
    if circle.findings.is_empty() {
        page.add_paragraph("No cause: centre and radius of the set-up, and noise.");
    }
    for finding in &circle.findings {
        let mut table = HtmlTable::new(&["constant", "value", "95 %"]);
        for parameter in &finding.parameters {
            let interval = parameter
                .ci95
                .map_or_else(|| "–".into(), |[low, high]| format!("{low:.3} … {high:.3}"));
            table.add_row(&[parameter.name.clone(), format!("{:.3}", parameter.value), interval]);
        }
        page.add_subheading(&format!(
            "{}{}: {} RMS",
            finding_title(finding),
            if finding.claimed { "" } else { " (not claimed)" },
            format_micrometres(finding.rms_um)
        ));
        page.add_table(&table);
        page.add_list(&finding.evidence);
        if !finding.alternatives.is_empty() {
            page.add_paragraph(&format!(
                "It would look the same: {}.",
                finding.alternatives.join(", ")
            ));
        }
        if !finding.next_test.is_empty() {
            page.add_paragraph(&format!("Next: {}.", finding.next_test));
        }
    }
}

/// Returns the polar plot: both directions, and what the causes predict.
fn render_polar_plot(circle: &CircleResult, axes: [String; 2]) -> String {
    let record = &circle.record;
    let mut series = Vec::new();
    for (name, colour, sense) in
        [("counter-clockwise", ColourRole::Before, 1.0), ("clockwise", ColourRole::After, -1.0)]
    {
        for (number, passes) in record.rows.chunk_by(|a, b| a.pass == b.pass).enumerate() {
            let first: usize =
                record.rows.chunk_by(|a, b| a.pass == b.pass).take(number).map(<[_]>::len).sum();
            if passes[0].sense * sense < 0.0 {
                continue;
            }
            let points = passes.iter().map(|row| [row.angle.rem_euclid(TAU), row.um]).collect();
            series.push(ChartSeries::line(name, colour, points));
            let predicted = &circle.predicted_um[first..first + passes.len()];
            let points = passes.iter().zip(predicted).map(|(row, um)| [row.angle, *um]).collect();
            series.push(ChartSeries::line("the causes", ColourRole::Truth, points));
        }
    }
    let causes: Vec<String> =
        circle.findings.iter().filter(|finding| finding.claimed).map(finding_title).collect();
    let causes = if causes.is_empty() { "no cause".into() } else { causes.join(", ") };
    PolarPlot { title: format!("Deviation of the radius, enlarged: {causes}."), axes, series }
        .to_figure()
}

fn build_deviation_table(circle: &CircleResult) -> HtmlTable {
    let it = &circle.figures;
    let cell = |um: Option<f64>| um.map_or_else(|| "–".into(), format_micrometres);
    let mut table = HtmlTable::new(&["ISO 230-4", "counter-clockwise", "clockwise", "both"]);
    for (name, [ccw, cw], both) in [
        ("G, circular deviation", it.g_um, it.g_both_um),
        ("F max, radial deviation", it.f_max_um, None),
        ("F min, radial deviation", it.f_min_um, None),
        ("H, circular hysteresis", [None; 2], it.h_um),
        ("D, mean radial deviation", [None; 2], it.d_um),
    ] {
        table.add_row(&[name.to_string(), cell(ccw), cell(cw), cell(both)]);
    }
    table
}
