//! The independent watchdog of a start (section 21).
//!
//! | its oscillator (data sheet, LSI oscillator characteristics) | limit |
//! |---|---|
//! | 17 kHz, the slowest | 1.51 s |
//! | 32 kHz | 0.80 s |
//! | 47 kHz, the fastest | 0.54 s |
//!
//! The longest is what counts for an image that hangs: with two starts of this program around it the board is back
//! within 2 s. The shortest is longer than anything between two feeds here: the erase of a sector of 16 KB takes
//! 0.5 s at most, a part of an image 1 ms. An application sets its own limit in its first milliseconds.

use stm32f4xx_hal::pac::{DBGMCU, IWDG};

/// IWDG_KR: start, unlock, reload.
const START: u16 = 0xCCCC;
const UNLOCK: u16 = 0x5555;
const RELOAD: u16 = 0xAAAA;
/// IWDG_PR: the oscillator by 32.
const BY_32: u8 = 3;
/// Periods of that.
const PERIODS: u16 = 800;
/// The registers take five periods of the oscillator, 0.3 ms at most (section 21.4.4): this is some 3 ms.
const POLLS: u32 = 8_000;

/// The watchdog, started.
pub struct Watchdog<'a>(&'a IWDG);

/// Starts it; it pauses while a debugger halts the core.
#[allow(unsafe_code, reason = "registers of the watchdog")]
pub fn start<'a>(iwdg: &'a IWDG, dbgmcu: &DBGMCU) -> Watchdog<'a> {
    dbgmcu.apb1_fz().modify(|_, w| w.dbg_iwdg_stop().set_bit());
    // SAFETY: the keys and values of section 21.4.
    unsafe {
        iwdg.kr().write(|w| w.bits(START));
        iwdg.kr().write(|w| w.bits(UNLOCK));
        iwdg.pr().write(|w| w.bits(u32::from(BY_32) as _));
        iwdg.rlr().write(|w| w.bits(u32::from(PERIODS) as _));
    }
    // An emulator without a watchdog says at once that it is done.
    let _is_done = (0..POLLS).any(|_| iwdg.sr().read().bits() == 0);
    let watchdog = Watchdog(iwdg);
    watchdog.feed();
    watchdog
}

impl Watchdog<'_> {
    /// Another [`PERIODS`].
    #[allow(unsafe_code, reason = "registers of the watchdog")]
    pub fn feed(&self) {
        // SAFETY: the key of section 21.4.1.
        self.0.kr().write(|w| unsafe { w.bits(RELOAD) });
    }
}
