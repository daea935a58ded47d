//! The pictures of the report, as SVG.

use plotters::prelude::*;

const SIZE: (u32, u32) = (820, 260);
const SMALL: (u32, u32) = (400, 240);
const BEFORE: RGBColor = RGBColor(190, 90, 40);
const AFTER: RGBColor = RGBColor(30, 90, 170);
const MEASURED: RGBColor = RGBColor(60, 60, 60);
/// A picture does not show more points than that.
const MOST_POINTS: usize = 1500;

/// Points (x, y) of one colour.
pub(crate) struct Points<'a> {
    pub x: &'a [f64],
    pub y: &'a [f64],
    pub colour: Colour,
    pub is_line: bool,
}

impl<'a> Points<'a> {
    pub(super) fn dots(x: &'a [f64], y: &'a [f64], colour: Colour) -> Self {
        Self { x, y, colour, is_line: false }
    }

    pub(super) fn line(x: &'a [f64], y: &'a [f64], colour: Colour) -> Self {
        Self { x, y, colour, is_line: true }
    }
}

/// What is drawn.
#[derive(Clone, Copy)]
pub(crate) enum Colour {
    Before,
    After,
    Measured,
}

/// A picture of `lists` over one axis; an empty text where there is nothing to be drawn.
pub(crate) fn picture(x_name: &str, y_name: &str, lists: &[Points<'_>], is_small: bool) -> String {
    drawn(x_name, y_name, lists, if is_small { SMALL } else { SIZE }).unwrap_or_default()
}

fn drawn(x_name: &str, y_name: &str, lists: &[Points<'_>], size: (u32, u32)) -> Option<String> {
    let extent = |of: fn(&Points<'_>) -> Vec<f64>| {
        let all = lists.iter().flat_map(of).filter(|value| value.is_finite());
        let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
        let margin = if high > low { 0.04 * (high - low) } else { 0.5 };
        (low <= high).then_some(low - margin..high + margin)
    };
    let x_range = extent(|points| points.x.to_vec())?;
    let y_range = extent(|points| points.y.to_vec())?;
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE).ok()?;
        let mut chart = ChartBuilder::on(&root)
            .margin(8)
            .x_label_area_size(36)
            .y_label_area_size(56)
            .build_cartesian_2d(x_range, y_range)
            .ok()?;
        chart
            .configure_mesh()
            .x_desc(x_name)
            .y_desc(y_name)
            .x_labels(6)
            .y_labels(6)
            .light_line_style(WHITE)
            .draw()
            .ok()?;
        for list in lists {
            let colour = match list.colour {
                Colour::Before => BEFORE,
                Colour::After => AFTER,
                Colour::Measured => MEASURED,
            };
            let every = list.x.len().div_ceil(MOST_POINTS).max(1);
            let points: Vec<(f64, f64)> = list
                .x
                .iter()
                .zip(list.y)
                .step_by(every)
                .filter(|(x, y)| x.is_finite() && y.is_finite())
                .map(|(x, y)| (*x, *y))
                .collect();
            if list.is_line {
                chart.draw_series(LineSeries::new(points, colour)).ok()?;
            } else {
                let dot = |at| Circle::new(at, 2, colour.mix(0.6).filled());
                chart.draw_series(points.into_iter().map(dot)).ok()?;
            }
        }
        root.present().ok()?;
    }
    Some(svg)
}
