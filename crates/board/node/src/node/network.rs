//! Effects of the commands of network management; which command it is,
//! [`trueup_canopen::network`] says.

use trueup_canopen::{heartbeat::Consumer, network::Command, sdo};
use trueup_link::frame::Frame;

use super::{Node, default_heartbeat_ms};

impl Node<'_> {
    pub(super) fn network_command(&mut self, frame: &Frame) {
        match Command::decode(frame) {
            Some(Command::ResetNode) if self.allow_change().is_ok() => self.restart = true,
            Some(Command::ResetCommunication) if self.is_at_rest() => self.reset_communication(),
            _ => {}
        }
    }

    /// A restart that a master has asked for, once.
    pub fn take_restart(&mut self) -> bool {
        // The CNC may have engaged since.
        core::mem::take(&mut self.restart) && self.is_at_rest()
    }

    /// A calibration that is being stored just now is stored all the same; only its answer is
    /// no longer sent.
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
