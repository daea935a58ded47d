//! A flash for tests that forgives nothing, and whose power can be cut at any byte.

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use std::vec::Vec;

/// A strict flash: a bit only goes from 1 to 0, a word is written when it is erased or not at
/// all, and the power is cut when the fuel is burnt: one unit a byte written or erased.
#[derive(Clone, Debug)]
pub struct StrictFlash<const SECTOR: usize> {
    /// What it holds: two sectors.
    pub bytes: Vec<u8>,
    /// Bytes that can still be written or erased.
    pub fuel: usize,
    /// Does not take a single bit.
    pub dead: bool,
}

impl<const SECTOR: usize> StrictFlash<SECTOR> {
    /// Blank.
    pub fn erased() -> Self {
        Self { bytes: std::vec![0xFF; 2 * SECTOR], fuel: usize::MAX, dead: false }
    }

    fn burn(&mut self) -> Result<(), NorFlashErrorKind> {
        self.fuel = self.fuel.checked_sub(1).ok_or(NorFlashErrorKind::Other)?;
        Ok(())
    }

    /// The power is back.
    pub fn powered(&self) -> Self {
        Self { fuel: usize::MAX, ..self.clone() }
    }
}

impl<const SECTOR: usize> ErrorType for StrictFlash<SECTOR> {
    type Error = NorFlashErrorKind;
}

impl<const SECTOR: usize> ReadNorFlash for StrictFlash<SECTOR> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        bytes.copy_from_slice(&self.bytes[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        2 * SECTOR
    }
}

impl<const SECTOR: usize> NorFlash for StrictFlash<SECTOR> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        assert_eq!((offset % 4, bytes.len() % 4), (0, 0), "whole words");
        for (word, at) in bytes.chunks(4).zip((offset as usize..).step_by(4)) {
            assert_eq!(self.bytes[at..at + 4], [0xFF; 4], "a word is written once");
            for (byte, at) in word.iter().zip(at..) {
                self.burn()?;
                if !self.dead {
                    self.bytes[at] &= byte;
                }
            }
        }
        Ok(())
    }

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        assert_eq!((from as usize % SECTOR, (to - from) as usize), (0, SECTOR));
        for at in from as usize..to as usize {
            if let Err(cut) = self.burn() {
                // What the erase had not come to is undefined.
                let noise = (0_u8..=u8::MAX).cycle().map(|n| n.wrapping_mul(151) ^ 0x5A);
                self.bytes[at..to as usize]
                    .iter_mut()
                    .zip(noise)
                    .for_each(|(byte, bits)| *byte |= bits);
                return Err(cut);
            }
            if !self.dead {
                self.bytes[at] = 0xFF;
            }
        }
        Ok(())
    }
}
