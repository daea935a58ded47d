//! The heartbeat that a master expects the bridge to receive (object 0x1016).
//!
//! It only reports a loss, by an emergency: the offsets rest on `Control`, which is
//! protected, and not on a byte that is not.

use trueup_link::{frame::Frame, layout::HEARTBEAT_ID};

use crate::sdo::AbortCode;

/// Identifier of the heartbeat of node 0.
const HEARTBEAT_BASE_ID: u16 = 0x700;

/// Whose heartbeat is expected, and when it was received.
#[derive(Clone, Copy, Debug, Default)]
pub struct HeartbeatConsumer {
    node: u8,
    time_ms: u16,
    /// Milliseconds since it was received; it counts from the first on.
    silent_ms: Option<u32>,
}

impl HeartbeatConsumer {
    /// As object 0x1016 has it: the node, 0…127, in bits 16…22, milliseconds below; 0: off.
    #[must_use]
    pub fn to_object_value(&self) -> u32 {
        u32::from(self.node) << 16 | u32::from(self.time_ms)
    }

    /// Sets it; 0 for either part switches it off.
    ///
    /// # Errors
    /// [`AbortCode::Value`]: a node above 127 or this one, or reserved bits that are set.
    pub fn set_object_value(&mut self, setting: u32) -> Result<(), AbortCode> {
        let [low, high, node, reserved] = setting.to_le_bytes();
        let time_ms = u16::from_le_bytes([low, high]);
        if reserved != 0 || node > 127 || HEARTBEAT_BASE_ID | u16::from(node) == HEARTBEAT_ID {
            return Err(AbortCode::Value);
        }
        *self = Self { node, time_ms, silent_ms: None };
        Ok(())
    }

    /// Takes a frame from the bus; every other than the expected heartbeat has no effect.
    pub fn receive(&mut self, frame: &Frame) {
        if self.is_enabled() && frame.id() == HEARTBEAT_BASE_ID | u16::from(self.node) {
            self.silent_ms = Some(0);
        }
    }

    /// Time passes, in milliseconds.
    pub fn advance_time(&mut self, elapsed_ms: u32) {
        self.silent_ms = self.silent_ms.map(|silent| silent.saturating_add(elapsed_ms));
    }

    /// Returns whether it was received before, and for longer than the set time no more.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.is_enabled() && self.silent_ms.is_some_and(|silent| silent > self.time_ms.into())
    }

    fn is_enabled(&self) -> bool {
        self.node > 0 && self.time_ms > 0
    }
}
