//! How long an answer of the bridge is waited for.
//!
//! A bridge gets requests while it works, and it may live slower than we do: one that is emulated on a busy PC gets
//! a part of the time of a real one, and one that writes its flash stands still for a second. So what counts is
//! *its* time, which its heartbeats show, ten a second, and the time for which *we* have listened: a program
//! that was not let run for five seconds has received nothing in them, and knows nothing.
//!
//! | given up after | where |
//! |---|---|
//! | [`MIN_LISTENING_TIME`], and [`MIN_HEARTBEATS`] heartbeats | the bridge lives, and has not answered: the frame is lost |
//! | [`MAX_SILENCE`] without a heartbeat | no bridge is there, or it hangs, or its heartbeat is turned off |
//! | [`MAX_ERASE_SILENCE`] without a heartbeat | the same of a bridge that erases a firmware slot, which stops all of it |

use std::time::{Duration, Instant};

/// How long each look at the line may take. A look that took longer was one at which we slept.
pub const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// Heartbeats of a bridge that has had its time: 2 s of it.
const MIN_HEARTBEATS: u32 = 20;
/// The same by the clock, for heartbeats that have waited in a buffer all at once.
const MIN_LISTENING_TIME: Duration = Duration::from_secs(2);
/// The longest wait without any heartbeat.
const MAX_SILENCE: Duration = Duration::from_secs(5);
/// The same of a bridge that erases two sectors of 128 KB meanwhile: 4 s at most by the data sheet of its chip, and as
/// much again for one that is emulated, or waits for its CNC.
const MAX_ERASE_SILENCE: Duration = Duration::from_secs(12);

/// The patience of one question.
pub(crate) struct TimeoutPolicy {
    looked: Instant,
    listened: Duration,
    /// How much of it since the last heartbeat.
    silent: Duration,
    beats: u32,
    /// The longest wait without any heartbeat.
    silence: Duration,
}

impl TimeoutPolicy {
    /// From `now` on an answer is waited for.
    pub fn new(now: Instant) -> Self {
        let [listened, silent] = [Duration::ZERO; 2];
        Self { looked: now, listened, silent, beats: 0, silence: MAX_SILENCE }
    }

    /// As [`Self::new`], of a bridge that may erase a firmware slot first.
    pub(crate) fn for_flash_erase(now: Instant) -> Self {
        Self { silence: MAX_ERASE_SILENCE, ..Self::new(now) }
    }

    /// A look at the line ends now; whether it has brought a heartbeat.
    pub(crate) fn record_poll(&mut self, now: Instant, is_beat: bool) {
        let look = now.saturating_duration_since(self.looked).min(POLL_INTERVAL);
        self.looked = now;
        self.listened += look;
        self.silent = if is_beat { Duration::ZERO } else { self.silent + look };
        self.beats = self.beats.saturating_add(is_beat.into());
    }

    /// Returns whether no answer is to be expected any more.
    pub(crate) fn is_expired(&self) -> bool {
        self.silent >= self.silence
            || self.listened >= MIN_LISTENING_TIME && self.beats >= MIN_HEARTBEATS
    }

    /// Returns how long has been listened.
    pub(crate) fn listening_time(&self) -> Duration {
        self.listened
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    /// Looks that each take `look`, every `per_beat`th of which brings a heartbeat; when it is over.
    fn over_after(look: Duration, per_beat: u32) -> Duration {
        over(TimeoutPolicy::new, look, per_beat)
    }

    fn over(timeout: fn(Instant) -> TimeoutPolicy, look: Duration, per_beat: u32) -> Duration {
        let start = Instant::now();
        let (mut timeout, mut now) = (timeout(start), start);
        for number in 1..100_000 {
            now += look;
            timeout.record_poll(now, per_beat > 0 && number % per_beat == 0);
            if timeout.is_expired() {
                return now - start;
            }
        }
        panic!("never over");
    }

    #[test]
    fn a_live_bridge_has_two_seconds_and_a_slow_one_as_much_of_its_own_time() {
        // A frame a millisecond, a heartbeat each 100 ms.
        assert_eq!(over_after(MS, 100), 2_000 * MS);
        // A bridge that lives at a fifth of our speed.
        assert_eq!(over_after(5 * MS, 100), 10_000 * MS);
        // Heartbeats that had waited in a buffer.
        assert_eq!(over_after(MS, 1), 2_000 * MS);
    }

    #[test]
    fn silence_is_five_seconds_of_listening_and_time_in_which_we_slept_is_not() {
        assert_eq!(over_after(POLL_INTERVAL, 0), 5_000 * MS);
        // Frames without heartbeats.
        assert_eq!(over_after(MS, 0), 5_000 * MS);
        // Each look took ten times what it may: we were not let run.
        assert_eq!(over_after(10 * POLL_INTERVAL, 0), 50_000 * MS);
    }
    #[test]
    fn an_erase_may_last_twelve_seconds_and_a_live_bridge_has_no_longer_for_it() {
        assert_eq!(over(TimeoutPolicy::for_flash_erase, POLL_INTERVAL, 0), 12_000 * MS);
        assert_eq!(over(TimeoutPolicy::for_flash_erase, MS, 100), 2_000 * MS);
    }
}
