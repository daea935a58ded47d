//! A chart of curves or points over one axis, as SVG; its legend stands next to it and not on a curve.

use std::fmt::Write as _;

use crate::{html::escape_html, number::axis_ticks, point_reduction};

const CHART_WIDTH: f64 = 480.0;
const CHART_HEIGHT: f64 = 290.0;
/// Left, right, top, bottom: room for the numbers and the names of the axes.
const CHART_MARGINS: [f64; 4] = [58.0, 12.0, 12.0, 44.0];

/// Colours by what they stand for: the same on every page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColourRole {
    /// As it was: with the current machine file.
    Before,
    /// As it is corrected.
    After,
    /// Readings of an instrument.
    Measured,
    /// Hidden true values.
    Truth,
}

impl ColourRole {
    pub(crate) const fn css_class(self) -> &'static str {
        match self {
            Self::Before => "before",
            Self::After => "after",
            Self::Measured => "measured",
            Self::Truth => "truth",
        }
    }
}

/// Points of one colour under one name.
#[derive(Clone, Debug)]
pub struct ChartSeries {
    /// Its name in the legend.
    pub name: String,
    /// Its colour.
    pub colour: ColourRole,
    /// The points; one that is not finite is left out.
    pub points: Vec<[f64; 2]>,
    /// Whether they are joined.
    pub is_line: bool,
}

/// A chart.
#[derive(Clone, Debug)]
pub struct Chart {
    /// The caption, a sentence on what is shown: for those who cannot see it, and under it.
    pub title: String,
    /// The name of the horizontal axis, with its unit.
    pub x: String,
    /// The name of the vertical axis, with its unit.
    pub y: String,
    /// The series to draw, the last on top.
    pub series: Vec<ChartSeries>,
}

impl Chart {
    /// Returns the chart as a figure; an empty text where there is nothing to be drawn.
    #[must_use]
    pub fn to_figure(&self) -> String {
        let Some([x, y]) = self.extent() else { return String::new() };
        let [left, right, top, bottom] = CHART_MARGINS;
        let at_x =
            |value: f64| left + (value - x[0]) / (x[1] - x[0]) * (CHART_WIDTH - left - right);
        let at_y = |value: f64| {
            CHART_HEIGHT - bottom - (value - y[0]) / (y[1] - y[0]) * (CHART_HEIGHT - top - bottom)
        };
        let mut svg = format!(
            "<figure class=\"chart\"><svg viewBox=\"0 0 {CHART_WIDTH} {CHART_HEIGHT}\" role=\"img\" \
             aria-label=\"{}\">",
            escape_html(&self.title)
        );
        let (floor, end) = (CHART_HEIGHT - bottom, CHART_WIDTH - right);
        for (value, label) in axis_ticks(x[0], x[1], 6.0) {
            let at = at_x(value);
            let _ = write!(
                svg,
                "<path class=\"grid\" d=\"M{at:.1} {top}V{floor}\"/>\
                 <text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{label}</text>",
                floor + 16.0
            );
        }
        for (value, label) in axis_ticks(y[0], y[1], 5.0) {
            let at = at_y(value);
            let class = if value == 0.0 { "zero" } else { "grid" };
            let _ = write!(
                svg,
                "<path class=\"{class}\" d=\"M{left} {at:.1}H{end}\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>",
                left - 6.0,
                at + 4.0
            );
        }
        let middle = (top + floor) / 2.0;
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\
             <text transform=\"translate(14 {middle:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            (left + end) / 2.0,
            CHART_HEIGHT - 8.0,
            escape_html(&self.x),
            escape_html(&self.y)
        );
        for series in &self.series {
            let class = series.colour.css_class();
            let points: Vec<[f64; 2]> =
                series.finite_points().map(|[x, y]| [at_x(x), at_y(y)]).collect();
            let (kind, path) = match series.is_line {
                true => ("line", point_reduction::line_path(&points)),
                false => ("dots", point_reduction::dots_path(&points)),
            };
            let _ = write!(svg, "<path class=\"{kind} {class}\" d=\"{path}\"/>");
        }
        svg + &figure_end_html(&self.title, &self.series)
    }

    /// Returns the chart as a picture that stands alone in a file: colours that read on light and on dark, and its
    /// legend below.
    #[must_use]
    pub fn to_standalone_svg(&self) -> String {
        const STANDALONE_STYLE: &str = "<style>text{font:12px sans-serif;fill:#7a858e}path{fill:none}\
             .grid{stroke:#9aa5ae;stroke-width:.4}.zero{stroke:#7a858e}.line{stroke-width:1.7}\
             .dots{stroke-width:4.8;stroke-linecap:round}path.before{stroke:#d9703a}\
             path.after{stroke:#3b87d6}path.measured{stroke:#7a858e}path.truth{stroke:#3f9a45}\
             text.before{fill:#d9703a}text.after{fill:#3b87d6}text.truth{fill:#3f9a45}</style>";
        let figure = self.to_figure();
        let Some((start, end)) = figure.find("<svg").zip(figure.find("</svg>")) else {
            return String::new();
        };
        let height = CHART_HEIGHT + 22.0;
        let mut svg = figure[start..end].replacen(
            &format!("viewBox=\"0 0 {CHART_WIDTH} {CHART_HEIGHT}\""),
            &format!("xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {CHART_WIDTH} {height}\""),
            1,
        );
        let inside = svg.find('>').map_or(svg.len(), |at| at + 1);
        svg.insert_str(inside, STANDALONE_STYLE);
        let legend = legend_entries(&self.series);
        let share = (CHART_WIDTH - CHART_MARGINS[0]) / legend.len().max(1) as f64;
        for (number, series) in legend.into_iter().enumerate() {
            let _ = write!(
                svg,
                "<text class=\"{}\" x=\"{:.0}\" y=\"{:.0}\">● {}</text>",
                series.colour.css_class(),
                CHART_MARGINS[0] + share * number as f64,
                height - 6.0,
                escape_html(&series.name)
            );
        }
        svg + "</svg>\n"
    }

    /// Lowest and highest of x and of y, with a margin; none where there is no point.
    fn extent(&self) -> Option<[[f64; 2]; 2]> {
        let all = || self.series.iter().flat_map(ChartSeries::finite_points);
        let range = |of: usize| {
            let (low, high) = all()
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), point| {
                    (low.min(point[of]), high.max(point[of]))
                });
            let margin = if high > low { 0.04 * (high - low) } else { 0.5 };
            [low - margin, high + margin]
        };
        all().next().map(|_| [range(0), range(1)])
    }
}

