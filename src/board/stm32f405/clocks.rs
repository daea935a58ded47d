//! The clock tree: 168 MHz from the crystal, or the best that is alive (section 7.2).
//!
//! Which crystal there is, is measured, not believed ([`super::crystal`]); one that is not known counts as
//! dead. The HAL waits for a crystal and for the PLL without a limit. So both are tried here first,
//! with a limit, and the HAL is only asked for what was seen to work:
//!
//! | crystal | PLL | core | CAN |
//! |---|---|---|---|
//! | runs | locks | 168 MHz from the crystal | on |
//! | dead | locks | 144 MHz from the internal oscillator | silent: 1 % is out of its tolerance |
//! | | dead | 16 MHz from the internal oscillator | silent |
//!
//! The internal oscillator is up to 4 % fast between −10 and 85 °C (data sheet, HSI oscillator characteristics;
//! 4.5 % beyond): 168 MHz from it might be 175, above what the chip is made for. 144 MHz is not, and is a whole
//! multiple of 20 kHz.
//!
//! At 16 MHz the serial line is 2.1 % fast, at the edge of what a receiver takes.
//!
//! A crystal that stops later is caught by the clock security system: the chip falls back to its
//! internal oscillator and raises the NMI. Every timer would be wrong from then on, so the NMI
//! resets, and the start that follows finds the dead crystal and reports it.

use cortex_m::peripheral::{SCB, SYST};
use stm32f4xx_hal::{
    pac::{FLASH, RCC, TIM11},
    prelude::*,
    rcc::{Config, Rcc},
};

use super::{
    crash_record::{self, CoreRegisters, StopReason},
    crystal,
    startup_timer::{self, poll_with_timeout},
};

/// Clock source of the core.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum ClockSource {
    /// 168 MHz from the crystal.
    Crystal {
        /// Its rate as measured, one of those known.
        mhz: u32,
    },
    /// 144 MHz from the internal oscillator: exact to about 1 %, 4 % when hot or cold.
    InternalThroughPll,
    /// 16 MHz straight from the internal oscillator.
    Internal,
}

/// Core cycles in a millisecond while the chip still runs from its internal oscillator at 16 MHz.
const HSI_CYCLES_PER_MS: u32 = 16_000;
/// A crystal starts in about 2 ms (data sheet, HSE oscillator characteristics): ten times that.
const CRYSTAL_TIMEOUT_CYCLES: u32 = 20 * HSI_CYCLES_PER_MS;
/// The PLL locks in at most 300 µs (data sheet, main PLL characteristics): ten times that.
const PLL_TIMEOUT_CYCLES: u32 = 3 * HSI_CYCLES_PER_MS;

/// Starts the best clock there is, and says which. SysTick measures the time until then.
pub fn start(rcc: RCC, timer: &TIM11, flash: &FLASH, systick: &mut SYST) -> (Rcc, ClockSource) {
    startup_timer::start(systick);
    reset_clock_tree(&rcc);
    let source = select_clock_source(&rcc, timer);
    let rcc = rcc.freeze(clock_config(source));
    // The HAL has switched it on. The errata of the F40x name it as noise in the converter, and the
    // caches hold what matters.
    flash.acr().modify(|_, w| w.prften().clear_bit());
    match source {
        ClockSource::Crystal { mhz } => {
            rcc.cr().modify(|_, w| w.csson().on());
            defmt::info!("clock: 168 MHz from the crystal of {} MHz", mhz);
        }
        ClockSource::InternalThroughPll => {
            defmt::error!("clock: 144 MHz from the internal oscillator, CAN stays silent");
        }
        ClockSource::Internal => {
            defmt::error!("clock: 16 MHz from the internal oscillator, CAN stays silent");
        }
    }
    (rcc, source)
}

