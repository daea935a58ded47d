//! The independent watchdog of a start (section 21): of the boot program, and of the application until its tasks run.
//!
//! | limit | 47 kHz | 32 kHz | 17 kHz |
//! |---|---|---|---|
//! | [`BOOT_TIMEOUT`]: while the boot program chooses an image | 0.54 s | 0.80 s | 1.51 s |
//! | [`IMAGE_START_TIMEOUT`]: from its last step on, until the tasks of the application run | 0.34 s | 0.50 s | 0.94 s |
//!
//! The oscillator has 17 to 47 kHz (data sheet, LSI oscillator characteristics). The longest is what counts for an image that
//! hangs: with two starts around it the board is back within 2 s. The shortest is longer than anything between two
//! feeds: in the boot program the erase of a sector of 16 KB takes 0.5 s at most, a part of an image 1 ms.

use stm32f4xx_hal::pac::{DBGMCU, iwdg::RegisterBlock};

/// IWDG_KR: start, unlock, reload.
const START_KEY: u16 = 0xCCCC;
const UNLOCK_KEY: u16 = 0x5555;
const RELOAD_KEY: u16 = 0xAAAA;
/// The registers take five periods of the oscillator, 0.3 ms at most (section 21.4.4). A poll takes at least eight cycles
/// of the core: 0.9 ms at 168 MHz.
const MAX_UPDATE_POLLS: u32 = 20_000;

/// How long it waits for a feed.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct WatchdogTimeout {
    /// IWDG_PR: 3 divides the oscillator by 32, 6 by 256.
    pub prescaler: u8,
    /// IWDG_RLR: periods of that, one less.
    pub reload: u16,
}

/// The boot program chooses, or an application starts on a slow core.
pub const BOOT_TIMEOUT: WatchdogTimeout = WatchdogTimeout { prescaler: 3, reload: 799 };
/// An image starts.
pub const IMAGE_START_TIMEOUT: WatchdogTimeout = WatchdogTimeout { prescaler: 3, reload: 499 };

/// Starts it with a limit; it pauses while a debugger halts the core. Nothing but a reset stops it again.
#[allow(unsafe_code, reason = "registers of the watchdog")]
pub fn start(iwdg: &RegisterBlock, dbgmcu: &DBGMCU, limit: WatchdogTimeout) {
    dbgmcu.apb1_fz().modify(|_, w| w.dbg_iwdg_stop().set_bit());
    // SAFETY: the key of section 21.4.1.
    iwdg.kr().write(|w| unsafe { w.bits(START_KEY) });
    set_timeout(iwdg, limit);
}

/// Sets a limit, and feeds: it counts by this one from now on.
#[allow(unsafe_code, reason = "registers of the watchdog")]
pub fn set_timeout(iwdg: &RegisterBlock, limit: WatchdogTimeout) {
    wait_until_registers_updated(iwdg);
    // SAFETY: the keys and values of section 21.4.
    unsafe {
        iwdg.kr().write(|w| w.bits(UNLOCK_KEY));
        iwdg.pr().write(|w| w.bits(u32::from(limit.prescaler) as _));
        iwdg.rlr().write(|w| w.bits(u32::from(limit.reload) as _));
    }
    wait_until_registers_updated(iwdg);
    feed(iwdg);
}

/// Waits until its registers are what was written. An emulator without a watchdog says at once that it is done.
fn wait_until_registers_updated(iwdg: &RegisterBlock) {
    let _is_done = (0..MAX_UPDATE_POLLS).any(|_| iwdg.sr().read().bits() == 0);
}

/// Lets it wait anew.
#[allow(unsafe_code, reason = "registers of the watchdog")]
pub fn feed(iwdg: &RegisterBlock) {
    // SAFETY: the key of section 21.4.1.
    iwdg.kr().write(|w| unsafe { w.bits(RELOAD_KEY) });
}
