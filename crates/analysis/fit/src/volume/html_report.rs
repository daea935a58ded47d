//! The page of a volume: what is known of each error, its curve with the 95 % interval, and what to measure next.

use trueup_page::{
    Chart, ChartSeries, ColourRole, HtmlPage, HtmlTable, Provenance, format_micrometres,
};

use super::{VolumeReport, identifiability::ErrorAssessment, reading::ReadingKind};

/// Returns the page of a report.
#[must_use]
pub fn build_page(report: &VolumeReport, origin: &Provenance) -> HtmlPage {
    let mut page = HtmlPage::new("The errors of the volume, ISO 230-1 and 230-7");
    let acting: Vec<&ErrorAssessment> =
        report.known.iter().filter(|assessment| assessment.acts).collect();
    let known = acting.iter().filter(|assessment| assessment.is_known).count();
    let (state, heading) = match (report.has_significant_improvement(), known == acting.len()) {
        _ if report.held_out.readings == 0 => {
            ("bad", "Not written: no set-up has enough readings to hold some out")
        }
        (false, _) => {
            ("bad", "Not written: the correction is not surely better on held-out readings")
        }
        (true, true) => ("good", "All errors are known"),
        (true, false) => ("open", "Some errors are not known by themselves"),
    };
    let text = [format!("{known} of {} errors are known.", acting.len())];
    page.add_card(state, heading, &text);
    let held_out = report.held_out;
    page.add_key_figures(&[
        (
            format_micrometres(held_out.before_um),
            "held-out readings, RMS, file as it is".into(),
            "before",
        ),
        (
            format_micrometres(held_out.after_um),
            "held-out readings, RMS, corrected".into(),
            "after",
        ),
    ]);
    page.add_table(&errors_table(report));
    page.add_list(&list_next_tests(&acting));
    page.add_heading("Readings");
    page.add_table(&readings_table(report));
    page.add_heading("Curves");
    let charts: Vec<String> = acting
        .iter()
        .filter(|assessment| !assessment.curve.is_empty())
        .map(|assessment| error_chart(assessment))
        .collect();
    page.add_charts(&charts);
    page.add_list(&report.warnings);
    page.add_note(
        "X is the first axis, the plane of X and Y the second. An angle counts from its mean over the travel, a straightness from its \
         straight line, which is the squareness. Intervals are those of 95 %: \
         of lengths on simulated machines 92 to 96 of 100 were inside.",
    );
    page.add_signature_block();
    page.add_provenance_footer(origin);
    page
}

fn errors_table(report: &VolumeReport) -> HtmlTable {
    let mut table =
        HtmlTable::new(&["error", "value or range", "± 95 %", "known", "looks the same as"]);
    for it in &report.known {
        let unit = it.error.unit();
        let state = match (it.acts, it.is_known) {
            (false, _) => "does not move the tip",
            (true, true) => "yes",
            (true, false) => "not by itself",
        };
        table.add_row(&[
            it.error.to_string(),
            format!("{:.2} {unit}", it.size),
            format!("{:.2}", it.half_width),
            state.into(),
            it.confused_with.join(", "),
        ]);
    }
    table
}

fn list_next_tests(acting: &[&ErrorAssessment]) -> Vec<String> {
    let mut tests: Vec<(&str, Vec<String>)> = Vec::new();
    for it in acting.iter().filter(|assessment| !assessment.is_known) {
        match tests.iter_mut().find(|(test, _)| *test == it.next_test) {
            Some((_, names)) => names.push(it.error.to_string()),
            None => tests.push((&it.next_test, vec![it.error.to_string()])),
        }
    }
    let sentence = |(test, names): (&str, Vec<String>)| format!("{}: {test}.", names.join(", "));
    tests.into_iter().map(sentence).collect()
}

fn readings_table(report: &VolumeReport) -> HtmlTable {
    let mut table = HtmlTable::new(&["measured with", "readings", "noise"]);
    for kind in ReadingKind::ALL {
        if let Some(um) = report.noise_um[kind.index()] {
            let count = report.readings[kind.index()].to_string();
            table.add_row(&[kind.name().to_string(), count, format_micrometres(um)]);
        }
    }
    table
}

fn error_chart(it: &ErrorAssessment) -> String {
    let along = it.error.motion_axis().map_or_else(String::new, |axis| axis.name().to_uppercase());
    let line = |name: &str, colour, sign: f64| {
        let points = it.curve.iter().map(|[mm, value, half]| [*mm, value + sign * half]).collect();
        ChartSeries::line(name, colour, points)
    };
    let state = if it.is_known { "" } else { ", not known by itself" };
    Chart {
        title: format!("{} over {along}{state}.", it.error),
        x: format!("{along}, mm"),
        y: format!("{}, {}", it.error, it.error.unit()),
        series: vec![
            line("95 % interval", ColourRole::Before, 1.0),
            line("95 % interval", ColourRole::Before, -1.0),
            line("found", ColourRole::After, 0.0),
        ],
    }
    .to_figure()
}
