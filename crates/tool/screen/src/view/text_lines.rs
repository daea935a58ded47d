//! The lines of text of the screen.

use ratatui::{
    style::Style,
    text::{Line, Span},
};
use trueup_client::state_text::quality_name;
use trueup_core::cnc::OffsetQuality;
use trueup_link::receiver::FrameCounters;

use super::Theme;
use crate::state::{MAX_GAUGE_AGE_S, ModelSource, ScreenState};

/// Of a column of numbers in the table of offsets.
const NUMBER_COLUMN_WIDTH: usize = 11;
/// Of the names of the shares.
const NAME_COLUMN_WIDTH: usize = 16;

/// Who is spoken to, whether it is recorded, how good its offsets are, what the sensor reads.
pub(crate) fn status_lines(state: &ScreenState, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let mut lines = title_lines(state, theme, width);
    lines.extend(recording_lines(state, theme, width));
    lines.extend(quality_lines(state, theme, width));
    lines.extend(sensor_lines(state, theme, width));
    lines.push(growth_line(state, theme));
    lines.extend(gauge_error_lines(state, theme, width));
    lines
}

fn title_lines(state: &ScreenState, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let crc = match state.board.calibration {
        None => "calibration ?".to_owned(),
        Some(0) => "no calibration".to_owned(),
        Some(crc) => format!("calibration {crc:08x}"),
    };
    let expected = state.laws.as_ref().and_then(crate::compensation_model::CompensationModel::crc);
    let (machine, is_other) = match (&state.source, &state.laws) {
        (ModelSource::File(file), Some(laws)) => {
            let running = state.board.calibration;
            let is_other = running.is_some() && running != expected;
            let verdict = match (running, is_other) {
                (None, _) => "",
                (_, true) => " NOT of ",
                (_, false) => " of ",
            };
            (format!("{}, {crc}{verdict}{file}", laws.machine_name()), is_other)
        }
        (ModelSource::Board, Some(laws)) => (format!("{}, {crc}", laws.machine_name()), false),
        (ModelSource::Reading(percent), _) => (format!("{crc}, reading it {percent} %"), false),
        _ => (crc, false),
    };
    let style = if is_other { theme.error_style() } else { theme.heading_style() };
    let items = [format!("trueup  {machine}"), state.port.clone()];
    apply_style(pack_items("", items.into_iter(), width), style)
}

/// That a recording is being made: where, and how much of it there is.
fn recording_lines(state: &ScreenState, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let Some(path) = &state.recording else { return Vec::new() };
    let readings = match state.marks {
        1 => "1 reading".to_owned(),
        count => format!("{count} readings"),
    };
    let items = [format!("REC  {path}"), format!("{} rows", state.rows), readings];
    apply_style(pack_items("", items.into_iter(), width), theme.error_style())
}

fn quality_lines(state: &ScreenState, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let Some(output) = state.output() else {
        let age =
            state.output_age_s().map(|age_s| format!(" for {age_s:.0} s")).unwrap_or_default();
        return vec![Line::styled(format!("NO OFFSETS COME{age}"), theme.error_style())];
    };
    let waits = state.pending_action();
    let (meaning, is_good) = match (output.quality, waits) {
        (OffsetQuality::Fault, Some("engage")) => ("for Engage: off at the CNC, then on", true),
        (OffsetQuality::Fault, Some(_)) => ("for Confirm at the CNC: see below", true),
        (OffsetQuality::Off, _) => ("not engaged: the offset is 0", true),
        (OffsetQuality::Live, _) => ("every input is fresh", true),
        (OffsetQuality::TemperatureModel, _) => ("no sensor: by its temperature model", false),
        (OffsetQuality::WarmUpModel, _) => ("no sensor: by its warm-up model", false),
        (OffsetQuality::Hold, _) => ("an input is lost: the last offset is held", false),
        (OffsetQuality::RampingOut, _) => ("an input is lost: on the way to 0", false),
        (OffsetQuality::Fault, None) => ("no offset can be given", false),
    };
    let word = if waits.is_some() { "waiting" } else { quality_name(output.quality) };
    let age = match output.age_ms {
        u8::MAX => "255 ms or more".to_owned(),
        age_ms => format!("{age_ms} ms"),
    };
    let style = if is_good { theme.ok_style() } else { theme.error_style() };
    let word = Span::styled(word.to_uppercase(), style);
    let (meaning, age) = (format!("  {meaning},"), format!("age {age}"));
    let length = word.width() + meaning.chars().count() + 1 + age.chars().count();
    if length <= width {
        return vec![Line::from(vec![word, Span::raw(format!("{meaning} {age}"))])];
    }
    vec![Line::from(vec![word, Span::raw(meaning)]), Line::raw(format!("  {age}"))]
}

