//! LinuxCNC (RS-274/NGC).

use super::dialect::{AXES, Around, Cell, Dialect, Ends, Touching, number, plain, wrapped};
use crate::{
    plan::{Plan, Step},
    template,
};

/// A comment's width: the interpreter takes 255 characters of a line.
const WIDTH: usize = 120;

#[derive(Default)]
pub(super) struct Text {
    lines: Vec<String>,
    open: Vec<usize>,
    repeats: usize,
    /// Guarded moves so far.
    guarded: usize,
    is_logging: bool,
}

impl Text {
    fn push(&mut self, line: String) {
        self.lines.push(format!("{}{line}", "  ".repeat(self.open.len())));
    }
}

impl Text {
    /// No probing move has machine coordinates: what the work coordinates differ by is added to each place.
    fn probe_in_machine_coordinates(&mut self) {
        self.push("o98 if [EXISTS[#<_abs_x>] EQ 0]".into());
        self.push("  (MSG, Not run: this needs LinuxCNC 2.9)".into());
        self.push("  M2".into());
        self.push("o98 endif".into());
        // The queue is empty: the places are those of now.
        self.push("M66 E0 L0".into());
        for axis in AXES.map(|axis| axis.to_ascii_lowercase()) {
            self.push(format!("#<shift_{axis}> = [#<_abs_{axis}> - #<_{axis}>]"));
        }
    }

    /// Returns `X[5-#<shift_x>]`.
    fn place(axis: usize, um: i64) -> String {
        let name = AXES[axis];
        format!("{name}[{}-#<shift_{}>]", number(um), name.to_ascii_lowercase())
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

    fn modes(&mut self, plan: &Plan) {
        let has = |is: fn(&Step) -> bool| plan.steps.iter().any(is);
        let is_probed = has(|step| matches!(step, Step::Touch(_)));
        if is_probed || has(|step| matches!(step, Step::Arc(_))) {
            self.push("o99 if [#[5210 + 20 * #5220] NE 0]".into());
            self.push(
                "  (MSG, Not run: the work coordinates are rotated. G10 L2 P0 R0 cancels it)"
                    .into(),
            );
            self.push("  M2".into());
            self.push("o99 endif".into());
        }
        let plane = if plan.is_lathe { "G18 G7" } else { "G17" };
        self.push(format!("{plane} G21 G40 G49 G80 G90 G94 G97 G61"));
        if is_probed {
            self.probe_in_machine_coordinates();
            let names: Vec<String> = plan.columns.iter().map(template::name).collect();
            self.push(format!("(LOGOPEN,{}.csv)", plan.name));
            self.push(format!("(LOG,{})", names.join(",")));
            self.is_logging = true;
        }
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

    fn around(&mut self, around: &Around) {
        // An abort leaves this mode in force, and the next line that is typed is an increment.
        self.push(
            "(MSG, If the circle is aborted, type G90 first: until its end places are increments.)"
                .into(),
        );
        self.push(format!("{} G91 G91.1 G64", around.plane()));
        let word = |letter, um| format!("{letter}{}", number(um));
        for (is_ccw, words) in around.words(word, word) {
            self.push(format!("{}{words} F{}", if is_ccw { "G3" } else { "G2" }, around.feed));
        }
        self.push("G17 G90 G61".into());
    }

    fn guarded(&mut self, axis: usize, to: i64, feed: f64) {
        self.guarded += 1;
        let number_of = 1000 + self.guarded;
        self.push(format!("G38.3 {} F{feed}", Self::place(axis, to)));
        // A preview touches nothing, or everything.
        self.push(format!("o{number_of} if [#5070 AND #<_task>]"));
        self.push(format!(
            "  (MSG, Stopped: contact on the way to {} {} mm)",
            AXES[axis],
            number(to)
        ));
        self.push("  M2".into());
        self.push(format!("o{number_of} endif"));
    }

    fn touch(&mut self, touching: &Touching, back: f64) {
        let Touching { axis, from, to, feed, number: touch } = *touching;
        let name = AXES[axis];
        let shift = format!("#<shift_{}>", name.to_ascii_lowercase());
        self.push(format!("G38.2 {} F{feed}", Self::place(axis, to)));
        self.push(format!("#<touch_{touch}> = [#{} + {shift}]", 5061 + axis));
        // Until it is open, which may bounce, and then to where it came from.
        self.push(format!("G38.5 {} F{feed}", Self::place(axis, from)));
        self.push(format!("G53 G1 {name}{} F{back}", number(from)));
    }

    fn found(&mut self, cells: &[Cell]) {
        let mut row = Vec::new();
        for (n, cell) in cells.iter().enumerate() {
            row.push(match cell {
                Cell::Text(text) => text.clone(),
                Cell::Found(mean) => {
                    let [first, second] = mean.touches;
                    let expected = number((mean.expected_mm * 1000.0).round() as i64);
                    self.push(format!(
                        "#<cell_{n}> = [[{expected} - [#<touch_{first}> + #<touch_{second}>] / 2] * 1000]"
                    ));
                    format!("#<cell_{n}>")
                }
            });
        }
        self.push(format!("(LOG,{})", row.join(",")));
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
        if self.is_logging {
            self.push("(LOGCLOSE)".into());
        }
        self.push("M2".into());
        self.lines.join("\n") + "\n"
    }
}

fn words(to: &Ends) -> String {
    to.axes.iter().map(|(axis, _, to)| format!(" {}{}", AXES[*axis], number(*to))).collect()
}
