//! LinuxCNC (RS-274/NGC).

use super::dialect::{AXES, Dialect, Ends, number, plain};
use crate::plan::Plan;

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
        self.note("In machine coordinates; no offset, no tool length.");
        self.push("G17 G21 G40 G49 G80 G90 G94 G61".into());
    }

    fn note(&mut self, text: &str) {
        self.push(format!("({})", plain(text)));
    }

    fn stop(&mut self, text: &str) {
        self.push(format!("(MSG, {})", plain(text)));
        self.push("M0".into());
    }

    fn rapid(&mut self, to: &Ends) {
        self.push(format!("G53 G0{}", words(to)));
    }

    fn line(&mut self, to: &Ends, feed: f64) {
        self.push(format!("G53 G1{} F{feed}", words(to)));
    }

    fn by(&mut self, axis: usize, um: i64, feed: f64) {
        self.push(format!("G91 G1 {}{} F{feed}", AXES[axis], number(um)));
        self.push("G90".into());
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
