//! The protection of a block: AUTOSAR E2E profile 5 as on CAN, over registers.
//!
//! ```text
//! Crc = CRC-16 (polynomial 0x1021, start 0xFFFF, not reflected, no final XOR)
//!       over the registers before it, each with its high byte first as on the wire,
//!       then the data ID's low byte, then its high byte
//! ```
//!
//! The counter is a register of its own. The data ID distinguishes an input block from a holding block, so
//! that neither passes for the other.

use trueup_link::e2e::compute_crc;

/// Returns the CRC of these registers under this data ID.
///
/// ```
/// // Over the bytes 31 32 33 34 35 36 37 38, then 00 and 39: not the check value of
/// // "123456789" (0x29B1), because a data ID has two bytes.
/// let words = [0x3132, 0x3334, 0x3536, 0x3738];
/// assert_eq!(trueup_modbus::e2e::compute_block_crc(&words, 0x3900), 0x1C3C);
/// ```
#[must_use]
pub fn compute_block_crc(registers: &[u16], data_id: u16) -> u16 {
    compute_crc(data_id, registers.iter().map(|register| register.to_be_bytes()))
}

/// Puts the CRC into the last register of a block.
pub(crate) fn write_crc(block: &mut [u16], data_id: u16) {
    if let [covered @ .., place] = block {
        *place = compute_block_crc(covered, data_id);
    }
}

/// Returns whether the last register of a block is its CRC.
#[must_use]
pub fn has_valid_crc(block: &[u16], data_id: u16) -> bool {
    matches!(block, [covered @ .., last] if compute_block_crc(covered, data_id) == *last)
}

/// Puts a number of two registers into a block, the high one first.
pub(crate) fn write_u32(block: &mut [u16], address: usize, value: u32) {
    let [a, b, c, d] = value.to_be_bytes();
    let words = [u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d])];
    block.iter_mut().skip(address).zip(words).for_each(|(place, word)| *place = word);
}

/// Puts a number of one register into a block.
pub(crate) fn write_u16(block: &mut [u16], address: usize, value: u16) {
    if let Some(place) = block.get_mut(address) {
        *place = value;
    }
}

/// Returns the register at an address; 0 behind the block.
pub(crate) fn read_u16(block: &[u16], address: usize) -> u16 {
    block.get(address).copied().unwrap_or(0)
}

/// Returns the number in two registers, the high one first.
pub(crate) fn read_i32(block: &[u16], address: usize) -> i32 {
    let [a, b] = read_u16(block, address).to_be_bytes();
    let [c, d] = read_u16(block, address.saturating_add(1)).to_be_bytes();
    i32::from_be_bytes([a, b, c, d])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_single_and_double_bit_error_is_found() {
        let mut block = [0x1234, 0, 0xFFFF, 7, 0x8000, 0];
        write_crc(&mut block, 0x0181);
        assert!(has_valid_crc(&block, 0x0181) && !has_valid_crc(&block, 0x0302));
        let flip = |block: &mut [u16; 6], bit: usize| block[bit / 16] ^= 1 << (bit % 16);
        for first in 0..96 {
            for second in first..96 {
                let mut bad = block;
                flip(&mut bad, first);
                assert!(!has_valid_crc(&bad, 0x0181));
                if second != first {
                    flip(&mut bad, second);
                    assert!(!has_valid_crc(&bad, 0x0181), "{first} {second}");
                }
            }
        }
    }

    #[test]
    fn nothing_is_no_block() {
        assert!(!has_valid_crc(&[], 0x0181));
    }

    #[test]
    fn a_long_keeps_its_sign_and_its_place() {
        let mut block = [0; 4];
        for value in [0, 1, -1, i32::MIN, i32::MAX, 0x1234_5678] {
            write_u32(&mut block, 1, value.cast_unsigned());
            assert_eq!(read_i32(&block, 1), value);
        }
        assert_eq!(block, [0, 0x1234, 0x5678, 0]);
        write_u32(&mut block, 3, 0xAAAA_BBBB);
        write_u32(&mut block, 9, 1);
        assert_eq!((block[3], read_i32(&block, 9)), (0xAAAA, 0), "what is behind it is left out");
    }
}
