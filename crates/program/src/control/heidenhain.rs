//! HEIDENHAIN Klartext.

use super::dialect::{AXES, Dialect, Ends, number, plain};
use crate::plan::Plan;

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
    }

    fn note(&mut self, text: &str) {
        self.push(format!("; {}", plain(text)));
    }

    fn stop(&mut self, text: &str) {
        self.note(text);
        self.push("STOP".into());
    }

    fn rapid(&mut self, to: &Ends) {
        self.push(format!("L{} R0 FMAX M91", words(to)));
    }

    fn line(&mut self, to: &Ends, feed: f64) {
        self.push(format!("L{} R0 F{feed} M91", words(to)));
    }

    fn by(&mut self, axis: usize, um: i64, feed: f64) {
        self.push(format!("L I{}{} R0 F{feed}", AXES[axis], signed(um)));
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
