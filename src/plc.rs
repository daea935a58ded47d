//! A PLC's view of the node, which it shares with every other task: each look is short. A block that is read is a copy of one
//! moment, encoded and sealed outside of the lock. A block that is written is checked and decoded outside of it, accepted or
//! refused as a whole in one look, and its values follow one by one before the answer, as the frames of a CNC do.

use heapless::spsc::Producer;
use rtic::Mutex;
use trueup_modbus::{
    holding_block::{self, HoldingBlock},
    input_block,
    server::{RegisterStore, RegistersBusy},
};
use trueup_node::node::Node;

/// The node behind its lock.
pub struct SharedRegisters<N>(pub N);

impl<N: Mutex<T = &'static mut Node<'static>>> RegisterStore for SharedRegisters<N> {
    fn input_registers(&mut self) -> input_block::InputRegisters {
        self.0.lock(|node| node.input_block()).encode()
    }

    fn holding_registers(&mut self) -> holding_block::HoldingRegisters {
        self.0.lock(|node| node.holding_registers())
    }

    fn write_holding_registers(
        &mut self,
        registers: &holding_block::HoldingRegisters,
    ) -> Result<(), RegistersBusy> {
        let block = HoldingBlock::from_registers(registers);
        if self.0.lock(|node| node.receive_block(&block))? {
            for value in block.commands() {
                self.0.lock(|node| node.receive_command(value));
            }
        }
        Ok(())
    }
}

/// Queues an answer to the PLC.
// A function of its own in the image: its time is bounded by the requests (`cargo xtask bounds`).
#[inline(never)]
pub fn queue_response(to_line: &mut Producer<'static, u8>, answer: &[u8]) {
    for byte in answer {
        to_line.enqueue(*byte).ok();
    }
}