/// The clock tree as a reset leaves it. After a loader ("leave", "go") the image starts in the loader's
/// state: on a PLL of its own, whose settings cannot be changed while it runs.
fn reset_clock_tree(rcc: &RCC) {
    rcc.cr().modify(|_, w| w.hsion().on());
    poll_with_timeout(PLL_TIMEOUT_CYCLES, || rcc.cr().read().hsirdy().bit_is_set());
    rcc.cfgr().modify(|_, w| w.sw().hsi());
    poll_with_timeout(PLL_TIMEOUT_CYCLES, || rcc.cfgr().read().sws().is_hsi());
    rcc.cfgr().reset();
    rcc.cr().modify(|_, w| w.pllon().off().csson().off());
    poll_with_timeout(PLL_TIMEOUT_CYCLES, || rcc.cr().read().pllrdy().bit_is_clear());
    rcc.cr().modify(|_, w| w.hseon().off().hsebyp().clear_bit());
}

fn select_clock_source(rcc: &RCC, timer: &TIM11) -> ClockSource {
    if start_crystal(rcc) {
        match crystal::measure_crystal_mhz(rcc, timer) {
            Some(mhz) if try_pll_lock(rcc, Some(mhz)) => return ClockSource::Crystal { mhz },
            Some(_) => defmt::error!("dead: PLL on the crystal"),
            None => defmt::error!("dead: crystal, its rate is none that is known"),
        }
    } else {
        defmt::error!("dead: crystal");
    }
    // Off, lest it come to life behind the back of the board.
    rcc.cr().modify(|_, w| w.hseon().off());
    if try_pll_lock(rcc, None) {
        return ClockSource::InternalThroughPll;
    }
    defmt::error!("dead: PLL");
    ClockSource::Internal
}

fn start_crystal(rcc: &RCC) -> bool {
    rcc.cr().modify(|_, w| w.hseon().on());
    poll_with_timeout(CRYSTAL_TIMEOUT_CYCLES, || rcc.cr().read().hserdy().bit_is_set())
}

/// Tries the PLL on its later settings, and leaves it off, because the HAL sets it up anew.
#[allow(unsafe_code, reason = "registers of the clock tree")]
fn try_pll_lock(rcc: &RCC, crystal_mhz: Option<u32>) -> bool {
    // 2 MHz times 168 or 144, by 2 (the reset value of P); from 25 MHz 1 MHz times 336.
    let (input_divider, factor) = match crystal_mhz {
        Some(mhz) if mhz % 2 == 0 => (mhz / 2, 168),
        Some(mhz) => (mhz, 336),
        None => (8, 144),
    };
    rcc.pllcfgr().write(|w| {
        // SAFETY: M, N and Q are within the ranges of section 7.3.2, and the PLL is off.
        unsafe { w.pllm().bits(input_divider as u8).plln().bits(factor).pllq().bits(7) };
        w.pllp().div2().pllsrc().bit(crystal_mhz.is_some())
    });
    rcc.cr().modify(|_, w| w.pllon().on());
    let locks = poll_with_timeout(PLL_TIMEOUT_CYCLES, || rcc.cr().read().pllrdy().bit_is_set());
    rcc.cr().modify(|_, w| w.pllon().off());
    // Its settings are locked until it has stopped.
    locks && poll_with_timeout(PLL_TIMEOUT_CYCLES, || rcc.cr().read().pllrdy().bit_is_clear())
}

fn clock_config(source: ClockSource) -> Config {
    // The buses at a quarter and at half of the core's rate, 42 and 84 MHz at the most; 42 MHz on APB1 is
    // what CAN's bit timing counts on.
    let with = |config: Config, core: u32| {
        config.sysclk(core.MHz()).hclk(core.MHz()).pclk1((core / 4).MHz()).pclk2((core / 2).MHz())
    };
    match source {
        ClockSource::Crystal { mhz } => with(Config::hse(mhz.MHz()), 168),
        ClockSource::InternalThroughPll => with(Config::hsi(), 144),
        ClockSource::Internal => Config::hsi(),
    }
}

/// The crystal has stopped: a record for the next start. Nothing is logged: the NMI may have come in the midst of a
/// log.
// SAFETY: "unsafe" is how cortex-m-rt marks a handler that critical sections do not hold off; this
// one writes a record that no other code writes any more.
#[cortex_m_rt::exception]
#[allow(unsafe_code, reason = "registers of the clock tree")]
unsafe fn NonMaskableInt() -> ! {
    crash_record::write(StopReason::Crystal, CoreRegisters::default(), None);
    SCB::sys_reset()
}
