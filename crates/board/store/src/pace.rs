//! How often a record may be stored: a word that is programmed stops the core, and a record that the flash refuses twice takes
//! milliseconds. The bounds of time rest on this limit (`cargo xtask bounds`).

/// Milliseconds between two records, at the least.
pub const STORE_PERIOD_MS: u32 = 50;

/// The time until the next record.
///
/// ```
/// use trueup_store::pace::{Pace, STORE_PERIOD_MS};
/// let mut pace = Pace::default();
/// assert!(pace.is_due());
/// pace.record();
/// assert!(!pace.is_due());
/// pace.elapse(STORE_PERIOD_MS);
/// assert!(pace.is_due());
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct Pace {
    until_ms: u32,
}

impl Pace {
    /// Lets milliseconds pass.
    pub fn elapse(&mut self, elapsed_ms: u32) {
        self.until_ms = self.until_ms.saturating_sub(elapsed_ms);
    }

    /// Returns whether a record may be stored now: the first one at once.
    #[must_use]
    pub const fn is_due(&self) -> bool {
        self.until_ms == 0
    }

    /// Notes that one is stored.
    pub fn record(&mut self) {
        self.until_ms = STORE_PERIOD_MS;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn however_many_records_wait_each_has_its_period_to_itself() {
        let mut pace = Pace::default();
        let mut stored = Vec::new();
        for turn in 0..100_u32 {
            pace.elapse(10);
            // As a turn of the supervisor does: what holds for the calibration first, then a write.
            for _ in 0..2 {
                if pace.is_due() {
                    pace.record();
                    stored.push(turn * 10);
                }
            }
        }
        assert_eq!(stored, (0..1_000).step_by(50).collect::<Vec<_>>());
    }
}
