//! The last four sectors of the flash, for what has to outlast the power (section 3.3): 8 and 9 for
//! calibrations that were loaded, 10 and 11 for what `Zero` has taken.
//!
//! They are the linker's no more (`memory.x`), and a new image leaves them alone. The HAL's driver
//! waits without a limit and writes bytes; here every wait has a bound and a word is written at
//! once, which the brown-out level allows (2.7 V and more, section 3.6.2).
//!
//! The core runs from the same flash, so it stands still while a word is written (16 µs, at most
//! 100 µs) or a sector is erased (1 s, at most 2 s; data sheet, flash memory programming). A record
//! of eight words therefore costs some bytes of the serial line, which has 10.8 µs: the lines they
//! belong to are refused and counted, and come again; a calibration costs some hundred words of them,
//! while no offset is followed. An erase is for the start alone, before anything runs that would miss
//! the time: so neither store ever stands in need of one later. The watchdog waits longer during an erase alone.

use core::{ptr, slice};

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use stm32f4xx_hal::pac::{FLASH, flash::cr::PSIZE};

use super::{HSI_CYCLES_PER_MS, mpu, poll_until, watchdog};

/// Where sector 8 begins.
const STORE_START_ADDRESS: usize = 0x0808_0000;
const STORE_FIRST_SECTOR: u8 = 8;
const STORE_SECTOR_SIZE: usize = 128 * 1024;
const SECTORS_PER_STORE: usize = 2;
/// The two keys that unlock the control register (section 3.6.1).
const UNLOCK_KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
/// PGSERR, PGPERR, PGAERR, WRPERR, OPERR and EOP.
const SR_CLEARABLE_FLAGS: u32 = 0xF3;
/// A word needs 100 µs at most; this is about 1 ms.
const MAX_WRITE_POLLS: u32 = 16_384;
/// Milliseconds that an erase may take, twice what the data sheet says.
const ERASE_TIMEOUT_MS: u32 = 4_000;
/// Two of the sectors, as one memory.
pub struct Flash {
    controller: FLASH,
    /// The first of the two.
    sector: u8,
}

impl Flash {
    /// Takes the controller over from those who have set it up: the sectors for calibrations, and
    /// those for references. Neither is written while the other is: both belong to the supervisor.
    #[allow(unsafe_code, reason = "registers and words of the flash")]
    pub fn split(controller: FLASH) -> [Self; 2] {
        // SAFETY: the two are used one after the other, by the start and then by one task.
        let second = unsafe { FLASH::steal() };
        // A loader may have left it unlocked; every write here unlocks for itself.
        if is_idle(&controller) && controller.cr().read().lock().bit_is_clear() {
            controller.cr().reset();
        }
        [
            Self { controller, sector: STORE_FIRST_SECTOR },
            Self { controller: second, sector: STORE_FIRST_SECTOR + SECTORS_PER_STORE as u8 },
        ]
    }

    fn start_address(&self) -> usize {
        STORE_START_ADDRESS + usize::from(self.sector - STORE_FIRST_SECTOR) * STORE_SECTOR_SIZE
    }

    /// Returns what is stored there, in place.
    ///
    /// # Safety
    /// It is neither written nor erased from now on.
    #[allow(unsafe_code, reason = "registers and words of the flash")]
    pub unsafe fn mapped_slice(&self, offset: u32, length: usize) -> &'static [u8] {
        let end = offset as usize + length;
        assert!(end <= SECTORS_PER_STORE * STORE_SECTOR_SIZE, "within the two sectors");
        // SAFETY: flash that is there, and stays unchanged, as the caller promises.
        unsafe {
            slice::from_raw_parts((self.start_address() + offset as usize) as *const u8, length)
        }
    }

    /// Does `work` with the controller unlocked and without old errors.
    fn with_unlocked(
        &mut self,
        work: impl FnOnce(&FLASH) -> bool,
    ) -> Result<(), NorFlashErrorKind> {
        let flash = &self.controller;
        if !poll_until(MAX_WRITE_POLLS, || is_idle(flash)) {
            return Err(NorFlashErrorKind::Other);
        }
        for key in UNLOCK_KEYS {
            flash.keyr().write(|w| w.key().set(key));
        }
        clear_errors(flash);
        let done = flash.cr().read().lock().bit_is_clear()
            && mpu::with_store_writable(|| work(flash))
            && !has_failed(flash);
        // Its reset value: locked, and nothing asked.
        flash.cr().reset();
        if done { Ok(()) } else { Err(NorFlashErrorKind::Other) }
    }
}

