//! Siemens SINUMERIK 840D sl and 828D.

use super::dialect::{AXES, Dialect, Ends, number, plain};
use crate::plan::Plan;

#[derive(Default)]
pub(super) struct Text {
    lines: Vec<String>,
    depth: usize,
}

impl Text {
    fn push(&mut self, line: String) {
        self.lines.push(format!("{}{line}", "  ".repeat(self.depth)));
    }
}

impl Dialect for Text {
    fn head(&mut self, plan: &Plan) {
        self.push(format!("%_N_{}_MPF", plan.name.replace('-', "_").to_uppercase()));
        self.push(";$PATH=/_N_MPF_DIR".into());
        plan.notes.iter().for_each(|note| self.note(note));
        self.note("In machine coordinates; no frame, no tool length, no transformation.");
        self.push("TRAFOOF".into());
        self.push("G17 G710 G40 G90 G94 G60 G500 D0".into());
    }

    fn note(&mut self, text: &str) {
        self.push(format!("; {}", plain(text)));
    }

    fn stop(&mut self, text: &str) {
        self.push(format!("MSG(\"{}\")", plain(text).replace('"', "'")));
        self.push("M0".into());
        self.push("MSG()".into());
    }

    fn rapid(&mut self, to: &Ends) {
        self.push(format!("SUPA G0{}", words(to)));
    }

    fn line(&mut self, to: &Ends, feed: f64) {
        self.push(format!("SUPA G1{} F{feed}", words(to)));
    }

    fn by(&mut self, axis: usize, um: i64, feed: f64) {
        self.push(format!("G1 {}=IC({}) F{feed}", AXES[axis], number(um)));
    }

    fn spindle(&mut self, rpm: f64) {
        self.push(if rpm == 0.0 { "M5".into() } else { format!("M3 S{rpm}") });
    }

    fn dwell(&mut self, s: f64, is_reading: bool) {
        self.push(format!("G4 F{s}{}", if is_reading { " ; read" } else { "" }));
    }

    fn repeat(&mut self, times: u32) {
        self.push(format!("FOR R{}=1 TO {times}", self.depth + 1));
        self.depth += 1;
    }

    fn repeated(&mut self) {
        self.depth -= 1;
        self.push("ENDFOR".into());
    }

    fn end(&mut self) -> String {
        self.push("M30".into());
        self.lines.join("\n") + "\n"
    }
}

fn words(to: &Ends) -> String {
    to.axes.iter().map(|(axis, _, to)| format!(" {}{}", AXES[*axis], number(*to))).collect()
}
