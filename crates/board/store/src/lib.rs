//! The bridge's store: the calibration as one blob, and the flash that keeps what outlasts the
//! power.
//!
//! `calibration` is the layout of what the host compiles for the board, `load` the way of a new one
//! to the board, `slots` where a board keeps it, `reference` what the board stores of itself,
//! `writes` who has written to it, `rate_limit` how often it may,
//! `retained` what outlasts a reset in RAM and a power cut behind a battery, and `calendar` the time of a
//! clock there.
//! Nothing here touches hardware, allocates, reads a clock, or panics on any input.
#![no_std]
#![forbid(unsafe_code)]
// A test that overflows fails, which is what a test is for.
#![cfg_attr(test, allow(clippy::arithmetic_side_effects, clippy::cast_possible_truncation))]

#[cfg(any(test, feature = "strict-flash"))]
extern crate std;

pub mod calendar;
pub mod calibration;
pub mod calibration_load;
pub mod calibration_store;
mod crc;
mod flash_log;
pub mod rate_limit;
pub mod reference;
pub mod retained_state;
#[cfg(any(test, feature = "strict-flash"))]
#[allow(
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    reason = "it is for tests"
)]
pub mod simulated_nor_flash;
pub mod write_log;

pub use flash_log::StoreError;
