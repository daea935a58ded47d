//! The PC's end of the bridge's line: where a bridge is, how it is spoken to, and what it says.

#![forbid(unsafe_code)]

pub mod object;
pub mod port;
pub mod record;
pub mod session;
#[cfg(all(feature = "socketcan", target_os = "linux"))]
pub mod socket_can;
pub mod status;
pub mod words;

/// What the user has to mend: a port, or the place of a recording.
#[derive(Debug)]
pub struct Mend(String);

impl std::fmt::Display for Mend {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Mend {}
