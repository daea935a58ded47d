//! The moment from which the replay runs: the board has answered a client's first `O`.
//!
//! Frames that the board sends while its channel is closed are lost, and the first millisecond already has the
//! boot-up message.

use std::{
    sync::{
        OnceLock,
        atomic::{AtomicU32, Ordering},
    },
    time::{Duration, Instant},
};

use trueup_link::slcan::{BELL, CR};

/// Time for which the answer is awaited.
const ANSWER: Duration = Duration::from_secs(1);

/// Counts lines to the board and its answers. While the board's time stands still, it says one end of a
/// line for each line that it takes, and nothing else.
#[derive(Default)]
pub(crate) struct Opening {
    lines: AtomicU32,
    answers: AtomicU32,
    /// The number of the line with the first `O`, and its time.
    asked: OnceLock<(u32, Instant)>,
}

impl Opening {
    /// Takes a line to the board, before it is written.
    pub(crate) fn take_line(&self, opens: bool) {
        let line = self.lines.fetch_add(1, Ordering::SeqCst) + 1;
        if opens {
            self.asked.get_or_init(|| (line, Instant::now()));
        }
    }

    /// Takes what the board says.
    pub(crate) fn take_answers(&self, said: &[u8]) {
        let ends = said.iter().filter(|&&byte| is_end(byte)).count();
        self.answers.fetch_add(u32::try_from(ends).unwrap_or(0), Ordering::SeqCst);
    }

    /// Whether the board has answered, or has had the time for it.
    pub fn is_over(&self) -> bool {
        self.asked.get().is_some_and(|&(line, at)| {
            self.answers.load(Ordering::SeqCst) >= line || at.elapsed() > ANSWER
        })
    }
}

/// Whether this byte ends what the board says.
pub const fn is_end(byte: u8) -> bool {
    matches!(byte, CR | BELL)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_answer_to_an_earlier_line_does_not_open() {
        let opening = Opening::default();
        opening.take_line(false);
        opening.take_line(true);
        assert!(!opening.is_over(), "nothing was answered");
        opening.take_answers(b"\r");
        assert!(!opening.is_over(), "that was the first line's");
        opening.take_answers(b"\x07");
        assert!(opening.is_over());
    }

    #[test]
    fn an_answer_alone_does_not_open() {
        let opening = Opening::default();
        opening.take_line(false);
        opening.take_answers(b"V1013\r");
        assert!(!opening.is_over());
    }
}
