//! Effects of the commands of network management; which command it is,
//! [`trueup_canopen::nmt`] says.

use trueup_canopen::{heartbeat::HeartbeatConsumer, nmt::NmtCommand, sdo};
use trueup_link::frame::Frame;

use super::{Node, default_heartbeat_period_ms};

impl Node<'_> {
    pub(super) fn handle_nmt_command(&mut self, frame: &Frame) {
        match NmtCommand::decode(frame) {
            Some(NmtCommand::ResetNode) if self.check_change_allowed().is_ok() => {
                self.restart = true
            }
            Some(NmtCommand::ResetCommunication) if self.is_offset_inactive() => {
                self.reset_communication()
            }
            _ => {}
        }
    }

    /// A restart that a master has requested, once.
    pub fn take_restart_request(&mut self) -> bool {
        // The CNC may have engaged since.
        core::mem::take(&mut self.restart) && self.is_offset_inactive()
    }

    /// A calibration that is being stored just now is stored all the same; only its answer is
    /// no longer sent.
    fn reset_communication(&mut self) {
        self.server = sdo::SdoServer::default();
        self.answer = None;
        self.consumer = HeartbeatConsumer::default();
        self.emergencies.reset_inhibit_time();
        self.heartbeat.period_ms = default_heartbeat_period_ms();
        self.heartbeat.since_ms = 0;
        self.heartbeat.has_booted = false;
    }
}
