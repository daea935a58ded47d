//! The bridge in registers: what a PLC reads and writes over the RS-485 line, by the rules that hold for a CNC
//! on CAN. One block says all that CAN has in six frames, so there is one counter and one check for it.

use trueup_core::cnc::Command;
use trueup_modbus::{
    cnc::{self, Checker, Cnc, Refused, is_sound},
    input::Input,
    server::Busy,
};

use super::{Line, Node};

/// State of the exchange in registers.
#[derive(Debug, Default)]
pub(super) struct Registers {
    checker: Checker,
    holding: cnc::Registers,
    last_refused: u16,
    refused: u16,
}

impl Node<'_> {
    /// Returns what a PLC reads: all of the last tick, whose time is the counter.
    // A function of its own in the image, where a test follows its calls (host-tests, no_panic).
    #[inline(never)]
    #[must_use]
    pub fn said(&self) -> Input {
        let [low, high, ..] = self.now.0.to_le_bytes();
        Input {
            counter: u16::from_le_bytes([low, high]),
            output: self.last,
            age_ms: self.last.age_ms.into(),
            last_refused: self.registers.last_refused,
            refused: self.registers.refused,
            state: self.faults(&self.last).state().0,
            calibration: self.running_crc(),
            elongation: self.state.elongation(),
            centi_c: [0, 1, 2, 3, 4, 5, 6, 7].map(|channel| self.centi_c(channel)),
        }
    }

    /// Returns the holding block that was last used; zeros before.
    #[must_use]
    pub const fn holding(&self) -> cnc::Registers {
        self.registers.holding
    }

    /// Takes a holding block from the RS-485 line. One that is refused has no effect; it is counted, and reported
    /// in the input block.
    ///
    /// # Errors
    /// A CNC on another line is the master.
    // A function of its own in the image, where a test follows its calls (host-tests, no_panic).
    #[inline(never)]
    pub fn hear_block(&mut self, block: &cnc::Registers) -> Result<(), Busy> {
        if !self.master.admits(Line::Modbus) {
            if is_sound(block) {
                self.master.hear_other();
            }
            return Err(Busy);
        }
        match self.registers.checker.accept(block) {
            Ok(said) => {
                self.registers.holding = *block;
                self.hear_plc(&said);
            }
            Err(refused) => {
                self.registers.last_refused = refused as u16;
                self.registers.refused = self.registers.refused.saturating_add(1);
                let is_another = matches!(refused, Refused::Repeated | Refused::WrongSequence);
                self.master.refuse(is_another);
            }
        }
        Ok(())
    }

    /// As the frames that a CNC would send it with.
    fn hear_plc(&mut self, said: &Cnc) {
        self.hear_control(Line::Modbus, said.control);
        let Some(bridge) = &self.bridge else { return };
        let positions = said.positions.into_iter().flatten().map(Command::Position);
        let rotary = said.rotary.map(Command::Rotary);
        let spindle = said.spindle.map(Command::Spindle);
        let conditions = said.conditions.map(Command::Conditions);
        for command in positions.chain(rotary).chain(spindle).chain(conditions) {
            bridge.hear(&mut self.state, command);
        }
    }
}
