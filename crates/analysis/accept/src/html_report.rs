//! The printable page: passed or not, what to change, the two runs as a picture, part by part.

use trueup_page::{
    Chart, ChartSeries, ColourRole, HtmlPage, HtmlTable, Provenance, choose_time_unit,
    format_micrometres, format_with_interval,
};

use crate::{AcceptanceResult, recommended_changes::format_four_significant_digits};

/// Returns the error in both runs.
pub(crate) fn build_error_chart(it: &AcceptanceResult) -> Chart {
    let (unit, divisor) = abscissa_label_and_divisor(it);
    let points =
        |um: &[f64]| it.pair.at.iter().zip(um).map(|(at, um)| [at / divisor, *um]).collect();
    Chart {
        title: "The error in both runs".into(),
        x: unit,
        y: format!("{}, µm", it.quantity),
        series: vec![
            ChartSeries::dots("without", ColourRole::Before, points(&it.pair.off_um)),
            ChartSeries::dots("with compensation", ColourRole::After, points(&it.pair.on_um)),
        ],
    }
}

pub(crate) fn render_html(
    it: &AcceptanceResult,
    name: &str,
    origin: &Provenance,
    next: &[String],
) -> String {
    let mut page = HtmlPage::new(&format!("Acceptance of {name}"));
    let mut sentences = it.unmet.clone();
    sentences.extend(it.advice.sentences.iter().cloned());
    let (state, heading) = if it.passed { ("good", "Passed") } else { ("bad", "Not passed") };
    page.add_card_with_commands(state, heading, &sentences, next);
    page.add_key_figures(&[
        (format_micrometres(it.before.rms_um), "RMS error without compensation".into(), "before"),
        (format_micrometres(it.after.rms_um), "with it".into(), "after"),
        (
            format!("{:.1} %", 100.0 * it.reduction),
            format!("less; required: {:.0} %", 100.0 * it.required_reduction),
            "",
        ),
        (
            format_micrometres(it.after.max_um),
            it.limit_um.map_or("largest with it".into(), |um| {
                format!("largest with it; allowed: {um} µm")
            }),
            "after",
        ),
    ]);
    let (unit, divisor) = abscissa_label_and_divisor(it);
    page.add_charts(&[build_error_chart(it).to_figure()]);
    if !it.advice.changes.is_empty() {
        page.add_heading("Constants to change");
        let mut table = HtmlTable::new(&["constant", "from", "to", "95 %"]);
        for change in &it.advice.changes {
            // As many digits as the interval has; what the file has, as it has it.
            let (to, interval) = match change.ci95 {
                Some(ci95) => {
                    let [to, low, high] = format_with_interval(change.to, ci95);
                    (to, format!("{low} … {high}"))
                }
                None => (format_four_significant_digits(change.to), "–".into()),
            };
            table.add_row(&[
                change.key.clone(),
                format_four_significant_digits(change.from),
                to,
                interval,
            ]);
        }
        page.add_table(&table);
    }
    page.add_heading("Part by part");
    let mut table =
        HtmlTable::new(&[unit.as_str(), "RMS without", "RMS with", "gone", "largest with"]);
    for part in &it.parts {
        table.add_row(&[
            format!("{:.1} … {:.1}", part.from / divisor, part.to / divisor),
            format_micrometres(part.before.rms_um),
            format_micrometres(part.after.rms_um),
            format!("{:.0} %", 100.0 * (1.0 - part.after.rms_um / part.before.rms_um)),
            format_micrometres(part.after.max_um),
        ]);
    }
    page.add_table(&table);
    page.add_note(&format!("{} readings of {} that both runs have.", it.rows, it.quantity));
    page.add_list(&it.notes);
    page.add_signature_block();
    page.add_provenance_footer(origin);
    page.to_html()
}

/// Returns the name of what the readings are over, and what it is divided by.
fn abscissa_label_and_divisor(it: &AcceptanceResult) -> (String, f64) {
    match it.pair.over.as_str() {
        "time_s" => {
            let longest = it.pair.at.iter().copied().fold(0.0, f64::max);
            let (unit, seconds) = choose_time_unit(longest);
            (format!("time, {unit}"), seconds)
        }
        "row" => ("reading".into(), 1.0),
        place => (format!("{}, mm", place[..1].to_uppercase()), 1.0),
    }
}
