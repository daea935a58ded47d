//! The primary host application: whether it is there, by its state message.

use serde_json::Value;

/// A host application, as far as it has reported its state.
pub(crate) struct PrimaryHost {
    is_online: bool,
    /// The time in its last message, in ms since 1970.
    at_ms: u64,
}

impl PrimaryHost {
    /// Returns a host of which nothing is known: it counts as offline.
    pub fn new() -> Self {
        Self { is_online: false, at_ms: 0 }
    }

    /// Returns whether it is there.
    pub(crate) fn is_online(&self) -> bool {
        self.is_online
    }

    /// Takes its state message; `None`: it is none. One that is older than the last one changes nothing.
    pub(crate) fn update_state(&mut self, payload: &[u8]) -> Option<()> {
        let state: Value = serde_json::from_slice(payload).ok()?;
        let (online, at_ms) = (state["online"].as_bool()?, state["timestamp"].as_u64()?);
        if at_ms >= self.at_ms {
            (self.is_online, self.at_ms) = (online, at_ms);
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_message_counts_and_what_is_none_changes_nothing() {
        let mut host = PrimaryHost::new();
        assert!(!host.is_online());
        assert_eq!(host.update_state(br#"{"online":true,"timestamp":20}"#), Some(()));
        assert!(host.is_online());
        assert_eq!(host.update_state(br#"{"online":false,"timestamp":10}"#), Some(()));
        assert!(host.is_online(), "the will of an older connection");
        for none in [&b"OFFLINE"[..], b"{}", b"{\"online\":1,\"timestamp\":99}", b"\xFF"] {
            assert_eq!(host.update_state(none), None);
        }
        assert_eq!(host.update_state(br#"{"online":false,"timestamp":20}"#), Some(()));
        assert!(!host.is_online());
    }
}