fn sensor_lines(state: &ScreenState, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let mut spans = vec![Span::styled("Sensor  ", theme.heading_style())];
    let laws = state.laws.as_ref();
    match (state.growth_um(), laws) {
        (None, _) => spans.push(Span::raw("gives no reading")),
        (Some(_), None) => spans.push(Span::raw("volts and codes need --machine M.toml")),
        (Some(um), Some(laws)) => match laws.sensor_reading_from_elongation(um) {
            None => spans.push(Span::raw("none in this machine")),
            Some(reading) => {
                spans.push(Span::styled(format!("{:8.4} V", reading.volts), theme.value_style()));
                // The calibration of a board does not have the divider's own values.
                let nominal = if reading.counts.is_none() { " nominal" } else { "" };
                spans.push(Span::raw(format!("{nominal}  {:8.2} codes", reading.codes)));
                if let Some(counts) = reading.counts {
                    spans.push(Span::raw(format!("  {counts:8.1} counts")));
                }
                let noise = state.board.rms_noise_codes();
                spans.push(Span::raw(format!("  noise {noise:.2} codes")));
            }
        },
    }
    let line = Line::from(spans.clone());
    match spans.pop() {
        // The noise is the last of them.
        Some(last) if line.width() > width => {
            vec![Line::from(spans), Line::raw(format!("      {}", last.content))]
        }
        _ => vec![line],
    }
}

fn growth_line(state: &ScreenState, theme: Theme) -> Line<'static> {
    let mut spans = vec![Span::styled("Growth  ", theme.heading_style())];
    match state.last_growth_um() {
        Some((um, None)) => spans.push(Span::styled(format!("{um:+8.2} µm"), theme.value_style())),
        Some((um, Some(age_s))) => {
            spans.push(Span::styled(
                format!("{um:+8.2} µm ({})", format_age(age_s)),
                theme.stale_style(),
            ));
        }
        None => spans.push(Span::raw("not available")),
    }
    let gauge = &state.gauge;
    if let (None, Some((um, at_s))) = (&gauge.connection_error, gauge.latest) {
        let age_s = state.now_s() - at_s;
        let is_old = age_s > MAX_GAUGE_AGE_S;
        let old = if is_old { format!(" ({})", format_age(age_s)) } else { String::new() };
        let text = format!("   gauge {} {um:+.2} µm{old}", gauge.quantity.name());
        spans.push(if is_old { Span::styled(text, theme.stale_style()) } else { Span::raw(text) });
        if let Some(um) = state.gauge_difference_um() {
            spans.push(Span::raw(format!("   gauge − bridge {um:+.2} µm")));
        }
    }
    Line::from(spans)
}

/// Returns what is wrong with the gauge.
fn gauge_error_lines(state: &ScreenState, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let connection_error = state.gauge.connection_error.iter();
    connection_error.flat_map(|alarm| wrap_text(alarm, width, theme.error_style())).collect()
}

/// Returns an age in words.
fn format_age(age_s: f64) -> String {
    if age_s < 120.0 { format!("{age_s:.0} s ago") } else { format!("{:.0} min ago", age_s / 60.0) }
}

/// Returns the offsets, with the share of each cause or without.
pub(crate) fn offset_lines(
    state: &ScreenState,
    theme: Theme,
    with_shares: bool,
) -> Vec<Line<'static>> {
    let cell = |um: f64| match um.is_nan() {
        true => format!("{:>NUMBER_COLUMN_WIDTH$}", "?"),
        // Less than half a step of the wire is 0, of no sign.
        false => format!("{:+NUMBER_COLUMN_WIDTH$.2}", if um.abs() < 0.005 { 0.0 } else { um }),
    };
    let row =
        |name: &str, um: [f64; 3]| format!("{name:NAME_COLUMN_WIDTH$}{}", um.map(cell).concat());
    let heads = ["X", "Y", "Z"].map(|axis| format!("{axis:>NUMBER_COLUMN_WIDTH$}")).concat();
    let mut lines = vec![Line::styled(
        format!("{:NAME_COLUMN_WIDTH$}{heads}", "Offset, µm"),
        theme.heading_style(),
    )];
    let given = state.offset_um();
    if with_shares {
        lines.extend(state.shares.iter().map(|share| Line::raw(row(share.name, share.offset_um))));
        if let (Some(given), false) = (given, state.shares.is_empty()) {
            let known = |axis: usize| {
                let shares = state.shares.iter().map(|share| share.offset_um[axis]);
                shares.filter(|um| !um.is_nan()).sum::<f64>()
            };
            let rest = [0, 1, 2].map(|axis| given[axis] - known(axis));
            lines.push(Line::raw(row("rest", rest)));
        }
    }
    lines.push(match given {
        Some(um) => Line::styled(row("given to the CNC", um), theme.value_style()),
        None => Line::styled(
            format!("{:NAME_COLUMN_WIDTH$}{:>NUMBER_COLUMN_WIDTH$}", "given to the CNC", "none"),
            theme.error_style(),
        ),
    });
    if let Some((um, age_s)) = state.stale_offset_um() {
        let age = format_age(age_s);
        lines.push(Line::styled(
            row(&age.chars().take(NAME_COLUMN_WIDTH).collect::<String>(), um),
            theme.stale_style(),
        ));
    }
    lines
}

/// Temperatures and the line.
pub(crate) fn footer_lines(state: &ScreenState, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let mut lines = temperature_lines(state, theme, width);
    lines.extend(condition_lines(state, width));
    lines.extend(link_lines(state, theme, width));
    lines
}

