//! The series as one page: what to do first, the machines in a table, and each constant as a picture.

use trueup_page::{Forest, ForestRow, Origin, Page, Table, significant, within};

use crate::report::{Constant, Machine, Series};

/// The most constants that have a picture; the others are in `fleet.json`.
const MAX_PICTURES: usize = 12;

/// Returns the page.
#[must_use]
pub fn html(series: &Series, folder: &str, origin: &Origin) -> String {
    let mut page = Page::new(&format!("Series of {} machines: {folder}", series.machines.len()));
    let conspicuous = conspicuous(series);
    match conspicuous.is_empty() {
        true => page.card("good", "No machine is unlike the others", &none_sentences(series)),
        false => page.card("bad", "These machines need a look", &conspicuous),
    }
    let next: Vec<&str> = series.next.iter().map(|it| it.sentence.as_str()).collect();
    if !next.is_empty() {
        page.card("open", "Measure next", &next);
    }
    page.heading("Machines");
    page.table(&machines(&series.machines));
    page.heading("Constants of the series");
    page.note(
        "Upper bar: the machine's own records. Lower bar: with the help of the others. Dashed: the mean. Intervals are \
         of 95 %.",
    );
    let mut shown: Vec<&Constant> = series.constants.iter().filter(|it| it.machines > 1).collect();
    shown.sort_by_key(|it| std::cmp::Reverse(it.machines));
    let pictures: Vec<String> =
        shown.iter().take(MAX_PICTURES).map(|it| picture(it).figure()).collect();
    page.raw(&pictures.concat());
    if shown.is_empty() {
        page.text("No constant has been measured on more than one machine.");
    } else {
        page.table(&constants(&shown));
    }
    if !series.causes.is_empty() {
        page.heading("Causes");
        let mut table = Table::new(&["cause", "claimed on", "found on", "confirmed", ""]);
        for it in &series.causes {
            let confirmed = if it.confirmed { "yes" } else { "no" };
            let counts = [it.claimed_on.len(), it.found_on.len()].map(|count| count.to_string());
            let [claimed, found] = &counts;
            table.row(&[it.name.as_str(), claimed, found, confirmed, &it.sentence]);
        }
        page.table(&table);
    }
    if !series.notes.is_empty() {
        page.heading("Notes");
        page.list(&series.notes);
    }
    page.origin(origin);
    page.html()
}

/// Returns the machines that are odd or drift, in sentences.
#[must_use]
pub fn conspicuous(series: &Series) -> Vec<String> {
    let mut all = Vec::new();
    for machine in &series.machines {
        for name in &machine.odd {
            all.extend(odd_sentence(series, &machine.machine, name));
        }
        for name in &machine.drifting {
            let own = |it: &&crate::report::Drifting| {
                it.machine == machine.machine && it.constant == *name
            };
            all.extend(series.drifts.iter().find(own).map(|it| {
                let [rate, low, high] = within(it.drift.per_year, it.drift.ci95);
                format!(
                    "{} drifts: {name} changes by {rate} ({low} to {high}) a year.",
                    machine.machine
                )
            }));
        }
    }
    all
}

fn odd_sentence(series: &Series, machine: &str, name: &str) -> Option<String> {
    let constant = series.constants.iter().find(|it| it.name == *name)?;
    let member = constant.values.iter().find(|it| it.machine == machine)?;
    let compared = member.compared?;
    let [value, low, high] = within(member.own.value, member.own.ci95);
    let [predicted, ..] = within(compared.predicted, member.own.ci95);
    let often = match compared.p_series {
        p if p < 0.001 => "less than one in 1000 series of healthy machines has".to_string(),
        p => format!("{:.1} of 100 series of healthy machines have", 100.0 * p),
    };
    Some(format!(
        "{machine} is unlike the others: {name} is {value} ({low} to {high}), and they predict {predicted}; {often} one so far off.",
    ))
}

fn none_sentences(series: &Series) -> Vec<String> {
    let compared =
        series.constants.iter().filter(|it| it.values.iter().any(|it| it.compared.is_some()));
    let count = compared.count();
    vec![match count {
        0 => "No constant has been measured on four machines: there is nothing to compare yet."
            .into(),
        1 => "1 constant was compared.".into(),
        _ => format!("{count} constants were compared."),
    }]
}

fn machines(machines: &[Machine]) -> Table {
    let mut table = Table::new(&["machine", "results", "newest", "verdict", "odd in", "drifts in"]);
    for it in machines {
        let results = it.results.to_string();
        let newest = it.newest.as_deref().unwrap_or("–");
        let [odd, drifting] = [&it.odd, &it.drifting].map(|names| names.join(", "));
        table.row(&[it.machine.as_str(), &results, newest, &it.verdict, &odd, &drifting]);
    }
    table
}

fn constants(constants: &[&Constant]) -> Table {
    let mut table = Table::new(&["constant", "machines", "mean", "95 %", "spread"]);
    for it in constants {
        let [mean, low, high] = within(it.mean.value, it.mean.ci95);
        let spread = match it.by_ratios {
            true => format!("× {}", significant(it.spread.value)),
            false => significant(it.spread.value),
        };
        let (machines, range) = (it.machines.to_string(), format!("{low} to {high}"));
        table.row(&[it.name.as_str(), &machines, &mean, &range, &spread]);
    }
    table
}

fn picture(constant: &Constant) -> Forest {
    let row = |it: &crate::report::Member| {
        let is_odd = it.compared.is_some_and(|it| it.odd);
        ForestRow {
            name: if is_odd { format!("odd: {}", it.machine) } else { it.machine.clone() },
            own: (it.own.value, it.own.ci95),
            shared: Some((it.shrunk.value, it.shrunk.ci95)),
        }
    };
    Forest {
        title: format!("{} on {} machines.", constant.name, constant.machines),
        axis: constant.parameter.clone(),
        rows: constant.values.iter().map(row).collect(),
        mean: Some((constant.mean.value, constant.mean.ci95)),
    }
}
