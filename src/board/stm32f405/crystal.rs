//! Which crystal there is, measured against the internal oscillator (section 7.2.11).
//!
//! The board is drawn for 8 MHz, but boards with 12, 16 and 25 MHz are as common, and with the wrong
//! divider a crystal of 12 MHz would run the core at 252 MHz. TIM11 captures the crystal divided by 31
//! while it counts the internal oscillator, which is true to 8 % at any temperature (data sheet, HSI
//! oscillator characteristics): the nearest two of these crystals differ by 28 %.
//!
//! Where that timer captures nothing, the watchdog's oscillator is the witness: it says only a rough 17 to
//! 47 kHz, but the same before and after. The core counts its own cycles over the same number of its
//! periods twice, once on the internal oscillator and once on the crystal; their ratio is that of the two.

use stm32f4xx_hal::pac::{IWDG, RCC, TIM11};

use super::{poll_until, startup_timer};

/// Crystals that the clock tree has settings for, in MHz.
const SUPPORTED_CRYSTALS_MHZ: [u32; 4] = [8, 12, 16, 25];
/// How far the measured rate may be off, in percent: the oscillator's 8 and the measurement's own 1.
const CRYSTAL_TOLERANCE_PERCENT: u32 = 10;
/// The internal oscillator, which the core and TIM11 run from meanwhile.
const HSI_KHZ: u32 = 16_000;
/// RTCPRE: a capture of 25 MHz comes every 10 µs, time enough for a poll.
const RTC_PRESCALER: u8 = 31;
/// Periods of the divided crystal in one capture (IC1PSC).
const PERIODS_PER_CAPTURE: u32 = 8;
/// Captures that are measured over: 120 µs at 8 MHz, exact to 0.1 %.
const MEASURED_CAPTURES: u32 = 4;
/// A capture takes 31 µs at 8 MHz: some fifty polls. A crystal below 0.5 MHz is none.
const MAX_CAPTURE_POLLS: u32 = 1_000;

/// Updates of the watchdog's prescaler that are measured over, each of up to 5 periods of its oscillator
/// (section 21.4.4), of as many each time: only the ratio counts. With 5 they are at least 6 800 core cycles,
/// where one poll is 0.2 %.
const MEASURED_UPDATES: u32 = 8;
/// An update takes at most 294 µs (17 kHz, data sheet, LSI oscillator characteristics), 7 400 cycles of a
/// crystal of 25 MHz; a poll takes more than one.
const MAX_UPDATE_POLLS: u32 = 10_000;

/// Returns the crystal that runs, in MHz; `None`: it is none of those known, or it cannot be measured. Its rate is
/// in the log. The core runs from the internal oscillator before and after, and SysTick counts its cycles.
pub fn measure_crystal_mhz(rcc: &RCC, timer: &TIM11) -> Option<u32> {
    let khz = measure_crystal_khz_by_timer(rcc, timer).or_else(|| {
        defmt::warn!("crystal: TIM11 captures nothing, the watchdog's oscillator measures it");
        measure_crystal_khz_by_watchdog(rcc)
    })?;
    let known = SUPPORTED_CRYSTALS_MHZ
        .into_iter()
        .find(|mhz| khz.abs_diff(mhz * 1_000) * 100 <= mhz * 1_000 * CRYSTAL_TOLERANCE_PERCENT);
    match known {
        Some(mhz) => defmt::info!("crystal: {} MHz, measured {} kHz", mhz, khz),
        None => defmt::error!("crystal: {} kHz is none of 8, 12, 16, 25 MHz", khz),
    }
    known
}

