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

use trueup_core::{bridge::UNIT_NM, units::Nanometres};

use crate::{
    input::{Input, Registers},
    protect::{put, seal},
    table::{INPUT_DATA_ID, INPUT_LEN, LAYOUT},
};

/// Registers of the block.
pub const LEN: usize = INPUT_LEN + 4;
/// The number of this layout.
pub(crate) const LAYOUT_WITH_SLOPES: u16 = 2;
/// The data ID of the CRC over all of it.
pub(crate) const DATA_ID: u16 = 0x0381;

/// K₀ in 0.1 µm and the slope in 0.1 µm/m of an axis.
pub type Part = (i16, i16);

/// Returns the block. Without parts, or where `input` has no offset, there is none in it either.
///
/// ```
/// use trueup_core::{cnc::{Output, Quality}, units::Nanometres};
/// use trueup_modbus::{input::Input, slopes};
/// let offset = Some([Nanometres(-39_000), Nanometres(0), Nanometres(0)]);
/// let input = Input { output: Output { offset, quality: Quality::Live, ..Output::default() }, ..Input::default() };
/// // An axis at 1 m: -12.0 µm and -27.0 µm/m.
/// let block = slopes::encode(&input, Some([(-120, -270), (0, 0), (0, 0)]));
/// assert_eq!((block[0], block[2], block[3]), (2, 0xFFFF, 0xFB50)); // -1200 of 0.01 µm
/// assert_eq!(block[28].cast_signed(), -270);
/// ```
#[must_use]
pub fn encode(input: &Input, parts: Option<[Part; 3]>) -> [u16; LEN] {
    let mut said = *input;
    let parts = parts.filter(|_| said.output.offset.is_some());
    said.output.offset = parts.map(|parts| {
        parts.map(|(constant, _)| Nanometres(i32::from(constant).wrapping_mul(UNIT_NM)))
    });
    let mut first: Registers = said.encode();
    put(&mut first, LAYOUT, LAYOUT_WITH_SLOPES);
    seal(&mut first, INPUT_DATA_ID);
    let mut block = [0; LEN];
    let slopes = parts.unwrap_or_default().map(|(_, slope)| slope.cast_unsigned());
    block.iter_mut().zip(first.into_iter().chain(slopes)).for_each(|(place, word)| *place = word);
    seal(&mut block, DATA_ID);
    block
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{protect::is_whole, table::NOT_AVAILABLE};
    use trueup_core::cnc::Output;

    #[test]
    fn both_crcs_hold_and_a_program_without_slopes_refuses_it() {
        let offset = Some([Nanometres(1); 3]);
        let input = Input { output: Output { offset, ..Output::default() }, ..Input::default() };
        let block = encode(&input, Some([(1, 2); 3]));
        assert!(is_whole(&block, DATA_ID) && is_whole(&block[..INPUT_LEN], INPUT_DATA_ID));
        let first: Registers = block[..INPUT_LEN].try_into().expect("that long");
        assert_eq!(Input::decode(&first), None);
    }

    #[test]
    fn without_parts_nothing_is_available() {
        let offset = Some([Nanometres(1); 3]);
        let input = Input { output: Output { offset, ..Output::default() }, ..Input::default() };
        let nothing = Input::default();
        for block in [encode(&input, None), encode(&nothing, Some([(1, 2); 3]))] {
            let raw = crate::protect::get_long(&block, crate::table::OFFSET_X);
            assert_eq!((raw, &block[28..31]), (NOT_AVAILABLE, &[0, 0, 0][..]));
        }
    }
}
