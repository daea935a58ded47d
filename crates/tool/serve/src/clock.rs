//! The time of day of what is published, and whether it was set.
//!
//! Order never depends on it: records have numbers, and the times of a connection are those of a clock that
//! only advances.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// A clock that differs from the one that only advances by more than this was set.
const CLOCK_STEP_THRESHOLD_MS: i64 = 1_000;

/// Returns the time of day in ms since 1970 (UTC).
#[must_use]
pub fn now_ms() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO);
    u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
}

/// Returns a time in ms since 1970 as ISO 8601, to the millisecond.
#[must_use]
pub fn format_utc(ms: u64) -> String {
    let seconds = u32::try_from(ms / 1_000).unwrap_or(u32::MAX);
    let whole = trueup_client::write_log::format_utc(seconds);
    format!("{}.{:03}Z", whole.trim_end_matches('Z'), ms % 1_000)
}

/// Notices that the time of day was set.
#[derive(Debug)]
pub(crate) struct ClockStepDetector {
    start: Instant,
    start_ms: u64,
}

impl ClockStepDetector {
    /// Begins with both clocks as they are.
    #[must_use]
    pub fn new(now: Instant, now_ms: u64) -> Self {
        Self { start: now, start_ms: now_ms }
    }

    /// Returns by how many ms the time of day was set since the last call, if it was; negative: back.
    pub(crate) fn detect_step_ms(&mut self, now: Instant, now_ms: u64) -> Option<i64> {
        let passed = now.saturating_duration_since(self.start).as_millis();
        let expected = i64::try_from(passed).ok()?.checked_add_unsigned(self.start_ms)?;
        let step = i64::try_from(now_ms).ok()? - expected;
        if step.abs() <= CLOCK_STEP_THRESHOLD_MS {
            return None;
        }
        *self = Self::new(now, now_ms);
        Some(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_is_set_is_noticed_once_and_its_drift_is_none() {
        let start = Instant::now();
        let mut watch = ClockStepDetector::new(start, 1_000_000);
        let at = |s: u64| start + Duration::from_secs(s);
        assert_eq!(watch.detect_step_ms(at(10), 1_010_900), None);
        assert_eq!(watch.detect_step_ms(at(20), 420_000), Some(-600_000));
        assert_eq!(watch.detect_step_ms(at(30), 430_000), None);
        assert_eq!(watch.detect_step_ms(at(31), 7_431_000), Some(7_000_000));
    }

    #[test]
    fn times_are_written_to_the_millisecond() {
        assert_eq!(format_utc(1_709_164_800_007), "2024-02-29T00:00:00.007Z");
    }
}
