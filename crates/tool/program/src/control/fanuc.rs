//! FANUC, milling. Repeated steps are a subprogram in the same file, its blocks numbered by ten.
//!
//! `G53` moves at rapid only. So the first move of an axis is the way from where it stands, which the control's
//! variables `#5021` to `#5023` say in machine coordinates (custom macro B), at a feed; all others are in increments
//! from there, as in the paper. No work offset and no tool length has a part in it: `G49` would move the tool.
//! The variables are read while that axis stands, so reading ahead does no harm. Increments would be turned or
//! scaled by a mode that an earlier program left: such a mode is an alarm before anything moves.

use super::dialect::{
    AXIS_LETTERS, ArcBlocks, Dialect, MoveTargets, format_mm, sanitise_text, wrap_lines,
};
use crate::plan::MeasurementPlan;

/// The number of the main program; subprograms follow. From 8000 on programs are often locked.
const MAIN_PROGRAM_NUMBER: usize = 7100;

/// A comment's width: the screen of the control.
const MAX_COMMENT_LENGTH: usize = 60;
/// The variable with the machine position of X; those of Y and Z follow.
const MACHINE_POSITION_VARIABLE: usize = 5021;
/// Modes that turn or scale an increment: the variable of each group, and the alarm (26 characters at most).
const MODAL_ALARMS: [(&str, &str); 5] = [
    ("#4007 NE 40", "CANCEL G41 G42 FIRST"),
    ("FIX[#4011] EQ 51", "CANCEL SCALING G51 FIRST"),
    ("FIX[#4016] EQ 68", "CANCEL ROTATION G68 FIRST"),
    ("FIX[#4017] EQ 16", "CANCEL POLAR G16 FIRST"),
    ("FIX[#4022] EQ 51", "CANCEL MIRROR G51.1 FIRST"),
];

/// A program on its way.
#[derive(Default)]
struct Program {
    number: usize,
    /// How often it is to run.
    times: u32,
    blocks: Vec<String>,
    /// `G91` and `G01` hold, and this feed.
    feed: Option<f64>,
}

#[derive(Default)]
pub(super) struct FanucWriter {
    name: String,
    /// Whether an axis moves, and not the spindle alone.
    moves: bool,
    open: Vec<Program>,
    closed: Vec<Program>,
}

impl FanucWriter {
    fn push_block(&mut self, block: String) {
        if let Some(program) = self.open.last_mut() {
            program.blocks.push(block);
        }
    }

    /// Words in increments, with what of `G91 G01 F` does not hold already.
    fn push_incremental_move(&mut self, words: &str, feed: f64) {
        let Some(program) = self.open.last_mut() else { return };
        let held = program.feed.replace(feed);
        let before = if held.is_none() { "G91 G01 " } else { "" };
        let after = if held == Some(feed) { String::new() } else { format!(" F{feed}") };
        program.blocks.push(format!("{before}{words}{after}"));
    }

    fn reset_modal_feed(&mut self) {
        if let Some(program) = self.open.last_mut() {
            program.feed = None;
        }
    }

    fn format_program(program: &Program, name: &str) -> String {
        let mut text = format!("O{}({})\n", program.number, name.to_uppercase());
        for (n, block) in program.blocks.iter().enumerate() {
            let is_comment = block.starts_with('(');
            let number = if is_comment { String::new() } else { format!("N{} ", 10 * (n + 1)) };
            text += &format!("{number}{block}\n");
        }
        text
    }
}

impl Dialect for FanucWriter {
    fn write_header(&mut self, plan: &MeasurementPlan) {
        self.name = plan.name.clone();
        self.open.push(Program { number: MAIN_PROGRAM_NUMBER, ..Program::default() });
        for note in &plan.notes {
            self.write_comment(note);
        }
        self.moves = plan.extent_mm() != [None; 3];
        if self.moves {
            self.write_comment("For a machine in millimetres. Needs custom macro B.");
        }
        self.push_block("M05".into());
    }

