//! The input block: what the bridge says, to and from registers.

use trueup_core::{
    cnc::{Flags, Output, Quality},
    dimensions::CHANNELS,
    units::Nanometres,
};
use trueup_link::layout::NANOMETRES_PER_BIT;

use crate::{
    protect::{get, get_long, is_whole, put, put_long, seal},
    table::{
        AGE, CALIBRATION, COUNTER, ELONGATION, FLAGS, INPUT_DATA_ID, INPUT_LEN, LAST_REFUSED,
        LAYOUT, LAYOUT_NUMBER, NO_TEMPERATURE, NOT_AVAILABLE, OFFSET_X, OFFSET_Y, OFFSET_Z,
        QUALITY, REFUSED, STATE, TEMPERATURE_0,
    },
};

/// The block as it stands in the registers.
pub type Registers = [u16; INPUT_LEN];

/// Data that a PLC reads from the bridge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Input {
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
    pub centi_c: [Option<i16>; CHANNELS],
}

impl Input {
    /// Returns the registers. Offsets are rounded to 10 nm, halves away from zero.
    #[must_use]
    pub fn encode(&self) -> Registers {
        let mut block = [0; INPUT_LEN];
        put(&mut block, LAYOUT, LAYOUT_NUMBER);
        put(&mut block, COUNTER, self.counter);
        for (axis, place) in [OFFSET_X, OFFSET_Y, OFFSET_Z].into_iter().enumerate() {
            let offset = self.output.offset.and_then(|offset| offset.get(axis).copied());
            put_long(&mut block, place, offset.map_or(NOT_AVAILABLE, bits).cast_unsigned());
        }
        put(&mut block, QUALITY, u16::from(self.output.quality as u8));
        put(&mut block, FLAGS, self.output.flags.0.into());
        put(&mut block, AGE, self.age_ms);
        put(&mut block, LAST_REFUSED, self.last_refused);
        put(&mut block, REFUSED, self.refused);
        put_long(&mut block, STATE, self.state);
        put_long(&mut block, CALIBRATION, self.calibration);
        let elongation = self.elongation.map_or(NOT_AVAILABLE, |it| it.0);
        put_long(&mut block, ELONGATION, elongation.cast_unsigned());
        for (place, centi_c) in (TEMPERATURE_0..).zip(self.centi_c) {
            put(&mut block, place, centi_c.unwrap_or(NO_TEMPERATURE).cast_unsigned());
        }
        seal(&mut block, INPUT_DATA_ID);
        block
    }

    /// Returns what the registers say; `None`: half old, damaged, of another layout, or without meaning. An
    /// offset is available on three axes or on none.
    #[must_use]
    pub fn decode(block: &Registers) -> Option<Self> {
        if !is_whole(block, INPUT_DATA_ID) || get(block, LAYOUT) != LAYOUT_NUMBER {
            return None;
        }
        let offset = [OFFSET_X, OFFSET_Y, OFFSET_Z].map(|place| get_long(block, place));
        let is_available = offset.iter().all(|raw| *raw != NOT_AVAILABLE);
        let nanometres = |raw: i32| Nanometres(raw.saturating_mul(NANOMETRES_PER_BIT));
        let elongation = get_long(block, ELONGATION);
        let mut centi_c = [None; CHANNELS];
        for (place, centi_c) in (TEMPERATURE_0..).zip(&mut centi_c) {
            let raw = get(block, place).cast_signed();
            *centi_c = (raw != NO_TEMPERATURE).then_some(raw);
        }
        let age_ms = get(block, AGE);
        Some(Self {
            counter: get(block, COUNTER),
            output: Output {
                offset: is_available.then_some(offset.map(nanometres)),
                quality: Quality::from_wire(u8::try_from(get(block, QUALITY)).ok()?)?,
                flags: Flags(u8::try_from(get(block, FLAGS)).ok()?),
                age_ms: u8::try_from(age_ms).unwrap_or(u8::MAX),
            },
            age_ms,
            last_refused: get(block, LAST_REFUSED),
            refused: get(block, REFUSED),
            state: get_long(block, STATE).cast_unsigned(),
            calibration: get_long(block, CALIBRATION).cast_unsigned(),
            elongation: (elongation != NOT_AVAILABLE).then_some(Nanometres(elongation)),
            centi_c,
        })
    }
}

/// 10 nm a bit, halves away from zero.
fn bits(offset: Nanometres) -> i32 {
    let half = NANOMETRES_PER_BIT.wrapping_div(2).saturating_mul(offset.0.signum());
    offset.0.saturating_add(half).wrapping_div(NANOMETRES_PER_BIT)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said() -> Input {
        Input {
            counter: 0xFFFE,
            output: Output {
                offset: Some([1_000, -2_000, 62_810].map(Nanometres)),
                quality: Quality::Live,
                flags: Flags::SLEWING,
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
        let block = said().encode();
        assert_eq!(block[..12], [1, 0xFFFE, 0, 100, 0xFFFF, 0xFF38, 0, 6_281, 1, 2, 3, 4]);
        assert_eq!(block[12..19], [65_535, 0x8000, 1, 0xF4AC, 0xFB13, 0xFFFF, 0xFFFB]);
        assert_eq!(block[19..23], [2_345, 0x8000, 0xFFCE, 0x8000]);
        assert_eq!(Input::decode(&block), Some(said()));
    }

    #[test]
    fn what_is_not_available_is_so_on_all_axes_and_no_number() {
        let block = Input { elongation: None, ..Input::default() }.encode();
        assert_eq!(block[2..8], [0x8000, 0, 0x8000, 0, 0x8000, 0]);
        let mut one = said().encode();
        one[4..6].copy_from_slice(&[0x8000, 0]);
        seal(&mut one, INPUT_DATA_ID);
        assert_eq!(Input::decode(&one).map(|input| input.output.offset), Some(None));
    }

    #[test]
    fn a_block_half_of_one_and_half_of_the_next_is_none() {
        let mut next = said();
        next.counter = 0xFFFF;
        next.output.offset = Some([1_010, -2_010, 62_820].map(Nanometres));
        let (old, new) = (said().encode(), next.encode());
        for split in 1..INPUT_LEN {
            let mut mixed = old;
            mixed[split..].copy_from_slice(&new[split..]);
            let is_one_of_them = mixed == old || mixed == new;
            assert_eq!(Input::decode(&mixed).is_some(), is_one_of_them, "split at {split}");
        }
    }

    #[test]
    fn another_layout_and_a_quality_without_meaning_are_refused() {
        for (place, value) in [(LAYOUT, 2), (QUALITY, 7), (QUALITY, 0x101), (FLAGS, 0x100)] {
            let mut block = said().encode();
            block[place] = value;
            seal(&mut block, INPUT_DATA_ID);
            assert_eq!(Input::decode(&block), None, "{place} {value}");
        }
    }
}
