//! The simulation's time: whole ticks, so that no clock of the chip is rounded.

/// Ticks in a second: a whole number of them is in a cycle of 168, 144, 84, 42, 25, 16, 12 and 8 MHz.
pub const TICKS_PER_SECOND: u64 = 25_200_000_000;
/// Later than everything.
pub const NEVER: u64 = u64::MAX;

/// Ticks in this many microseconds.
#[must_use]
pub const fn us_to_ticks(n: u64) -> u64 {
    n * (TICKS_PER_SECOND / 1_000_000)
}

/// Ticks in this many milliseconds.
#[must_use]
pub const fn ms_to_ticks(n: u64) -> u64 {
    n * (TICKS_PER_SECOND / 1_000)
}

/// Seconds in this many ticks.
#[must_use]
pub fn ticks_to_seconds(ticks: u64) -> f64 {
    ticks as f64 / TICKS_PER_SECOND as f64
}

/// Microseconds in this many ticks.
#[must_use]
pub fn ticks_to_us(ticks: u64) -> f64 {
    ticks_to_seconds(ticks) * 1e6
}

/// Whole nanoseconds in this many ticks.
#[must_use]
pub fn ticks_to_ns(ticks: u64) -> u64 {
    (u128::from(ticks) * 1_000_000_000 / u128::from(TICKS_PER_SECOND)) as u64
}