    fn write_modes(&mut self, _: &MeasurementPlan) {
        let alarms = if self.moves { &MODAL_ALARMS[..] } else { &[] };
        for (n, (test, what)) in alarms.iter().enumerate() {
            self.push_block(format!("IF [{test}] THEN #3000={}({what})", n + 1));
        }
        self.push_block("G17 G21 G40 G80 G94".into());
    }

    fn write_comment(&mut self, text: &str) {
        for line in wrap_lines(&sanitise_comment(text), MAX_COMMENT_LENGTH) {
            self.push_block(format!("({line})"));
        }
    }

    fn write_stop(&mut self, text: &[String]) {
        text.iter().for_each(|sentence| self.write_comment(sentence));
        self.push_block("M00".into());
    }

    fn write_linear_move(&mut self, to: &MoveTargets, feed: f64) {
        let word = |(axis, from, to): &(usize, Option<i64>, i64)| {
            let name = AXIS_LETTERS[*axis];
            match from {
                Some(from) => format!("{name}{}", format_mm_with_point(to - from)),
                None => {
                    format!(
                        "{name}[{}-#{}]",
                        format_mm_with_point(*to),
                        MACHINE_POSITION_VARIABLE + axis
                    )
                }
            }
        };
        let words: Vec<String> = to.axes.iter().map(word).collect();
        self.push_incremental_move(&words.join(" "), feed);
    }

    fn write_arc(&mut self, around: &ArcBlocks) {
        self.push_block(format!("{} G64", around.plane_code()));
        let word = |letter, um| format!("{letter}{}", format_mm_with_point(um));
        for (is_ccw, words) in around.format_words(word, word) {
            let turn = if is_ccw { "G03" } else { "G02" };
            self.push_block(format!("G91 {turn}{words} F{}", around.feed));
        }
        self.push_block("G17".into());
        // G01 does not hold any more.
        self.reset_modal_feed();
    }

    fn write_spindle_command(&mut self, rpm: f64) {
        self.push_block(if rpm == 0.0 { "M05".into() } else { format!("M03 S{rpm}") });
    }

    fn write_dwell(&mut self, s: f64, _: bool) {
        let text = s.to_string();
        let point = if text.contains('.') { "" } else { "." };
        self.push_block(format!("G04 X{text}{point}"));
    }

    fn begin_repeat(&mut self, times: u32) {
        self.open.push(Program { times, ..Program::default() });
    }

    fn end_repeat(&mut self) {
        self.push_block("M99".into());
        let Some(mut done) = self.open.pop() else { return };
        // In increments a cycle is the same at each place.
        let same = self
            .closed
            .iter()
            .find(|program| program.blocks == done.blocks)
            .map(|program| program.number);
        let number = same.unwrap_or(MAIN_PROGRAM_NUMBER + 1 + self.closed.len());
        self.push_block(format!("M98 P{number} L{}", done.times));
        if same.is_none() {
            done.number = number;
            self.closed.push(done);
        }
        // The subprogram has left another feed.
        self.reset_modal_feed();
    }

    fn finish(&mut self) -> String {
        // A program after this one must not find increments.
        self.push_block("G90".into());
        self.push_block("M30".into());
        self.closed.extend(self.open.pop());
        self.closed.sort_by_key(|program| program.number);
        let programs: String =
            self.closed.iter().map(|program| Self::format_program(program, &self.name)).collect();
        format!("%\n{programs}%\n")
    }
}

/// Returns the characters of a comment that every FANUC takes: a colon is another letter O, a semicolon ends the block.
fn sanitise_comment(text: &str) -> String {
    let text = sanitise_text(text).to_uppercase().replace(':', " -").replace(';', ",");
    text.chars().filter(|c| !"<>'\"%&!^`{}|~_".contains(*c)).collect()
}

/// `50.`: without its point a number may count in micrometres.
fn format_mm_with_point(um: i64) -> String {
    let text = format_mm(um);
    if text.contains('.') { text } else { text + "." }
}
