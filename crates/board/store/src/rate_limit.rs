//! How often a record may be stored: a word that is programmed stops the core, and a record that the flash refuses twice takes
//! milliseconds. The bounds of time rest on this limit (`cargo xtask bounds`).

/// Milliseconds between two records, at the least.
pub const MIN_STORE_INTERVAL_MS: u32 = 50;

/// The time until the next record.
///
/// ```
/// use trueup_store::rate_limit::{RateLimiter, MIN_STORE_INTERVAL_MS};
/// let mut pace = RateLimiter::default();
/// let permit = pace.store_permit().expect("the first one at once");
/// pace.record(permit);
/// assert!(pace.store_permit().is_none());
/// pace.advance_time(MIN_STORE_INTERVAL_MS);
/// assert!(pace.store_permit().is_some());
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct RateLimiter {
    until_ms: u32,
}

/// The permission to store one record: whatever stores a paced one asks for it, and it cannot be made up.
///
/// ```
/// fn store(_permit: trueup_store::rate_limit::StorePermit) {}
/// ```
/// ```compile_fail,E0423
/// let permit = trueup_store::rate_limit::StorePermit(());
/// ```
#[derive(Debug)]
pub struct StorePermit(());

impl StorePermit {
    /// Returns the permission for a record that a restart would lose: no deadline stands after it.
    #[must_use]
    pub const fn before_restart() -> Self {
        Self(())
    }
}

impl RateLimiter {
    /// Lets milliseconds pass.
    pub fn advance_time(&mut self, elapsed_ms: u32) {
        self.until_ms = self.until_ms.saturating_sub(elapsed_ms);
    }

    /// Returns the permission where a record may be stored now: the first one at once.
    #[must_use]
    pub const fn store_permit(&self) -> Option<StorePermit> {
        if self.until_ms == 0 { Some(StorePermit(())) } else { None }
    }

    /// Notes that the record is stored.
    pub fn record(&mut self, StorePermit(()): StorePermit) {
        self.until_ms = MIN_STORE_INTERVAL_MS;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn however_many_records_wait_each_has_its_period_to_itself() {
        let mut pace = RateLimiter::default();
        let mut stored = Vec::new();
        for turn in 0..100_u32 {
            pace.advance_time(10);
            // As a turn of the supervisor does: what holds for the calibration first, then a write.
            for _ in 0..2 {
                if let Some(permit) = pace.store_permit() {
                    pace.record(permit);
                    stored.push(turn * 10);
                }
            }
        }
        assert_eq!(stored, (0..1_000).step_by(50).collect::<Vec<_>>());
    }
}
