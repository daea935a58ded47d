//! The series as one page: what to do first, the machines in a table, and each constant as a picture.

use trueup_page::{
    ForestPlot, ForestRow, HtmlPage, HtmlTable, Provenance, format_three_digits,
    format_with_interval,
};

use crate::report::{Machine, SeriesConstant, SeriesReport};

/// The most constants that have a picture; the others are in `fleet.json`.
const MAX_FIGURES: usize = 12;

/// Returns the page.
#[must_use]
pub fn render_html(series: &SeriesReport, folder: &str, origin: &Provenance) -> String {
    let mut page =
        HtmlPage::new(&format!("Series of {} machines: {folder}", series.machines.len()));
    let conspicuous = anomaly_sentences(series);
    match conspicuous.is_empty() {
        true => {
            page.add_card("good", "No machine is unlike the others", &no_anomaly_sentences(series))
        }
        false => page.add_card("bad", "These machines need a look", &conspicuous),
    }
    let next: Vec<&str> =
        series.next.iter().map(|measurement| measurement.sentence.as_str()).collect();
    if !next.is_empty() {
        page.add_card("open", "Measure next", &next);
    }
    page.add_heading("Machines");
    page.add_table(&machine_table(&series.machines));
    page.add_heading("Constants of the series");
    page.add_note(
        "Upper bar: the machine's own records. Lower bar: with the help of the others. Dashed: the mean. Intervals are \
         of 95 %.",
    );
    let mut shown: Vec<&SeriesConstant> =
        series.constants.iter().filter(|constant| constant.machines > 1).collect();
    shown.sort_by_key(|constant| std::cmp::Reverse(constant.machines));
    let pictures: Vec<String> =
        shown.iter().take(MAX_FIGURES).map(|constant| forest_plot(constant).to_figure()).collect();
    page.add_raw_html(&pictures.concat());
    if shown.is_empty() {
        page.add_paragraph("No constant has been measured on more than one machine.");
    } else {
        page.add_table(&constant_table(&shown));
    }
    if !series.causes.is_empty() {
        page.add_heading("Causes");
        let mut table = HtmlTable::new(&["cause", "claimed on", "found on", "confirmed", ""]);
        for it in &series.causes {
            let confirmed = if it.confirmed { "yes" } else { "no" };
            let counts = [it.claimed_on.len(), it.found_on.len()].map(|count| count.to_string());
            let [claimed, found] = &counts;
            table.add_row(&[it.name.as_str(), claimed, found, confirmed, &it.sentence]);
        }
        page.add_table(&table);
    }
    if !series.notes.is_empty() {
        page.add_heading("Notes");
        page.add_list(&series.notes);
    }
    page.add_provenance_footer(origin);
    page.to_html()
}

/// Returns the machines that are odd or drift, in sentences.
#[must_use]
pub fn anomaly_sentences(series: &SeriesReport) -> Vec<String> {
    let mut all = Vec::new();
    for machine in &series.machines {
        for name in &machine.odd {
            all.extend(anomaly_sentence(series, &machine.machine, name));
        }
        for name in &machine.drifting {
            let own = |constant: &&crate::report::DriftingConstant| {
                constant.machine == machine.machine && constant.constant == *name
            };
            all.extend(series.drifts.iter().find(own).map(|drift| {
                let [rate, low, high] =
                    format_with_interval(drift.drift.per_year, drift.drift.ci95);
                format!(
                    "{} drifts: {name} changes by {rate} ({low} to {high}) a year.",
                    machine.machine
                )
            }));
        }
    }
    all
}

fn anomaly_sentence(series: &SeriesReport, machine: &str, name: &str) -> Option<String> {
    let constant = series.constants.iter().find(|constant| constant.name == *name)?;
    let member = constant.values.iter().find(|value| value.machine == machine)?;
    let compared = member.compared?;
    let [value, low, high] = format_with_interval(member.own.value, member.own.ci95);
    let [predicted, ..] = format_with_interval(compared.predicted, member.own.ci95);
    let often = match compared.p_series {
        p if p < 0.001 => "less than one in 1000 series of healthy machines has".to_string(),
        p => format!("{:.1} of 100 series of healthy machines have", 100.0 * p),
    };
    Some(format!(
        "{machine} is unlike the others: {name} is {value} ({low} to {high}), and they predict {predicted}; {often} one so far off.",
    ))
}

fn no_anomaly_sentences(series: &SeriesReport) -> Vec<String> {
    let compared = series
        .constants
        .iter()
        .filter(|constant| constant.values.iter().any(|value| value.compared.is_some()));
    let count = compared.count();
    vec![match count {
        0 => "No constant has been measured on four machines: there is nothing to compare yet."
            .into(),
        1 => "1 constant was compared.".into(),
        _ => format!("{count} constants were compared."),
    }]
}

fn machine_table(machines: &[Machine]) -> HtmlTable {
    let mut table =
        HtmlTable::new(&["machine", "results", "newest", "verdict", "odd in", "drifts in"]);
    for it in machines {
        let results = it.results.to_string();
        let newest = it.newest.as_deref().unwrap_or("–");
        let [odd, drifting] = [&it.odd, &it.drifting].map(|names| names.join(", "));
        table.add_row(&[it.machine.as_str(), &results, newest, &it.verdict, &odd, &drifting]);
    }
    table
}

fn constant_table(constants: &[&SeriesConstant]) -> HtmlTable {
    let mut table = HtmlTable::new(&["constant", "machines", "mean", "95 %", "spread"]);
    for it in constants {
        let [mean, low, high] = format_with_interval(it.mean.value, it.mean.ci95);
        let spread = match it.by_ratios {
            true => format!("× {}", format_three_digits(it.spread.value)),
            false => format_three_digits(it.spread.value),
        };
        let (machines, range) = (it.machines.to_string(), format!("{low} to {high}"));
        table.add_row(&[it.name.as_str(), &machines, &mean, &range, &spread]);
    }
    table
}

fn forest_plot(constant: &SeriesConstant) -> ForestPlot {
    let row = |constant: &crate::report::MemberConstant| {
        let is_odd = constant.compared.is_some_and(|comparison| comparison.odd);
        ForestRow {
            name: if is_odd {
                format!("odd: {}", constant.machine)
            } else {
                constant.machine.clone()
            },
            own: (constant.own.value, constant.own.ci95),
            shared: Some((constant.shrunk.value, constant.shrunk.ci95)),
        }
    };
    ForestPlot {
        title: format!("{} on {} machines.", constant.name, constant.machines),
        axis: constant.parameter.clone(),
        rows: constant.values.iter().map(row).collect(),
        mean: Some((constant.mean.value, constant.mean.ci95)),
    }
}
