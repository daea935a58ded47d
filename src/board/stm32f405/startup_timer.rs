//! Time while the clocks are still being chosen: SysTick counts the core's cycles.

use cortex_m::peripheral::{SYST, syst::SystClkSource};

use super::poll_until;

/// All bits of SysTick's counter, which counts down.
const COUNTER_MASK: u32 = 0xFF_FFFF;

/// Lets it count.
pub fn start(systick: &mut SYST) {
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(COUNTER_MASK);
    systick.clear_current();
    systick.enable_counter();
}

/// Returns what [`cycles_since`] counts from.
pub fn now() -> u32 {
    SYST::get_current()
}

/// Core cycles since then, below 2²⁴.
pub fn cycles_since(start: u32) -> u32 {
    start.wrapping_sub(now()) & COUNTER_MASK
}

/// Returns whether `ready` came true within this many core cycles, below 2²⁴, by SysTick. A poll takes some cycles,
/// so that many polls are the limit where SysTick stands.
pub fn poll_with_timeout(cycles: u32, mut ready: impl FnMut() -> bool) -> bool {
    let start = now();
    let mut is_ready = false;
    poll_until(cycles, || {
        is_ready = ready();
        is_ready || cycles_since(start) >= cycles
    });
    is_ready || ready()
}