fn temperature_lines(state: &ScreenState, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let names = state
        .laws
        .as_ref()
        .map(crate::compensation_model::CompensationModel::temperature_names)
        .unwrap_or_default();
    let items = (0_u8..).zip(state.board.centi_c).filter_map(|(channel, centi_c)| {
        let name = names.get(&channel).map(|name| (*name).to_owned());
        let name = match (name, centi_c) {
            (Some(name), _) => name,
            (None, Some(_)) => format!("T{channel}"),
            (None, None) => return None,
        };
        let age = state
            .stale_temperature_age_s(channel.into())
            .map(|age_s| format!(" ({})", format_age(age_s)));
        Some(match centi_c {
            Some(it) => {
                format!("{name} {:.2} °C{}", f64::from(it) / 100.0, age.unwrap_or_default())
            }
            None => format!("{name} not available"),
        })
    });
    let lines = pack_items("Temperatures  ", items, width);
    let is_old = (0..state.board.centi_c.len())
        .any(|channel| state.stale_temperature_age_s(channel).is_some());
    if is_old { apply_style(lines, theme.stale_style()) } else { lines }
}

/// Tool and conditions, where a law depends on them.
fn condition_lines(state: &ScreenState, width: usize) -> Vec<Line<'static>> {
    let items: Vec<String> = state
        .conditions()
        .into_iter()
        .map(|(name, value)| match value.is_nan() {
            true => format!("{name} ?"),
            false => format!("{name} {value}"),
        })
        .collect();
    if items.is_empty() { Vec::new() } else { pack_items("Conditions  ", items.into_iter(), width) }
}

fn link_lines(state: &ScreenState, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let FrameCounters { malformed, crc_errors, sequence_errors, lost, .. } = state.counters();
    let malformed = malformed.saturating_add(state.malformed_lines);
    let text = format!(
        "Line  {:.0} frames/s  errors: crc {crc_errors}, sequence {sequence_errors}, malformed \
         {malformed}, lost {lost}, unpaired {}",
        state.frames_per_s,
        state.unpaired_frame_count()
    );
    wrap_text(&text, width, if state.is_error_free() { Style::new() } else { theme.error_style() })
}

/// Returns what is wrong, each with what to do, wrapped between words.
pub(crate) fn alarm_lines(state: &ScreenState, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let alarms = state.alarms();
    if alarms.is_empty() {
        let received = state.output().is_some();
        let text = if received { "No faults" } else { "No report of faults is received" };
        return vec![Line::styled(
            text,
            if received { theme.ok_style() } else { theme.error_style() },
        )];
    }
    let wrapped = alarms.into_iter().flat_map(|(word, remedy)| {
        let words = remedy.split(' ').map(str::to_owned);
        wrap_items(&format!("{word}: "), words, width, " ")
    });
    let lines: Vec<Line<'static>> = wrapped.collect();
    match state.stale_state_age_s() {
        None => lines,
        Some(age_s) => {
            let head =
                Line::styled(format!("As it was {}:", format_age(age_s)), theme.stale_style());
            std::iter::once(head).chain(apply_style(lines, theme.stale_style())).collect()
        }
    }
}

/// Returns a text in lines of this width, broken between words.
pub(crate) fn wrap_text(text: &str, width: usize, style: Style) -> Vec<Line<'static>> {
    // Two spaces between words stay two.
    let words = text.split_inclusive(' ').fold(Vec::<String>::new(), |mut words, word| {
        match words.last_mut() {
            Some(last) if word == " " => last.push(' '),
            _ => words.push(word.to_owned()),
        }
        words
    });
    let mut lines = vec![String::new()];
    for word in words {
        let line = lines.last_mut().expect("it begins with one");
        let is_full = line.chars().count() + word.trim_end().chars().count() > width;
        if is_full && !line.trim().is_empty() {
            lines.push(format!("  {word}"));
        } else {
            line.push_str(&word);
        }
    }
    lines.into_iter().map(|line| Line::styled(line.trim_end().to_owned(), style)).collect()
}

fn apply_style(lines: Vec<Line<'static>>, style: Style) -> Vec<Line<'static>> {
    lines.into_iter().map(|line| line.style(style)).collect()
}

/// Items side by side, as many as a line takes.
fn pack_items(
    first: &str,
    items: impl Iterator<Item = String>,
    width: usize,
) -> Vec<Line<'static>> {
    wrap_items(first, items, width, "  ")
}

fn wrap_items(
    first: &str,
    items: impl Iterator<Item = String>,
    width: usize,
    between: &str,
) -> Vec<Line<'static>> {
    let mut lines: Vec<String> = Vec::new();
    let mut line = first.to_owned();
    let mut is_empty = true;
    for item in items {
        if !is_empty && line.chars().count() + between.len() + item.chars().count() > width {
            lines.push(std::mem::replace(&mut line, "  ".into()));
            is_empty = true;
        }
        if !is_empty {
            line.push_str(between);
        }
        line.push_str(&item);
        is_empty = false;
    }
    if !is_empty {
        lines.push(line);
    }
    lines.into_iter().map(Line::raw).collect()
}
