//! The watchdog, and what the last reset came from (sections 21 and 7.3.21).

#[path = "../../bin/boot/watchdog.rs"]
mod independent_watchdog;

use trueup_link::status::ResetReason;

use super::crash_record::{CrashRecord, StopReason};
use independent_watchdog::WatchdogTimeout;
use stm32f4xx_hal::pac::{DBGMCU, IWDG, RCC, iwdg::RegisterBlock};

/// Cause of the last reset.
#[derive(Clone, Copy, PartialEq, Eq, defmt::Format)]
pub enum ResetCause {
    /// The supervisor had stopped.
    Watchdog,
    /// A panic, the crystal stopped, or a CANopen master requested it.
    Software,
    /// The supply came up.
    PowerOn,
    /// The supply had dipped.
    BrownOut,
    /// The reset pin.
    Pin,
    /// No flag is set, as in an emulator.
    Unknown,
}

/// Reads and clears the reset flags. A reset of the chip pulls its own reset pin, and power-on
/// counts as a brown-out as well, so the rarest cause is tested first.
pub fn take_reset_cause(rcc: &RCC) -> ResetCause {
    let flags = rcc.csr().read();
    rcc.csr().modify(|_, w| w.rmvf().clear());
    if flags.wdgrstf().bit_is_set() || flags.wwdgrstf().bit_is_set() {
        ResetCause::Watchdog
    } else if flags.sftrstf().bit_is_set() {
        ResetCause::Software
    } else if flags.porrstf().bit_is_set() {
        ResetCause::PowerOn
    } else if flags.borrstf().bit_is_set() {
        ResetCause::BrownOut
    } else if flags.padrstf().bit_is_set() {
        ResetCause::Pin
    } else {
        ResetCause::Unknown
    }
}

/// Why the board started, as it reports it: a reset by software has several reasons, and a watchdog that bit
/// while the board was ending itself is not the first of them.
pub fn reset_reason(reset: ResetCause, last_words: Option<&CrashRecord>) -> ResetReason {
    match (reset, last_words.map(|words| words.why)) {
        (ResetCause::PowerOn, _) => ResetReason::PowerOn,
        (ResetCause::BrownOut, _) => ResetReason::BrownOut,
        (_, Some(StopReason::Panic)) => ResetReason::Panic,
        (_, Some(StopReason::HardFault)) => ResetReason::HardFault,
        (_, Some(StopReason::Crystal)) => ResetReason::Crystal,
        (_, Some(StopReason::StackOverflow)) => ResetReason::StackOverflow,
        (_, Some(StopReason::Registers)) => ResetReason::Registers,
        (ResetCause::Watchdog, None) => ResetReason::Watchdog,
        (ResetCause::Software, None) => ResetReason::Software,
        (ResetCause::Pin, None) => ResetReason::Pin,
        (ResetCause::Unknown, None) => ResetReason::Unknown,
    }
}

/// An erase, at least 5.4 s: two sectors of 128 KB take 4 s at most.
const ERASE_TIMEOUT: WatchdogTimeout = WatchdogTimeout { prescaler: 6, reload: 999 };
/// The supervisor feeds it.
const RUN_TIMEOUT: WatchdogTimeout = WatchdogTimeout { prescaler: 6, reload: 12 };

/// The independent watchdog: resets the chip unless it is fed.
///
/// | limit | by its oscillator, 47…32…17 kHz (data sheet) | holds |
/// |---|---|---|
/// | [`independent_watchdog::IMAGE_START_TIMEOUT`] | 0.34…0.50…0.94 s | from the end of the boot program on until the tasks run; each part of the start feeds once |
/// | [`RUN_TIMEOUT`] | 71…104…196 ms | then: ten turns of the supervisor that feeds it, at least seven; well below the 500 ms after which either end of the link counts the other as lost |
/// | [`ERASE_TIMEOUT`] | 5.4…8.0…15 s | while a sector is erased or an option byte written, and no code besides |
pub struct Watchdog(IWDG);

impl Watchdog {
    /// Starts it, first of all parts; it pauses while a debugger halts the core.
    pub fn start(iwdg: IWDG, dbgmcu: &DBGMCU) -> Self {
        independent_watchdog::start(&iwdg, dbgmcu, independent_watchdog::IMAGE_START_TIMEOUT);
        Self(iwdg)
    }

    /// The core has 16 MHz and not 144 or more: the limit of the boot program, 0.54…0.80…1.51 s, because the
    /// two stores are read as slowly.
    pub fn set_slow_clock_timeout(&mut self) {
        independent_watchdog::set_timeout(&self.0, independent_watchdog::BOOT_TIMEOUT);
    }

    /// Does `work`, which may take up to 5.4 s in which no code feeds it.
    pub fn with_extended_timeout<R>(&mut self, work: impl FnOnce() -> R) -> R {
        with_extended_timeout(&self.0, work)
    }

    /// The start is done: from now on it is fed by the supervisor.
    pub fn set_run_timeout(&mut self) {
        independent_watchdog::set_timeout(&self.0, RUN_TIMEOUT);
    }

    /// Lets it wait anew.
    pub fn feed(&mut self) {
        independent_watchdog::feed(&self.0);
    }
}

/// Does `work`, an erase, for one who does not have the watchdog: for the stores, which are opened by the start.
#[allow(unsafe_code, reason = "the watchdog has two users")]
pub fn with_erase_timeout<R>(work: impl FnOnce() -> R) -> R {
    // SAFETY: start and supervisor use it one after the other, and neither while the other is in `work`.
    with_extended_timeout(unsafe { &*IWDG::ptr() }, work)
}

fn with_extended_timeout<R>(iwdg: &RegisterBlock, work: impl FnOnce() -> R) -> R {
    let before = WatchdogTimeout {
        prescaler: iwdg.pr().read().pr().bits(),
        reload: iwdg.rlr().read().rl().bits(),
    };
    independent_watchdog::set_timeout(iwdg, ERASE_TIMEOUT);
    let result = work();
    independent_watchdog::set_timeout(iwdg, before);
    result
}
