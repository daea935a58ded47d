//! When `Engage` is raised: only while LinuxCNC applies no offset.
//!
//! A bridge that has restarted does not know which offset is still applied, and gives none until it
//! has received `Engage` as 0 in three frames and then as 1. So whenever the bridge says "not
//! available", or the operator lets go, `Engage` goes to 0, and comes back once the offset is gone
//! and has been for as long as three frames take. A bridge that stays without an offset for another
//! reason, a dead sensor, receives the same once a second: it changes nothing for it.

use core::time::Duration;

/// Three `Control` frames, 20 ms apart, with as long again for a loop that comes late.
const MIN_RELEASE_TIME: Duration = Duration::from_millis(120);
/// A bridge that has received `Engage` for this long and still says "not available" gets the sequence (0, then 1) again.
const ENGAGE_RETRY_DELAY: Duration = Duration::from_secs(1);

/// Whether `Engage` is raised.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct EngageSequence {
    /// Since when it is, or is not; `None`: the component has just begun.
    since: Option<Duration>,
    is_raised: bool,
}

impl EngageSequence {
    /// Returns what to say now. `requested`: the operator wants offsets and the machine is on; `available`: the
    /// bridge gives one, or has not been received; `at_zero`: LinuxCNC applies none.
    pub fn step(&mut self, now: Duration, requested: bool, available: bool, at_zero: bool) -> bool {
        let lasts = now.saturating_sub(*self.since.get_or_insert(now));
        let falls = self.is_raised && (!requested || (!available && lasts >= ENGAGE_RETRY_DELAY));
        let rises = !self.is_raised && requested && at_zero && lasts >= MIN_RELEASE_TIME;
        if falls || rises {
            self.is_raised = rises;
            self.since = Some(now);
        }
        self.is_raised
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn it_is_raised_only_where_no_offset_is_applied_and_after_three_frames_without() {
        let mut engage = EngageSequence::default();
        let raised = (0..1_000).find(|n| engage.step(ms(*n), true, false, *n >= 500));
        assert_eq!(raised, Some(500));
        let mut engage = EngageSequence::default();
        let raised = (0..1_000).find(|n| engage.step(ms(*n), true, false, true));
        assert_eq!(raised, Some(120));
    }

    #[test]
    fn it_falls_with_the_operator_at_once_and_comes_back_only_at_zero() {
        let mut engage = EngageSequence::default();
        assert!((0..200).any(|n| engage.step(ms(n), true, true, true)));
        assert!(!engage.step(ms(200), false, true, false));
        assert!((201..900).all(|n| !engage.step(ms(n), true, true, false)));
        assert!(engage.step(ms(900), true, true, true));
    }

    #[test]
    fn a_bridge_that_gives_nothing_is_reported_from_the_beginning_once_a_second() {
        let mut engage = EngageSequence::default();
        let engaged: Vec<bool> =
            (0..5_000).map(|n| engage.step(ms(n), true, false, true)).collect();
        let rises = engaged.windows(2).filter(|pair| !pair[0] && pair[1]).count();
        assert_eq!(rises, 5);
        let mut engage = EngageSequence::default();
        let engaged: Vec<bool> = (0..5_000).map(|n| engage.step(ms(n), true, true, true)).collect();
        assert!(engaged[200..].iter().all(|raised| *raised), "a live bridge is left alone");
    }
}
