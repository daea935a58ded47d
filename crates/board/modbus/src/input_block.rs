//! The input block: what the bridge says, to and from registers.

use trueup_core::{
    cnc::{OffsetFlags, OffsetQuality, Output},
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    units::Nanometres,
};
use trueup_link::layout::NANOMETRES_PER_BIT;

use crate::{
    e2e::{has_valid_crc, read_i32, read_u16, write_crc, write_u16, write_u32},
    register_map::{
        AGE, CALIBRATION, COUNTER, ELONGATION, FLAGS, INPUT_DATA_ID, INPUT_LEN, LAST_REFUSED,
        LAYOUT, LAYOUT_VERSION, NOT_AVAILABLE, OFFSET_X, OFFSET_Y, OFFSET_Z, QUALITY, REFUSED,
        STATE, TEMPERATURE_0, TEMPERATURE_NOT_AVAILABLE,
    },
};

/// The block as it stands in the registers.
pub type InputRegisters = [u16; INPUT_LEN];

/// Data that a PLC reads from the bridge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InputBlock {
    /// One more with each new content.
    pub counter: u16,
    /// Offsets, how good they are and why.
    pub output: Output,
    /// Milliseconds since the sample that they rest on.
    pub age_ms: u16,
    /// The number of the reason why a holding block was last refused; 0: none was.
    pub last_refused: u16,
    /// Holding blocks that were refused.
    pub refused: u16,
    /// State bits of the bridge.
    pub state: u32,
    /// CRC of the calibration that the bridge runs on; 0: none, or not known.
    pub calibration: u32,
    /// Elongation of the spindle by its sensor; `None`: not available.
    pub elongation: Option<Nanometres>,
    /// Temperatures by channel in 0.01 °C; `None`: not available.
    pub centi_c: [Option<i16>; TEMPERATURE_CHANNEL_COUNT],
}

impl InputBlock {
    /// Returns the registers. Offsets are rounded to 10 nm, halves away from zero.
    #[must_use]
    pub fn encode(&self) -> InputRegisters {
        let mut block = [0; INPUT_LEN];
        write_u16(&mut block, LAYOUT, LAYOUT_VERSION);
        write_u16(&mut block, COUNTER, self.counter);
        for (axis, place) in [OFFSET_X, OFFSET_Y, OFFSET_Z].into_iter().enumerate() {
            let offset = self.output.offset.and_then(|offset| offset.get(axis).copied());
            write_u32(
                &mut block,
                place,
                offset.map_or(NOT_AVAILABLE, offset_to_raw).cast_unsigned(),
            );
        }
        write_u16(&mut block, QUALITY, u16::from(self.output.quality as u8));
        write_u16(&mut block, FLAGS, self.output.flags.0.into());
        write_u16(&mut block, AGE, self.age_ms);
        write_u16(&mut block, LAST_REFUSED, self.last_refused);
        write_u16(&mut block, REFUSED, self.refused);
        write_u32(&mut block, STATE, self.state);
        write_u32(&mut block, CALIBRATION, self.calibration);
        let elongation = self.elongation.map_or(NOT_AVAILABLE, |elongation| elongation.0);
        write_u32(&mut block, ELONGATION, elongation.cast_unsigned());
        for (place, centi_c) in (TEMPERATURE_0..).zip(self.centi_c) {
            write_u16(
                &mut block,
                place,
                centi_c.unwrap_or(TEMPERATURE_NOT_AVAILABLE).cast_unsigned(),
            );
        }
        write_crc(&mut block, INPUT_DATA_ID);
        block
    }

