//! A comparison and a trend as pages with pictures.

use trueup_page::{
    Chart, ChartSeries, ColourRole, HtmlPage, HtmlTable, Provenance, format_micrometres,
};

use crate::{
    run_comparison::{PositionDifference, RunComparison},
    trend::ConstantTrend,
};

/// Returns the page of a comparison of two runs, by their names.
#[must_use]
pub fn build_comparison_page(it: &RunComparison, [a, b]: [&str; 2], origin: &Provenance) -> String {
    let mut page = HtmlPage::new(&format!("{a} and {b}"));
    let (state, heading) =
        if it.differs { ("open", "They differ") } else { ("good", "No difference") };
    page.add_card(state, heading, &it.sentences);
    let scatter = it.repeatability_um.map_or("not known".into(), format_micrometres);
    page.add_key_figures(&[
        (format_micrometres(it.rms_um), "RMS difference, the shift taken off".into(), "before"),
        (format_micrometres(it.max_um), "largest".into(), "before"),
        (scatter, "standard deviation of a reading, from repeats".into(), ""),
    ]);
    let of = |way: i8| -> Vec<[f64; 2]> {
        let mine = it.places.iter().filter(|place| place.direction == way);
        mine.map(|place| [place.at_mm, place.difference_um]).collect()
    };
    let ways = [
        (1, "approached upwards", ColourRole::After),
        (-1, "downwards", ColourRole::Before),
        (0, "", ColourRole::Measured),
    ];
    let series = ways
        .into_iter()
        .map(|(way, name, colour)| ChartSeries::dots(name, colour, of(way)))
        .filter(|series| !series.points.is_empty());
    let chart = Chart {
        title: format!("{b} minus {a}"),
        x: format!("{}, mm", it.over[..1].to_uppercase()),
        y: format!("difference of {}, µm", it.quantity),
        series: series.collect(),
    };
    page.add_charts(&[chart.to_figure()]);
    page.add_heading("Place by place");
    let mut table = HtmlTable::new(&["mm", "direction", "difference, µm", "95 %, µm", "readings"]);
    for PositionDifference { at_mm, direction, difference_um, half_width_um, readings: [a, b] } in
        &it.places
    {
        table.add_row(&[
            at_mm.to_string(),
            direction.to_string(),
            format!("{difference_um:+.2}"),
            half_width_um.map_or("–".into(), |half| format!("± {half:.2}")),
            format!("{a} + {b}"),
        ]);
    }
    page.add_table(&table);
    page.add_provenance_footer(origin);
    page.to_html()
}

/// Returns the page of trends.
#[must_use]
pub fn build_trends_page(trends: &[ConstantTrend], folder: &str, origin: &Provenance) -> String {
    let mut page = HtmlPage::new(&format!("What changes in {folder}"));
    let say = |trend: &ConstantTrend| format!("{}: {}", trend.name, trend.sentence);
    page.add_card("open", "Constants over time", &trends.iter().map(say).collect::<Vec<_>>());
    let picture = |trend: &ConstantTrend| {
        let points: Vec<[f64; 2]> =
            trend.points.iter().map(|point| [point.days, point.value]).collect();
        let mut series = vec![ChartSeries::dots("measured", ColourRole::Measured, points)];
        if let ([first, .., last], Some([rate, _])) = (&trend.points[..], trend.per_year) {
            // The line of least squares passes through the means.
            let count = trend.points.len() as f64;
            let days = trend.points.iter().map(|point| point.days).sum::<f64>() / count;
            let value = trend.points.iter().map(|point| point.value).sum::<f64>() / count;
            let at = |day: f64| [day, value + rate * (day - days) / 365.25];
            series.push(ChartSeries::line(
                "line",
                ColourRole::After,
                vec![at(first.days), at(last.days)],
            ));
        }
        let from = trend.points.first().map_or("", |point| &point.date);
        Chart {
            title: trend.name.clone(),
            x: format!("days from {from}"),
            y: trend.name.clone(),
            series,
        }
        .to_figure()
    };
    page.add_charts(&trends.iter().map(picture).collect::<Vec<_>>());
    let mut table = HtmlTable::new(&["constant", "day", "value", "95 %"]);
    for it in trends {
        for point in &it.points {
            let half = point.half_width.map_or("–".into(), |half| format!("± {half:.2}"));
            table.add_row(&[
                it.name.clone(),
                point.date.clone(),
                format!("{:.3}", point.value),
                half,
            ]);
        }
    }
    page.add_table(&table);
    page.add_provenance_footer(origin);
    page.to_html()
}
