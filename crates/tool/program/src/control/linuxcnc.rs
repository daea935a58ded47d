//! LinuxCNC (RS-274/NGC).

use super::dialect::{
    AXIS_LETTERS, ArcBlocks, Cell, Dialect, MoveTargets, ProbeMove, format_mm, sanitise_text,
    wrap_lines,
};
use crate::{
    plan::{MeasurementPlan, Step},
    template,
};

/// A comment's width: the interpreter takes 255 characters of a line.
const MAX_COMMENT_LENGTH: usize = 120;

#[derive(Default)]
pub(super) struct LinuxcncWriter {
    lines: Vec<String>,
    open: Vec<usize>,
    repeats: usize,
    /// Guarded moves so far.
    guarded: usize,
    is_logging: bool,
}

impl LinuxcncWriter {
    fn push_line(&mut self, line: String) {
        self.lines.push(format!("{}{line}", "  ".repeat(self.open.len())));
    }
}

impl LinuxcncWriter {
    /// No probing move has machine coordinates: what the work coordinates differ by is added to each place.
    fn push_work_offset_variables(&mut self) {
        self.push_line("o98 if [EXISTS[#<_abs_x>] EQ 0]".into());
        self.push_line("  (MSG, Not run: this needs LinuxCNC 2.9)".into());
        self.push_line("  M2".into());
        self.push_line("o98 endif".into());
        // The queue is empty: the places are those of now.
        self.push_line("M66 E0 L0".into());
        for axis in AXIS_LETTERS.map(|axis| axis.to_ascii_lowercase()) {
            self.push_line(format!("#<shift_{axis}> = [#<_abs_{axis}> - #<_{axis}>]"));
        }
    }

    /// Returns `X[5-#<shift_x>]`.
    fn format_machine_coordinate(axis: usize, um: i64) -> String {
        let name = AXIS_LETTERS[axis];
        format!("{name}[{}-#<shift_{}>]", format_mm(um), name.to_ascii_lowercase())
    }
}

impl Dialect for LinuxcncWriter {
    fn write_header(&mut self, plan: &MeasurementPlan) {
        self.write_comment(&plan.name);
        plan.notes.iter().for_each(|note| self.write_comment(note));
        if plan.is_lathe {
            self.write_comment(
                "X words are diameters, G7. Messages and the run file state the radius.",
            );
        }
        self.write_comment("In machine coordinates; no offset, no tool length.");
        self.push_line("M5".into());
    }

    fn write_modes(&mut self, plan: &MeasurementPlan) {
        let has = |is: fn(&Step) -> bool| plan.steps.iter().any(is);
        let is_probed = has(|step| matches!(step, Step::Touch(_)));
        if is_probed || has(|step| matches!(step, Step::Arc(_))) {
            self.push_line("o99 if [#[5210 + 20 * #5220] NE 0]".into());
            self.push_line(
                "  (MSG, Not run: the work coordinates are rotated. G10 L2 P0 R0 cancels it)"
                    .into(),
            );
            self.push_line("  M2".into());
            self.push_line("o99 endif".into());
        }
        let plane = if plan.is_lathe { "G18 G7" } else { "G17" };
        self.push_line(format!("{plane} G21 G40 G49 G80 G90 G94 G97 G61"));
        if is_probed {
            self.push_work_offset_variables();
            let names: Vec<String> = plan.columns.iter().map(template::column_name).collect();
            self.push_line(format!("(LOGOPEN,{}.csv)", plan.name));
            self.push_line(format!("(LOG,{})", names.join(",")));
            self.is_logging = true;
        }
    }

    fn write_comment(&mut self, text: &str) {
        for line in wrap_lines(&sanitise_text(text), MAX_COMMENT_LENGTH) {
            self.push_line(format!("({line})"));
        }
    }

    fn write_stop(&mut self, text: &[String]) {
        for sentence in text {
            self.push_line(format!("(MSG, {})", sanitise_text(sentence)));
        }
        self.push_line("M0".into());
    }

