//! 144 MHz while the images are verified, and the state of a reset afterwards (sections 3.5 and 7.2).

use stm32f4xx_hal::pac::{DBGMCU, FLASH, RCC};
use trueup_boot::start::Clock;

/// The PLL locks in at most 300 µs (data sheet, main PLL characteristics), 4 800 cycles of 16 MHz; a poll takes some
/// five: ten times that.
const POLLS: u32 = 10_000;
/// Wait states at up to 150 MHz and from 2.7 V on (section 3.5.1, table 10).
const WAIT_STATES: u32 = 4;
/// FLASH_ACR: instruction and data cache on; prefetch; the resets of the caches.
const CACHES: u32 = 1 << 9 | 1 << 10;
const PREFETCH: u32 = 1 << 8;
const CACHE_RESETS: u32 = 1 << 11 | 1 << 12;
/// Revision A of the chip, whose prefetch does not work (errata sheet, revisions A and Z; section 38.6.1). It is for
/// this program alone: the converter, which it disturbs, does not run.
const REVISION_A: u32 = 0x1000;
/// RCC_PLLCFGR: 16 MHz by 8, times 144, by 2; Q 7; bit 29 is reserved and set.
const PLL: u32 = 8 | 144 << 6 | 7 << 24 | 1 << 29;
/// RCC_CFGR: APB1 a quarter, APB2 half of the core's rate.
const BUSES: u32 = 5 << 10 | 4 << 13;
const TO_PLL: u32 = 2;

/// Has the core run as fast as it can; says how fast.
pub fn start(rcc: &RCC, flash: &FLASH, dbgmcu: &DBGMCU) -> Clock {
    // As a reset leaves it, even after a loader.
    leave_pll(rcc);
    let is_first = dbgmcu.idcode().read().bits() >> 16 == REVISION_A;
    let fast = if is_first { CACHES } else { CACHES | PREFETCH };
    set_access(flash, fast);
    // SAFETY: values within the ranges of section 7.3.2, while the PLL is off.
    #[allow(unsafe_code, reason = "registers of the clock tree")]
    rcc.pllcfgr().write(|w| unsafe { w.bits(PLL) });
    rcc.cr().modify(|_, w| w.pllon().on());
    if !within(|| rcc.cr().read().pllrdy().bit_is_set()) {
        rcc.cr().modify(|_, w| w.pllon().off());
        return Clock::Slow;
    }
    set_access(flash, fast | WAIT_STATES);
    if !within(|| flash.acr().read().bits() & 7 == WAIT_STATES) {
        return Clock::Slow;
    }
    switch(rcc, BUSES);
    switch(rcc, BUSES | TO_PLL);
    if within(|| rcc.cfgr().read().sws().is_pll()) { Clock::Full } else { Clock::Slow }
}

/// Leaves the clocks and the flash as a reset does.
pub fn stop(rcc: &RCC, flash: &FLASH) {
    leave_pll(rcc);
    set_access(flash, 0);
    set_access(flash, CACHE_RESETS);
    set_access(flash, 0);
}

/// Back to the internal oscillator, without a PLL.
fn leave_pll(rcc: &RCC) {
    rcc.cr().modify(|_, w| w.hsion().on());
    within(|| rcc.cr().read().hsirdy().bit_is_set());
    switch(rcc, rcc.cfgr().read().bits() & BUSES);
    within(|| rcc.cfgr().read().sws().is_hsi());
    switch(rcc, 0);
    rcc.cr().modify(|_, w| w.pllon().off());
    within(|| rcc.cr().read().pllrdy().bit_is_clear());
}

#[allow(unsafe_code, reason = "registers of the clock tree")]
fn switch(rcc: &RCC, to: u32) {
    // SAFETY: sources that run, and dividers within the limits of section 7.3.3.
    rcc.cfgr().write(|w| unsafe { w.bits(to) });
}

#[allow(unsafe_code, reason = "registers of the flash")]
fn set_access(flash: &FLASH, to: u32) {
    // SAFETY: wait states that suffice, and caches, which are reset while they are off (section 3.9.1).
    flash.acr().write(|w| unsafe { w.bits(to) });
}

/// Returns whether `ready` came true in time: the only way to wait here.
fn within(mut ready: impl FnMut() -> bool) -> bool {
    (0..POLLS).any(|_| ready())
}
