//! 144 MHz while the images are verified, and the state of a reset afterwards (sections 3.5 and 7.2).

use stm32f4xx_hal::pac::{DBGMCU, FLASH, RCC};
use trueup_boot::start::ClockSpeed;

/// The PLL locks in at most 300 µs (data sheet, main PLL characteristics), 4 800 cycles of 16 MHz; a poll takes some
/// five: ten times that.
const MAX_READY_POLLS: u32 = 10_000;
/// Wait states at up to 150 MHz and from 2.7 V on (section 3.5.1, table 10).
const FLASH_WAIT_STATES: u32 = 4;
/// FLASH_ACR: instruction and data cache on; prefetch; the resets of the caches.
const ACR_ICEN_DCEN: u32 = 1 << 9 | 1 << 10;
const ACR_PRFTEN: u32 = 1 << 8;
const ACR_ICRST_DCRST: u32 = 1 << 11 | 1 << 12;
/// Revision A of the chip, whose prefetch does not work (errata sheet, revisions A and Z; section 38.6.1). It is for
/// this program alone: the converter, which it disturbs, does not run.
const REVISION_A_ID: u32 = 0x1000;
/// RCC_PLLCFGR: 16 MHz by 8, times 144, by 2; Q 7; bit 29 is reserved and set.
const PLLCFGR_VALUE: u32 = 8 | 144 << 6 | 7 << 24 | 1 << 29;
/// RCC_CFGR: APB1 a quarter, APB2 half of the core's rate.
const CFGR_BUS_PRESCALERS: u32 = 5 << 10 | 4 << 13;
const CFGR_SW_PLL: u32 = 2;

/// Has the core run as fast as it can; says how fast.
pub fn start(rcc: &RCC, flash: &FLASH, dbgmcu: &DBGMCU) -> ClockSpeed {
    // As a reset leaves it, even after a loader.
    switch_to_hsi(rcc);
    let is_first = dbgmcu.idcode().read().bits() >> 16 == REVISION_A_ID;
    let fast = if is_first { ACR_ICEN_DCEN } else { ACR_ICEN_DCEN | ACR_PRFTEN };
    write_acr(flash, fast);
    // SAFETY: values within the ranges of section 7.3.2, while the PLL is off.
    #[allow(unsafe_code, reason = "registers of the clock tree")]
    rcc.pllcfgr().write(|w| unsafe { w.bits(PLLCFGR_VALUE) });
    rcc.cr().modify(|_, w| w.pllon().on());
    if !poll_until(|| rcc.cr().read().pllrdy().bit_is_set()) {
        rcc.cr().modify(|_, w| w.pllon().off());
        return ClockSpeed::Slow;
    }
    write_acr(flash, fast | FLASH_WAIT_STATES);
    if !poll_until(|| flash.acr().read().bits() & 7 == FLASH_WAIT_STATES) {
        return ClockSpeed::Slow;
    }
    write_cfgr(rcc, CFGR_BUS_PRESCALERS);
    write_cfgr(rcc, CFGR_BUS_PRESCALERS | CFGR_SW_PLL);
    if poll_until(|| rcc.cfgr().read().sws().is_pll()) {
        ClockSpeed::Full
    } else {
        ClockSpeed::Slow
    }
}

/// Leaves the clocks and the flash as a reset does.
pub fn restore_reset_state(rcc: &RCC, flash: &FLASH) {
    switch_to_hsi(rcc);
    write_acr(flash, 0);
    write_acr(flash, ACR_ICRST_DCRST);
    write_acr(flash, 0);
}

/// Back to the internal oscillator, without a PLL.
fn switch_to_hsi(rcc: &RCC) {
    rcc.cr().modify(|_, w| w.hsion().on());
    poll_until(|| rcc.cr().read().hsirdy().bit_is_set());
    write_cfgr(rcc, rcc.cfgr().read().bits() & CFGR_BUS_PRESCALERS);
    poll_until(|| rcc.cfgr().read().sws().is_hsi());
    write_cfgr(rcc, 0);
    rcc.cr().modify(|_, w| w.pllon().off());
    poll_until(|| rcc.cr().read().pllrdy().bit_is_clear());
}

#[allow(unsafe_code, reason = "registers of the clock tree")]
fn write_cfgr(rcc: &RCC, to: u32) {
    // SAFETY: sources that run, and dividers within the limits of section 7.3.3.
    rcc.cfgr().write(|w| unsafe { w.bits(to) });
}

#[allow(unsafe_code, reason = "registers of the flash")]
fn write_acr(flash: &FLASH, to: u32) {
    // SAFETY: wait states that suffice, and caches, which are reset while they are off (section 3.9.1).
    flash.acr().write(|w| unsafe { w.bits(to) });
}

/// Returns whether `ready` came true in time: the only way to wait here.
fn poll_until(mut ready: impl FnMut() -> bool) -> bool {
    (0..MAX_READY_POLLS).any(|_| ready())
}
