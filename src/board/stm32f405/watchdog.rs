//! The watchdog, and what the last reset came from (sections 21 and 7.3.21).

#[path = "../../bin/boot/watchdog.rs"]
mod limit;

use trueup_link::status::ResetReason;

use super::crash_record::{CrashRecord, StopReason};
use limit::Limit;
use stm32f4xx_hal::pac::{DBGMCU, IWDG, RCC, iwdg::RegisterBlock};

/// Cause of the last reset.
#[derive(Clone, Copy, PartialEq, Eq, defmt::Format)]
pub enum Reset {
    /// The supervisor had stopped.
    Watchdog,
    /// A panic, the crystal stopped, or a CANopen master asked for it.
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
/// counts as a brown-out as well, so the rarest cause is asked for first.
pub fn last_reset(rcc: &RCC) -> Reset {
    let flags = rcc.csr().read();
    rcc.csr().modify(|_, w| w.rmvf().clear());
    if flags.wdgrstf().bit_is_set() || flags.wwdgrstf().bit_is_set() {
        Reset::Watchdog
    } else if flags.sftrstf().bit_is_set() {
        Reset::Software
    } else if flags.porrstf().bit_is_set() {
        Reset::PowerOn
    } else if flags.borrstf().bit_is_set() {
        Reset::BrownOut
    } else if flags.padrstf().bit_is_set() {
        Reset::Pin
    } else {
        Reset::Unknown
    }
}

/// Why the board started, as it reports it: a reset by software has several reasons, and a watchdog that bit
/// while the board was ending itself is not the first of them.
pub fn reason(reset: Reset, last_words: Option<&CrashRecord>) -> ResetReason {
    match (reset, last_words.map(|words| words.why)) {
        (Reset::PowerOn, _) => ResetReason::PowerOn,
        (Reset::BrownOut, _) => ResetReason::BrownOut,
        (_, Some(StopReason::Panic)) => ResetReason::Panic,
        (_, Some(StopReason::HardFault)) => ResetReason::HardFault,
        (_, Some(StopReason::Crystal)) => ResetReason::Crystal,
        (_, Some(StopReason::StackOverflow)) => ResetReason::StackOverflow,
        (_, Some(StopReason::Registers)) => ResetReason::Registers,
        (Reset::Watchdog, None) => ResetReason::Watchdog,
        (Reset::Software, None) => ResetReason::Software,
        (Reset::Pin, None) => ResetReason::Pin,
        (Reset::Unknown, None) => ResetReason::Unknown,
    }
}

/// An erase, at least 5.4 s: two sectors of 128 KB take 4 s at most.
const ERASE: Limit = Limit { prescaler: 6, reload: 999 };
/// The supervisor feeds it.
const RUN: Limit = Limit { prescaler: 6, reload: 12 };

/// The independent watchdog: resets the chip unless it is fed.
///
/// | limit | by its oscillator, 47…32…17 kHz (data sheet) | holds |
/// |---|---|---|
/// | [`limit::START`] | 0.34…0.50…0.94 s | from the end of the boot program on until the tasks run; each part of the start feeds once |
/// | [`RUN`] | 71…104…196 ms | then: ten turns of the supervisor that feeds it, at least seven; well below the 500 ms after which either end of the link counts the other as lost |
/// | [`ERASE`] | 5.4…8.0…15 s | while a sector is erased or an option byte written, and no code besides |
pub struct Watchdog(IWDG);

impl Watchdog {
    /// Starts it, first of all parts; it pauses while a debugger halts the core.
    pub fn start(iwdg: IWDG, dbgmcu: &DBGMCU) -> Self {
        limit::start(&iwdg, dbgmcu, limit::START);
        Self(iwdg)
    }

    /// The core has 16 MHz and not 144 or more: the limit of the boot program, 0.54…0.80…1.51 s, because the
    /// two stores are read as slowly.
    pub fn slow_down(&mut self) {
        limit::set(&self.0, limit::CHOICE);
    }

    /// Does `work`, which may take up to 5.4 s in which nobody feeds it.
    pub fn loosened<R>(&mut self, work: impl FnOnce() -> R) -> R {
        loosened(&self.0, work)
    }

    /// The start is done: from now on it is fed by the supervisor.
    pub fn tighten(&mut self) {
        limit::set(&self.0, RUN);
    }

    /// Lets it wait anew.
    pub fn feed(&mut self) {
        limit::feed(&self.0);
    }
}

/// Does `work`, an erase, for one who does not have the watchdog: for the stores, which are opened by the start.
#[allow(unsafe_code, reason = "the watchdog has two users")]
pub fn while_erasing<R>(work: impl FnOnce() -> R) -> R {
    // SAFETY: start and supervisor use it one after the other, and neither while the other is in `work`.
    loosened(unsafe { &*IWDG::ptr() }, work)
}

fn loosened<R>(iwdg: &RegisterBlock, work: impl FnOnce() -> R) -> R {
    let before =
        Limit { prescaler: iwdg.pr().read().pr().bits(), reload: iwdg.rlr().read().rl().bits() };
    limit::set(iwdg, ERASE);
    let result = work();
    limit::set(iwdg, before);
    result
}
