//! The flash of the virtual board: a file of the host, so that it outlasts the power.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

use super::{open_file, read_until_full};

/// The flash, in two small sectors: a copy of the host's file, which follows every change.
pub struct Flash([u8; 2 * SECTOR_SIZE]);

const SECTOR_SIZE: usize = 1024;

impl Flash {
    /// As the host's file has it; what is not there is blank.
    pub fn load() -> Self {
        let mut bytes = [0xFF; _];
        if let Some(mut file) = open_file(c"flash.bin") {
            read_until_full(&mut file, &mut bytes);
        }
        Self(bytes)
    }

    fn save(&self) -> Result<(), NorFlashErrorKind> {
        semihosting::fs::write(c"flash.bin", self.0).map_err(|_| NorFlashErrorKind::Other)
    }
}

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        check_read(self, offset, bytes.len())?;
        bytes.copy_from_slice(&self.0[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR_SIZE;

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        check_write(self, offset, bytes.len())?;
        self.0[offset as usize..].iter_mut().zip(bytes).for_each(|(cell, byte)| *cell &= byte);
        self.save()
    }

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        check_erase(self, from, to)?;
        self.0[from as usize..to as usize].fill(0xFF);
        self.save()
    }
}
