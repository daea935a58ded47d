//! A chart of curves or points over one axis, as SVG; its legend stands next to it and not on a curve.

use std::fmt::Write as _;

use crate::{html::escaped, number::ticks, seen};

const WIDTH: f64 = 480.0;
const HEIGHT: f64 = 290.0;
/// Left, right, top, bottom: room for the numbers and the names of the axes.
const MARGIN: [f64; 4] = [58.0, 12.0, 12.0, 44.0];

/// Colours by what they stand for: the same on every page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colour {
    /// As it was: the machine file as it is.
    Before,
    /// As it is corrected.
    After,
    /// Readings of an instrument.
    Measured,
    /// Hidden true values.
    Truth,
}

impl Colour {
    pub(crate) const fn class(self) -> &'static str {
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
pub struct Series {
    /// Its name in the legend.
    pub name: String,
    /// Its colour.
    pub colour: Colour,
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
    pub series: Vec<Series>,
}

impl Chart {
    /// Returns the chart as a figure; an empty text where there is nothing to be drawn.
    #[must_use]
    pub fn figure(&self) -> String {
        let Some([x, y]) = self.extent() else { return String::new() };
        let [left, right, top, bottom] = MARGIN;
        let at_x = |value: f64| left + (value - x[0]) / (x[1] - x[0]) * (WIDTH - left - right);
        let at_y =
            |value: f64| HEIGHT - bottom - (value - y[0]) / (y[1] - y[0]) * (HEIGHT - top - bottom);
        let mut svg = format!(
            "<figure class=\"chart\"><svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" \
             aria-label=\"{}\">",
            escaped(&self.title)
        );
        let (floor, end) = (HEIGHT - bottom, WIDTH - right);
        for (value, label) in ticks(x[0], x[1], 6.0) {
            let at = at_x(value);
            let _ = write!(
                svg,
                "<path class=\"grid\" d=\"M{at:.1} {top}V{floor}\"/>\
                 <text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{label}</text>",
                floor + 16.0
            );
        }
        for (value, label) in ticks(y[0], y[1], 5.0) {
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
            HEIGHT - 8.0,
            escaped(&self.x),
            escaped(&self.y)
        );
        for series in &self.series {
            let class = series.colour.class();
            let points: Vec<[f64; 2]> = series.shown().map(|[x, y]| [at_x(x), at_y(y)]).collect();
            let (kind, path) = match series.is_line {
                true => ("line", seen::line(&points)),
                false => ("dots", seen::dots(&points)),
            };
            let _ = write!(svg, "<path class=\"{kind} {class}\" d=\"{path}\"/>");
        }
        let _ = write!(svg, "</svg><figcaption>{}", escaped(&self.title));
        for series in legend(&self.series) {
            let _ = write!(
                svg,
                " <span class=\"key {}\">{}</span>",
                series.colour.class(),
                escaped(&series.name)
            );
        }
        svg.push_str("</figcaption></figure>\n");
        svg
    }

    /// Returns the chart as a picture that stands alone in a file: colours that read on light and on dark, and its
    /// legend below.
    #[must_use]
    pub fn standalone(&self) -> String {
        const STYLE: &str = "<style>text{font:12px sans-serif;fill:#7a858e}path{fill:none}\
             .grid{stroke:#9aa5ae;stroke-width:.4}.zero{stroke:#7a858e}.line{stroke-width:1.7}\
             .dots{stroke-width:4.8;stroke-linecap:round}path.before{stroke:#d9703a}\
             path.after{stroke:#3b87d6}path.measured{stroke:#7a858e}path.truth{stroke:#3f9a45}\
             text.before{fill:#d9703a}text.after{fill:#3b87d6}text.truth{fill:#3f9a45}</style>";
        let figure = self.figure();
        let Some((start, end)) = figure.find("<svg").zip(figure.find("</svg>")) else {
            return String::new();
        };
        let height = HEIGHT + 22.0;
        let mut svg = figure[start..end].replacen(
            &format!("viewBox=\"0 0 {WIDTH} {HEIGHT}\""),
            &format!("xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\""),
            1,
        );
        let inside = svg.find('>').map_or(svg.len(), |at| at + 1);
        svg.insert_str(inside, STYLE);
        let legend = legend(&self.series);
        let share = (WIDTH - MARGIN[0]) / legend.len().max(1) as f64;
        for (number, series) in legend.into_iter().enumerate() {
            let _ = write!(
                svg,
                "<text class=\"{}\" x=\"{:.0}\" y=\"{:.0}\">● {}</text>",
                series.colour.class(),
                MARGIN[0] + share * number as f64,
                height - 6.0,
                escaped(&series.name)
            );
        }
        svg + "</svg>\n"
    }