/// A flag is cleared by writing 1 to it (section 3.9.5). Not by `modify`, which spares such bits: one error
/// would hold up every later write.
#[allow(unsafe_code, reason = "registers and words of the flash")]
fn clear_errors(flash: &FLASH) {
    // SAFETY: the flags of the register, and no other bit.
    flash.sr().write(|w| unsafe { w.bits(SR_CLEARABLE_FLAGS) });
}

fn is_idle(flash: &FLASH) -> bool {
    flash.sr().read().bsy().bit_is_clear()
}

fn has_failed(flash: &FLASH) -> bool {
    let status = flash.sr().read();
    status.operr().bit_is_set()
        || status.wrperr().bit_is_set()
        || status.pgaerr().bit_is_set()
        || status.pgperr().bit_is_set()
        || status.pgserr().bit_is_set()
}

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 4;

    // Once in the image: the store reads at many places, and has time.
    #[inline(never)]
    #[allow(unsafe_code, reason = "registers and words of the flash")]
    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        check_read(self, offset, bytes.len())?;
        let words = (self.start_address() + offset as usize) as *const u32;
        for (n, place) in bytes.as_chunks_mut().0.iter_mut().enumerate() {
            // SAFETY: a whole word of the two sectors, as was just checked, and no code has a
            // reference to them. Volatile, because it changes without the compiler's knowledge.
            *place = unsafe { ptr::read_volatile(words.add(n)) }.to_le_bytes();
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        SECTORS_PER_STORE * STORE_SECTOR_SIZE
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = STORE_SECTOR_SIZE;

    #[inline(never)]
    #[allow(unsafe_code, reason = "registers and words of the flash")]
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        check_write(self, offset, bytes.len())?;
        let words = (self.start_address() + offset as usize) as *mut u32;
        self.with_unlocked(|flash| {
            // Not `write`, which begins with the reset value, and that locks.
            flash.cr().modify(|_, w| w.psize().variant(PSIZE::Psize32).pg().set_bit());
            bytes.as_chunks().0.iter().enumerate().all(|(n, word)| {
                // SAFETY: as for reading; the image ends before the two sectors, so no code and no
                // constant is overwritten. A bus fault cannot follow: a locked or busy controller
                // ignores the write and says so in its flags.
                unsafe { ptr::write_volatile(words.add(n), u32::from_le_bytes(*word)) };
                // The word has left the core before its end is waited for (section 3.6.4).
                cortex_m::asm::dsb();
                poll_until(MAX_WRITE_POLLS, || is_idle(flash))
            })
        })
    }

    #[allow(unsafe_code, reason = "registers and words of the flash")]
    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        check_erase(self, from, to)?;
        let first = from as usize / STORE_SECTOR_SIZE;
        let end = to as usize / STORE_SECTOR_SIZE;
        let own = self.sector;
        let erase = |flash: &FLASH| {
            let erased = (own..).take(SECTORS_PER_STORE).take(end).skip(first).all(|sector| {
                // SAFETY: 8 to 11 are sectors of this chip, and none holds the image.
                flash.cr().modify(|_, w| unsafe {
                    w.psize().variant(PSIZE::Psize32).ser().set_bit().snb().bits(sector)
                });
                flash.cr().modify(|_, w| w.strt().set_bit());
                poll_until(ERASE_TIMEOUT_MS, || {
                    let idle = is_idle(flash);
                    if !idle {
                        cortex_m::asm::delay(HSI_CYCLES_PER_MS);
                    }
                    idle
                })
            });
            reset_data_cache(flash);
            erased
        };
        watchdog::with_erase_timeout(|| self.with_unlocked(erase))
    }
}

/// Empties the data cache, whose values of an erased sector are old; it is off meanwhile (section
/// 3.6.4). After programming, the cache follows by itself.
fn reset_data_cache(flash: &FLASH) {
    flash.acr().modify(|_, w| w.dcen().clear_bit());
    flash.acr().modify(|_, w| w.dcrst().set_bit());
    flash.acr().modify(|_, w| w.dcrst().clear_bit());
    flash.acr().modify(|_, w| w.dcen().set_bit());
}
