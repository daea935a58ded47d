//! The page of the loop: what the tool tip did before and after, in the look of all reports.

use trueup_page::{Chart, ChartSeries, ColourRole, HtmlPage, HtmlTable, format_micrometres};

use super::{
    BridgePlatform, OffsetEntryPoint,
    loop_results::{AcceptanceCheck, ErrorCurve, LoopFigures, StaircaseStep},
};

/// Returns the page.
#[must_use]
pub fn render_page(figures: &LoopFigures) -> String {
    let mut page = HtmlPage::new("Where the tool tip really was, without and with the bridge");
    add_verdict(&mut page, &figures.checks);
    page.add_paragraph(&format!(
        "A real LinuxCNC drives a virtual gantry of 14.3 × 3 × 2.5 m; the bridge's real {}, corrects it {}. The machine file was made by \
         measuring the virtual machine and fitting, as on a real one. {} servo cycles were looked at.",
        match figures.way.on {
            BridgePlatform::Qemu => "firmware, on an emulated board",
            BridgePlatform::Chip => "firmware, as it is flashed, on the model of its chip",
            BridgePlatform::Servo => "component without a board, in the servo thread",
        },
        match figures.way.by {
            OffsetEntryPoint::Eoffset => "through LinuxCNC's external offsets",
            OffsetEntryPoint::Joint => "between LinuxCNC's joints and their drives",
        },
        figures.cycles[0]
    ));
    let mut table = HtmlTable::new(&["", "without", "with", "", "target"]);
    figures.checks.iter().for_each(|check| table.add_row(&format_check_row(check)));
    page.add_table(&table);

    let curves = &figures.curves;
    let across = "place on X, mm";
    page.add_heading("The error of the tool tip");
    page.add_charts(&[
        render_chart("Along the diagonal: height", across, "error on Z, µm", &curves.diagonal_z),
        render_chart("Along the diagonal: sideways", across, "error on Y, µm", &curves.diagonal_y),
        render_chart("Around the arc: height", "angle, degrees", "error on Z, µm", &curves.arc_z),
        render_chart(
            "Two hours of warm-up at 24 000 r/min: height",
            "time, h",
            "change of the error on Z, µm",
            &curves.warm_up,
        ),
        render_chart(
            "Five axes, the spindle warm",
            "time, s",
            "length of the error, µm",
            &curves.five_axes,
        ),
    ]);
    page.add_note(
        "Five axes: without the bridge the tool tip is off by the growth of the spindle, wherever the head \
         points. With it, this is the length of the whole error, of all axes.",
    );
    page.add_heading("The staircase: error on Z, µm");
    page.add_table(&staircase_table(&figures.stairs));
    page.add_heading("How late the offsets are");
    page.add_paragraph(&describe_lag(figures));
    page.add_heading("What was compressed");
    page.add_paragraph(&describe_time_compression(figures));
    page.add_details("What the diagnosis found in the measured warm-up", &figures.findings);
    page.add_details("The machine file that the board ran", &figures.machine_file);
    page.to_html()
}

/// Whether all is reached, and what is not.
fn add_verdict(page: &mut HtmlPage, checks: &[AcceptanceCheck]) {
    let missed: Vec<String> = checks
        .iter()
        .filter(|check| !check.is_met())
        .map(|check| {
            format!("{}: {}, target {}", check.name, format_value(check), format_limit(check))
        })
        .collect();
    if missed.is_empty() {
        page.add_card(
            "good",
            "Reached",
            &[format!("All {} figures reach their targets.", checks.len())],
        );
    } else {
        page.add_card("bad", "Not reached", &missed);
    }
}

fn format_value(check: &AcceptanceCheck) -> String {
    let sign = if check.before_um.is_some() { "−" } else { "" };
    format!("{sign}{:.2} {}", check.value, check.unit).trim_end().into()
}

fn format_limit(check: &AcceptanceCheck) -> String {
    let sense = if check.at_least { "≥" } else { "≤" };
    format!("{sense} {} {}", check.limit, check.unit).trim_end().into()
}

fn format_check_row(check: &AcceptanceCheck) -> [String; 5] {
    let um = |value: Option<f64>| value.map_or(String::new(), format_micrometres);
    [
        check.name.into(),
        um(check.before_um),
        um(check.after_um),
        format_value(check),
        format_limit(check),
    ]
}