    fn write_linear_move(&mut self, to: &MoveTargets, feed: f64) {
        self.push_line(format!("G53 G1{} F{feed}", to.format_words(format_mm)));
    }

    fn write_arc(&mut self, around: &ArcBlocks) {
        // An abort leaves this mode in force, and the next line that is typed is an increment.
        self.push_line(
            "(MSG, If the circle is aborted, type G90 first: until its end places are increments.)"
                .into(),
        );
        self.push_line(format!("{} G91 G91.1 G64", around.plane_code()));
        let word = |letter, um| format!("{letter}{}", format_mm(um));
        for (is_ccw, words) in around.format_words(word, word) {
            self.push_line(format!("{}{words} F{}", if is_ccw { "G3" } else { "G2" }, around.feed));
        }
        self.push_line("G17 G90 G61".into());
    }

    fn write_guarded_move(&mut self, axis: usize, to: i64, feed: f64) {
        self.guarded += 1;
        let number_of = 1000 + self.guarded;
        self.push_line(format!("G38.3 {} F{feed}", Self::format_machine_coordinate(axis, to)));
        // A preview touches nothing, or everything.
        self.push_line(format!("o{number_of} if [#5070 AND #<_task>]"));
        self.push_line(format!(
            "  (MSG, Stopped: contact on the way to {} {} mm)",
            AXIS_LETTERS[axis],
            format_mm(to)
        ));
        self.push_line("  M2".into());
        self.push_line(format!("o{number_of} endif"));
    }

    fn write_probe_move(&mut self, touching: &ProbeMove, back: f64) {
        let ProbeMove { axis, from, to, feed, number: touch } = *touching;
        let name = AXIS_LETTERS[axis];
        let shift = format!("#<shift_{}>", name.to_ascii_lowercase());
        self.push_line(format!("G38.2 {} F{feed}", Self::format_machine_coordinate(axis, to)));
        self.push_line(format!("#<touch_{touch}> = [#{} + {shift}]", 5061 + axis));
        // Until it is open, which may bounce, and then to where it came from.
        self.push_line(format!("G38.5 {} F{feed}", Self::format_machine_coordinate(axis, from)));
        self.push_line(format!("G53 G1 {name}{} F{back}", format_mm(from)));
    }

    fn write_result_row(&mut self, cells: &[Cell]) {
        let mut row = Vec::new();
        for (n, cell) in cells.iter().enumerate() {
            row.push(match cell {
                Cell::Text(text) => text.clone(),
                Cell::Found(mean) => {
                    let [first, second] = mean.touches;
                    let expected = format_mm((mean.expected_mm * 1000.0).round() as i64);
                    self.push_line(format!(
                        "#<cell_{n}> = [[{expected} - [#<touch_{first}> + #<touch_{second}>] / 2] * 1000]"
                    ));
                    format!("#<cell_{n}>")
                }
            });
        }
        self.push_line(format!("(LOG,{})", row.join(",")));
    }

    fn write_spindle_command(&mut self, rpm: f64) {
        self.push_line(if rpm == 0.0 { "M5".into() } else { format!("M3 S{rpm}") });
    }

    fn write_dwell(&mut self, s: f64, is_reading: bool) {
        self.push_line(format!("G4 P{s}{}", if is_reading { " (read)" } else { "" }));
    }

    fn begin_repeat(&mut self, times: u32) {
        self.repeats += 1;
        let number = 100 + self.repeats;
        self.push_line(format!("o{number} repeat [{times}]"));
        self.open.push(number);
    }

    fn end_repeat(&mut self) {
        if let Some(number) = self.open.pop() {
            self.push_line(format!("o{number} endrepeat"));
        }
    }

    fn finish(&mut self) -> String {
        if self.is_logging {
            self.push_line("(LOGCLOSE)".into());
        }
        self.push_line("M2".into());
        self.lines.join("\n") + "\n"
    }
}
