//! The page of the loop: what the tool tip did before and after, in one file that needs nothing else.

use anyhow::{Result, anyhow};
use plotters::{chart::ChartContext, coord::types::RangedCoordf64, prelude::*};

use super::figures::{Check, ErrorCurve, Figures};

const BEFORE: RGBColor = RGBColor(192, 80, 40);
const AFTER: RGBColor = RGBColor(30, 110, 170);
const SIZE: (u32, u32) = (720, 360);

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// The page.
///
/// # Errors
/// A picture cannot be drawn.
pub fn page(figures: &Figures) -> Result<String> {
    let Figures { curves, time, lag, .. } = figures;
    let across = "place on X, mm";
    Ok(format!(
        r#"<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>trueup: LinuxCNC in the loop</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 760px; margin: 2rem auto; padding: 0 1rem; color: #222 }}
h1 {{ font-size: 1.5rem }} h2 {{ font-size: 1.15rem; margin-top: 2rem }}
svg {{ max-width: 100%; height: auto }}
table {{ border-collapse: collapse }} td, th {{ padding: .15rem .7rem; text-align: right }}
td:first-child, th:first-child {{ text-align: left }}
tr:nth-child(even) {{ background: #f4f4f2 }} th {{ border-bottom: 1px solid #888 }}
.before {{ color: rgb(192,80,40) }} .after {{ color: rgb(30,110,170) }}
.missed {{ color: #b00; font-weight: bold }} details pre {{ font-size: .8rem; overflow-x: auto }}
</style>
<h1>Where the tool tip really was, without and with the bridge</h1>
<p>A real LinuxCNC drives a virtual gantry of 14.3 × 3 × 2.5&nbsp;m; the bridge's real firmware, on an
emulated board, corrects it through LinuxCNC's external offsets. The machine file was made by
measuring the virtual machine and fitting, as on a real one. {cycles} servo cycles were looked at.</p>
<table>
<tr><th></th><th class="before">without</th><th class="after">with</th><th></th><th>wanted</th></tr>
{checks}</table>
<h2>Along the diagonal: height of the tool tip</h2>
{diagonal_z}
<h2>Along the diagonal: sideways, on Y</h2>
{diagonal_y}
<h2>Around the arc: height of the tool tip</h2>
{arc}
<h2>Two hours of warm-up at 24&nbsp;000&nbsp;r/min: height of the tool tip</h2>
{warm_up}
<h2>Five axes, the spindle warm</h2>
<p>Without the bridge the tool tip is off by the growth of the spindle, wherever the head points. With
it, this is the length of the whole error, of all axes.</p>
{five}
<h2>The staircase: error on Z, µm</h2>
<table>
<tr><th>Z, mm</th><th class="before">from below</th><th class="before">from above</th><th class="after">from below</th><th class="after">from above</th></tr>
{stairs}</table>
<h2>How late the offsets are</h2>
<p>{mean:.1}&nbsp;ms from where a joint is to the offset that belongs there, over the diagonal;
{worst:.1}&nbsp;ms in the worst two seconds of it. Where the error is steepest, {steep:.3}&nbsp;µm/mm, that
costs {costs:.2}&nbsp;µm at 10&nbsp;m/min. The lag holds: sending the position (every 2&nbsp;ms), the
board's millisecond, the way back, and LinuxCNC's own planner for offsets, which has
OFFSET_AV_RATIO&nbsp;=&nbsp;{ratio} of each axis' acceleration. Slew limit of board and component:
{slew}&nbsp;µm/s, half a micrometre in a servo cycle; the diagonal at 58&nbsp;m/min needs about
70&nbsp;µm/s of it, a reversal the rest.</p>
<h2>What was compressed</h2>
<p>All motion was cut at real time. In the warm-up board and machine lived {hours:.0}&nbsp;h in
{wall:.0}&nbsp;s, {factor:.0} times as fast as the wall clock, while LinuxCNC stayed in real time and its
program waited for the machine's clock. Because the board counts the CNC's silence in its own time,
its link_timeout_ms and hold_ms were {longer} times longer in this part; LinuxCNC got one pair of
offsets in {stride}, each as the board sent it. Board time lost in the motion because this computer was
too slow: {slipped}&nbsp;ms.</p>
<details><summary>What the diagnosis found in the measured warm-up</summary><pre>{findings}</pre></details>
<details><summary>The machine file that the board ran</summary><pre>{machine}</pre></details>
</html>
"#,
        cycles = figures.cycles[0],
        checks = figures.checks.iter().map(row).collect::<String>(),
        diagonal_z = picture(&curves.diagonal_z, across, "error on Z, µm")?,
        diagonal_y = picture(&curves.diagonal_y, across, "error on Y, µm")?,
        arc = picture(&curves.arc_z, "angle, degrees", "error on Z, µm")?,
        warm_up = picture(&curves.warm_up, "hours", "change of the error on Z, µm")?,
        five = picture(&curves.five_axes, "seconds", "length of the error, µm")?,
        stairs = stairs(figures),
        mean = lag.mean_ms,
        worst = lag.worst_ms,
        steep = lag.steepest_um_per_mm,
        costs = lag.costs_um_at_10_m_per_min,
        ratio = figures.offset_av_ratio,
        slew = figures.slew_um_per_s,
        hours = f64::from(time.warm_up_s) / 3_600.0,
        wall = time.warm_up_wall_s,
        factor = f64::from(time.warm_up_s) / time.warm_up_wall_s,
        longer = time.limits_longer_by,
        stride = time.pairs_passed_one_in,
        slipped = time.slipped_ms,
        findings = escaped(&figures.findings),
        machine = escaped(&figures.machine_file),
    ))
}

fn row(check: &Check) -> String {
    let um = |value: Option<f64>| value.map_or(String::new(), |um| format!("{um:.2} µm"));
    let class = if check.is_met() { "" } else { " class=\"missed\"" };
    let sense = if check.at_least { "≥" } else { "≤" };
    let Check { name, value, unit, limit, .. } = check;
    let sign = if check.before_um.is_some() { "−" } else { "" };
    format!(
        "<tr{class}><td>{name}</td><td>{}</td><td>{}</td><td>{sign}{value:.2} {unit}</td><td>{sense} \
         {limit} {unit}</td></tr>\n",
        um(check.before_um),
        um(check.after_um),
    )
}

fn stairs(figures: &Figures) -> String {
    let row = |stair: &super::figures::Stair| {
        let ([b0, b1], [a0, a1]) = (stair.before_um, stair.after_um);
        format!(
            "<tr><td>{:.1}</td><td>{b0:.2}</td><td>{b1:.2}</td><td>{a0:.2}</td><td>{a1:.2}</td></tr>\n",
            stair.z_mm
        )
    };
    figures.stairs.iter().map(row).collect()
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

fn picture(curve: &ErrorCurve, x_title: &str, y_title: &str) -> Result<String> {
    let limits = |values: &mut dyn Iterator<Item = f64>| {
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
    };
    let (left, right) = limits(&mut curve.at.iter().copied());
    let (low, high) =
        limits(&mut curve.before_um.iter().chain(&curve.after_um).copied().chain([0.0]));
    let room = 0.05 * (high - low).max(1e-3);
    let mut svg = String::new();
    let mut all = || -> Result<(), DrawingAreaErrorKind<std::io::Error>> {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        let mut chart: Chart = ChartBuilder::on(&area)
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(56)
            .build_cartesian_2d(left..right.max(left + 1e-6), low - room..high + room)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.1))
            .label_style(("sans-serif", 15))
            .axis_desc_style(("sans-serif", 16))
            .x_desc(x_title)
            .y_desc(y_title)
            .draw()?;
        let lines = [
            (&curve.before_um, BEFORE, "without compensation"),
            (&curve.after_um, AFTER, "with the bridge"),
        ];
        for (values, colour, label) in lines {
            let points = curve.at.iter().copied().zip(values.iter().copied());
            chart
                .draw_series(LineSeries::new(points, colour.stroke_width(2)))?
                .label(label)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], colour));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperLeft)
            .background_style(WHITE.mix(0.85))
            .label_font(("sans-serif", 15))
            .draw()?;
        area.present()
    };
    all().map_err(|error| anyhow!("a picture cannot be drawn: {error}"))?;
    Ok(svg)
}
