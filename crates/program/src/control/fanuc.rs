//! FANUC, milling. What is repeated is a subprogram in the same file, its blocks numbered by ten.
//!
//! `G53` moves at rapid only. So a place is reached by it, and every move that counts is in increments
//! from there, as in the paper: no work offset has a part in it.

use super::dialect::{AXES, Dialect, Ends, number, plain};
use crate::plan::Plan;

/// The number of the main program; subprograms follow. From 8000 on programs are often locked.
const MAIN: usize = 7100;

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
pub(super) struct Text {
    name: String,
    open: Vec<Program>,
    closed: Vec<Program>,
}

impl Text {
    fn push(&mut self, block: String) {
        if let Some(program) = self.open.last_mut() {
            program.blocks.push(block);
        }
    }

    /// Words in increments, with what of `G91 G01 F` does not hold already.
    fn increments(&mut self, words: &str, feed: f64) {
        let Some(program) = self.open.last_mut() else { return };
        let held = program.feed.replace(feed);
        let before = if held.is_none() { "G91 G01 " } else { "" };
        let after = if held == Some(feed) { String::new() } else { format!(" F{feed}") };
        program.blocks.push(format!("{before}{words}{after}"));
    }

    fn forget(&mut self) {
        if let Some(program) = self.open.last_mut() {
            program.feed = None;
        }
    }

    fn text_of(program: &Program, name: &str) -> String {
        let mut text = format!("O{}({})\n", program.number, name.to_uppercase());
        for (n, block) in program.blocks.iter().enumerate() {
            let is_comment = block.starts_with('(');
            let number = if is_comment { String::new() } else { format!("N{} ", 10 * (n + 1)) };
            text += &format!("{number}{block}\n");
        }
        text
    }
}

impl Dialect for Text {
    fn head(&mut self, plan: &Plan) {
        self.name = plan.name.clone();
        self.open.push(Program { number: MAIN, ..Program::default() });
        for note in &plan.notes {
            self.note(note);
        }
        self.push("G17 G21 G40 G49 G80 G90 G94".into());
    }

    fn note(&mut self, text: &str) {
        self.push(format!("({})", plain(text).to_uppercase()));
    }

    fn stop(&mut self, text: &str) {
        self.note(text);
        self.push("M00".into());
    }

    fn rapid(&mut self, to: &Ends) {
        let words: String = to
            .axes
            .iter()
            .map(|(axis, _, to)| format!(" {}{}", AXES[*axis], decimal(*to)))
            .collect();
        self.push(format!("G90 G53 G00{words}"));
        self.forget();
    }

    fn line(&mut self, to: &Ends, feed: f64) {
        let word = |(axis, from, to): &(usize, Option<i64>, i64)| {
            format!("{}{}", AXES[*axis], decimal(to - from.unwrap_or(0)))
        };
        let words: Vec<String> = to.axes.iter().map(word).collect();
        self.increments(&words.join(" "), feed);
    }

    fn by(&mut self, axis: usize, um: i64, feed: f64) {
        self.increments(&format!("{}{}", AXES[axis], decimal(um)), feed);
    }

    fn spindle(&mut self, rpm: f64) {
        self.push(if rpm == 0.0 { "M05".into() } else { format!("M03 S{rpm}") });
    }

    fn dwell(&mut self, s: f64, _: bool) {
        let text = s.to_string();
        let point = if text.contains('.') { "" } else { "." };
        self.push(format!("G04 X{text}{point}"));
    }

    fn repeat(&mut self, times: u32) {
        self.open.push(Program { times, ..Program::default() });
    }

    fn repeated(&mut self) {
        self.push("M99".into());
        let Some(mut done) = self.open.pop() else { return };
        // In increments a cycle is the same at each place.
        let same = self.closed.iter().find(|it| it.blocks == done.blocks).map(|it| it.number);
        let number = same.unwrap_or(MAIN + 1 + self.closed.len());
        self.push(format!("M98 P{number} L{}", done.times));
        if same.is_none() {
            done.number = number;
            self.closed.push(done);
        }
        // The subprogram has left another feed.
        self.forget();
    }

    fn end(&mut self) -> String {
        self.push("M30".into());
        self.closed.extend(self.open.pop());
        self.closed.sort_by_key(|program| program.number);
        let programs: String =
            self.closed.iter().map(|program| Self::text_of(program, &self.name)).collect();
        format!("%\n{programs}%\n")
    }
}

/// `50.`: without its point a number may count in micrometres.
fn decimal(um: i64) -> String {
    let text = number(um);
    if text.contains('.') { text } else { text + "." }
}
