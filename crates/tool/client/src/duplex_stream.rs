//! Both directions of an open line, whatever it goes through.

use std::{
    io::{self, Read, Write},
    time::Duration,
};

/// How long a read waits for bytes: short, so that a deadline is met without them too, and an end of
/// the line is noticed as fast.
pub(crate) const READ_TIMEOUT: Duration = Duration::from_millis(20);

/// Both directions of an open line, for a thread each if need be. A read that finds nothing for a
/// while fails in a way that [`is_timeout`].
pub type DuplexStream = (Box<dyn Read + Send>, Box<dyn Write + Send>);

/// Returns whether a read that failed so has found nothing yet, and the line still stands.
#[must_use]
pub fn is_timeout(error: &io::Error) -> bool {
    use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), Interrupted | TimedOut | WouldBlock)
}

/// Returns whether a serial port that failed to open so is in use by another program: by the system's own word, or
/// by that of `serialport`, which locks a device that it opens, and has no kind for it.
#[must_use]
pub fn is_busy(error: &io::Error) -> bool {
    error.kind() == io::ErrorKind::ResourceBusy
        || ["exclusive lock", "resource busy"]
            .iter()
            .any(|phrase| error.to_string().contains(phrase))
}
