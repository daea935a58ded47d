//! A forest plot: one value of many things with its interval, one below the other, and where their mean lies.

use std::fmt::Write as _;

use crate::{
    chart::ColourRole,
    html::escape_html,
    number::{axis_ticks, format_three_digits},
};

const PLOT_WIDTH: f64 = 640.0;
/// From row to row.
const ROW_HEIGHT: f64 = 18.0;
/// Left, right, top, bottom: room for the names and the numbers of the axis.
const FOREST_PLOT_MARGINS: [f64; 4] = [190.0, 14.0, 10.0, 42.0];
/// The longest name that has room, in characters.
const MAX_NAME_CHARS: usize = 26;

/// A value with its interval.
pub type IntervalEstimate = (f64, [f64; 2]);

/// A row of the plot.
#[derive(Clone, Debug)]
pub struct ForestRow {
    /// Its name.
    pub name: String,
    /// The value by itself.
    pub own: IntervalEstimate,
    /// The value with the help of the others, drawn below it.
    pub shared: Option<IntervalEstimate>,
}

/// Values of many things.
#[derive(Clone, Debug)]
pub struct ForestPlot {
    /// The caption, a sentence on what is shown.
    pub title: String,
    /// The name of the axis, with its unit.
    pub axis: String,
    /// The rows, from the top.
    pub rows: Vec<ForestRow>,
    /// The mean, drawn as a line, and its interval as a second bar at the bottom.
    pub mean: Option<IntervalEstimate>,
}

impl ForestPlot {
    /// Returns the plot as a figure; an empty text where there is nothing to be drawn.
    #[must_use]
    pub fn to_figure(&self) -> String {
        let Some([low, high]) = self.extent() else { return String::new() };
        let [left, right, top, bottom] = FOREST_PLOT_MARGINS;
        let rows = self.rows.len() + usize::from(self.mean.is_some());
        let (floor, end) = (top + ROW_HEIGHT * rows as f64, PLOT_WIDTH - right);
        let height = floor + bottom;
        let at = |value: f64| left + (value.clamp(low, high) - low) / (high - low) * (end - left);
        let mut svg = format!(
            "<figure><svg viewBox=\"0 0 {PLOT_WIDTH} {height}\" role=\"img\" aria-label=\"{}\">",
            escape_html(&self.title)
        );
        for (value, label) in axis_ticks(low, high, 6.0) {
            let (x, class) = (at(value), if value == 0.0 { "zero" } else { "grid" });
            let _ = write!(
                svg,
                "<path class=\"{class}\" d=\"M{x:.1} {top}V{floor}\"/>\
                 <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{label}</text>",
                floor + 16.0
            );
        }
        if let Some((mean, _)) = self.mean.filter(|(mean, _)| mean.is_finite()) {
            let x = at(mean);
            let _ = write!(svg, "<path class=\"line truth\" d=\"M{x:.1} {top}V{floor}\"/>");
        }
        let mut bar = |(value, [from, to]): IntervalEstimate, y: f64, colour: ColourRole| {
            let class = colour.css_class();
            let _ = write!(
                svg,
                "<path class=\"line {class}\" d=\"M{:.1} {y:.1}H{:.1}\"/>\
                 <path class=\"dots {class}\" d=\"M{:.1} {y:.1}h0\"/>",
                at(from),
                at(to),
                at(value)
            );
        };
        for (number, row) in self.rows.iter().enumerate() {
            let middle = top + ROW_HEIGHT * (number as f64 + 0.5);
            let apart = if row.shared.is_some() { 0.18 * ROW_HEIGHT } else { 0.0 };
            bar(row.own, middle - apart, ColourRole::Before);
            row.shared
                .into_iter()
                .for_each(|shared| bar(shared, middle + apart, ColourRole::After));
        }
        if let Some(mean) = self.mean {
            bar(mean, floor - 0.5 * ROW_HEIGHT, ColourRole::Truth);
        }
        let names = self.rows.iter().map(|row| row.name.as_str());
        for (number, name) in names.chain(self.mean.map(|_| "mean")).enumerate() {
            let _ = write!(
                svg,
                "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                left - 8.0,
                top + ROW_HEIGHT * (number as f64 + 0.5) + 4.0,
                escape_html(&abbreviate(name))
            );
        }
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text></svg><figcaption>{}",
            (left + end) / 2.0,
            height - 6.0,
            escape_html(&self.axis),
            escape_html(&self.title)
        );
        if let Some((mean, [from, to])) = self.mean {
            let [mean, from, to] = [mean, from, to].map(format_three_digits);
            let _ = write!(svg, " <span class=\"key truth\">mean {mean} ({from} to {to})</span>");
        }
        svg.push_str("</figcaption></figure>\n");
        svg
    }

    /// Returns the lowest and highest end of the intervals, with a margin.
    fn extent(&self) -> Option<[f64; 2]> {
        let of = |(value, [low, high]): IntervalEstimate| [value, low, high];
        let rows = self.rows.iter().flat_map(|row| std::iter::once(row.own).chain(row.shared));
        let values = rows.chain(self.mean).flat_map(of).filter(|value| value.is_finite());
        let [low, high] = values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
            [low.min(value), high.max(value)]
        });
        let margin = if high > low { 0.04 * (high - low) } else { 0.5 };
        (!self.rows.is_empty() && low <= high).then_some([low - margin, high + margin])
    }
}

/// Returns a name that has room: its beginning and its end, which distinguishes serial numbers.
fn abbreviate(name: &str) -> String {
    let characters: Vec<char> = name.chars().collect();
    if characters.len() <= MAX_NAME_CHARS {
        return name.into();
    }
    let half = MAX_NAME_CHARS / 2;
    let start: String = characters[..half].iter().collect();
    let end: String = characters[characters.len() - half + 1..].iter().collect();
    format!("{start}…{end}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(name: &str, own: IntervalEstimate) -> ForestRow {
        ForestRow { name: name.into(), own, shared: None }
    }

    #[test]
    fn every_row_has_its_name_and_its_interval_and_names_are_text() {
        let rows = (0..30).map(|n| row(&format!("<{n}>"), (f64::from(n), [-1.0, 40.0]))).collect();
        let mean = Some((14.5, [13.0, 16.0]));
        let figure = ForestPlot { title: "t".into(), axis: "µm".into(), rows, mean }.to_figure();
        assert_eq!(figure.matches("class=\"line before\"").count(), 30);
        assert!(figure.contains("&lt;29&gt;") && !figure.contains("<29>"));
        assert!(figure.contains("line truth") && figure.contains("mean 14.5 (13.0 to 16.0)"));
    }

    #[test]
    fn a_value_that_is_not_finite_draws_no_row_outside_the_picture() {
        let rows = vec![row("a", (1.0, [0.0, f64::INFINITY])), row("b", (2.0, [1.0, 3.0]))];
        let figure =
            ForestPlot { title: String::new(), axis: String::new(), rows, mean: None }.to_figure();
        assert!(!figure.contains("NaN") && !figure.contains("inf"), "{figure}");
        let none =
            ForestPlot { title: String::new(), axis: String::new(), rows: vec![], mean: None };
        assert_eq!(none.to_figure(), "");
    }

    #[test]
    fn a_long_name_keeps_both_ends() {
        let short = abbreviate("a-very-long-serial-number-of-a-machine-0042");
        assert!(short.chars().count() <= MAX_NAME_CHARS && short.ends_with("0042"), "{short}");
    }
}
