//! The clock tree: 168 MHz from the crystal, or the best that is alive (section 7.2).
//!
//! The HAL waits for a crystal and for the PLL without a limit. So both are tried here first,
//! with a limit, and the HAL is only asked for what was seen to work:
//!
//! | crystal | PLL | core | CAN |
//! |---|---|---|---|
//! | runs | locks | 168 MHz from the crystal | on |
//! | dead | locks | 168 MHz from the internal oscillator | silent: 1 % is out of its tolerance |
//! | | dead | 16 MHz from the internal oscillator | silent |
//!
//! At 16 MHz the serial line is 2.1 % fast, at the edge of what a receiver takes.
//!
//! A crystal that stops later is caught by the clock security system: the chip falls back to its
//! internal oscillator and raises the NMI. Every timer would be wrong from then on, so the NMI
//! resets, and the start that follows finds the dead crystal and reports it.

use cortex_m::{asm, peripheral::SCB};
use stm32f4xx_hal::{
    pac::RCC,
    prelude::*,
    rcc::{Config, Rcc},
};

use super::within;

/// What the core is clocked from.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// 168 MHz from the crystal.
    Crystal,
    /// 168 MHz from the internal oscillator: exact to about 1 %.
    InternalThroughPll,
    /// 16 MHz straight from the internal oscillator.
    Internal,
}

/// Core cycles in 10 µs while the chip still runs from its internal oscillator at 16 MHz.
const TEN_MICROSECONDS: u32 = 160;
/// A crystal starts in about 2 ms (data sheet, HSE oscillator characteristics); 100 ms is ample.
const CRYSTAL_POLLS: u32 = 10_000;
/// The PLL locks in at most 300 µs (data sheet, main PLL characteristics); 10 ms is ample.
const PLL_POLLS: u32 = 1_000;

/// Starts the best clock there is, and says which.
pub fn start(rcc: RCC) -> (Rcc, Source) {
    let source = best_source(&rcc);
    let rcc = rcc.freeze(configuration(source));
    match source {
        Source::Crystal => {
            rcc.cr().modify(|_, w| w.csson().on());
            defmt::info!("clock: 168 MHz from the crystal");
        }
        Source::InternalThroughPll => {
            defmt::error!("clock: 168 MHz from the internal oscillator, CAN stays silent");
        }
        Source::Internal => {
            defmt::error!("clock: 16 MHz from the internal oscillator, CAN stays silent");
        }
    }
    (rcc, source)
}

fn best_source(rcc: &RCC) -> Source {
    if crystal_starts(rcc) {
        if pll_locks(rcc, true) {
            return Source::Crystal;
        }
        defmt::error!("dead: PLL on the crystal");
    } else {
        defmt::error!("dead: crystal");
    }
    // Off, lest it come to life behind the back of the board.
    rcc.cr().modify(|_, w| w.hseon().off());
    if pll_locks(rcc, false) {
        return Source::InternalThroughPll;
    }
    defmt::error!("dead: PLL");
    Source::Internal
}

fn crystal_starts(rcc: &RCC) -> bool {
    rcc.cr().modify(|_, w| w.hseon().on());
    soon(CRYSTAL_POLLS, || rcc.cr().read().hserdy().bit_is_set())
}

/// Tries the PLL on its later settings, and leaves it off, because the HAL sets it up anew.
#[allow(unsafe_code, reason = "registers of the clock tree")]
fn pll_locks(rcc: &RCC, from_crystal: bool) -> bool {
    // 8 MHz / 4 or 16 MHz / 8 is 2 MHz, times 168, by 2 (the reset value of P): 168 MHz.
    let input_divider = if from_crystal { 4 } else { 8 };
    rcc.pllcfgr().write(|w| {
        // SAFETY: M, N and Q are within the ranges of section 7.3.2, and the PLL is off.
        unsafe { w.pllm().bits(input_divider).plln().bits(168).pllq().bits(7) };
        w.pllp().div2().pllsrc().bit(from_crystal)
    });
    rcc.cr().modify(|_, w| w.pllon().on());
    let locks = soon(PLL_POLLS, || rcc.cr().read().pllrdy().bit_is_set());
    rcc.cr().modify(|_, w| w.pllon().off());
    // Its settings are locked until it has stopped.
    locks && soon(PLL_POLLS, || rcc.cr().read().pllrdy().bit_is_clear())
}

/// [`within`] at 10 µs a poll, before the clocks are set.
fn soon(polls: u32, mut ready: impl FnMut() -> bool) -> bool {
    within(polls, || {
        asm::delay(TEN_MICROSECONDS);
        ready()
    })
}

fn configuration(source: Source) -> Config {
    let config = match source {
        Source::Crystal => Config::hse(8.MHz()),
        Source::InternalThroughPll => Config::hsi(),
        Source::Internal => return Config::hsi(),
    };
    // The buses at their highest rates; 42 MHz on APB1 is what CAN's bit timing counts on.
    config.sysclk(168.MHz()).hclk(168.MHz()).pclk1(42.MHz()).pclk2(84.MHz())
}

/// The crystal has stopped. Nothing is logged: the NMI may have come in the midst of a log.
// SAFETY: "unsafe" is how cortex-m-rt marks a handler that critical sections do not hold off; this
// one shares nothing.
#[cortex_m_rt::exception]
#[allow(unsafe_code, reason = "registers of the clock tree")]
unsafe fn NonMaskableInt() -> ! {
    SCB::sys_reset()
}
