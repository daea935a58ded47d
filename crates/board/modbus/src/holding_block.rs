//! The holding block: what the control says, from registers, with the checks of a frame on CAN.
//!
//! ```text
//! register  0 … 16   the block that every control writes
//!          17 … 19   behind it tool and conditions, with a CRC over all 20: they count if `Present` says so
//! ```

use trueup_core::{
    cnc::{
        AxisPosition, CncMessage, Control, LinearAxis, MachineConditions, RotaryAxisAngles,
        SpindleState, TravelDirection,
    },
    units::{MicroDegrees, Position, Rpm},
};
use trueup_link::{e2e::MAX_DELTA_COUNTER, layout::MICRO_DEGREES_PER_BIT};

use crate::{
    e2e::{has_valid_crc, read_i32, read_u16, write_crc, write_u16, write_u32},
    register_map::{
        ANGLE_1, ANGLE_2, CNC_COUNTER, CONDITION_BITS, CONDITIONS_DATA_ID, CONTROL, DIRECTIONS,
        HOLDING_DATA_ID, HOLDING_LEN, LOAD, POSITION_X, POSITION_Y, POSITION_Z, PRESENT, SPEED,
        TOOL, WHOLE_HOLDING_LEN,
    },
};

/// The block as it stands in the registers; zeros where a control has written the first 17 alone.
pub type HoldingRegisters = [u16; WHOLE_HOLDING_LEN];

const ROTARY_PRESENT: u16 = 1 << 3;
const SPINDLE_PRESENT: u16 = 1 << 4;
const CONDITIONS_PRESENT: u16 = 1 << 5;
/// Bits that have a meaning.
const CONTROL_MASK: u16 = 0x1F;
const PRESENT_MASK: u16 = 0x3F;

/// Returns whether both CRCs are right, that of tool and conditions where `Present` says that they are meant.
#[must_use]
pub(crate) fn has_valid_crcs(block: &HoldingRegisters) -> bool {
    let has_conditions = read_u16(block, PRESENT) & CONDITIONS_PRESENT != 0;
    let first = block.first_chunk::<HOLDING_LEN>();
    first.is_some_and(|first| has_valid_crc(first, HOLDING_DATA_ID))
        && (!has_conditions || has_valid_crc(block, CONDITIONS_DATA_ID))
}

/// Returns the registers of a block that a control has to write: all of them, or the first 17.
#[must_use]
pub fn registers_to_write(block: &HoldingRegisters) -> &[u16] {
    let has_conditions = read_u16(block, PRESENT) & CONDITIONS_PRESENT != 0;
    match block.first_chunk::<HOLDING_LEN>() {
        Some(first) if !has_conditions => first,
        _ => block,
    }
}

/// Data that the control writes in one block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CncData {
    /// Its sign of life, and what it allows.
    pub control: Control,
    /// Where X, Y and Z are sent; `None`: the control does not say.
    pub positions: [Option<AxisPosition>; 3],
    /// Where the rotary axes are sent.
    pub rotary: Option<RotaryAxisAngles>,
    /// The spindle's speed and load.
    pub spindle: Option<SpindleState>,
    /// The tool and the conditions; `None`: the control does not say.
    pub conditions: Option<MachineConditions>,
}