    /// Lowest and highest of x and of y, with a margin; none where there is no point.
    fn extent(&self) -> Option<[[f64; 2]; 2]> {
        let all = || self.series.iter().flat_map(Series::shown);
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

/// Returns one of each name and colour: a run may be many lines.
pub(crate) fn legend(all: &[Series]) -> Vec<&Series> {
    let mut legend: Vec<&Series> = Vec::new();
    for series in all {
        if !legend.iter().any(|it| (&it.name, it.colour) == (&series.name, series.colour)) {
            legend.push(series);
        }
    }
    legend
}

impl Series {
    /// Points that are joined.
    #[must_use]
    pub fn line(name: &str, colour: Colour, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), colour, points, is_line: true }
    }

    /// Points alone.
    #[must_use]
    pub fn dots(name: &str, colour: Colour, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), colour, points, is_line: false }
    }

    pub(crate) fn shown(&self) -> impl Iterator<Item = [f64; 2]> {
        let is_there = |point: &&[f64; 2]| point.iter().all(|value| value.is_finite());
        self.points.iter().filter(is_there).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: Vec<[f64; 2]>) -> Chart {
        let series = vec![Series::dots("a <b>", Colour::Before, points)];
        Chart { title: "t".into(), x: "time, min".into(), y: "error, µm".into(), series }
    }

    #[test]
    fn a_point_that_is_missing_is_left_out_and_without_points_there_is_no_picture() {
        let figure = chart(vec![[0.0, 1.0], [1.0, f64::NAN], [2.0, 3.0]]).figure();
        assert_eq!(figure.matches("h0").count(), 2);
        assert!(figure.contains("a &lt;b&gt;</span>"), "the legend is beside the picture");
        assert!(!figure.contains("NaN"));
        assert_eq!(chart(vec![[f64::NAN, 1.0]]).figure(), "");
    }

    #[test]
    fn a_picture_that_stands_alone_has_its_legend_and_its_style() {
        let svg = chart(vec![[0.0, 1.0], [2.0, 3.0]]).standalone();
        assert!(svg.starts_with("<svg xmlns=") && svg.ends_with("</svg>\n"), "{svg}");
        assert!(svg.contains("<style>") && svg.contains("● a &lt;b&gt;"), "{svg}");
    }

    #[test]
    fn the_lines_of_a_run_have_one_entry_in_the_legend() {
        let mut chart = chart(vec![[0.0, 1.0], [2.0, 3.0]]);
        chart.series.push(chart.series[0].clone());
        let figure = chart.figure();
        assert_eq!(
            (figure.matches("<path class=\"dots").count(), figure.matches("class=\"key").count()),
            (2, 1)
        );
    }

    #[test]
    fn every_point_is_inside_the_picture() {
        let figure = chart(vec![[-5.0, 1e-4], [7.0, 2e-4]]).figure();
        let (_, dots) = figure.split_once("class=\"dots before\" d=\"").expect("dots");
        for dot in dots.split("h0").filter_map(|dot| dot.strip_prefix('M')) {
            let x: f64 = dot.split(' ').next().and_then(|x| x.parse().ok()).expect("a number");
            assert!((MARGIN[0]..=WIDTH - MARGIN[1]).contains(&x), "{x}");
        }
    }
}
