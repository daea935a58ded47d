//! The flash of records and slots, as memories of their own (section 3). Every wait has a bound.
//!
//! The core runs from the same flash, so it stands still while a word is written (16 µs, at most 100 µs) or a
//! sector is erased (data sheet, flash memory programming: 16 KB 0.25 s, at most 0.5 s; 64 KB 0.55 s, at most 1.1 s;
//! 128 KB 1 s, at most 2 s).

use core::ptr;

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use stm32f4xx_hal::pac::FLASH;
use trueup_boot::flash_layout::{
    JOURNAL_FIRST_SECTOR, JOURNAL_SECTOR_SIZE, JOURNAL_START, SLOT_SECTORS, SLOT_SIZE, SLOTS_START,
    Slot,
};

/// The two keys that unlock the control register (section 3.6.1).
const UNLOCK_KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
/// The flags of errors, and EOP.
const SR_CLEARABLE_FLAGS: u32 = 0xF3;
const SR_ERROR_FLAGS: u32 = 0xF2;
const SR_BSY: u32 = 1 << 16;
/// FLASH_CR: programming, sector erase, start, 32 bits at once, lock.
const CR_PG: u32 = 1;
const CR_SER: u32 = 1 << 1;
const CR_STRT: u32 = 1 << 16;
const CR_PSIZE_X32: u32 = 2 << 8;
const CR_LOCK: u32 = 1 << 31;
/// FLASH_ACR: the data cache, and its reset.
const ACR_DCEN: u32 = 1 << 10;
const ACR_DCRST: u32 = 1 << 12;
/// The core stands still meanwhile, so one poll is enough where it runs from the flash.
const MAX_BUSY_POLLS: u32 = 100_000;

/// A part of the flash: two units of `UNIT` bytes.
pub struct FlashRegion<const UNIT: u32> {
    controller: FLASH,
    start: u32,
    /// The sectors of each unit: the first, and how many.
    sectors: [(u8, u8); 2],
}

/// The two sectors of the records.
pub type JournalRegion = FlashRegion<JOURNAL_SECTOR_SIZE>;
/// The two slots.
pub type SlotRegion = FlashRegion<SLOT_SIZE>;

/// Returns records and slots. They are used one after the other.
#[allow(unsafe_code, reason = "registers of the flash")]
pub fn split(controller: FLASH) -> (JournalRegion, SlotRegion) {
    // SAFETY: the caller has both, and uses them one after the other.
    let second = unsafe { FLASH::steal() };
    let sectors = [(JOURNAL_FIRST_SECTOR, 1), (JOURNAL_FIRST_SECTOR + 1, 1)];
    let records = FlashRegion { controller, start: JOURNAL_START, sectors };
    (records, FlashRegion { controller: second, start: SLOTS_START, sectors: SLOT_SECTORS })
}

impl<const UNIT: u32> FlashRegion<UNIT> {
    /// Returns the controller, for the wait states.
    #[allow(dead_code, reason = "the boot program's alone")]
    pub fn controller(&self) -> &FLASH {
        &self.controller
    }

    /// Does `work` with the controller unlocked and without old errors.
    fn with_unlocked(&self, work: impl FnOnce() -> bool) -> Result<(), NorFlashErrorKind> {
        if !self.wait_until_idle() {
            return Err(NorFlashErrorKind::Other);
        }
        if self.read_control() & CR_LOCK != 0 {
            UNLOCK_KEYS.iter().for_each(|key| self.write_key(*key));
        }
        self.clear_errors();
        let is_done = self.read_control() & CR_LOCK == 0 && work() && !self.has_failed();
        self.write_control(CR_LOCK);
        if is_done { Ok(()) } else { Err(NorFlashErrorKind::Other) }
    }

    fn erase_sector(&self, sector: u8) -> bool {
        let how = CR_PSIZE_X32 | CR_SER | u32::from(sector) << 3;
        self.write_control(how);
        self.write_control(how | CR_STRT);
        cortex_m::asm::dsb();
        self.wait_until_idle() && !self.has_failed()
    }

