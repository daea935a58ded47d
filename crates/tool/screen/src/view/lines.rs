//! The lines of text of the screen.

use ratatui::{
    style::Style,
    text::{Line, Span},
};
use trueup_client::words::quality_word;
use trueup_core::cnc::Quality;
use trueup_link::receiver::Counters;

use super::Theme;
use crate::state::{FRESH_S, Source, State};

/// Of a column of numbers in the table of offsets.
const COLUMN: usize = 11;
/// Of the names of the shares.
const NAMES: usize = 16;

/// Who is spoken to, whether it is recorded, how good its offsets are, what the sensor reads.
pub(crate) fn top(state: &State, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let mut lines = title(state, theme, width);
    lines.extend(recording(state, theme, width));
    lines.extend(quality(state, theme, width));
    lines.extend(sensor(state, theme, width));
    lines.push(growth(state, theme));
    lines.extend(gauge_trouble(state, theme, width));
    lines
}

fn title(state: &State, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let crc = match state.board.calibration {
        None => "calibration ?".to_owned(),
        Some(0) => "no calibration".to_owned(),
        Some(crc) => format!("calibration {crc:08x}"),
    };
    let expected = state.laws.as_ref().and_then(crate::laws::Laws::crc);
    let (machine, is_other) = match (&state.source, &state.laws) {
        (Source::File(file), Some(laws)) => {
            let running = state.board.calibration;
            let is_other = running.is_some() && running != expected;
            let verdict = match (running, is_other) {
                (None, _) => "",
                (_, true) => " NOT of ",
                (_, false) => " of ",
            };
            (format!("{}, {crc}{verdict}{file}", laws.name()), is_other)
        }
        (Source::Board, Some(laws)) => (format!("{}, {crc}", laws.name()), false),
        (Source::Reading(percent), _) => (format!("{crc}, reading it {percent} %"), false),
        _ => (crc, false),
    };
    let style = if is_other { theme.bad() } else { theme.heading() };
    let items = [format!("trueup  {machine}"), state.port.clone()];
    styled(packed("", items.into_iter(), width), style)
}

/// That a recording is being made: where, and how much of it there is.
fn recording(state: &State, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let Some(path) = &state.recording else { return Vec::new() };
    let readings = match state.marks {
        1 => "1 reading".to_owned(),
        count => format!("{count} readings"),
    };
    let items = [format!("REC  {path}"), format!("{} rows", state.rows), readings];
    styled(packed("", items.into_iter(), width), theme.bad())
}

fn quality(state: &State, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let Some(output) = state.output() else {
        let age = state.output_age_s().map(|it| format!(" for {it:.0} s")).unwrap_or_default();
        return vec![Line::styled(format!("NO OFFSETS COME{age}"), theme.bad())];
    };
    let waits = state.waits_for();
    let (meaning, is_good) = match (output.quality, waits) {
        (Quality::Fault, Some("engage")) => ("for Engage: off at the CNC, then on", true),
        (Quality::Fault, Some(_)) => ("for Confirm at the CNC: see below", true),
        (Quality::Off, _) => ("not engaged: the offset is 0", true),
        (Quality::Live, _) => ("every input is fresh", true),
        (Quality::TemperatureModel, _) => ("no sensor: by its temperature model", false),
        (Quality::WarmUpModel, _) => ("no sensor: by its warm-up model", false),
        (Quality::Hold, _) => ("an input is lost: the last offset is held", false),
        (Quality::RampingOut, _) => ("an input is lost: on the way to 0", false),
        (Quality::Fault, None) => ("no offset can be given", false),
    };
    let word = if waits.is_some() { "waiting" } else { quality_word(output.quality) };
    let age = match output.age_ms {
        u8::MAX => "255 ms or more".to_owned(),
        age_ms => format!("{age_ms} ms"),
    };
    let style = if is_good { theme.good() } else { theme.bad() };
    let word = Span::styled(word.to_uppercase(), style);
    let (meaning, age) = (format!("  {meaning},"), format!("age {age}"));
    let length = word.width() + meaning.chars().count() + 1 + age.chars().count();
    if length <= width {
        return vec![Line::from(vec![word, Span::raw(format!("{meaning} {age}"))])];
    }
    vec![Line::from(vec![word, Span::raw(meaning)]), Line::raw(format!("  {age}"))]
}

