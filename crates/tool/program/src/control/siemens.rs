//! Siemens SINUMERIK 840D sl and 828D.

use super::dialect::{AXES, Around, Dialect, Ends, number, plain, wrapped};
use crate::plan::{Plan, Step};

/// A comment's width: the screen of the editor.
const WIDTH: usize = 100;
/// The longest text of `MSG`: a control shows 124 characters.
const MESSAGE: usize = 120;

/// Parts of a frame that would turn or scale a way, with the value that does not, and their names.
const FRAMES: [(&str, &str, &str); 3] =
    [("RT", "0", "rotation"), ("SC", "1", "scale"), ("MI", "0", "mirror")];

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
        if plan.is_lathe {
            self.note("X words are diameters, DIAMON. Messages and the run file state the radius.");
        }
        self.note("In machine coordinates; no frame, no tool length, no transformation.");
        self.push("M5".into());
    }

    fn modes(&mut self, plan: &Plan) {
        self.push("TRAFOOF".into());
        let plane = if plan.is_lathe { "DIAMON G18" } else { "G17" };
        self.push(format!("{plane} G710 G40 G90 G94 G97 G60 G500 D0"));
        if plan.steps.iter().any(|step| matches!(step, Step::Arc(_))) {
            for (part, right, what) in FRAMES {
                let tests = AXES.map(|axis| format!("($P_ACTFRAME[{axis},{part}]<>{right})"));
                self.push(format!("IF {}", tests.join(" OR ")));
                self.push(format!("  MSG(\"Not run: cancel the {what} of the frames first.\")"));
                self.push("  M0".into());
                self.push("  M30".into());
                self.push("ENDIF".into());
            }
        }
    }

    fn note(&mut self, text: &str) {
        for line in wrapped(&plain(text), WIDTH) {
            self.push(format!("; {line}"));
        }
    }

    fn stop(&mut self, text: &[String]) {
        text.iter().for_each(|sentence| self.note(sentence));
        // A message that is too long is cut by the control: what does not fit gets a stop of its own.
        let mut messages: Vec<String> = Vec::new();
        for sentence in text {
            for part in wrapped(&plain(sentence).replace('"', "'"), MESSAGE) {
                match messages.last_mut() {
                    Some(last) if last.len() + 1 + part.len() <= MESSAGE => {
                        *last += &format!(" {part}")
                    }
                    _ => messages.push(part),
                }
            }
        }
        for message in messages {
            self.push(format!("MSG(\"{message}\")"));
            self.push("M0".into());
        }
        self.push("MSG()".into());
    }

    fn line(&mut self, to: &Ends, feed: f64) {
        self.push(format!("SUPA G1{} F{feed}", words(to)));
    }

    fn around(&mut self, around: &Around) {
        self.push(format!("{} G64", around.plane()));
        let end = |letter, um| format!("{letter}=IC({})", number(um));
        let centre = |letter, um| format!("{letter}{}", number(um));
        for (is_ccw, words) in around.words(end, centre) {
            self.push(format!("{}{words} F{}", if is_ccw { "G3" } else { "G2" }, around.feed));
        }
        self.push("G17 G60".into());
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
