//! How a control says a step, and what all of them have in common.

use crate::{plan::MeasurementPlan, probe::TouchMean};

/// X, Y and Z as controls call them.
pub(super) const AXIS_LETTERS: [char; 3] = ['X', 'Y', 'Z'];

/// How a control says it.
pub(super) trait Dialect {
    /// Writes everything up to the first stop: nothing that moves, and the spindle off.
    fn write_header(&mut self, plan: &MeasurementPlan);
    /// Sets the modes that the program relies on, and ends it where one cannot be set; after the first stop, as cancelling
    /// one may move an axis.
    fn write_modes(&mut self, plan: &MeasurementPlan);
    /// A line for the reader.
    fn write_comment(&mut self, text: &str);
    /// The control shows these sentences and waits for the operator.
    fn write_stop(&mut self, text: &[String]);
    /// At a feed in mm/min.
    fn write_linear_move(&mut self, to: &MoveTargets, feed: f64);
    /// Around a centre, block by block without a stop. A control that cannot is refused before.
    fn write_arc(&mut self, _: &ArcBlocks) {}
    /// A probe goes to a place, in µm, at a feed; contact ends the program.
    fn write_guarded_move(&mut self, _axis: usize, _to: i64, _feed: f64) {}
    /// A probe touches, and goes back at this feed.
    fn write_probe_move(&mut self, _: &ProbeMove, _back: f64) {}
    /// Writes a row of the run file.
    fn write_result_row(&mut self, _: &[Cell]) {}
    /// Turns the spindle, or stops it.
    fn write_spindle_command(&mut self, rpm: f64);
    /// Stands for this many seconds; a reading is taken at the end.
    fn write_dwell(&mut self, s: f64, is_reading: bool);
    /// Begins what is done this many times.
    fn begin_repeat(&mut self, times: u32);
    /// Ends it.
    fn end_repeat(&mut self);
    /// Returns the text as a whole.
    fn finish(&mut self) -> String;
}

/// Where a move ends, in µm.
pub(super) struct MoveTargets {
    /// By axis: where it stands, if that is known, and where it is sent.
    pub(super) axes: Vec<(usize, Option<i64>, i64)>,
}

impl MoveTargets {
    /// Returns a word for each axis, its place in µm written by `format_place`, with a blank before each.
    pub(super) fn format_words(&self, format_place: fn(i64) -> String) -> String {
        let word = |(axis, _, to): &(usize, Option<i64>, i64)| {
            format!(" {}{}", AXIS_LETTERS[*axis], format_place(*to))
        };
        self.axes.iter().map(word).collect()
    }
}

/// Blocks of arcs in one plane, by ways from where the axes stand: no work offset has a part in them.
pub(super) struct ArcBlocks {
    /// The axes of the plane.
    pub(super) axes: [usize; 2],
    /// For each block: counter-clockwise or not, the way to its end and the way to its centre, in µm.
    pub(super) blocks: Vec<(bool, [i64; 2], [i64; 2])>,
    pub(super) feed: f64,
}

impl ArcBlocks {
    /// Returns `G17`, `G18` or `G19`.
    pub(super) fn plane_code(&self) -> &'static str {
        ["G19", "G18", "G17"][3 - self.axes[0] - self.axes[1]]
    }

    /// Returns the words of each block: letters and ways in µm, end before centre, as `ends` and `centres` write them.
    pub(super) fn format_words(
        &self,
        ends: impl Fn(char, i64) -> String,
        centres: impl Fn(char, i64) -> String,
    ) -> Vec<(bool, String)> {
        let words = |(is_ccw, end, centre): &(bool, [i64; 2], [i64; 2])| {
            let mut words = String::new();
            for (axis, um) in self.axes.into_iter().zip(end) {
                words += &format!(" {}", ends(AXIS_LETTERS[axis], *um));
            }
            for (axis, um) in self.axes.into_iter().zip(centre) {
                words += &format!(" {}", centres(CENTRE_LETTERS[axis], *um));
            }
            (*is_ccw, words)
        };
        self.blocks.iter().map(words).collect()
    }
}

/// A touch from a place that is known, in µm.
pub(super) struct ProbeMove {
    pub(super) axis: usize,
    pub(super) from: i64,
    pub(super) to: i64,
    pub(super) feed: f64,
    pub(super) number: usize,
}

/// A cell of a row that the control writes.
pub(super) enum Cell {
    /// As it stands.
    Text(String),
    /// The expected mean of touches minus the mean that was found, in µm.
    Found(TouchMean),
}

/// The letters of a centre, of X, Y and Z.
const CENTRE_LETTERS: [char; 3] = ['I', 'J', 'K'];

/// `12.5`, `-50`: as few digits as say it.
pub(super) fn format_mm(um: i64) -> String {
    let text = format!("{:.3}", um as f64 / 1000.0);
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}

/// `text` in lines of at most `width` characters, cut between words; a longer word stays whole.
pub(super) fn wrap_lines(text: &str, width: usize) -> Vec<String> {
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
pub(super) fn sanitise_text(text: &str) -> String {
    let plain = |c: char| match c {
        '(' | '[' => '<',
        ')' | ']' => '>',
        c if c.is_ascii() && !c.is_ascii_control() => c,
        _ => '?',
    };
    text.chars().map(plain).collect()
}
