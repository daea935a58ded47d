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
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(1);

/// Counts lines to the board and its answers. While the board's time stands still, it says one end of a
/// line for each line that it takes, and nothing else.
#[derive(Default)]
pub(crate) struct OpeningHandshake {
    lines: AtomicU32,
    answers: AtomicU32,
    /// The number of the line with the first `O`, and its time.
    request: OnceLock<(u32, Instant)>,
}

impl OpeningHandshake {
    /// Takes a line to the board, before it is written.
    pub(crate) fn count_line(&self, opens: bool) {
        let line = self.lines.fetch_add(1, Ordering::SeqCst) + 1;
        if opens {
            self.request.get_or_init(|| (line, Instant::now()));
        }
    }

    /// Takes what the board says.
    pub(crate) fn count_responses(&self, bytes: &[u8]) {
        let ends = bytes.iter().filter(|&&byte| is_response_end(byte)).count();
        self.answers.fetch_add(u32::try_from(ends).unwrap_or(0), Ordering::SeqCst);
    }

    /// Whether the board has answered, or has had the time for it.
    pub fn is_complete(&self) -> bool {
        self.request.get().is_some_and(|&(line, at)| {
            self.answers.load(Ordering::SeqCst) >= line || at.elapsed() > RESPONSE_TIMEOUT
        })
    }
}

/// Whether this byte ends what the board says.
pub(crate) const fn is_response_end(byte: u8) -> bool {
    matches!(byte, CR | BELL)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_answer_to_an_earlier_line_does_not_open() {
        let opening = OpeningHandshake::default();
        opening.count_line(false);
        opening.count_line(true);
        assert!(!opening.is_complete(), "nothing was answered");
        opening.count_responses(b"\r");
        assert!(!opening.is_complete(), "that was the first line's");
        opening.count_responses(b"\x07");
        assert!(opening.is_complete());
    }

    #[test]
    fn an_answer_alone_does_not_open() {
        let opening = OpeningHandshake::default();
        opening.count_line(false);
        opening.count_responses(b"V1013\r");
        assert!(!opening.is_complete());
    }
}
