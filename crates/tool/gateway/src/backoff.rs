//! The pauses before something is opened again.

use std::{
    thread,
    time::{Duration, Instant},
};

use crate::bridge::SharedHub;

/// Before the first try; each further one waits twice as long.
const INITIAL_DELAY: Duration = Duration::from_millis(250);
/// The longest: once the cable is plugged in again, nothing waits longer.
const MAX_DELAY: Duration = Duration::from_secs(4);
/// How often is looked whether it is the end.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// The next pause.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Backoff(Duration);

impl Default for Backoff {
    fn default() -> Self {
        Self(INITIAL_DELAY)
    }
}

impl Backoff {
    /// Waits for it, or until the end; the next is twice as long.
    pub fn wait(&mut self, shared: &SharedHub) {
        let until = Instant::now() + self.0;
        while Instant::now() < until && !shared.is_stop_requested() {
            thread::sleep(POLL_INTERVAL.min(until.saturating_duration_since(Instant::now())));
        }
        self.0 = MAX_DELAY.min(2 * self.0);
    }
}
