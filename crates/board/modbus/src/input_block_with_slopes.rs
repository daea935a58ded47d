//! The input block of an S7 with slopes: for a control that multiplies by its own position.
//!
//! ```text
//! register  0 … 27   the input block of layout 2: in the place of the offset its constant, K₀
//!          28 … 30   slope of X, Y, Z as signed numbers of 0.1 µm/m
//!               31   CRC over all before it and the data ID 0x0381
//! ```
//!
//! The offset is K₀ + slope·(P − P₀), P₀ the `origin_mm` of the axis's thermal law. A program that does not know slopes
//! refuses layout 2, and does not take K₀ for the whole offset.

use trueup_core::{bridge::SLOPE_RESOLUTION_NM, units::Nanometres};

use crate::{
    e2e::{write_crc, write_u16},
    input_block::{InputBlock, InputRegisters},
    register_map::{INPUT_DATA_ID, INPUT_LEN, LAYOUT},
};

/// Registers of the block.
pub const INPUT_WITH_SLOPES_LEN: usize = INPUT_LEN + 4;
/// The number of this layout.
pub(crate) const LAYOUT_VERSION_WITH_SLOPES: u16 = 2;
/// The data ID of the CRC over all of it.
pub(crate) const INPUT_WITH_SLOPES_DATA_ID: u16 = 0x0381;

/// K₀ in 0.1 µm and the slope in 0.1 µm/m of an axis.
pub type LinearCoefficients = (i16, i16);

/// Returns the block. Without parts, or where `input` has no offset, there is none in it either.
///
/// ```
/// use trueup_core::{cnc::{Output, OffsetQuality}, units::Nanometres};
/// use trueup_modbus::{input_block::InputBlock, input_block_with_slopes};
/// let offset = Some([Nanometres(-39_000), Nanometres(0), Nanometres(0)]);
/// let input = InputBlock { output: Output { offset, quality: OffsetQuality::Live, ..Output::default() }, ..InputBlock::default() };
/// // An axis at 1 m: -12.0 µm and -27.0 µm/m.
/// let block = input_block_with_slopes::encode(&input, Some([(-120, -270), (0, 0), (0, 0)]));
/// assert_eq!((block[0], block[2], block[3]), (2, 0xFFFF, 0xFB50)); // -1200 of 0.01 µm
/// assert_eq!(block[28].cast_signed(), -270);
/// ```
#[must_use]
pub fn encode(
    input: &InputBlock,
    parts: Option<[LinearCoefficients; 3]>,
) -> [u16; INPUT_WITH_SLOPES_LEN] {
    let mut reported = *input;
    let parts = parts.filter(|_| reported.output.offset.is_some());
    reported.output.offset = parts.map(|parts| {
        parts.map(|(constant, _)| Nanometres(i32::from(constant).wrapping_mul(SLOPE_RESOLUTION_NM)))
    });
    let mut first: InputRegisters = reported.encode();
    write_u16(&mut first, LAYOUT, LAYOUT_VERSION_WITH_SLOPES);
    write_crc(&mut first, INPUT_DATA_ID);
    let mut block = [0; INPUT_WITH_SLOPES_LEN];
    let slopes = parts.unwrap_or_default().map(|(_, slope)| slope.cast_unsigned());
    block.iter_mut().zip(first.into_iter().chain(slopes)).for_each(|(place, word)| *place = word);
    write_crc(&mut block, INPUT_WITH_SLOPES_DATA_ID);
    block
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{e2e::has_valid_crc, register_map::NOT_AVAILABLE};
    use trueup_core::cnc::Output;

    #[test]
    fn both_crcs_hold_and_a_program_without_slopes_refuses_it() {
        let offset = Some([Nanometres(1); 3]);
        let input =
            InputBlock { output: Output { offset, ..Output::default() }, ..InputBlock::default() };
        let block = encode(&input, Some([(1, 2); 3]));
        assert!(
            has_valid_crc(&block, INPUT_WITH_SLOPES_DATA_ID)
                && has_valid_crc(&block[..INPUT_LEN], INPUT_DATA_ID)
        );
        let first: InputRegisters = block[..INPUT_LEN].try_into().expect("that long");
        assert_eq!(InputBlock::decode(&first), None);
    }

    #[test]
    fn without_parts_nothing_is_available() {
        let offset = Some([Nanometres(1); 3]);
        let input =
            InputBlock { output: Output { offset, ..Output::default() }, ..InputBlock::default() };
        let nothing = InputBlock::default();
        for block in [encode(&input, None), encode(&nothing, Some([(1, 2); 3]))] {
            let raw = crate::e2e::read_i32(&block, crate::register_map::OFFSET_X);
            assert_eq!((raw, &block[28..31]), (NOT_AVAILABLE, &[0, 0, 0][..]));
        }
    }
}
