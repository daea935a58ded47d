//! The demonstration's page: two pictures and the table, in one file that needs nothing else.

use anyhow::{Result, anyhow};
use plotters::{chart::ChartContext, coord::types::RangedCoordf64, prelude::*};

use crate::demo::Findings;

const PAPER: RGBColor = RGBColor(192, 80, 40);
const CALIBRATED: RGBColor = RGBColor(30, 110, 170);
const SIZE: (u32, u32) = (720, 420);

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// The page.
///
/// # Errors
/// A picture cannot be drawn.
pub fn page(findings: &Findings) -> Result<String> {
    let answer: String = findings.answer().iter().map(|line| format!("<p>{line}</p>\n")).collect();
    let mut rows = String::new();
    for row in &findings.rows {
        rows += &format!(
            "<tr><td>{:.1}</td><td>{:.2}</td><td>{:+.2}</td><td>{:.2}</td><td>{:+.2}</td></tr>\n",
            row.dial_um,
            row.bridge_um,
            row.bridge_um - row.dial_um,
            row.calibrated_um,
            row.calibrated_um - row.dial_um,
        );
    }
    Ok(format!(
        r#"<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>trueup: the paper's spindle through the bridge</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 760px; margin: 2rem auto; padding: 0 1rem; color: #222 }}
h1 {{ font-size: 1.5rem }} h2 {{ font-size: 1.15rem; margin-top: 2rem }}
svg {{ max-width: 100%; height: auto }}
table {{ border-collapse: collapse }} td, th {{ padding: .15rem .9rem; text-align: right }}
tr:nth-child(even) {{ background: #f4f4f2 }} th {{ border-bottom: 1px solid #888 }}
.figures {{ display: flex; gap: 2rem; flex-wrap: wrap }} .figures b {{ font-size: 1.6rem; display: block }}
.paper {{ color: rgb(192,80,40) }} .calibrated {{ color: rgb(30,110,170) }}
</style>
<h1>A spindle's growth: what the sensor says, what the dial gauge shows</h1>
<p>Fifteen readings of a spindle displacement sensor (Table 1 of the paper named in
<code>data/README.md</code>), played through the bridge's real firmware on an emulated board at
24&nbsp;000&nbsp;r/min, with 1&nbsp;LSB of noise and ±5&nbsp;µm of run-out. {frames} frames were read as a CNC
reads them, {errors} of them damaged or lost.</p>
<div class="figures">
<div class="paper"><b>{paper_rms:.1} µm</b>RMS error with the paper's constants (largest {paper_max:.1})</div>
<div class="calibrated"><b>{cal_rms:.2} µm</b>RMS error calibrated, each row from the others (largest {cal_max:.2})</div>
</div>
<h2>The answer</h2>
{answer}
<h2>Growth: bridge against dial gauge</h2>
{growth}
<h2>What is left: bridge minus dial gauge</h2>
{left}
<h2>Row by row, in µm</h2>
<table>
<tr><th>dial</th><th class="paper">paper</th><th class="paper">off by</th><th class="calibrated">calibrated</th><th class="calibrated">off by</th></tr>
{rows}</table>
</html>
"#,
        frames = findings.frames,
        errors = findings.e2e_errors,
        paper_rms = findings.paper.rms_um,
        paper_max = findings.paper.max_um,
        cal_rms = findings.calibrated.loo_rms_um,
        cal_max = findings.calibrated.loo_max_um,
        growth = growth(findings)?,
        left = left(findings)?,
    ))
}

/// The bridge's elongation against the dial gauge's.
fn growth(findings: &Findings) -> Result<String> {
    let legend = SeriesLabelPosition::LowerRight;
    draw(0.0..85.0, 0.0..85.0, "bridge, µm", legend, |chart| {
        let ideal = LineSeries::new([(0.0, 0.0), (85.0, 85.0)], BLACK.mix(0.4));
        chart.draw_series(ideal)?.label("what a true bridge shows").legend(line(BLACK));
        let paper = findings.rows.iter().map(|row| (row.dial_um, row.bridge_um));
        let calibrated = findings.rows.iter().map(|row| (row.dial_um, row.calibrated_um));
        points(chart, paper, PAPER, "with the paper's constants")?;
        points(chart, calibrated, CALIBRATED, "calibrated from the other rows")
    })
}

/// What is left of the error.
fn left(findings: &Findings) -> Result<String> {
    let legend = SeriesLabelPosition::LowerLeft;
    draw(0.0..85.0, -18.0..6.0, "bridge minus dial, µm", legend, |chart| {
        let zero = LineSeries::new([(0.0, 0.0), (85.0, 0.0)], BLACK.mix(0.4));
        chart.draw_series(zero)?;
        let rows = findings.rows.iter();
        let paper = rows.clone().map(|row| (row.dial_um, row.bridge_um - row.dial_um));
        let calibrated = rows.map(|row| (row.dial_um, row.calibrated_um - row.dial_um));
        points(chart, paper, PAPER, "with the paper's constants")?;
        points(chart, calibrated, CALIBRATED, "calibrated from the other rows")
    })
}

type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;

fn draw(
    x: std::ops::Range<f64>,
    y: std::ops::Range<f64>,
    y_title: &str,
    legend: SeriesLabelPosition,
    content: impl FnOnce(&mut Chart) -> Drawn,
) -> Result<String> {
    let mut svg = String::new();
    let all = || -> Drawn {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&area)
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(56)
            .build_cartesian_2d(x, y)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.1))
            .label_style(("sans-serif", 15))
            .axis_desc_style(("sans-serif", 16))
            .x_desc("dial gauge, µm")
            .y_desc(y_title)
            .draw()?;
        content(&mut chart)?;
        chart
            .configure_series_labels()
            .position(legend)
            .background_style(WHITE.mix(0.85))
            .label_font(("sans-serif", 15))
            .draw()?;
        area.present()
    };
    all().map_err(|error| anyhow!("a picture cannot be drawn: {error}"))?;
    Ok(svg)
}

fn points(
    chart: &mut Chart,
    values: impl Iterator<Item = (f64, f64)>,
    color: RGBColor,
    label: &str,
) -> Drawn {
    chart
        .draw_series(values.map(|place| Circle::new(place, 5, color.mix(0.8).filled())))?
        .label(label)
        .legend(move |(x, y)| Circle::new((x + 10, y), 5, color.filled()));
    Ok(())
}

fn line(color: RGBColor) -> impl Fn((i32, i32)) -> PathElement<(i32, i32)> {
    move |(x, y)| PathElement::new([(x, y), (x + 20, y)], color.mix(0.4))
}
