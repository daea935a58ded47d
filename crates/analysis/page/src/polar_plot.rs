//! A polar plot: deviations from a circle, enlarged, as SVG in the colours of the charts.

use std::fmt::Write as _;

use crate::{
    ChartSeries, chart::figure_end_html, html::escape_html, number::axis_ticks, point_reduction,
};

/// Width and height.
const PLOT_SIZE: f64 = 420.0;
/// The radius of the circle without deviation.
const ZERO_DEVIATION_RADIUS: f64 = 125.0;
/// The largest deviation.
const MAX_RADIAL_OFFSET: f64 = 65.0;

/// A polar plot. The points of its series are an angle in rad and a deviation in µm, outward positive.
#[derive(Clone, Debug)]
pub struct PolarPlot {
    /// A sentence on what it shows, for those who cannot see it, and under it.
    pub title: String,
    /// The names of the axes to the right and upward.
    pub axes: [String; 2],
    /// The curves, the last on top.
    pub series: Vec<ChartSeries>,
}

impl PolarPlot {
    /// Returns the plot as a figure; an empty text without points.
    #[must_use]
    pub fn to_figure(&self) -> String {
        let all = || self.series.iter().flat_map(ChartSeries::finite_points);
        let largest = all().map(|[_, um]| um.abs()).fold(0.0, f64::max);
        if all().next().is_none() {
            return String::new();
        }
        let scale = MAX_RADIAL_OFFSET / largest.max(1e-3);
        let middle = PLOT_SIZE / 2.0;
        let at = |[angle, um]: [f64; 2]| {
            let radius = ZERO_DEVIATION_RADIUS + scale * um;
            [middle + radius * angle.cos(), middle - radius * angle.sin()]
        };
        let mut svg = format!(
            "<figure class=\"chart\"><svg viewBox=\"0 0 {PLOT_SIZE} {PLOT_SIZE}\" role=\"img\" aria-label=\"{}\">",
            escape_html(&self.title)
        );
        let end = ZERO_DEVIATION_RADIUS + MAX_RADIAL_OFFSET + 8.0;
        let _ = write!(
            svg,
            "<path class=\"grid\" d=\"M{0:.1} {middle:.1}H{1:.1}M{middle:.1} {0:.1}V{1:.1}\"/>",
            middle - end,
            middle + end
        );
        for (um, label) in axis_ticks(-largest, largest, 4.0) {
            let radius = ZERO_DEVIATION_RADIUS + scale * um;
            let class = if um == 0.0 { "zero" } else { "grid" };
            // On the diagonal, where the fewest curves have their peaks.
            let [x, y] = at([std::f64::consts::FRAC_PI_4, um]);
            let _ = write!(
                svg,
                "<circle class=\"{class}\" cx=\"{middle}\" cy=\"{middle}\" r=\"{radius:.1}\"/>\
                 <text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"middle\">{label}</text>"
            );
        }
        let [right, up] = &self.axes;
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}+</text>\
             <text x=\"{:.1}\" y=\"{:.1}\">{}+ (rings in µm)</text>",
            middle + end,
            middle - 6.0,
            escape_html(right),
            middle + 6.0,
            middle - end + 8.0,
            escape_html(up)
        );
        for series in &self.series {
            let points: Vec<[f64; 2]> = series.finite_points().map(at).collect();
            let class = series.colour.css_class();
            let _ = write!(
                svg,
                "<path class=\"line {class}\" d=\"{}\"/>",
                point_reduction::curve_path(&points)
            );
        }
        svg + &figure_end_html(&self.title, &self.series)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;
    use crate::ColourRole;

    #[test]
    fn a_positive_deviation_is_outside_the_circle_and_plus_is_right_and_up() {
        let points = vec![[0.0, 10.0], [FRAC_PI_2, -5.0], [PI, f64::NAN]];
        let series = vec![ChartSeries::line("a <b>", ColourRole::Before, points)];
        let polar = PolarPlot { title: "t".into(), axes: ["X".into(), "Y".into()], series };
        let figure = polar.to_figure();
        // 210 + 125 + 65 to the right; 210 − (125 − 32.5) upward.
        assert!(figure.contains("d=\"M400.0 210.0L210.0 117.5\""), "{figure}");
        assert!(figure.contains("a &lt;b&gt;</span>") && !figure.contains("NaN"), "{figure}");
        assert_eq!(PolarPlot { series: Vec::new(), ..polar }.to_figure(), "");
    }
}