/// Returns the crystal's rate by TIM11; `None`: nothing was captured, or a capture was missed.
#[allow(unsafe_code, reason = "registers of a timer and of the clock tree")]
fn measure_crystal_khz_by_timer(rcc: &RCC, timer: &TIM11) -> Option<u32> {
    rcc.apb2enr().modify(|_, w| w.tim11en().enabled());
    // A read of the register lets the clock come up (errata sheet, delay after an RCC clock enabling).
    let _clocked = rcc.apb2enr().read();
    rcc.apb2rstr().modify(|_, w| w.tim11rst().set_bit());
    rcc.apb2rstr().modify(|_, w| w.tim11rst().clear_bit());
    // SAFETY: 31 is a divisor that section 7.3.3 allows.
    rcc.cfgr().modify(|_, w| unsafe { w.rtcpre().bits(RTC_PRESCALER) });
    // SAFETY: TI1_RMP 2 is the divided crystal (section 19.5.11); CC1S 1 and IC1PSC 3 (section 19.5.5) are
    // the input itself, every eighth period.
    unsafe {
        timer.or().write(|w| w.rmp().bits(2));
        timer.ccmr1_input().write(|w| w.bits(3 << 2 | 1));
    }
    timer.ccer().write(|w| w.cc1e().set_bit());
    timer.cr1().write(|w| w.cen().enabled());
    let counts = wait_for_capture(timer).and_then(|first| {
        let mut last = first;
        for _ in 0..MEASURED_CAPTURES {
            last = wait_for_capture(timer)?;
        }
        Some(u32::from(last.wrapping_sub(first)))
    });
    let missed = timer.sr().read().cc1of().bit_is_set();
    timer.cr1().reset();
    rcc.apb2enr().modify(|_, w| w.tim11en().disabled());
    // SAFETY: no clock for the RTC.
    rcc.cfgr().modify(|_, w| unsafe { w.rtcpre().bits(0) });
    let counts = counts.filter(|counts| *counts > 0 && !missed)?;
    Some(u32::from(RTC_PRESCALER) * PERIODS_PER_CAPTURE * MEASURED_CAPTURES * HSI_KHZ / counts)
}

/// Returns the count at the next capture.
fn wait_for_capture(timer: &TIM11) -> Option<u16> {
    poll_until(MAX_CAPTURE_POLLS, || timer.sr().read().cc1if().bit_is_set())
        .then(|| timer.ccr1().read().bits() as u16)
}

/// Returns the crystal's rate by the watchdog's oscillator; `None`: the watchdog does not answer. The core runs from
/// the crystal meanwhile, without wait states, which do up to 30 MHz (section 3.5.1), and under the clock
/// security system, lest it stop for good with the crystal.
fn measure_crystal_khz_by_watchdog(rcc: &RCC) -> Option<u32> {
    let internal = measure_prescaler_update_cycles()?;
    rcc.cr().modify(|_, w| w.csson().on());
    rcc.cfgr().modify(|_, w| w.sw().hse());
    let runs = poll_until(MAX_UPDATE_POLLS, || rcc.cfgr().read().sws().is_hse());
    let crystal = if runs { measure_prescaler_update_cycles() } else { None };
    rcc.cfgr().modify(|_, w| w.sw().hsi());
    let is_back = poll_until(MAX_UPDATE_POLLS, || rcc.cfgr().read().sws().is_hsi());
    rcc.cr().modify(|_, w| w.csson().off());
    // At most 75 000 cycles: no overflow.
    crystal.filter(|_| is_back && internal > 0).map(|cycles| cycles * HSI_KHZ / internal)
}

/// Returns how many cycles the core makes while the watchdog's prescaler is written again and again with what it is.
#[allow(unsafe_code, reason = "registers of the watchdog")]
fn measure_prescaler_update_cycles() -> Option<u32> {
    /// Lets the prescaler be written (IWDG_KR, section 21.4.1).
    const UNLOCK_KEY: u16 = 0x5555;
    // SAFETY: the watchdog's owner does nothing before the start is done, and finds everything as it was.
    let watchdog = unsafe { &*IWDG::ptr() };
    let done = || poll_until(MAX_UPDATE_POLLS, || watchdog.sr().read().pvu().bit_is_clear());
    let update = || {
        // SAFETY: the key, and the value that it has.
        unsafe { watchdog.kr().write(|w| w.bits(UNLOCK_KEY)) };
        watchdog.pr().modify(|_, w| w);
        done()
    };
    // The first update begins at any time, the others with the end of the one before.
    if !done() || !update() {
        return None;
    }
    let start = startup_timer::now();
    (0..MEASURED_UPDATES).all(|_| update()).then(|| startup_timer::cycles_since(start))
}