/// Returns the end of a figure: its title, and its series once each.
pub(crate) fn figure_end_html(title: &str, series: &[ChartSeries]) -> String {
    let mut caption = format!("</svg><figcaption>{}", escape_html(title));
    for ChartSeries { name, colour, .. } in legend_entries(series) {
        let _ = write!(
            caption,
            " <span class=\"key {}\">{}</span>",
            colour.css_class(),
            escape_html(name)
        );
    }
    caption + "</figcaption></figure>\n"
}

/// Returns one of each name and colour: a run may be many lines.
fn legend_entries(all: &[ChartSeries]) -> Vec<&ChartSeries> {
    let mut legend: Vec<&ChartSeries> = Vec::new();
    for series in all {
        if !legend.iter().any(|other| (&other.name, other.colour) == (&series.name, series.colour))
        {
            legend.push(series);
        }
    }
    legend
}

impl ChartSeries {
    /// Points that are joined.
    #[must_use]
    pub fn line(name: &str, colour: ColourRole, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), colour, points, is_line: true }
    }

    /// Points alone.
    #[must_use]
    pub fn dots(name: &str, colour: ColourRole, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), colour, points, is_line: false }
    }

    pub(crate) fn finite_points(&self) -> impl Iterator<Item = [f64; 2]> {
        let is_there = |point: &&[f64; 2]| point.iter().all(|value| value.is_finite());
        self.points.iter().filter(is_there).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: Vec<[f64; 2]>) -> Chart {
        let series = vec![ChartSeries::dots("a <b>", ColourRole::Before, points)];
        Chart { title: "t".into(), x: "time, min".into(), y: "error, µm".into(), series }
    }

    #[test]
    fn a_point_that_is_missing_is_omitted_and_without_points_there_is_no_picture() {
        let figure = chart(vec![[0.0, 1.0], [1.0, f64::NAN], [2.0, 3.0]]).to_figure();
        assert_eq!(figure.matches("h0").count(), 2);
        assert!(figure.contains("a &lt;b&gt;</span>"), "the legend is beside the picture");
        assert!(!figure.contains("NaN"));
        assert_eq!(chart(vec![[f64::NAN, 1.0]]).to_figure(), "");
    }

    #[test]
    fn a_picture_that_stands_alone_has_its_legend_and_its_style() {
        let svg = chart(vec![[0.0, 1.0], [2.0, 3.0]]).to_standalone_svg();
        assert!(svg.starts_with("<svg xmlns=") && svg.ends_with("</svg>\n"), "{svg}");
        assert!(svg.contains("<style>") && svg.contains("● a &lt;b&gt;"), "{svg}");
    }

    #[test]
    fn the_lines_of_a_run_have_one_entry_in_the_legend() {
        let mut chart = chart(vec![[0.0, 1.0], [2.0, 3.0]]);
        chart.series.push(chart.series[0].clone());
        let figure = chart.to_figure();
        assert_eq!(
            (figure.matches("<path class=\"dots").count(), figure.matches("class=\"key").count()),
            (2, 1)
        );
    }

    #[test]
    fn every_point_is_inside_the_picture() {
        let figure = chart(vec![[-5.0, 1e-4], [7.0, 2e-4]]).to_figure();
        let (_, dots) = figure.split_once("class=\"dots before\" d=\"").expect("dots");
        for dot in dots.split("h0").filter_map(|dot| dot.strip_prefix('M')) {
            let x: f64 = dot.split(' ').next().and_then(|x| x.parse().ok()).expect("a number");
            assert!((CHART_MARGINS[0]..=CHART_WIDTH - CHART_MARGINS[1]).contains(&x), "{x}");
        }
    }
}