    /// Returns what the registers say; `None`: half old, damaged, of another layout, or without meaning. An
    /// offset is available on three axes or on none.
    #[must_use]
    pub fn decode(block: &InputRegisters) -> Option<Self> {
        if !has_valid_crc(block, INPUT_DATA_ID) || read_u16(block, LAYOUT) != LAYOUT_VERSION {
            return None;
        }
        let offset = [OFFSET_X, OFFSET_Y, OFFSET_Z].map(|place| read_i32(block, place));
        let is_available = offset.iter().all(|raw| *raw != NOT_AVAILABLE);
        let nanometres = |raw: i32| Nanometres(raw.saturating_mul(NANOMETRES_PER_BIT));
        let elongation = read_i32(block, ELONGATION);
        let mut centi_c = [None; TEMPERATURE_CHANNEL_COUNT];
        for (place, centi_c) in (TEMPERATURE_0..).zip(&mut centi_c) {
            let raw = read_u16(block, place).cast_signed();
            *centi_c = (raw != TEMPERATURE_NOT_AVAILABLE).then_some(raw);
        }
        let age_ms = read_u16(block, AGE);
        Some(Self {
            counter: read_u16(block, COUNTER),
            output: Output {
                offset: is_available.then_some(offset.map(nanometres)),
                quality: OffsetQuality::from_wire(u8::try_from(read_u16(block, QUALITY)).ok()?)?,
                flags: OffsetFlags(u8::try_from(read_u16(block, FLAGS)).ok()?),
                age_ms: u8::try_from(age_ms).unwrap_or(u8::MAX),
            },
            age_ms,
            last_refused: read_u16(block, LAST_REFUSED),
            refused: read_u16(block, REFUSED),
            state: read_i32(block, STATE).cast_unsigned(),
            calibration: read_i32(block, CALIBRATION).cast_unsigned(),
            elongation: (elongation != NOT_AVAILABLE).then_some(Nanometres(elongation)),
            centi_c,
        })
    }
}

/// 10 nm a bit, halves away from zero.
fn offset_to_raw(offset: Nanometres) -> i32 {
    let half = NANOMETRES_PER_BIT.wrapping_div(2).saturating_mul(offset.0.signum());
    offset.0.saturating_add(half).wrapping_div(NANOMETRES_PER_BIT)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample_block() -> InputBlock {
        InputBlock {
            counter: 0xFFFE,
            output: Output {
                offset: Some([1_000, -2_000, 62_810].map(Nanometres)),
                quality: OffsetQuality::Live,
                flags: OffsetFlags::SLEWING,
                age_ms: 3,
            },
            age_ms: 3,
            last_refused: 4,
            refused: 65_535,
            state: 0x8000_0001,
            calibration: 0xF4AC_FB13,
            elongation: Some(Nanometres(-5)),
            centi_c: [Some(2_345), None, Some(-50), None, None, None, None, Some(i16::MAX)],
        }
    }

    #[test]
    fn the_registers_are_those_of_the_documentation() {
        let block = sample_block().encode();
        assert_eq!(block[..12], [1, 0xFFFE, 0, 100, 0xFFFF, 0xFF38, 0, 6_281, 1, 2, 3, 4]);
        assert_eq!(block[12..19], [65_535, 0x8000, 1, 0xF4AC, 0xFB13, 0xFFFF, 0xFFFB]);
        assert_eq!(block[19..23], [2_345, 0x8000, 0xFFCE, 0x8000]);
        assert_eq!(InputBlock::decode(&block), Some(sample_block()));
    }

    #[test]
    fn what_is_not_available_is_so_on_all_axes_and_no_number() {
        let block = InputBlock { elongation: None, ..InputBlock::default() }.encode();
        assert_eq!(block[2..8], [0x8000, 0, 0x8000, 0, 0x8000, 0]);
        let mut one = sample_block().encode();
        one[4..6].copy_from_slice(&[0x8000, 0]);
        write_crc(&mut one, INPUT_DATA_ID);
        assert_eq!(InputBlock::decode(&one).map(|input| input.output.offset), Some(None));
    }

    #[test]
    fn a_block_half_of_one_and_half_of_the_next_is_none() {
        let mut next = sample_block();
        next.counter = 0xFFFF;
        next.output.offset = Some([1_010, -2_010, 62_820].map(Nanometres));
        let (old, new) = (sample_block().encode(), next.encode());
        for split in 1..INPUT_LEN {
            let mut mixed = old;
            mixed[split..].copy_from_slice(&new[split..]);
            let is_one_of_them = mixed == old || mixed == new;
            assert_eq!(InputBlock::decode(&mixed).is_some(), is_one_of_them, "split at {split}");
        }
    }

    #[test]
    fn another_layout_and_a_quality_without_meaning_are_refused() {
        for (place, value) in [(LAYOUT, 2), (QUALITY, 7), (QUALITY, 0x101), (FLAGS, 0x100)] {
            let mut block = sample_block().encode();
            block[place] = value;
            write_crc(&mut block, INPUT_DATA_ID);
            assert_eq!(InputBlock::decode(&block), None, "{place} {value}");
        }
    }
}
