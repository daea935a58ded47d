//! What a CANopen master may command by network management (NMT, CiA 301), and what it may not.
//!
//! | command | here |
//! |---|---|
//! | 0x01 start, 0x02 stop, 0x80 pre-operational | no effect |
//! | 0x81 reset node | the board restarts, if no offset is followed; else no effect |
//! | 0x82 reset communication | heartbeats, inhibit time and the SDO server as at the start, boot-up message; the offsets go on |
//!
//! A machine relies on the offsets while it cuts, and an NMT command is two bytes that nothing
//! protects, often sent to all nodes of a bus by a tool that knows none of them. So none of them
//! stops, starts or jumps an offset: that is for `Control` alone, which is protected, counted and
//! ramped. The heartbeat says what the bridge does and not what it was told: operational while it
//! sends offsets that can be used, stopped while they are not available.

use super::{Consumer, Node, default_heartbeat_ms};
use crate::{frame::Frame, sdo};

/// The node of [`crate::layout::HEARTBEAT_ID`].
const NODE: u8 = 1;
/// To all nodes.
const ALL: u8 = 0;
const RESET_NODE: u8 = 0x81;
const RESET_COMMUNICATION: u8 = 0x82;

impl Node<'_> {
    pub(super) fn network_command(&mut self, frame: &Frame) {
        let &[command, NODE | ALL] = frame.payload() else { return };
        match command {
            RESET_NODE if self.is_at_rest() => self.restart = true,
            RESET_COMMUNICATION => self.reset_communication(),
            _ => {}
        }
    }

    /// A restart that a master has asked for, once.
    pub fn take_restart(&mut self) -> bool {
        // The CNC may have engaged since.
        core::mem::take(&mut self.restart) && self.is_at_rest()
    }

    /// A calibration that is being stored just now is stored all the same; only its answer is
    /// not sent any more.
    fn reset_communication(&mut self) {
        self.server = sdo::Server::default();
        self.answer = None;
        self.consumer = Consumer::default();
        self.emergencies.reset_inhibit();
        self.heartbeat_period_ms = default_heartbeat_ms();
        self.since_heartbeat_ms = 0;
        self.has_booted = false;
    }
}
