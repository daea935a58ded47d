//! The number that tells this chip from every other: 96 bits that the factory wrote (section 39.1).

use core::ptr;

use stm32f4xx_hal::pac::DBGMCU;

/// Where they are: the place on the wafer, the wafer, and the lot.
const UNIQUE: *const u8 = 0x1FFF_7A10 as *const u8;

/// The chip's number, lowest byte first.
#[allow(unsafe_code, reason = "bytes of the system memory")]
fn unique() -> [u8; 12] {
    // SAFETY: twelve bytes that every chip of this kind has, and that never change.
    core::array::from_fn(|n| unsafe { ptr::read_volatile(UNIQUE.add(n)) })
}

/// The chip's number, the lowest word first; 1 in an emulator without a device code.
pub fn words(dbgmcu: &DBGMCU) -> [u32; 3] {
    if dbgmcu.idcode().read().bits() == 0 {
        return [1, 0, 0];
    }
    let mut words = [0; 3];
    for (word, bytes) in words.iter_mut().zip(unique().as_chunks().0) {
        *word = u32::from_le_bytes(*bytes);
    }
    words
}

/// Its hash, for people and for `N` on the serial line: FNV-1a over 32 bits, folded to 16. Two boards
/// of a shop have the same one once in 65 536 pairs.
///
/// An emulator without a device code has no system memory either, where the number would stand: 1.
pub fn short(dbgmcu: &DBGMCU) -> u16 {
    if dbgmcu.idcode().read().bits() == 0 {
        return 1;
    }
    let hash = unique()
        .into_iter()
        .fold(0x811C_9DC5_u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    (hash >> 16) as u16 ^ hash as u16
}
