//! The screen as a picture (SVG), for a page: text that stays text, and colours that read on light and on dark.

use std::fmt::Write as _;

use ratatui::{
    Terminal,
    backend::TestBackend,
    buffer::Cell,
    style::{Color, Modifier},
};

use super::{Theme, draw};
use crate::state::ScreenState;

/// Width and height of a character, in px.
const CELL_SIZE_PX: [f64; 2] = [8.4, 17.0];
/// Around the text.
const MARGIN_PX: f64 = 10.0;

/// Returns the screen of this width and height in characters.
#[must_use]
pub(crate) fn render_svg(state: &ScreenState, [width, height]: [u16; 2]) -> String {
    let mut terminal = match Terminal::new(TestBackend::new(width, height)) {
        Ok(terminal) => terminal,
        Err(impossible) => match impossible {},
    };
    let Ok(_) = terminal.draw(|frame| draw(frame, state, Theme { has_colour: true }));
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {:.0} {:.0}\" font-family=\"monospace\" \
         font-size=\"14\"><rect width=\"100%\" height=\"100%\" rx=\"6\" fill=\"#14181b\"/>\n",
        f64::from(width) * CELL_SIZE_PX[0] + 2.0 * MARGIN_PX,
        f64::from(height) * CELL_SIZE_PX[1] + 2.0 * MARGIN_PX
    );
    let buffer = terminal.backend().buffer();
    for (row, cells) in buffer.content.chunks(width.into()).enumerate() {
        let y = MARGIN_PX + (row as f64 + 0.75) * CELL_SIZE_PX[1];
        let mut at = 0;
        for run in cells.chunk_by(|a, b| (a.fg, a.modifier) == (b.fg, b.modifier)) {
            let text: String = run.iter().map(Cell::symbol).collect();
            let shown = text.trim_start();
            let x = MARGIN_PX
                + (at + text.chars().count() - shown.chars().count()) as f64 * CELL_SIZE_PX[0];
            at += run.len();
            let shown = shown.trim_end();
            if shown.is_empty() {
                continue;
            }
            let bold =
                if run[0].modifier.contains(Modifier::BOLD) { " font-weight=\"bold\"" } else { "" };
            let length = shown.chars().count() as f64 * CELL_SIZE_PX[0];
            let _ = writeln!(
                svg,
                "<text x=\"{x:.1}\" y=\"{y:.1}\" textLength=\"{length:.1}\" fill=\"{}\"{bold}>{}</text>",
                cell_colour(&run[0]),
                escape_xml(shown)
            );
        }
    }
    svg + "</svg>\n"
}

fn cell_colour(cell: &Cell) -> &'static str {
    match cell.fg {
        Color::Green => "#74c47a",
        Color::Red => "#ff8a80",
        Color::Cyan => "#6fc7d5",
        Color::DarkGray => "#7a858e",
        _ => "#e4e8eb",
    }
}

fn escape_xml(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    // Several spaces would become one.
    text.replace("  ", "\u{a0}\u{a0}")
}