impl CncData {
    /// Returns the registers, as a PLC has to make them.
    #[must_use]
    pub fn encode(&self, counter: u16) -> HoldingRegisters {
        let mut block = [0; WHOLE_HOLDING_LEN];
        // What was learned is a matter of frames: a PLC loads a new calibration, at rest.
        let Control { engage, referenced, zero, service, confirm, learned: _ } = self.control;
        let flags = [engage, referenced, zero, service, confirm];
        let bits = |flags: &[bool]| {
            flags.iter().rev().fold(0_u16, |bits, flag| bits << 1 | u16::from(*flag))
        };
        let [x, y, z] = self.positions.map(|position| position.is_some());
        let others = [self.rotary.is_some(), self.spindle.is_some(), self.conditions.is_some()];
        let [rotary, spindle, conditions] = others;
        let present = [x, y, z, rotary, spindle, conditions];
        write_u16(&mut block, CNC_COUNTER, counter);
        write_u16(&mut block, CONTROL, bits(&flags));
        write_u16(&mut block, PRESENT, bits(&present));
        let mut directions = 0;
        for (place, position) in
            [POSITION_X, POSITION_Y, POSITION_Z].into_iter().zip(self.positions).rev()
        {
            directions <<= 2;
            if let Some(AxisPosition { position, direction, .. }) = position {
                write_u32(&mut block, place, position.0.cast_unsigned());
                directions |= u16::from((direction as i8).cast_unsigned() & 3);
            }
        }
        write_u16(&mut block, DIRECTIONS, directions);
        if let Some(RotaryAxisAngles { angles }) = self.rotary {
            for (place, angle) in [ANGLE_1, ANGLE_2].into_iter().zip(angles) {
                let raw = angle.0.wrapping_div(MICRO_DEGREES_PER_BIT);
                write_u32(&mut block, place, raw.cast_unsigned());
            }
        }
        if let Some(SpindleState { speed, load_n }) = self.spindle {
            write_u16(&mut block, SPEED, speed.0);
            write_u16(&mut block, LOAD, load_n.cast_unsigned());
        }
        if let Some(first) = block.first_chunk_mut::<HOLDING_LEN>() {
            write_crc(first, HOLDING_DATA_ID);
        }
        if let Some(MachineConditions { tool, bits }) = self.conditions {
            write_u16(&mut block, TOOL, tool);
            write_u16(&mut block, CONDITION_BITS, bits);
            write_crc(&mut block, CONDITIONS_DATA_ID);
        }
        block
    }

    // On a board it is to be small, independent of the caller.
    #[inline(never)]
    /// Returns what the registers say, their protection aside; `None`: a bit or a direction without meaning, or
    /// an angle beyond what a number holds.
    fn decode(block: &HoldingRegisters) -> Option<Self> {
        let (control, present) = (read_u16(block, CONTROL), read_u16(block, PRESENT));
        let directions = read_u16(block, DIRECTIONS);
        let has_unknown = control & !CONTROL_MASK | present & !PRESENT_MASK;
        if has_unknown != 0 || directions & !0x3F != 0 {
            return None;
        }
        let bit = |n: u16| control & 1 << n != 0;
        let mut positions = [None; 3];
        let places = [POSITION_X, POSITION_Y, POSITION_Z].into_iter().zip(LinearAxis::ALL);
        for (n, ((place, axis), position)) in (0_u16..).zip(places.zip(&mut positions)) {
            let direction = match directions >> n.saturating_mul(2) & 3 {
                0 => TravelDirection::Standing,
                1 => TravelDirection::Positive,
                3 => TravelDirection::Negative,
                _ => return None,
            };
            let at = AxisPosition { axis, position: Position(read_i32(block, place)), direction };
            *position = (present & 1 << n != 0).then_some(at);
        }
        let angle = |place| read_i32(block, place).checked_mul(MICRO_DEGREES_PER_BIT);
        let rotary = if present & ROTARY_PRESENT == 0 {
            None
        } else {
            Some(RotaryAxisAngles { angles: [angle(ANGLE_1)?, angle(ANGLE_2)?].map(MicroDegrees) })
        };
        let spindle = SpindleState {
            speed: Rpm(read_u16(block, SPEED)),
            load_n: read_u16(block, LOAD).cast_signed(),
        };
        let conditions = MachineConditions {
            tool: read_u16(block, TOOL),
            bits: read_u16(block, CONDITION_BITS),
        };
        Some(Self {
            control: Control {
                engage: bit(0),
                referenced: bit(1),
                zero: bit(2),
                service: bit(3),
                confirm: bit(4),
                ..Control::default()
            },
            positions,
            rotary,
            spindle: (present & SPINDLE_PRESENT != 0).then_some(spindle),
            conditions: (present & CONDITIONS_PRESENT != 0).then_some(conditions),
        })
    }
}

