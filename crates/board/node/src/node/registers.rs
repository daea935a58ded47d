//! The bridge in registers: what a PLC reads and writes over the RS-485 line, by the rules that hold for a CNC
//! on CAN. One block says all that CAN has in six frames, so there is one counter and one check for it.

use trueup_core::cnc::CncMessage;
use trueup_modbus::{
    holding_block::{self, BlockRejectReason, HoldingBlock, HoldingBlockChecker},
    input_block::InputBlock,
    server::RegistersBusy,
};

use super::{Interface, Node};

/// State of the exchange in registers.
#[derive(Debug, Default)]
pub(super) struct RegisterExchange {
    checker: HoldingBlockChecker,
    holding: holding_block::HoldingRegisters,
    last_refused: u16,
    refused: u16,
}

impl Node<'_> {
    /// Returns what a PLC reads: all of the last tick, whose time is the counter.
    // A function of its own in the image, where a test follows its calls (host-tests, no_panic).
    #[inline(never)]
    #[must_use]
    pub fn input_block(&self) -> InputBlock {
        let [low, high, ..] = self.now.0.to_le_bytes();
        InputBlock {
            counter: u16::from_le_bytes([low, high]),
            output: self.last,
            age_ms: self.last.age_ms.into(),
            last_refused: self.registers.last_refused,
            refused: self.registers.refused,
            state: self.faults(&self.last).state_bits().0,
            calibration: self.running_calibration_crc(),
            elongation: self.state.elongation(),
            centi_c: [0, 1, 2, 3, 4, 5, 6, 7].map(|channel| self.temperature_centi_c(channel)),
        }
    }

    /// Returns the holding block that was last used; zeros before.
    #[must_use]
    pub const fn holding_registers(&self) -> holding_block::HoldingRegisters {
        self.registers.holding
    }

    /// Takes a holding block from the RS-485 line, and follows its `Control`. Returns whether its values are to follow, one
    /// by one, by [`Node::receive_command`]: a tick between two of them comes first, as between two frames on CAN. A block that
    /// is refused has no effect; it is counted, and reported in the input block.
    ///
    /// # Errors
    /// A CNC on another line is the master.
    // A function of its own in the image, where a test follows its calls (host-tests, no_panic).
    #[inline(never)]
    pub fn receive_block(&mut self, block: &HoldingBlock) -> Result<bool, RegistersBusy> {
        if !self.master.accepts_interface(Interface::Modbus) {
            if block.has_valid_crc() {
                self.master.record_frame_on_other_interface();
            }
            return Err(RegistersBusy);
        }
        match self.registers.checker.accept_block(block) {
            Ok(cnc_data) => {
                self.registers.holding = *block.registers();
                self.receive_control(Interface::Modbus, cnc_data.control);
                Ok(true)
            }
            Err(refused) => {
                self.registers.last_refused = refused as u16;
                self.registers.refused = self.registers.refused.saturating_add(1);
                let is_another = matches!(
                    refused,
                    BlockRejectReason::Repeated | BlockRejectReason::WrongSequence
                );
                self.master.reject_control(is_another);
                Ok(false)
            }
        }
    }

    /// Takes one of the values of a block that was taken. It has no effect once another line has the master.
    // A function of its own in the image, where a test follows its calls (host-tests, no_panic).
    #[inline(never)]
    pub fn receive_command(&mut self, value: CncMessage) {
        if !self.master.accepts_interface(Interface::Modbus) {
            return;
        }
        if let Some(bridge) = &self.bridge {
            bridge.receive_command(&mut self.state, value);
        }
    }

    /// Takes the registers of a holding block and all of its values, where nothing else uses the node.
    ///
    /// # Errors
    /// As [`Node::receive_block`].
    pub fn receive_registers(
        &mut self,
        registers: &holding_block::HoldingRegisters,
    ) -> Result<(), RegistersBusy> {
        let block = HoldingBlock::from_registers(registers);
        if self.receive_block(&block)? {
            block.commands().for_each(|value| self.receive_command(value));
        }
        Ok(())
    }
}