fn sensor(state: &State, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let mut spans = vec![Span::styled("Sensor  ", theme.heading())];
    let laws = state.laws.as_ref();
    match (state.growth_um(), laws) {
        (None, _) => spans.push(Span::raw("gives no reading")),
        (Some(_), None) => spans.push(Span::raw("volts and codes need --machine M.toml")),
        (Some(um), Some(laws)) => match laws.reading(um) {
            None => spans.push(Span::raw("none in this machine")),
            Some(reading) => {
                spans.push(Span::styled(format!("{:8.4} V", reading.volts), theme.number()));
                // The calibration of a board does not have the divider's own values.
                let nominal = if reading.counts.is_none() { " nominal" } else { "" };
                spans.push(Span::raw(format!("{nominal}  {:8.2} codes", reading.codes)));
                if let Some(counts) = reading.counts {
                    spans.push(Span::raw(format!("  {counts:8.1} counts")));
                }
                let noise = state.board.noise_codes();
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

fn growth(state: &State, theme: Theme) -> Line<'static> {
    let mut spans = vec![Span::styled("Growth  ", theme.heading())];
    match state.last_growth() {
        Some((um, None)) => spans.push(Span::styled(format!("{um:+8.2} µm"), theme.number())),
        Some((um, Some(age_s))) => {
            spans.push(Span::styled(format!("{um:+8.2} µm ({})", ago(age_s)), theme.old()));
        }
        None => spans.push(Span::raw("not available")),
    }
    let gauge = &state.gauge;
    if let (None, Some((um, at_s))) = (&gauge.trouble, gauge.latest) {
        let age_s = state.now_s() - at_s;
        let is_old = age_s > FRESH_S;
        let old = if is_old { format!(" ({})", ago(age_s)) } else { String::new() };
        let text = format!("   gauge {} {um:+.2} µm{old}", gauge.quantity.name());
        spans.push(if is_old { Span::styled(text, theme.old()) } else { Span::raw(text) });
        if let Some(um) = state.difference_um() {
            spans.push(Span::raw(format!("   gauge − bridge {um:+.2} µm")));
        }
    }
    Line::from(spans)
}

/// Returns what is wrong with the gauge.
fn gauge_trouble(state: &State, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let trouble = state.gauge.trouble.iter();
    trouble.flat_map(|it| wrapped(it, width, theme.bad())).collect()
}

/// Returns an age in words.
fn ago(age_s: f64) -> String {
    if age_s < 120.0 { format!("{age_s:.0} s ago") } else { format!("{:.0} min ago", age_s / 60.0) }
}

/// Returns the offsets, with the share of each cause or without.
pub fn offsets(state: &State, theme: Theme, with_shares: bool) -> Vec<Line<'static>> {
    let cell = |um: f64| match um.is_nan() {
        true => format!("{:>COLUMN$}", "?"),
        // Less than half a step of the wire is 0, of no sign.
        false => format!("{:+COLUMN$.2}", if um.abs() < 0.005 { 0.0 } else { um }),
    };
    let row = |name: &str, um: [f64; 3]| format!("{name:NAMES$}{}", um.map(cell).concat());
    let heads = ["X", "Y", "Z"].map(|axis| format!("{axis:>COLUMN$}")).concat();
    let mut lines = vec![Line::styled(format!("{:NAMES$}{heads}", "Offset, µm"), theme.heading())];
    let given = state.offset_um();
    if with_shares {
        lines.extend(state.shares.iter().map(|it| Line::raw(row(it.name, it.offset_um))));
        if let (Some(given), false) = (given, state.shares.is_empty()) {
            let known = |axis: usize| {
                let shares = state.shares.iter().map(|it| it.offset_um[axis]);
                shares.filter(|um| !um.is_nan()).sum::<f64>()
            };
            let rest = [0, 1, 2].map(|axis| given[axis] - known(axis));
            lines.push(Line::raw(row("rest", rest)));
        }
    }
    lines.push(match given {
        Some(um) => Line::styled(row("given to the CNC", um), theme.number()),
        None => {
            Line::styled(format!("{:NAMES$}{:>COLUMN$}", "given to the CNC", "none"), theme.bad())
        }
    });
    if let Some((um, age_s)) = state.old_offset_um() {
        let age = ago(age_s);
        lines
            .push(Line::styled(row(&age.chars().take(NAMES).collect::<String>(), um), theme.old()));
    }
    lines
}

/// Temperatures and the line.
pub(crate) fn below(state: &State, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let mut lines = temperatures(state, theme, width);
    lines.extend(conditions(state, width));
    lines.extend(link(state, theme, width));
    lines
}

fn temperatures(state: &State, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let names = state.laws.as_ref().map(crate::laws::Laws::temperatures).unwrap_or_default();
    let items = (0_u8..).zip(state.board.centi_c).filter_map(|(channel, centi_c)| {
        let name = names.get(&channel).map(|it| (*it).to_owned());
        let name = match (name, centi_c) {
            (Some(name), _) => name,
            (None, Some(_)) => format!("T{channel}"),
            (None, None) => return None,
        };
        let age = state.temperature_age_s(channel.into()).map(|it| format!(" ({})", ago(it)));
        Some(match centi_c {
            Some(it) => {
                format!("{name} {:.2} °C{}", f64::from(it) / 100.0, age.unwrap_or_default())
            }
            None => format!("{name} not available"),
        })
    });
    let lines = packed("Temperatures  ", items, width);
    let is_old = (0..state.board.centi_c.len()).any(|it| state.temperature_age_s(it).is_some());
    if is_old { styled(lines, theme.old()) } else { lines }
}

/// Tool and conditions, where a law depends on them.
fn conditions(state: &State, width: usize) -> Vec<Line<'static>> {
    let items: Vec<String> = state
        .conditions()
        .into_iter()
        .map(|(name, value)| match value.is_nan() {
            true => format!("{name} ?"),
            false => format!("{name} {value}"),
        })
        .collect();
    if items.is_empty() { Vec::new() } else { packed("Conditions  ", items.into_iter(), width) }
}

fn link(state: &State, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let Counters { malformed, crc_errors, sequence_errors, lost, .. } = state.counters();
    let malformed = malformed.saturating_add(state.malformed_lines);
    let text = format!(
        "Line  {:.0} frames/s  errors: crc {crc_errors}, sequence {sequence_errors}, malformed \
         {malformed}, lost {lost}, unpaired {}",
        state.frames_per_s,
        state.unpaired()
    );
    wrapped(&text, width, if state.is_sound() { Style::new() } else { theme.bad() })
}

/// Returns what is wrong, each with what to do, wrapped between words.
pub(crate) fn alarms(state: &State, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let troubles = state.alarms();
    if troubles.is_empty() {
        let received = state.output().is_some();
        let text = if received { "No faults" } else { "Nothing is heard of faults" };
        return vec![Line::styled(text, if received { theme.good() } else { theme.bad() })];
    }
    let wrapped = troubles.into_iter().flat_map(|(word, remedy)| {
        let words = remedy.split(' ').map(str::to_owned);
        packed_by(&format!("{word}: "), words, width, " ")
    });
    let lines: Vec<Line<'static>> = wrapped.collect();
    match state.state_age_s() {
        None => lines,
        Some(age_s) => {
            let head = Line::styled(format!("As it was {}:", ago(age_s)), theme.old());
            std::iter::once(head).chain(styled(lines, theme.old())).collect()
        }
    }
}

/// Returns a text in lines of this width, broken between words.
pub(crate) fn wrapped(text: &str, width: usize, style: Style) -> Vec<Line<'static>> {
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

fn styled(lines: Vec<Line<'static>>, style: Style) -> Vec<Line<'static>> {
    lines.into_iter().map(|line| line.style(style)).collect()
}

/// Items side by side, as many as a line takes.
fn packed(first: &str, items: impl Iterator<Item = String>, width: usize) -> Vec<Line<'static>> {
    packed_by(first, items, width, "  ")
}

fn packed_by(
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
