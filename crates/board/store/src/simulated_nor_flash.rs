//! A flash for tests that forgives nothing, and whose power can be cut at any byte.
//!
//! A cut leaves behind other bits than the data sheet of a good cell says: bits that were on their way
//! from 1 to 0 may be read as either from then on, and differently each time, until the word is written
//! with a 0 there or its sector is erased. Bits of a sector whose erase was cut are undefined.

use core::cell::Cell;
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_read,
};
use std::{collections::BTreeMap, vec::Vec};

use crate::flash_log::WORD_SIZE;

/// This many bytes behind a cut in an erase are read differently twice.
const UNSTABLE_ERASE_BYTES: usize = 64;

/// A strict flash: a bit only goes from 1 to 0, a word is written when it is erased or not at
/// all, and the power is cut when the fuel is burnt: one unit a byte written or erased.
#[derive(Clone, Debug)]
pub struct SimulatedNorFlash<const SECTOR: usize> {
    /// Its bytes: two sectors.
    pub bytes: Vec<u8>,
    /// Bytes that can still be written or erased.
    pub fuel: usize,
    /// Does not take a single bit.
    pub dead: bool,
    /// Whether a cut leaves bits that are read differently; else it leaves them as they were.
    pub wavers: bool,
    /// The power is off.
    pub off: bool,
    /// Bytes with such bits, 1 where a bit is not sure to be 1.
    pub wavering: BTreeMap<usize, u8>,
    /// The next draw.
    pub random: Cell<u32>,
}

impl<const SECTOR: usize> SimulatedNorFlash<SECTOR> {
    /// Blank.
    pub fn erased() -> Self {
        Self::from_bytes(std::vec![0xFF; 2 * SECTOR])
    }

    /// It holds these bytes.
    pub fn from_bytes(bytes: Vec<u8>) -> Self {
        let random = Cell::new(0x2545_F491);
        let wavering = BTreeMap::new();
        Self { bytes, fuel: usize::MAX, dead: false, wavers: false, off: false, wavering, random }
    }

    /// Blank, and a cut leaves bits that are read differently twice, as this seed has it.
    pub fn with_unstable_bits(seed: u32) -> Self {
        let random = Cell::new(seed.wrapping_mul(0x9E37_79B9) | 1);
        Self { wavers: true, random, ..Self::erased() }
    }

    fn consume_fuel(&mut self) -> Result<(), NorFlashErrorKind> {
        self.fuel = self.fuel.checked_sub(1).ok_or(NorFlashErrorKind::Other)?;
        Ok(())
    }

    /// The power is back.
    pub fn with_power_restored(&self) -> Self {
        Self { fuel: usize::MAX, off: false, ..self.clone() }
    }

    fn next_random(&self) -> u8 {
        let mut random = self.random.get();
        random ^= random << 13;
        random ^= random >> 17;
        random ^= random << 5;
        self.random.set(random);
        (random >> 11) as u8
    }
}

impl<const SECTOR: usize> ErrorType for SimulatedNorFlash<SECTOR> {
    type Error = NorFlashErrorKind;
}

impl<const SECTOR: usize> ReadNorFlash for SimulatedNorFlash<SECTOR> {
    const READ_SIZE: usize = WORD_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        // As the board's driver.
        check_read(self, offset, bytes.len())?;
        let from = offset as usize;
        bytes.copy_from_slice(&self.bytes[from..][..bytes.len()]);
        // Cells on the edge often go all one way, and then the word looks sound.
        let mode = self.next_random() % 4;
        for (at, bits) in self.wavering.range(from..from + bytes.len()) {
            let read_as_0 = match mode {
                0 => u8::MAX,
                1 => 0,
                _ => self.next_random(),
            };
            bytes[at - from] &= !(bits & read_as_0);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        2 * SECTOR
    }
}

impl<const SECTOR: usize> NorFlash for SimulatedNorFlash<SECTOR> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        assert_eq!((offset % 4, bytes.len() % 4), (0, 0), "whole words");
        for (word, at) in bytes.chunks(4).zip((offset as usize..).step_by(4)) {
            assert_eq!(self.bytes[at..at + 4], [0xFF; 4], "a word is written once");
            for (n, (byte, at)) in word.iter().zip(at..).enumerate() {
                if let Err(cut) = self.consume_fuel() {
                    let was_off = core::mem::replace(&mut self.off, true);
                    // The word is written at once, so all of its bits that were to be 0 are on their way.
                    if self.wavers && !was_off {
                        let rest =
                            word.iter().enumerate().skip(n).map(|(k, byte)| (at - n + k, !byte));
                        self.wavering.extend(rest.filter(|(_, bits)| *bits != 0));
                    }
                    return Err(cut);
                }
                if !self.dead {
                    self.bytes[at] &= byte;
                    // What is written with a 0 is sure, what is not stays as it was.
                    if let Some(bits) = self.wavering.get_mut(&at) {
                        *bits &= byte;
                    }
                }
            }
        }
        Ok(())
    }

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        assert_eq!((from as usize % SECTOR, (to - from) as usize), (0, SECTOR));
        for at in from as usize..to as usize {
            if let Err(cut) = self.consume_fuel() {
                if core::mem::replace(&mut self.off, true) {
                    return Err(cut);
                }
                // What the erase had not come to is undefined.
                let noise = (0_u8..=u8::MAX).cycle().map(|n| n.wrapping_mul(151) ^ 0x5A);
                self.bytes[at..to as usize]
                    .iter_mut()
                    .zip(noise)
                    .for_each(|(byte, bits)| *byte |= bits);
                if self.wavers {
                    let rest = at..(to as usize).min(at + UNSTABLE_ERASE_BYTES);
                    self.wavering.extend(rest.map(|at| (at, 0xFF)));
                }
                return Err(cut);
            }
            if !self.dead {
                self.bytes[at] = 0xFF;
                self.wavering.remove(&at);
            }
        }
        Ok(())
    }
}
