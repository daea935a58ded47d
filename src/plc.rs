//! A PLC's view of the node, which it shares with every other task: each look is short. A block that is read is a copy of one
//! moment, encoded and sealed outside of the lock. A block that is written is checked and decoded outside of it, accepted or
//! refused as a whole in one look, and its values follow one by one before the answer, as the frames of a CNC do.

use rtic::Mutex;
use trueup_modbus::{
    cnc::{self, Block},
    input,
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

    fn take(&mut self, registers: &cnc::Registers) -> Result<(), Busy> {
        let block = Block::examine(registers);
        if self.0.lock(|node| node.receive_block(&block))? {
            for value in block.values() {
                self.0.lock(|node| node.receive_value(value));
            }
        }
        Ok(())
    }
}