    fn read_control(&self) -> u32 {
        self.controller.cr().read().bits()
    }

    #[allow(unsafe_code, reason = "registers of the flash")]
    fn write_control(&self, bits: u32) {
        // SAFETY: settings of section 3.9.6, for sectors of this region.
        self.controller.cr().write(|w| unsafe { w.bits(bits) });
    }

    #[allow(unsafe_code, reason = "registers of the flash")]
    fn write_key(&self, key: u32) {
        // SAFETY: a key of section 3.6.1.
        self.controller.keyr().write(|w| unsafe { w.bits(key) });
    }

    #[allow(unsafe_code, reason = "registers of the flash")]
    fn clear_errors(&self) {
        // SAFETY: a flag is cleared by writing 1 to it (section 3.9.5).
        self.controller.sr().write(|w| unsafe { w.bits(SR_CLEARABLE_FLAGS) });
    }

    fn wait_until_idle(&self) -> bool {
        (0..MAX_BUSY_POLLS).any(|_| self.controller.sr().read().bits() & SR_BSY == 0)
    }

    fn has_failed(&self) -> bool {
        self.controller.sr().read().bits() & SR_ERROR_FLAGS != 0
    }

    /// Empties the data cache, whose values of an erased sector are old; it is off meanwhile (section 3.6.4).
    #[allow(unsafe_code, reason = "registers of the flash")]
    fn reset_data_cache(&self) {
        let acr = self.controller.acr().read().bits();
        let off = acr & !ACR_DCEN;
        for bits in [off, off | ACR_DCRST, off, acr] {
            // SAFETY: the wait states stay, and the cache is reset while it is off.
            self.controller.acr().write(|w| unsafe { w.bits(bits) });
        }
    }
}

impl<const UNIT: u32> ErrorType for FlashRegion<UNIT> {
    type Error = NorFlashErrorKind;
}

impl<const UNIT: u32> ReadNorFlash for FlashRegion<UNIT> {
    const READ_SIZE: usize = 4;

    #[inline(never)]
    #[allow(unsafe_code, reason = "words of the flash")]
    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        check_read(self, offset, bytes.len())?;
        let words = self.start.wrapping_add(offset) as *const u32;
        for (n, place) in bytes.as_chunks_mut().0.iter_mut().enumerate() {
            // SAFETY: a word of the region, as was just checked; volatile, because it changes without the compiler's
            // knowledge.
            *place = unsafe { ptr::read_volatile(words.wrapping_add(n)) }.to_le_bytes();
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        2 * UNIT as usize
    }
}

impl<const UNIT: u32> NorFlash for FlashRegion<UNIT> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = UNIT as usize;

    #[inline(never)]
    #[allow(unsafe_code, reason = "words of the flash")]
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        check_write(self, offset, bytes.len())?;
        let words = self.start.wrapping_add(offset) as *mut u32;
        self.with_unlocked(|| {
            self.write_control(CR_PSIZE_X32 | CR_PG);
            bytes.as_chunks().0.iter().enumerate().all(|(n, word)| {
                // SAFETY: a word of the region; no code that runs lies there.
                unsafe { ptr::write_volatile(words.wrapping_add(n), u32::from_le_bytes(*word)) };
                // The word has left the core before its end is waited for (section 3.6.4).
                cortex_m::asm::dsb();
                self.wait_until_idle() && !self.has_failed()
            })
        })
    }

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        check_erase(self, from, to)?;
        let is_meant = |slot: &Slot| {
            let start = u32::from(slot.number()) * UNIT;
            (from..to).contains(&start)
        };
        self.with_unlocked(|| {
            let erased = Slot::ALL.iter().filter(|unit| is_meant(unit)).all(|unit| {
                let (first, count) = *unit.element_of(&self.sectors);
                (first..first.saturating_add(count)).all(|sector| self.erase_sector(sector))
            });
            self.reset_data_cache();
            erased
        })
    }
}
