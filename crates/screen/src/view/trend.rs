//! One series of the last minutes as a curve.

use ratatui::{
    Frame,
    layout::Rect,
    style::Style,
    symbols::Marker,
    text::Line,
    widgets::{Axis, Block, Borders, Chart, Dataset, GraphType},
};

use super::Theme;
use crate::{laws::Laws, state::State, trend::WINDOW_S};

/// The least height of the drawn range: below it there is only noise, in µm or °C.
const LEAST_SPAN: f64 = 0.5;
/// The least length of the drawn time, in s.
const LEAST_S: f64 = 10.0;

/// Draws it.
pub fn draw(frame: &mut Frame<'_>, area: Rect, state: &State, theme: Theme) {
    let points = state.trend.series(state.series);
    let values = || points.iter().map(|(_, value)| *value);
    let (least, most) =
        values().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), it| (a.min(it), b.max(it)));
    let (least, most) = if points.is_empty() { (0.0, 0.0) } else { (least, most) };
    let spare = ((LEAST_SPAN - (most - least)) / 2.0).max(0.0);
    let bounds = [least - spare, most + spare];
    let begin = points.first().map_or(0.0, |(at, _)| -*at).clamp(LEAST_S, WINDOW_S);
    let (name, unit) = name(state);
    let title = format!("{name}, {unit}, the last {}", length(begin));
    let data = Dataset::default()
        .marker(Marker::Braille)
        .graph_type(GraphType::Line)
        .style(theme.good())
        .data(&points);
    let y = Axis::default().bounds(bounds).labels(bounds.map(|it| Line::raw(format!("{it:+8.2}"))));
    let chart = Chart::new(vec![data])
        .block(Block::new().borders(Borders::TOP).title(title).style(Style::new()))
        .x_axis(Axis::default().bounds([-begin, 0.0]))
        .y_axis(y)
        .legend_position(None);
    frame.render_widget(chart, area);
}

fn length(seconds: f64) -> String {
    if seconds < 60.0 { format!("{seconds:.0} s") } else { format!("{:.1} min", seconds / 60.0) }
}

fn name(state: &State) -> (String, &'static str) {
    match state.series {
        0 => ("growth".into(), "µm"),
        which @ 1..=3 => (format!("offset of {}", ["X", "Y", "Z"][which - 1]), "µm"),
        which => {
            let channel = u8::try_from(which - 4).unwrap_or(u8::MAX);
            let names = state.laws.as_ref().map(Laws::temperatures).unwrap_or_default();
            let name = names.get(&channel).map(|it| (*it).to_owned());
            (name.unwrap_or_else(|| format!("T{channel}")), "°C")
        }
    }
}
