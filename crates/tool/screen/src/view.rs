//! The state as lines of a terminal of any size: what matters most stands on top, and where there is no
//! room the trend goes first, then the shares.

pub(crate) mod svg;
mod text_lines;
mod trend;

use ratatui::{
    Frame,
    layout::{Constraint, Layout, Rect},
    style::{Color, Modifier, Style},
    text::{Line, Span},
    widgets::Paragraph,
};

use crate::state::{LinkState, ScreenState};

/// Rows without which a trend says nothing.
const MIN_TREND_ROWS: u16 = 4;
/// The keys, each with its action.
const KEY_BINDINGS: [(&str, &str); 6] =
    [("q", "quit"), ("r", "record"), ("g", "gauge"), ("u", "undo"), ("t", "trend"), ("?", "help")];
const HELP_LINES: [&str; 11] = [
    "q  quit; the bridge goes on as it was",
    "r  begin or end a recording: every frame, and a run file for diagnose",
    "g  write a reading of the gauge into the recording, typed or live",
    "u  take the last reading out of the recording again",
    "t  draw the next: growth, offset of X, Y, Z, temperatures,",
    "   gauge minus bridge",
    "?  this help; any key closes it",
    "",
    "Offsets are what the CNC has to add: a tool that grows is lifted, +Z.",
    "A ? is a share that cannot be computed: its position or temperature",
    "is not received on this line. \"rest\" is slew, limits, zero, and what is ?.",
];

/// How things are distinguished: by letters and weight always, by colour where it is allowed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Theme {
    /// Colours may be used.
    pub has_colour: bool,
}

impl Theme {
    fn heading_style(self) -> Style {
        Style::new().add_modifier(Modifier::BOLD)
    }

    fn ok_style(self) -> Style {
        if self.has_colour { Style::new().fg(Color::Green) } else { Style::new() }
    }

    fn error_style(self) -> Style {
        let style = Style::new().add_modifier(Modifier::BOLD);
        if self.has_colour { style.fg(Color::Red) } else { style }
    }

    /// Of a value that is old.
    fn stale_style(self) -> Style {
        let style = Style::new().add_modifier(Modifier::DIM);
        if self.has_colour { style.fg(Color::DarkGray) } else { style }
    }

    fn value_style(self) -> Style {
        let style = Style::new().add_modifier(Modifier::BOLD);
        if self.has_colour { style.fg(Color::Cyan) } else { style }
    }
}

/// Draws the whole screen.
pub(crate) fn draw(frame: &mut Frame<'_>, state: &ScreenState, theme: Theme) {
    let area = frame.area();
    let width = area.width.into();
    let top = text_lines::status_lines(state, theme, width);
    let table = text_lines::offset_lines(state, theme, true);
    let short = text_lines::offset_lines(state, theme, false);
    let below = text_lines::footer_lines(state, theme, width);
    let alarms = text_lines::alarm_lines(state, theme, width);
    let rows = |lines: &[Line<'_>]| u16::try_from(lines.len()).unwrap_or(u16::MAX);
    let message = message_lines(state, theme, width);
    // The lines of messages and the line of keys.
    let fixed = rows(&top) + rows(&below) + rows(&alarms) + rows(&message) + 1;
    let fits = |table: &[Line<'_>], trend| fixed + rows(table) + trend <= area.height;
    let table = if fits(&table, MIN_TREND_ROWS) { table } else { short };
    let spare = area.height.saturating_sub(fixed + rows(&table));
    let trend = if spare >= MIN_TREND_ROWS { spare } else { 0 };
    // Alarms that do not fit are cut off at their end, where the lesser ones stand.
    let [at_top, at_table, at_below, at_alarms, at_trend, at_message, at_keys] =
        Layout::vertical([
            Constraint::Length(rows(&top)),
            Constraint::Length(rows(&table)),
            Constraint::Length(rows(&below)),
            Constraint::Fill(1),
            Constraint::Length(trend),
            Constraint::Length(rows(&message)),
            Constraint::Length(1),
        ])
        .areas(area);
    frame.render_widget(Paragraph::new(top), at_top);
    frame.render_widget(Paragraph::new(table), at_table);
    frame.render_widget(Paragraph::new(below), at_below);
    frame.render_widget(Paragraph::new(alarms), at_alarms);
    if trend > 0 {
        trend::draw(frame, at_trend, state, theme);
    }
    frame.render_widget(Paragraph::new(message), at_message);
    frame.render_widget(Paragraph::new(key_hint_line(state, theme)), at_keys);
    if state.is_helping {
        draw_help(frame, area, theme);
    }
}

/// Lines of the last one that need no more than this are shown whole.
const MAX_MESSAGE_LINES: usize = 3;

fn message_lines(state: &ScreenState, theme: Theme, width: usize) -> Vec<Line<'static>> {
    let quantity = state.gauge.quantity.name();
    let (text, style) = if let Some(typed) = &state.prompt {
        let or_live = if state.gauge.is_live { " (or press its button)" } else { "" };
        let prompt = format!("measured {quantity} in µm{or_live}: {typed}_");
        let cnc_data = state.message().map(|message| format!("   {message}")).unwrap_or_default();
        (prompt + &cnc_data, theme.heading_style())
    } else if let Some(message) = state.message() {
        (message.to_owned(), theme.heading_style())
    } else {
        match &state.link {
            LinkState::Down(why) => {
                (format!("line down, trying again: {why}"), theme.error_style())
            }
            LinkState::Opening => ("opening the line".to_owned(), Style::new()),
            LinkState::Up => {
                ("listening only: nothing is engaged by this screen".to_owned(), Style::new())
            }
        }
    };
    let mut lines = text_lines::wrap_text(&text, width, style);
    lines.truncate(MAX_MESSAGE_LINES);
    lines
}

fn key_hint_line(state: &ScreenState, theme: Theme) -> Line<'static> {
    let mut spans = Vec::new();
    for (key, word) in KEY_BINDINGS {
        let is_recording = state.recording.is_some();
        let word = if key == "r" && is_recording { "end recording" } else { word };
        if key == "u" && !is_recording {
            continue;
        }
        spans.push(Span::styled(key, theme.heading_style()));
        spans.push(Span::raw(format!(" {word}  ")));
    }
    Line::from(spans)
}

fn draw_help(frame: &mut Frame<'_>, area: Rect, theme: Theme) {
    let height = (HELP_LINES.len() as u16).min(area.height.saturating_sub(2));
    let at = Rect { y: area.height.saturating_sub(height + 1), height, ..area };
    frame.render_widget(ratatui::widgets::Clear, at);
    let lines = HELP_LINES.map(|line| Line::styled(line, theme.heading_style()));
    frame.render_widget(Paragraph::new(lines.to_vec()), at);
}

#[cfg(test)]
mod tests;
