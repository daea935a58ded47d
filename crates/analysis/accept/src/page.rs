//! The printable page: passed or not, what to change, the two runs as a picture, part by part.

use trueup_page::{Chart, Colour, Origin, Page, Series, Table, micrometres, time_unit, within};

use crate::{Acceptance, advice::digits};

/// Returns the error in both runs.
pub(crate) fn chart(it: &Acceptance) -> Chart {
    let (unit, divisor) = unit_of(it);
    let points =
        |um: &[f64]| it.pair.at.iter().zip(um).map(|(at, um)| [at / divisor, *um]).collect();
    Chart {
        title: "The error in both runs".into(),
        x: unit,
        y: format!("{}, µm", it.quantity),
        series: vec![
            Series::dots("without", Colour::Before, points(&it.pair.off_um)),
            Series::dots("with compensation", Colour::After, points(&it.pair.on_um)),
        ],
    }
}

pub(crate) fn html(it: &Acceptance, name: &str, origin: &Origin, next: &[String]) -> String {
    let mut page = Page::new(&format!("Acceptance of {name}"));
    let mut sentences = it.unmet.clone();
    sentences.extend(it.advice.sentences.iter().cloned());
    let (state, heading) = if it.passed { ("good", "Passed") } else { ("bad", "Not passed") };
    page.card_then(state, heading, &sentences, next);
    page.figures(&[
        (micrometres(it.before.rms_um), "RMS error without compensation".into(), "before"),
        (micrometres(it.after.rms_um), "with it".into(), "after"),
        (
            format!("{:.1} %", 100.0 * it.reduction),
            format!("less; required: {:.0} %", 100.0 * it.required_reduction),
            "",
        ),
        (
            micrometres(it.after.max_um),
            it.limit_um.map_or("largest with it".into(), |um| {
                format!("largest with it; allowed: {um} µm")
            }),
            "after",
        ),
    ]);
    let (unit, divisor) = unit_of(it);
    page.pictures(&[chart(it).figure()]);
    if !it.advice.changes.is_empty() {
        page.heading("Constants to change");
        let mut table = Table::new(&["constant", "from", "to", "95 %"]);
        for change in &it.advice.changes {
            // As many digits as the interval has; what the file has, as it has it.
            let (to, interval) = match change.ci95 {
                Some(ci95) => {
                    let [to, low, high] = within(change.to, ci95);
                    (to, format!("{low} … {high}"))
                }
                None => (digits(change.to), "–".into()),
            };
            table.row(&[change.key.clone(), digits(change.from), to, interval]);
        }
        page.table(&table);
    }
    page.heading("Part by part");
    let mut table = Table::new(&[unit.as_str(), "RMS without", "RMS with", "gone", "largest with"]);
    for part in &it.parts {
        table.row(&[
            format!("{:.1} … {:.1}", part.from / divisor, part.to / divisor),
            micrometres(part.before.rms_um),
            micrometres(part.after.rms_um),
            format!("{:.0} %", 100.0 * (1.0 - part.after.rms_um / part.before.rms_um)),
            micrometres(part.after.max_um),
        ]);
    }
    page.table(&table);
    page.note(&format!("{} readings of {} that both runs have.", it.rows, it.quantity));
    page.list(&it.notes);
    page.signature();
    page.origin(origin);
    page.html()
}

/// Returns the name of what the readings are over, and what it is divided by.
fn unit_of(it: &Acceptance) -> (String, f64) {
    match it.pair.over.as_str() {
        "time_s" => {
            let longest = it.pair.at.iter().copied().fold(0.0, f64::max);
            let (unit, seconds) = time_unit(longest);
            (format!("time, {unit}"), seconds)
        }
        "row" => ("reading".into(), 1.0),
        place => (format!("{}, mm", place[..1].to_uppercase()), 1.0),
    }
}
