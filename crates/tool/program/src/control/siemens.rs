//! Siemens SINUMERIK 840D sl and 828D.

use super::dialect::{
    AXIS_LETTERS, ArcBlocks, Dialect, MoveTargets, format_mm, sanitise_text, wrap_lines,
};
use crate::plan::{MeasurementPlan, Step};

/// A comment's width: the screen of the editor.
const MAX_COMMENT_LENGTH: usize = 100;
/// The longest text of `MSG`: a control shows 124 characters.
const MAX_MESSAGE_LENGTH: usize = 120;

/// Parts of a frame that would turn or scale a way, with the value that does not, and their names.
const FRAME_COMPONENTS: [(&str, &str, &str); 3] =
    [("RT", "0", "rotation"), ("SC", "1", "scale"), ("MI", "0", "mirror")];

#[derive(Default)]
pub(super) struct SiemensWriter {
    lines: Vec<String>,
    depth: usize,
}

impl SiemensWriter {
    fn push_line(&mut self, line: String) {
        self.lines.push(format!("{}{line}", "  ".repeat(self.depth)));
    }
}

impl Dialect for SiemensWriter {
    fn write_header(&mut self, plan: &MeasurementPlan) {
        self.push_line(format!("%_N_{}_MPF", plan.name.replace('-', "_").to_uppercase()));
        self.push_line(";$PATH=/_N_MPF_DIR".into());
        plan.notes.iter().for_each(|note| self.write_comment(note));
        if plan.is_lathe {
            self.write_comment(
                "X words are diameters, DIAMON. Messages and the run file state the radius.",
            );
        }
        self.write_comment("In machine coordinates; no frame, no tool length, no transformation.");
        self.push_line("M5".into());
    }

    fn write_modes(&mut self, plan: &MeasurementPlan) {
        self.push_line("TRAFOOF".into());
        let plane = if plan.is_lathe { "DIAMON G18" } else { "G17" };
        self.push_line(format!("{plane} G710 G40 G90 G94 G97 G60 G500 D0"));
        if plan.steps.iter().any(|step| matches!(step, Step::Arc(_))) {
            for (part, right, what) in FRAME_COMPONENTS {
                let tests =
                    AXIS_LETTERS.map(|axis| format!("($P_ACTFRAME[{axis},{part}]<>{right})"));
                self.push_line(format!("IF {}", tests.join(" OR ")));
                self.push_line(format!(
                    "  MSG(\"Not run: cancel the {what} of the frames first.\")"
                ));
                self.push_line("  M0".into());
                self.push_line("  M30".into());
                self.push_line("ENDIF".into());
            }
        }
    }

    fn write_comment(&mut self, text: &str) {
        for line in wrap_lines(&sanitise_text(text), MAX_COMMENT_LENGTH) {
            self.push_line(format!("; {line}"));
        }
    }

    fn write_stop(&mut self, text: &[String]) {
        text.iter().for_each(|sentence| self.write_comment(sentence));
        // A message that is too long is cut by the control: what does not fit gets a stop of its own.
        let mut messages: Vec<String> = Vec::new();
        for sentence in text {
            for part in wrap_lines(&sanitise_text(sentence).replace('"', "'"), MAX_MESSAGE_LENGTH) {
                match messages.last_mut() {
                    Some(last) if last.len() + 1 + part.len() <= MAX_MESSAGE_LENGTH => {
                        *last += &format!(" {part}")
                    }
                    _ => messages.push(part),
                }
            }
        }
        for message in messages {
            self.push_line(format!("MSG(\"{message}\")"));
            self.push_line("M0".into());
        }
        self.push_line("MSG()".into());
    }

    fn write_linear_move(&mut self, to: &MoveTargets, feed: f64) {
        self.push_line(format!("SUPA G1{} F{feed}", to.format_words(format_mm)));
    }

    fn write_arc(&mut self, around: &ArcBlocks) {
        self.push_line(format!("{} G64", around.plane_code()));
        let end = |letter, um| format!("{letter}=IC({})", format_mm(um));
        let centre = |letter, um| format!("{letter}{}", format_mm(um));
        for (is_ccw, words) in around.format_words(end, centre) {
            self.push_line(format!("{}{words} F{}", if is_ccw { "G3" } else { "G2" }, around.feed));
        }
        self.push_line("G17 G60".into());
    }

    fn write_spindle_command(&mut self, rpm: f64) {
        self.push_line(if rpm == 0.0 { "M5".into() } else { format!("M3 S{rpm}") });
    }

    fn write_dwell(&mut self, s: f64, is_reading: bool) {
        self.push_line(format!("G4 F{s}{}", if is_reading { " ; read" } else { "" }));
    }

    fn begin_repeat(&mut self, times: u32) {
        self.push_line(format!("FOR R{}=1 TO {times}", self.depth + 1));
        self.depth += 1;
    }

    fn end_repeat(&mut self) {
        self.depth -= 1;
        self.push_line("ENDFOR".into());
    }

    fn finish(&mut self) -> String {
        self.push_line("M30".into());
        self.lines.join("\n") + "\n"
    }
}