fn staircase_table(stairs: &[StaircaseStep]) -> HtmlTable {
    let mut table = HtmlTable::new(&[
        "Z, mm",
        "without: from below",
        "from above",
        "with: from below",
        "from above",
    ]);
    for stair in stairs {
        let ([b0, b1], [a0, a1]) = (stair.before_um, stair.after_um);
        let um = [b0, b1, a0, a1].map(|um| format!("{um:.2}"));
        table.add_row(&[&[format!("{:.1}", stair.z_mm)], &um[..]].concat());
    }
    table
}

fn describe_lag(figures: &LoopFigures) -> String {
    let lag = &figures.lag;
    format!(
        "{:.1} ms from where a joint is to the offset that belongs there, over the diagonal; {:.1} ms in the \
         worst two seconds of it. Where the error is steepest, {:.3} µm/mm, that costs {:.2} µm at 10 m/min. \
         {} \
         Slew limit of board and component: {} µm/s, half a micrometre in a servo cycle; the diagonal at \
         58 m/min needs about 70 µm/s of it, a reversal the rest.",
        lag.mean_ms,
        lag.worst_ms,
        lag.steepest_um_per_mm,
        lag.costs_um_at_10_m_per_min,
        describe_lag_components(figures),
        figures.slew_um_per_s
    )
}

/// The parts of the lag.
fn describe_lag_components(figures: &LoopFigures) -> String {
    let way_there = match figures.way.on {
        BridgePlatform::Qemu | BridgePlatform::Chip => {
            "sending the position (every 2 ms), the board's millisecond, the way back"
        }
        BridgePlatform::Servo => "the node's millisecond",
    };
    let at_last = match figures.way.by {
        OffsetEntryPoint::Eoffset => format!(
            "LinuxCNC's own planner for offsets, which has OFFSET_AV_RATIO = {} of each axis' acceleration",
            figures.offset_av_ratio
        ),
        OffsetEntryPoint::Joint => "the limits of the offset at the joint".into(),
    };
    format!("The lag contains: {way_there}, and {at_last}.")
}

fn describe_time_compression(figures: &LoopFigures) -> String {
    let time = &figures.time;
    let hours = f64::from(time.warm_up_s) / 3_600.0;
    let times = f64::from(time.warm_up_s) / time.warm_up_wall_s;
    let how = match figures.way.on {
        BridgePlatform::Qemu => format!(
            "All motion was cut at real time. In the warm-up board and machine lived {hours:.0} h in {:.0} s, \
             {times:.0} times as fast as the wall clock, while LinuxCNC stayed in real time and its program \
             waited for the machine's clock. Because the board counts the CNC's silence in its own time, its \
             link_timeout_ms and hold_ms were {} times longer in this part; LinuxCNC got one pair of offsets \
             in {}, each as the board sent it.",
            time.warm_up_wall_s, time.limits_longer_by, time.pairs_passed_one_in,
        ),
        BridgePlatform::Chip => format!(
            "On this computer a second of the chip was given {} of the wall, and so was LinuxCNC's: feeds \
             divided by it, accelerations by its square, dwells and the period of positions as much longer; \
             all times here are the chip's. In the warm-up the machine lived {} times faster than the chip, \
             whose machine file had time constants as many times shorter: {hours:.0} h took {:.0} s, \
             {times:.0} times as fast as the wall clock. No limit of board or component was longer, and \
             LinuxCNC got every pair of offsets.",
            time.slower, time.compression, time.warm_up_wall_s,
        ),
        BridgePlatform::Servo => format!(
            "LinuxCNC and the bridge in it lived in real time. The machine file had time constants {} times shorter, and in the \
             warm-up the machine lived as many times faster: {hours:.0} h took {:.0} s. No limit was longer.",
            time.compression, time.warm_up_wall_s,
        ),
    };
    format!(
        "{how} Board time lost in the motion because this computer was too slow: {} ms.",
        time.slipped_ms
    )
}

fn render_chart(title: &str, x: &str, y: &str, curve: &ErrorCurve) -> String {
    let points = |um: &[f64]| curve.at.iter().zip(um).map(|(at, um)| [*at, *um]).collect();
    let series = vec![
        ChartSeries::line("without", ColourRole::Before, points(&curve.before_um)),
        ChartSeries::line("with the bridge", ColourRole::After, points(&curve.after_um)),
    ];
    Chart { title: title.into(), x: x.into(), y: y.into(), series }.to_figure()
}
