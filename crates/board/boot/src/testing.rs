//! A board of tests: both flashes behind one supply, images, and a key that costs no time.
//!
//! The signature of these tests is a checksum: they are about the order of the steps, not about cryptography.

use core::cell::Cell;
use std::{rc::Rc, vec::Vec};

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use trueup_store::simulated_nor_flash::SimulatedNorFlash;

use crate::{
    boot_state::JOURNAL_ENTRY_SIZE,
    crc,
    flash_layout::Slot,
    image_check::VerifyingKey,
    image_header::{FirmwareVersion, HEADER_SIZE, ImageHeader, SIGNATURE_SIZE},
    journal::Journal,
};

/// Bytes of a sector of the records: room for four states.
pub const TEST_JOURNAL_SECTOR_BYTES: usize = 8 * JOURNAL_ENTRY_SIZE;
/// Bytes of a slot.
pub(crate) const TEST_SLOT_BYTES: usize = HEADER_SIZE + 128;

/// The supply of both flashes: bytes that can still be written or erased, and whether it is off.
#[derive(Clone, Debug, Default)]
pub struct PowerSupply {
    fuel: Rc<Cell<usize>>,
    off: Rc<Cell<bool>>,
}

impl PowerSupply {
    /// Returns one that lasts for this many bytes.
    pub(crate) fn with_byte_budget(fuel: usize) -> Self {
        let supply = Self::default();
        supply.fuel.set(fuel);
        supply
    }

    /// Returns whether it was cut.
    pub fn is_off(&self) -> bool {
        self.off.get()
    }

    /// Returns how many bytes it still lasts for.
    pub(crate) fn remaining_bytes(&self) -> usize {
        self.fuel.get()
    }
}

/// A flash at a supply.
#[derive(Debug)]
pub(crate) struct PoweredFlash<const SECTOR: usize> {
    pub flash: SimulatedNorFlash<SECTOR>,
    pub supply: PowerSupply,
}

impl<const SECTOR: usize> PoweredFlash<SECTOR> {
    pub fn new(flash: &SimulatedNorFlash<SECTOR>, supply: &PowerSupply) -> Self {
        Self { flash: flash.with_power_restored(), supply: supply.clone() }
    }

    fn run_powered(
        &mut self,
        work: impl FnOnce(&mut SimulatedNorFlash<SECTOR>) -> Result<(), NorFlashErrorKind>,
    ) -> Result<(), NorFlashErrorKind> {
        if self.supply.is_off() {
            return Err(NorFlashErrorKind::Other);
        }
        self.flash.fuel = self.supply.fuel.get();
        let result = work(&mut self.flash);
        self.supply.fuel.set(self.flash.fuel);
        self.supply.off.set(self.flash.off);
        result
    }
}

impl<const SECTOR: usize> ErrorType for PoweredFlash<SECTOR> {
    type Error = NorFlashErrorKind;
}

impl<const SECTOR: usize> ReadNorFlash for PoweredFlash<SECTOR> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        self.flash.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.flash.capacity()
    }
}

impl<const SECTOR: usize> NorFlash for PoweredFlash<SECTOR> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.run_powered(|flash| flash.erase(from, to))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        self.run_powered(|flash| flash.write(offset, bytes))
    }
}

/// A key whose signatures are checksums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TestKey(pub u32);

impl TestKey {
    fn sign(self, message: &[u8]) -> [u8; SIGNATURE_SIZE] {
        let crc = self.0 ^ crc::checksum(message);
        core::array::from_fn(|n| crc.to_le_bytes()[n % 4])
    }
}

impl VerifyingKey for TestKey {
    fn verify(&self, message: &[u8], signature: &[u8; SIGNATURE_SIZE]) -> bool {
        self.sign(message) == *signature
    }
}

/// The key of these boards.
pub(crate) const TEST_KEY: TestKey = TestKey(7);

/// Returns the file of an image of this version, signed.
pub(crate) fn signed_image(slot: Slot, version: u8, floor: u8) -> Vec<u8> {
    image_signed_by(TEST_KEY, slot, version, floor)
}

/// As [`image`], by another key.
pub(crate) fn image_signed_by(key: TestKey, slot: Slot, version: u8, floor: u8) -> Vec<u8> {
    let body: Vec<u8> =
        (0..64).map(|n: u8| n.wrapping_mul(version).wrapping_add(slot.number())).collect();
    let [version, floor] = [version, floor].map(|minor| FirmwareVersion::new(0, minor, 0, 0));
    let mut header = ImageHeader::new_unsigned(&body, slot, version, floor);
    header.signature = key.sign(ImageHeader::signed_bytes(&header.encode()));
    let mut file = header.encode().to_vec();
    file.extend(body);
    file
}

/// Writes a file as a probe does.
pub(crate) fn flash_by_probe(
    slots: &mut SimulatedNorFlash<TEST_SLOT_BYTES>,
    slot: Slot,
    file: &[u8],
) {
    let start = usize::from(slot.number()) * TEST_SLOT_BYTES;
    slots.bytes[start..start + TEST_SLOT_BYTES].fill(0xFF);
    slots.bytes[start..start + file.len()].copy_from_slice(file);
}

/// Runs work with both flashes at a supply.
pub(crate) fn with_supply<T>(
    records: &mut SimulatedNorFlash<TEST_JOURNAL_SECTOR_BYTES>,
    slots: &mut SimulatedNorFlash<TEST_SLOT_BYTES>,
    supply: &PowerSupply,
    work: impl FnOnce(
        &mut Journal<PoweredFlash<TEST_JOURNAL_SECTOR_BYTES>>,
        &mut PoweredFlash<TEST_SLOT_BYTES>,
    ) -> T,
) -> T {
    let mut both =
        (Journal::open(PoweredFlash::new(records, supply)), PoweredFlash::new(slots, supply));
    let result = work(&mut both.0, &mut both.1);
    (*records, *slots) = (both.0.into_flash().flash, both.1.flash);
    result
}