/// Why a block must not be used. The numbers are those of `LastRefused`, and of `Status` on CAN.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[repr(u16)]
pub enum BlockRejectReason {
    /// A value in it has no meaning.
    #[error("a value without meaning")]
    Malformed = 1,
    /// Its CRC is wrong: damaged, half old, or meant for elsewhere.
    #[error("the CRC is wrong")]
    Damaged = 2,
    /// It has the counter of the block before.
    #[error("the counter is repeated")]
    Repeated = 3,
    /// Its counter has moved by more than 15.
    #[error("the counter is out of sequence")]
    WrongSequence = 4,
}

/// A block, with what it says apart from the blocks before it: what takes time is done once, before it is taken.
#[derive(Clone, Copy, Debug)]
pub struct HoldingBlock {
    registers: HoldingRegisters,
    /// [`BlockRejectReason::Damaged`] or [`BlockRejectReason::Malformed`] where it says nothing.
    decoded: Result<CncData, BlockRejectReason>,
}

impl HoldingBlock {
    /// Returns a block with its CRCs checked and its values decoded.
    #[must_use]
    pub fn from_registers(registers: &HoldingRegisters) -> Self {
        let cnc_data = if has_valid_crcs(registers) {
            CncData::decode(registers).ok_or(BlockRejectReason::Malformed)
        } else {
            Err(BlockRejectReason::Damaged)
        };
        Self { registers: *registers, decoded: cnc_data }
    }

    /// Returns the registers.
    #[must_use]
    pub const fn registers(&self) -> &HoldingRegisters {
        &self.registers
    }

    /// Returns whether its CRCs are right.
    #[must_use]
    pub fn has_valid_crc(&self) -> bool {
        self.decoded != Err(BlockRejectReason::Damaged)
    }

    /// Returns the commands that it holds next to `Control`, at most six, in the order of their registers.
    pub fn commands(&self) -> impl Iterator<Item = CncMessage> + use<> {
        let cnc_data = self.decoded.unwrap_or_default();
        let positions = cnc_data.positions.into_iter().flatten().map(CncMessage::Position);
        let rotary = cnc_data.rotary.map(CncMessage::Rotary);
        let spindle = cnc_data.spindle.map(CncMessage::Spindle);
        let conditions = cnc_data.conditions.map(CncMessage::Conditions);
        positions.chain(rotary).chain(spindle).chain(conditions)
    }
}

/// Checks the blocks of one master, one after the other.
#[derive(Clone, Copy, Debug, Default)]
pub struct HoldingBlockChecker {
    last: Option<u16>,
}

impl HoldingBlockChecker {
    /// Returns what this block says, if it is to be used. The first whole block sets the counter.
    ///
    /// # Errors
    /// The block must not be used. After [`BlockRejectReason::WrongSequence`] the next in order is taken.
    pub fn accept(&mut self, registers: &HoldingRegisters) -> Result<CncData, BlockRejectReason> {
        let block = HoldingBlock::from_registers(registers);
        self.accept_block(&block).copied()
    }

