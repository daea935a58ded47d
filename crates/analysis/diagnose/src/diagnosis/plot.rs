//! The pictures of the report, in the look of all reports.

use trueup_page::{Chart, ChartSeries};

pub(crate) use trueup_page::ColourRole;

/// Points (x, y) of one colour.
pub(crate) struct PlotSeries<'a> {
    pub x: &'a [f64],
    pub y: &'a [f64],
    pub colour: ColourRole,
    pub is_line: bool,
}

impl<'a> PlotSeries<'a> {
    pub(super) fn dots(x: &'a [f64], y: &'a [f64], colour: ColourRole) -> Self {
        Self { x, y, colour, is_line: false }
    }

    pub(super) fn line(x: &'a [f64], y: &'a [f64], colour: ColourRole) -> Self {
        Self { x, y, colour, is_line: true }
    }
}

/// Returns what a colour stands for.
fn colour_role_label(colour: ColourRole) -> &'static str {
    match colour {
        ColourRole::Before => "the machine file as it is",
        ColourRole::After => "with the causes found",
        ColourRole::Measured => "measured",
        ColourRole::Truth => "true",
    }
}

/// Returns a picture of `lists` over one axis; an empty text where there is nothing to be drawn.
pub(crate) fn render_plot(
    title: &str,
    x_name: &str,
    y_name: &str,
    lists: &[PlotSeries<'_>],
) -> String {
    let series = lists.iter().map(|list| {
        let points = list.x.iter().zip(list.y).map(|(x, y)| [*x, *y]).collect();
        let of = if list.is_line { ChartSeries::line } else { ChartSeries::dots };
        of(colour_role_label(list.colour), list.colour, points)
    });
    Chart { title: title.into(), x: x_name.into(), y: y_name.into(), series: series.collect() }
        .to_figure()
}
