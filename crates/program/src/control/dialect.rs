//! How a control says a step, and what all of them have in common.

use crate::plan::Plan;

/// X, Y and Z as controls call them.
pub(super) const AXES: [char; 3] = ['X', 'Y', 'Z'];

/// How a control says it.
pub(super) trait Dialect {
    /// Writes everything up to the first stop: nothing that moves, and the spindle off.
    fn head(&mut self, plan: &Plan);
    /// Sets the modes that the program relies on; after the first stop, as cancelling one may move an axis.
    fn modes(&mut self, is_lathe: bool);
    /// A line for the reader.
    fn note(&mut self, text: &str);
    /// The control shows these sentences and waits for the operator.
    fn stop(&mut self, text: &[String]);
    /// At a feed in mm/min.
    fn line(&mut self, to: &Ends, feed: f64);
    /// Turns the spindle, or stops it.
    fn spindle(&mut self, rpm: f64);
    /// Stands for this many seconds; a reading is taken at the end.
    fn dwell(&mut self, s: f64, is_reading: bool);
    /// Begins what is done this many times.
    fn repeat(&mut self, times: u32);
    /// Ends it.
    fn repeated(&mut self);
    /// Returns the text as a whole.
    fn end(&mut self) -> String;
}

/// Where a move ends, in µm.
pub(super) struct Ends {
    /// By axis: where it stands, if that is known, and where it is sent.
    pub(super) axes: Vec<(usize, Option<i64>, i64)>,
}

/// `12.5`, `-50`: as few digits as say it.
pub(super) fn number(um: i64) -> String {
    let text = format!("{:.3}", um as f64 / 1000.0);
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}

/// `text` in lines of at most `width` characters, cut between words; a longer word stays whole.
pub(super) fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.len() + 1 + word.len() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.into()),
        }
    }
    lines
}

/// As far as every control's characters go.
pub(super) fn plain(text: &str) -> String {
    let plain = |c: char| match c {
        '(' | '[' => '<',
        ')' | ']' => '>',
        c if c.is_ascii() && !c.is_ascii_control() => c,
        _ => '?',
    };
    text.chars().map(plain).collect()
}
