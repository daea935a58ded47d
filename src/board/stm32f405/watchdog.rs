//! The watchdog, and what the last reset came from (sections 21 and 7.3.21).

use trueup_link::status::ResetReason;

use super::{
    MILLISECOND,
    last_words::{LastWords, Why},
};
use stm32f4xx_hal::{
    pac::{DBGMCU, IWDG, RCC},
    prelude::*,
    watchdog::IndependentWatchdog,
};

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
pub fn reason(reset: Reset, last_words: Option<&LastWords>) -> ResetReason {
    match (reset, last_words.map(|words| words.why)) {
        (Reset::PowerOn, _) => ResetReason::PowerOn,
        (Reset::BrownOut, _) => ResetReason::BrownOut,
        (_, Some(Why::Panic)) => ResetReason::Panic,
        (_, Some(Why::HardFault)) => ResetReason::HardFault,
        (_, Some(Why::Crystal)) => ResetReason::Crystal,
        (_, Some(Why::StackOverflow)) => ResetReason::StackOverflow,
        (_, Some(Why::Registers)) => ResetReason::Registers,
        (Reset::Watchdog, None) => ResetReason::Watchdog,
        (Reset::Software, None) => ResetReason::Software,
        (Reset::Pin, None) => ResetReason::Pin,
        (Reset::Unknown, None) => ResetReason::Unknown,
    }
}

/// The independent watchdog: resets the chip unless it is fed.
///
/// 100 ms are ten turns of the supervisor that feeds it. Its oscillator is not exact (17…47 kHz,
/// data sheet): the true limit lies between 70 and 196 ms, at least seven turns, and well below
/// the 500 ms after which either end of the link counts the other as lost.
pub struct Watchdog(IndependentWatchdog);

impl Watchdog {
    /// Starts it, first of all parts, and nothing but a reset stops it again; it pauses while a debugger
    /// halts the core. A start has 8 s by the watchdog's own clock, at least 5.4 s: erasing two sectors of
    /// the flash takes 4 s at most.
    pub fn start(iwdg: IWDG, dbgmcu: &DBGMCU) -> Self {
        let mut watchdog = Self(IndependentWatchdog::new(iwdg));
        watchdog.0.stop_on_debug(dbgmcu, true);
        watchdog.loosen();
        watchdog
    }

    /// Lets a start or an erase take its time. The longer limit holds from the next [`Self::feed`] on that comes a
    /// millisecond later: its registers take five periods of its oscillator, 0.3 ms at most (section 21.4.4).
    pub fn loosen(&mut self) {
        self.0.start(8_000.millis());
    }

    /// Does `work`, which may take up to 5.4 s in which nobody feeds it.
    pub fn loosened<R>(&mut self, work: impl FnOnce() -> R) -> R {
        self.loosen();
        // Until it counts by the new limit.
        cortex_m::asm::delay(MILLISECOND);
        self.feed();
        let result = work();
        self.tighten();
        result
    }

    /// The start is done: from now on it is fed by the supervisor.
    pub fn tighten(&mut self) {
        self.0.start(100.millis());
    }

    /// Another 100 ms.
    pub fn feed(&mut self) {
        self.0.feed();
    }
}
