//! The lines of text of the screen.

use ratatui::text::{Line, Span};
use trueup_client::words::quality_word;
use trueup_core::cnc::Quality;
use trueup_link::receiver::Counters;

use super::Theme;
use crate::state::{FRESH_S, Source, State};

/// Of a column of numbers in the table of offsets.
const COLUMN: usize = 11;
/// Of the names of the shares.
const NAMES: usize = 16;

/// Who is spoken to, how good its offsets are, what the sensor reads.
pub fn top(state: &State, theme: Theme, width: usize) -> Vec<Line<'static>> {
    vec![
        title(state, theme, width),
        quality(state, theme),
        sensor(state, theme),
        growth(state, theme),
    ]
}

fn title(state: &State, theme: Theme, width: usize) -> Line<'static> {
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
    let text = format!("trueup  {machine}  {}", state.port);
    let text: String = text.chars().take(width).collect();
    Line::styled(text, if is_other { theme.bad() } else { theme.heading() })
}

fn quality(state: &State, theme: Theme) -> Line<'static> {
    let Some(output) = state.output() else {
        return Line::styled("NO OFFSETS COME", theme.bad());
    };
    let (meaning, is_good) = match output.quality {
        Quality::Off => ("not engaged: the offset is 0", true),
        Quality::Live => ("every input is fresh", true),
        Quality::TemperatureModel => ("no sensor: by its temperature model", false),
        Quality::WarmUpModel => ("no sensor: by its warm-up model", false),
        Quality::Hold => ("an input is lost: the last offset is held", false),
        Quality::RampingOut => ("an input is lost: on the way to 0", false),
        Quality::Fault => ("no offset can be given", false),
    };
    let age = match output.age_ms {
        u8::MAX => "255 ms or more".to_owned(),
        age_ms => format!("{age_ms} ms"),
    };
    let style = if is_good { theme.good() } else { theme.bad() };
    Line::from(vec![
        Span::styled(quality_word(output.quality).to_uppercase(), style),
        Span::raw(format!("  {meaning}, age {age}")),
    ])
}

fn sensor(state: &State, theme: Theme) -> Line<'static> {
    let mut spans = vec![Span::styled("Sensor  ", theme.heading())];
    let laws = state.laws.as_ref();
    match (state.growth_um(), laws) {
        (None, _) => spans.push(Span::raw("gives no reading")),
        (Some(_), None) => spans.push(Span::raw("volts and codes need --machine M.toml")),
        (Some(um), Some(laws)) => match laws.reading(um) {
            None => spans.push(Span::raw("none in this machine")),
            Some(reading) => {
                spans.push(Span::styled(format!("{:8.4} V", reading.volts), theme.number()));
                spans.push(Span::raw(format!("  {:8.2} codes", reading.codes)));
                if let Some(counts) = reading.counts {
                    spans.push(Span::raw(format!("  {counts:8.1} counts")));
                }
                let noise = state.board.noise_codes();
                spans.push(Span::raw(format!("  noise {noise:.2} codes")));
            }
        },
    }
    Line::from(spans)
}

fn growth(state: &State, theme: Theme) -> Line<'static> {
    let mut spans = vec![Span::styled("Growth  ", theme.heading())];
    match state.growth_um() {
        Some(um) => spans.push(Span::styled(format!("{um:+8.2} µm"), theme.number())),
        None => spans.push(Span::raw("not available")),
    }
    let gauge = &state.gauge;
    if let Some(trouble) = &gauge.trouble {
        spans.push(Span::styled(format!("   {trouble}"), theme.bad()));
    } else if let Some((um, at_s)) = gauge.latest {
        let age_s = state.now_s() - at_s;
        let old = if age_s > FRESH_S { format!(" ({age_s:.0} s ago)") } else { String::new() };
        spans.push(Span::raw(format!("   gauge {} {um:+.2} µm{old}", gauge.quantity.name())));
    }
    Line::from(spans)
}

/// The offsets, with the share of each cause or without.
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
    lines
}

/// Temperatures and the line.
pub fn below(state: &State, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let mut lines = temperatures(state, width);
    lines.extend(conditions(state, width));
    lines.push(link(state, theme));
    lines
}

fn temperatures(state: &State, width: usize) -> Vec<Line<'static>> {
    let names = state.laws.as_ref().map(crate::laws::Laws::temperatures).unwrap_or_default();
    let items = (0_u8..).zip(state.board.centi_c).filter_map(|(channel, centi_c)| {
        let name = names.get(&channel).map(|it| (*it).to_owned());
        let name = match (name, centi_c) {
            (Some(name), _) => name,
            (None, Some(_)) => format!("T{channel}"),
            (None, None) => return None,
        };
        Some(match centi_c {
            Some(it) => format!("{name} {:.2} °C", f64::from(it) / 100.0),
            None => format!("{name} not available"),
        })
    });
    packed("Temperatures  ", items, width)
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

fn link(state: &State, theme: Theme) -> Line<'static> {
    let Counters { malformed, crc_errors, sequence_errors, lost, .. } = state.counters();
    let malformed = malformed.saturating_add(state.malformed_lines);
    let text = format!(
        "Line  {:.0} frames/s  errors: crc {crc_errors}, sequence {sequence_errors}, malformed \
         {malformed}, lost {lost}, unpaired {}",
        state.frames_per_s,
        state.unpaired()
    );
    Line::styled(text, if state.is_sound() { ratatui::style::Style::new() } else { theme.bad() })
}

/// What is wrong, each with what to do, wrapped between words.
pub fn troubles(state: &State, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let troubles = state.troubles();
    if troubles.is_empty() {
        let heard = state.output().is_some();
        let text = if heard { "No faults" } else { "Nothing is heard of faults" };
        return vec![Line::styled(text, if heard { theme.good() } else { theme.bad() })];
    }
    let wrapped = troubles.into_iter().flat_map(|(word, remedy)| {
        let words = remedy.split(' ').map(str::to_owned);
        packed_by(&format!("{word}: "), words, width, " ")
    });
    wrapped.collect()
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