    /// As [`Self::accept`], of a block that was examined before.
    ///
    /// # Errors
    /// As there.
    pub fn accept_block<'b>(
        &mut self,
        block: &'b HoldingBlock,
    ) -> Result<&'b CncData, BlockRejectReason> {
        if !block.has_valid_crc() {
            return Err(BlockRejectReason::Damaged);
        }
        let counter = read_u16(&block.registers, CNC_COUNTER);
        if let Some(last) = self.last.replace(counter) {
            match counter.wrapping_sub(last) {
                0 => return Err(BlockRejectReason::Repeated),
                delta if delta > u16::from(MAX_DELTA_COUNTER) => {
                    return Err(BlockRejectReason::WrongSequence);
                }
                _ => {}
            }
        }
        block.decoded.as_ref().map_err(|refused| *refused)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded() -> CncData {
        let at = |axis, position, direction| {
            Some(AxisPosition { axis, position: Position(position), direction })
        };
        CncData {
            control: Control { zero: true, ..Control::ENGAGED },
            positions: [
                at(LinearAxis::X, -100_000, TravelDirection::Negative),
                None,
                at(LinearAxis::Z, 1, TravelDirection::Positive),
            ],
            rotary: Some(RotaryAxisAngles { angles: [30_000_000, -500].map(MicroDegrees) }),
            spindle: Some(SpindleState { speed: Rpm(24_000), load_n: -1 }),
            conditions: None,
        }
    }

    fn with_tool(tool: u16, bits: u16) -> CncData {
        CncData { conditions: Some(MachineConditions { tool, bits }), ..decoded() }
    }

    #[test]
    fn tool_and_conditions_stand_behind_the_block_with_a_crc_over_all() {
        let block = with_tool(17, 0x8002).encode(7);
        assert_eq!((block[2], block[17], block[18]), (0b11_1101, 17, 0x8002));
        assert_eq!(block[3..16], decoded().encode(7)[3..16]);
        let crc = |covered: &[u16], id| crate::e2e::compute_block_crc(covered, id);
        assert_eq!([block[16], block[19]], [crc(&block[..16], 0x302), crc(&block[..19], 0x402)]);
        assert_eq!(HoldingBlockChecker::default().accept(&block), Ok(with_tool(17, 0x8002)));
        assert_eq!(
            (registers_to_write(&block).len(), registers_to_write(&decoded().encode(7)).len()),
            (20, 17)
        );
    }

    #[test]
    fn half_old_tool_and_conditions_are_refused_and_those_that_are_not_meant_are_not_looked_at() {
        let mut block = with_tool(17, 2).encode(8);
        for (place, old) in [(17, 3), (18, 0), (19, 0), (14, 0), (0, 7)] {
            let before = std::mem::replace(&mut block[place], old);
            assert_eq!(
                HoldingBlockChecker::default().accept(&block),
                Err(BlockRejectReason::Damaged),
                "{place}"
            );
            block[place] = before;
        }
        // A block of before, of 17 registers, with a bit of `Present` that meant nothing then.
        block[17..].fill(0);
        assert_eq!(HoldingBlockChecker::default().accept(&block), Err(BlockRejectReason::Damaged));
        let mut block = decoded().encode(8);
        block[17..].fill(0xABCD);
        assert_eq!(HoldingBlockChecker::default().accept(&block), Ok(decoded()));
    }

    #[test]
    fn the_registers_are_those_of_the_documentation() {
        let block = decoded().encode(7);
        let expected = [7, 0b111, 0b11101, 0b01_00_11, 0xFFFE, 0x7960, 0, 0, 0, 1];
        assert_eq!(block[..10], expected);
        assert_eq!(block[10..16], [0, 60_000, 0xFFFF, 0xFFFF, 24_000, 0xFFFF]);
        assert_eq!(HoldingBlockChecker::default().accept(&block), Ok(decoded()));
    }

    #[test]
    fn steps_of_the_counter_are_judged_as_on_can_across_its_wrap() {
        for last in [0, 1, 0xFFF0, 0xFFFF_u16] {
            for delta in [0, 1, 15, 16, 0x8000, 0xFFFF_u16] {
                let mut checker = HoldingBlockChecker::default();
                assert!(checker.accept(&decoded().encode(last)).is_ok());
                let counter = last.wrapping_add(delta);
                let expected = match delta {
                    0 => Err(BlockRejectReason::Repeated),
                    1..=15 => Ok(decoded()),
                    _ => Err(BlockRejectReason::WrongSequence),
                };
                assert_eq!(checker.accept(&decoded().encode(counter)), expected, "{last} {delta}");
                let next = counter.wrapping_add(1);
                assert_eq!(checker.accept(&decoded().encode(next)), Ok(decoded()));
            }
        }
    }

    #[test]
    fn what_has_no_meaning_is_refused_whole() {
        for (place, value) in [
            (CONTROL, 1 << 5),
            (PRESENT, 1 << 6),
            (DIRECTIONS, 2),
            (DIRECTIONS, 1 << 6),
            (ANGLE_1, 0x7FFF),
        ] {
            let mut block = decoded().encode(1);
            block[place] = value;
            assert_eq!(
                HoldingBlockChecker::default().accept(&block),
                Err(BlockRejectReason::Damaged)
            );
            write_crc(&mut block[..HOLDING_LEN], HOLDING_DATA_ID);
            assert_eq!(
                HoldingBlockChecker::default().accept(&block),
                Err(BlockRejectReason::Malformed),
                "{place}"
            );
        }
    }
}
