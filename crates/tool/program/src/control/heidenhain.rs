//! HEIDENHAIN Klartext.

use super::dialect::{Dialect, MoveTargets, format_mm, sanitise_text, wrap_lines};
use crate::plan::MeasurementPlan;

/// A comment's width: the screen of the control.
const MAX_COMMENT_LENGTH: usize = 70;

#[derive(Default)]
pub(super) struct HeidenhainWriter {
    name: String,
    lines: Vec<String>,
    /// Label and turns of what is open.
    open: Vec<(usize, u32)>,
    labels: usize,
}

impl HeidenhainWriter {
    fn push_line(&mut self, line: String) {
        self.lines.push(line);
    }
}

impl Dialect for HeidenhainWriter {
    fn write_header(&mut self, plan: &MeasurementPlan) {
        self.name = plan.name.replace('-', "_").to_uppercase();
        self.push_line(format!("BEGIN PGM {} MM", self.name));
        plan.notes.iter().for_each(|note| self.write_comment(note));
        self.write_comment("In machine coordinates (M91).");
        self.push_line("M5".into());
    }

    // A program in MM and blocks with M91 and R0 rely on no mode.
    fn write_modes(&mut self, _: &MeasurementPlan) {}

    fn write_comment(&mut self, text: &str) {
        for line in wrap_lines(&sanitise_text(text), MAX_COMMENT_LENGTH) {
            self.push_line(format!("; {line}"));
        }
    }

    fn write_stop(&mut self, text: &[String]) {
        text.iter().for_each(|sentence| self.write_comment(sentence));
        self.push_line("STOP".into());
    }

    fn write_linear_move(&mut self, to: &MoveTargets, feed: f64) {
        self.push_line(format!("L{} R0 F{feed} M91", to.format_words(format_signed)));
    }

    fn write_spindle_command(&mut self, rpm: f64) {
        if rpm == 0.0 {
            self.push_line("M5".into());
        } else {
            self.push_line(format!("TOOL CALL Z S{rpm}"));
            self.push_line("M3".into());
        }
    }

    fn write_dwell(&mut self, s: f64, is_reading: bool) {
        if is_reading {
            self.write_comment("read");
        }
        self.push_line("CYCL DEF 9.0 DWELL TIME".into());
        self.push_line(format!("CYCL DEF 9.1 DWELL {s}"));
    }

    fn begin_repeat(&mut self, times: u32) {
        self.labels += 1;
        self.push_line(format!("LBL {}", self.labels));
        self.open.push((self.labels, times));
    }

    fn end_repeat(&mut self) {
        // It has run once when it gets here.
        if let Some((label, times)) = self.open.pop()
            && times > 1
        {
            self.push_line(format!("CALL LBL {label} REP {}", times - 1));
        }
    }

    fn finish(&mut self) -> String {
        self.push_line("M30".into());
        self.push_line(format!("END PGM {} MM", self.name));
        let numbered = |(n, line): (usize, &String)| format!("{n} {line}\n");
        self.lines.iter().enumerate().map(numbered).collect()
    }
}

fn format_signed(um: i64) -> String {
    let sign = if um < 0 { "" } else { "+" };
    format!("{sign}{}", format_mm(um))
}
