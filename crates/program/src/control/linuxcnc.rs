//! LinuxCNC (RS-274/NGC).

use super::dialect::{AXES, Dialect, Ends, number, plain, wrapped};
use crate::plan::Plan;

/// A comment's width: the interpreter takes 255 characters of a line.
const WIDTH: usize = 120;

#[derive(Default)]
pub(super) struct Text {
    lines: Vec<String>,
    open: Vec<usize>,
    repeats: usize,
}

impl Text {
    fn push(&mut self, line: String) {
        self.lines.push(format!("{}{line}", "  ".repeat(self.open.len())));
    }
}

impl Dialect for Text {
    fn head(&mut self, plan: &Plan) {
        self.note(&plan.name);
        plan.notes.iter().for_each(|note| self.note(note));
        if plan.is_lathe {
            self.note("X words are diameters, G7. Messages and the run file state the radius.");
        }
        self.note("In machine coordinates; no offset, no tool length.");
        self.push("M5".into());
    }

    fn modes(&mut self, is_lathe: bool) {
        let plane = if is_lathe { "G18 G7" } else { "G17" };
        self.push(format!("{plane} G21 G40 G49 G80 G90 G94 G97 G61"));
    }

    fn note(&mut self, text: &str) {
        for line in wrapped(&plain(text), WIDTH) {
            self.push(format!("({line})"));
        }
    }

    fn stop(&mut self, text: &[String]) {
        for sentence in text {
            self.push(format!("(MSG, {})", plain(sentence)));
        }
        self.push("M0".into());
    }

    fn line(&mut self, to: &Ends, feed: f64) {
        self.push(format!("G53 G1{} F{feed}", words(to)));
    }

    fn spindle(&mut self, rpm: f64) {
        self.push(if rpm == 0.0 { "M5".into() } else { format!("M3 S{rpm}") });
    }

    fn dwell(&mut self, s: f64, is_reading: bool) {
        self.push(format!("G4 P{s}{}", if is_reading { " (read)" } else { "" }));
    }

    fn repeat(&mut self, times: u32) {
        self.repeats += 1;
        let number = 100 + self.repeats;
        self.push(format!("o{number} repeat [{times}]"));
        self.open.push(number);
    }

    fn repeated(&mut self) {
        if let Some(number) = self.open.pop() {
            self.push(format!("o{number} endrepeat"));
        }
    }

    fn end(&mut self) -> String {
        self.push("M2".into());
        self.lines.join("\n") + "\n"
    }
}

fn words(to: &Ends) -> String {
    to.axes.iter().map(|(axis, _, to)| format!(" {}{}", AXES[*axis], number(*to))).collect()
}
