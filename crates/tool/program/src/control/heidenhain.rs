//! HEIDENHAIN Klartext.

use super::dialect::{AXES, Dialect, Ends, number, plain, wrapped};
use crate::plan::Plan;

/// A comment's width: the screen of the control.
const WIDTH: usize = 70;

#[derive(Default)]
pub(super) struct Text {
    name: String,
    lines: Vec<String>,
    /// Label and turns of what is open.
    open: Vec<(usize, u32)>,
    labels: usize,
}

impl Text {
    fn push(&mut self, line: String) {
        self.lines.push(line);
    }
}

impl Dialect for Text {
    fn head(&mut self, plan: &Plan) {
        self.name = plan.name.replace('-', "_").to_uppercase();
        self.push(format!("BEGIN PGM {} MM", self.name));
        plan.notes.iter().for_each(|note| self.note(note));
        self.note("In machine coordinates (M91).");
        self.push("M5".into());
    }

    // A program in MM and blocks with M91 and R0 rely on no mode.
    fn modes(&mut self, _: &Plan) {}

    fn note(&mut self, text: &str) {
        for line in wrapped(&plain(text), WIDTH) {
            self.push(format!("; {line}"));
        }
    }

    fn stop(&mut self, text: &[String]) {
        text.iter().for_each(|sentence| self.note(sentence));
        self.push("STOP".into());
    }

    fn line(&mut self, to: &Ends, feed: f64) {
        self.push(format!("L{} R0 F{feed} M91", words(to)));
    }

    fn spindle(&mut self, rpm: f64) {
        if rpm == 0.0 {
            self.push("M5".into());
        } else {
            self.push(format!("TOOL CALL Z S{rpm}"));
            self.push("M3".into());
        }
    }

    fn dwell(&mut self, s: f64, is_reading: bool) {
        if is_reading {
            self.note("read");
        }
        self.push("CYCL DEF 9.0 DWELL TIME".into());
        self.push(format!("CYCL DEF 9.1 DWELL {s}"));
    }

    fn repeat(&mut self, times: u32) {
        self.labels += 1;
        self.push(format!("LBL {}", self.labels));
        self.open.push((self.labels, times));
    }

    fn repeated(&mut self) {
        // It has run once when it gets here.
        if let Some((label, times)) = self.open.pop()
            && times > 1
        {
            self.push(format!("CALL LBL {label} REP {}", times - 1));
        }
    }

    fn end(&mut self) -> String {
        self.push("M30".into());
        self.push(format!("END PGM {} MM", self.name));
        let numbered = |(n, line): (usize, &String)| format!("{n} {line}\n");
        self.lines.iter().enumerate().map(numbered).collect()
    }
}

fn words(to: &Ends) -> String {
    to.axes.iter().map(|(axis, _, to)| format!(" {}{}", AXES[*axis], signed(*to))).collect()
}

fn signed(um: i64) -> String {
    let sign = if um < 0 { "" } else { "+" };
    format!("{sign}{}", number(um))
}
