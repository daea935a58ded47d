//! Brown-out reset: the chip holds still while its supply is too low for the full clock.
//!
//! Out of the factory a chip runs down to 1.8 V, where 168 MHz are out of its specification. Level
//! 3 resets it below about 2.8 V (data sheet, embedded reset and power control block). The level
//! is an option byte (section 3.6.1), kept without power, so it is written once in a board's life.

use stm32f4xx_hal::pac::FLASH;

use super::{watchdog::Reset, within};

/// BOR_LEV for level 3; 0b11 is "off". The register crate has its names the wrong way round.
const LEVEL_3: u8 = 0b00;
/// The two keys that unlock the option bytes (section 3.6.2).
const UNLOCK: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];
/// Milliseconds that an option byte may take at the most: the figure for a sector is 0.8 s.
const WRITE_MS: u32 = 2_000;
/// Core cycles in a millisecond at the full clock; a slower clock only waits longer.
const MILLISECOND: u32 = 168_000;

/// Raises the brown-out level to 3 if it is not there yet.
///
/// Only after power-on, so that no loop of resets can wear the option bytes out if they do not
/// take the value.
pub fn protect(flash: &FLASH, reset: Reset) {
    if is_protected(flash) {
        return;
    }
    if reset != Reset::PowerOn {
        defmt::warn!("brown-out level is not 3; it will be set at the next power-on");
    } else if write(flash) {
        defmt::info!("brown-out level set to 3");
    } else {
        defmt::error!("dead: option bytes, the brown-out level is still not 3");
    }
}

fn is_protected(flash: &FLASH) -> bool {
    flash.optcr().read().bor_lev().bits() == LEVEL_3
}

fn write(flash: &FLASH) -> bool {
    if !is_idle(flash) {
        return false;
    }
    for key in UNLOCK {
        flash.optkeyr().write(|w| w.optkeyr().set(key));
    }
    // All other options, the read protection above all, are written back as they were read.
    flash.optcr().modify(|_, w| w.bor_lev().set(LEVEL_3));
    flash.optcr().modify(|_, w| w.optstrt().set_());
    let written = is_idle(flash);
    flash.optcr().modify(|_, w| w.optlock().set_());
    written && is_protected(flash)
}

fn is_idle(flash: &FLASH) -> bool {
    within(WRITE_MS, || {
        let idle = flash.sr().read().bsy().bit_is_clear();
        if !idle {
            cortex_m::asm::delay(MILLISECOND);
        }
        idle
    })
}
