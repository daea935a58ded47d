//! The number that distinguishes this chip from every other: 96 bits that the factory wrote (section 39.1).

use core::ptr;

use stm32f4xx_hal::pac::DBGMCU;

/// Where they are: the place on the wafer, the wafer, and the lot.
const UNIQUE_ID_ADDRESS: *const u8 = 0x1FFF_7A10 as *const u8;

/// Returns the chip's number, lowest byte first.
#[allow(unsafe_code, reason = "bytes of the system memory")]
fn read_unique_id() -> [u8; 12] {
    // SAFETY: twelve bytes that every chip of this kind has, and that never change.
    core::array::from_fn(|n| unsafe { ptr::read_volatile(UNIQUE_ID_ADDRESS.add(n)) })
}

/// Returns the chip's number, the lowest word first; 1 in an emulator without a device code.
pub fn unique_id_words(dbgmcu: &DBGMCU) -> [u32; 3] {
    if dbgmcu.idcode().read().bits() == 0 {
        return [1, 0, 0];
    }
    let mut words = [0; 3];
    for (word, bytes) in words.iter_mut().zip(read_unique_id().as_chunks().0) {
        *word = u32::from_le_bytes(*bytes);
    }
    words
}

/// Its hash, FNV-1a over 32 bits, for CANopen's serial number; 1 in an emulator without a device code,
/// which has no system memory either, where the number would stand.
pub fn hashed_serial_number(dbgmcu: &DBGMCU) -> u32 {
    if dbgmcu.idcode().read().bits() == 0 {
        return 1;
    }
    read_unique_id()
        .into_iter()
        .fold(0x811C_9DC5, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193))
}
