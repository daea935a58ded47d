//! One series of the last minutes as a curve.

use ratatui::{
    Frame,
    layout::Rect,
    style::Style,
    symbols::Marker,
    text::Line,
    widgets::{Axis, Block, Borders, Chart, Dataset, GraphType},
};

use trueup_machine::machine_file::Quantity;

use super::Theme;
use crate::{
    compensation_model::CompensationModel,
    state::ScreenState,
    trend::{GAUGE_DIFFERENCE_INDEX, TREND_WINDOW_S},
};

/// The least height of the drawn range: below it there is only noise, in µm or °C.
const MIN_PLOTTED_VALUE_RANGE: f64 = 0.5;
/// The least height with a row for the ticks of the time.
const MAX_HEIGHT_WITHOUT_TICKS: u16 = 5;
/// The least length of the drawn time, in s.
const MIN_PLOTTED_TIME_RANGE_S: f64 = 10.0;

/// Draws it.
pub(crate) fn draw(frame: &mut Frame<'_>, area: Rect, state: &ScreenState, theme: Theme) {
    let points = state.trend.series(state.series);
    // The readings of the gauge stand on the curve that they are to be compared with.
    let marks = match gauge_series_and_sign(state.gauge.quantity) {
        (series, sign) if series == state.series => {
            let marks = state.trend.gauge_readings().into_iter();
            marks.map(|(at_s, um)| (at_s, sign * um)).collect()
        }
        _ => Vec::new(),
    };
    let values = || points.iter().chain(&marks).map(|(_, value)| *value);
    let (least, most) = values()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), value| (a.min(value), b.max(value)));
    let (least, most) =
        if points.is_empty() && marks.is_empty() { (0.0, 0.0) } else { (least, most) };
    let spare = ((MIN_PLOTTED_VALUE_RANGE - (most - least)) / 2.0).max(0.0);
    let bounds = [least - spare, most + spare];
    let begin =
        points.first().map_or(0.0, |(at, _)| -*at).clamp(MIN_PLOTTED_TIME_RANGE_S, TREND_WINDOW_S);
    let (name, unit) = series_name_and_unit(state);
    let mut title = format!("{name}, {unit}, the last {}", format_duration(begin));
    if state.series == GAUGE_DIFFERENCE_INDEX
        && let Some((_, last)) = points.last()
    {
        title += &format!(": {last:+.2}");
    }
    if !marks.is_empty() {
        title += "; • gauge";
    }
    let data = Dataset::default()
        .marker(Marker::Braille)
        .graph_type(GraphType::Line)
        .style(theme.ok_style())
        .data(&points);
    let y = Axis::default()
        .bounds(bounds)
        .labels(bounds.map(|bound| Line::raw(format!("{bound:+8.2}"))));
    let readings = Dataset::default()
        .marker(Marker::Dot)
        .graph_type(GraphType::Scatter)
        .style(theme.value_style())
        .data(&marks);
    let ticks = [-begin, -begin / 2.0, 0.0].map(|at_s| Line::raw(format_tick(at_s)));
    // A row for the ticks, if the curve keeps some.
    let x = Axis::default().bounds([-begin, 0.0]);
    let x = if area.height > MAX_HEIGHT_WITHOUT_TICKS { x.labels(ticks) } else { x };
    let chart = Chart::new(vec![data, readings])
        .block(Block::new().borders(Borders::TOP).title(title).style(Style::new()))
        .x_axis(x)
        .y_axis(y)
        .legend_position(None);
    frame.render_widget(chart, area);
}

fn format_duration(seconds: f64) -> String {
    if seconds < 60.0 { format!("{seconds:.0} s") } else { format!("{:.1} min", seconds / 60.0) }
}

/// Returns a moment before now.
fn format_tick(at_s: f64) -> String {
    match at_s {
        0.0 => "now".into(),
        _ if at_s > -60.0 => format!("{at_s:.0} s"),
        _ => format!("{:.1} min", at_s / 60.0),
    }
}

/// Returns the series that a gauge of this quantity is compared with, and the sign of its readings there: an offset is
/// what takes an error away.
const fn gauge_series_and_sign(quantity: Quantity) -> (usize, f64) {
    match quantity {
        Quantity::Elongation => (0, 1.0),
        Quantity::Dx => (1, -1.0),
        Quantity::Dy => (2, -1.0),
        Quantity::Dz => (3, -1.0),
    }
}

fn series_name_and_unit(state: &ScreenState) -> (String, &'static str) {
    match state.series {
        0 => ("growth".into(), "µm"),
        GAUGE_DIFFERENCE_INDEX => {
            (format!("gauge {} minus bridge", state.gauge.quantity.name()), "µm")
        }
        which @ 1..=3 => (format!("offset of {}", ["X", "Y", "Z"][which - 1]), "µm"),
        which => {
            let channel = u8::try_from(which - 4).unwrap_or(u8::MAX);
            let names =
                state.laws.as_ref().map(CompensationModel::temperature_names).unwrap_or_default();
            let name = names.get(&channel).map(|name| (*name).to_owned());
            (name.unwrap_or_else(|| format!("T{channel}")), "°C")
        }
    }
}
