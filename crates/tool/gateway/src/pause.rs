//! The pauses before something is opened again.

use std::{
    thread,
    time::{Duration, Instant},
};

use crate::bridge::Shared;

/// Before the first try; each further one waits twice as long.
const FIRST: Duration = Duration::from_millis(250);
/// The longest: once the cable is plugged in again, nothing waits longer.
const LAST: Duration = Duration::from_secs(4);
/// How often is looked whether it is the end.
const LOOK: Duration = Duration::from_millis(50);

/// The next pause.
#[derive(Clone, Copy, Debug)]
pub struct Pause(Duration);

impl Default for Pause {
    fn default() -> Self {
        Self(FIRST)
    }
}

impl Pause {
    /// Waits for it, or until the end; the next is twice as long.
    pub fn wait(&mut self, shared: &Shared) {
        let until = Instant::now() + self.0;
        while Instant::now() < until && !shared.has_ended() {
            thread::sleep(LOOK.min(until.saturating_duration_since(Instant::now())));
        }
        self.0 = LAST.min(2 * self.0);
    }
}
