//! A PLC's view of the node, which it shares with every other task: each look is short, and the CRC of a block is
//! computed outside of it.

use rtic::Mutex;
use trueup_modbus::{
    cnc, input,
    server::{Bridge, Busy},
};
use trueup_node::node::Node;

/// The node behind its lock.
pub struct Registers<N>(pub N);

impl<N: Mutex<T = &'static mut Node<'static>>> Bridge for Registers<N> {
    fn input(&mut self) -> input::Registers {
        self.0.lock(|node| node.said()).encode()
    }

    fn holding(&mut self) -> cnc::Registers {
        self.0.lock(|node| node.holding())
    }

    fn take(&mut self, block: &cnc::Registers) -> Result<(), Busy> {
        self.0.lock(|node| node.hear_block(block))
    }
}
