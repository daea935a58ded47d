//! Network management (NMT, CiA 301): the commands of a CANopen master, and which of them have an effect.
//!
//! | command | here |
//! |---|---|
//! | 0x01 start, 0x02 stop, 0x80 pre-operational | no effect |
//! | 0x81 reset node | the board restarts, if no offset is followed; else no effect |
//! | 0x82 reset communication | heartbeats, inhibit time, SDO server as at the start, boot-up; the offsets go on |
//!
//! A machine relies on the offsets while it cuts, and an NMT command is two bytes that nothing
//! protects, often sent to all nodes of a bus by a tool that knows none of them. So none of them
//! stops, starts or jumps an offset: that is for `Control` alone, which is protected, counted and
//! ramped. The heartbeat says what the bridge does, not what it was commanded: operational while it
//! sends offsets that can be used, stopped while they are not available.

use trueup_link::{frame::Frame, layout::NMT_ID};

/// The node of [`trueup_link::layout::HEARTBEAT_ID`].
const NODE_ID: u8 = 1;
/// To all nodes.
const ALL_NODES: u8 = 0;
const RESET_NODE: u8 = 0x81;
const RESET_COMMUNICATION: u8 = 0x82;

/// A command that has an effect here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NmtCommand {
    /// The board is to restart.
    ResetNode,
    /// The node's communication is to restart.
    ResetCommunication,
}

impl NmtCommand {
    /// Returns the command in a frame; `None`: it is not a command, is one of another node, or one without an
    /// effect.
    #[must_use]
    pub fn decode(frame: &Frame) -> Option<Self> {
        match (frame.id(), frame.payload()) {
            (NMT_ID, &[RESET_NODE, NODE_ID | ALL_NODES]) => Some(Self::ResetNode),
            (NMT_ID, &[RESET_COMMUNICATION, NODE_ID | ALL_NODES]) => Some(Self::ResetCommunication),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_commands_to_this_node_or_to_all_have_an_effect() {
        let decode = |id, payload: &[u8]| {
            NmtCommand::decode(&Frame::new(id, payload).expect("a short frame"))
        };
        for node in [0, 1] {
            assert_eq!(decode(NMT_ID, &[0x81, node]), Some(NmtCommand::ResetNode));
            assert_eq!(decode(NMT_ID, &[0x82, node]), Some(NmtCommand::ResetCommunication));
            for none in [0x00, 0x01, 0x02, 0x80, 0x83] {
                assert_eq!(decode(NMT_ID, &[none, node]), None);
            }
        }
        assert_eq!(decode(NMT_ID, &[0x81, 2]), None);
        assert_eq!(decode(NMT_ID, &[0x81]), None);
        assert_eq!(decode(NMT_ID, &[0x81, 1, 0]), None);
        assert_eq!(decode(0x181, &[0x81, 1]), None);
    }
}
