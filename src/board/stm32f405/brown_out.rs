//! Brown-out reset: the chip holds still while its supply is too low for the full clock.
//!
//! Out of the factory a chip runs down to 1.8 V, where 168 MHz are out of its specification. Level
//! 3 resets it below about 2.8 V (data sheet, embedded reset and power control block). The level
//! is an option byte (section 3.7.1), kept without power, so it is written once in a board's life: by the
//! first start of a new board. That takes a quarter of a second in which the core stands still, so a board
//! that a machine relies on already, whose option bytes were changed from outside, comes up first, and does it
//! when it has given no offset for a while.

use super::{
    HSI_CYCLES_PER_MS, poll_until,
    watchdog::{ResetCause, Watchdog},
};
use stm32f4xx_hal::pac::FLASH;

/// BOR_LEV for level 3; 0b11 is "off". The register crate has its names the wrong way round.
const BOR_LEVEL_3: u8 = 0b00;
/// The two keys that unlock the option bytes (section 3.7.2).
const UNLOCK_KEYS: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];
/// Milliseconds that an option byte may take at the most: the figure for a sector is 0.8 s.
const OPTION_WRITE_TIMEOUT_MS: u32 = 2_000;
/// Turns of the supervisor without an offset until the level is raised on a board in service: 2 s. A CNC that
/// engages just then is held up by the quarter of a second.
const IDLE_TURNS_BEFORE_RAISE: u32 = 200;

/// The level, and what is still to be done about it.
pub struct BrownOutLevel {
    /// Of the flash.
    controller: FLASH,
    is_due: bool,
    turns: u32,
}

impl BrownOutLevel {
    /// Looks at it.
    ///
    /// It is raised only after power-on, so that no loop of resets can wear the option bytes out if they do
    /// not take the value.
    #[allow(unsafe_code, reason = "the flash has two users")]
    pub fn new(reset: ResetCause) -> Self {
        // SAFETY: start and supervisor use it, and the stores of the supervisor not at the same time.
        let controller = unsafe { FLASH::steal() };
        let is_low = !is_protected(&controller);
        if is_low && reset != ResetCause::PowerOn {
            defmt::warn!("brown-out level is not 3; it will be set at the next power-on");
        }
        Self { controller, is_due: is_low && reset == ResetCause::PowerOn, turns: 0 }
    }

    /// Raises it at once, if it is low.
    pub fn raise_level(&mut self, watchdog: &mut Watchdog) {
        if !self.is_due {
            return;
        }
        self.is_due = false;
        if watchdog.with_extended_timeout(|| write_level(&self.controller)) {
            defmt::info!("brown-out level set to 3");
        } else {
            defmt::error!("dead: option bytes, the brown-out level is still not 3");
        }
    }

    /// A turn of the supervisor: raises it, if it is low and no offset was given for a while.
    pub fn raise_level_when_idle(&mut self, gives_offset: bool, watchdog: &mut Watchdog) {
        self.turns = if gives_offset { 0 } else { self.turns + 1 };
        if self.is_due && self.turns >= IDLE_TURNS_BEFORE_RAISE {
            self.raise_level(watchdog);
        }
    }
}

fn is_protected(flash: &FLASH) -> bool {
    flash.optcr().read().bor_lev().bits() == BOR_LEVEL_3
}

fn write_level(flash: &FLASH) -> bool {
    if !wait_until_idle(flash) {
        return false;
    }
    for key in UNLOCK_KEYS {
        flash.optkeyr().write(|w| w.optkeyr().set(key));
    }
    // All other options, the read protection above all, are written back as they were read.
    flash.optcr().modify(|_, w| w.bor_lev().set(BOR_LEVEL_3));
    flash.optcr().modify(|_, w| w.optstrt().set_());
    let written = wait_until_idle(flash);
    flash.optcr().modify(|_, w| w.optlock().set_());
    written && is_protected(flash)
}

fn wait_until_idle(flash: &FLASH) -> bool {
    poll_until(OPTION_WRITE_TIMEOUT_MS, || {
        let idle = flash.sr().read().bsy().bit_is_clear();
        if !idle {
            cortex_m::asm::delay(HSI_CYCLES_PER_MS);
        }
        idle
    })
}
