//! The application of the bridge without any hardware: the same code on the board and in the tests
//! of the host.
//!
//! ```text
//!   CNC, master ── frames ──► node ── frames ──► CNC, master
//!                 samples ──►  │
//!          core: the law ◄─────┤
//!          canopen, store ◄────┤
//!                 start ◄──────┤          vectors ──► random inputs of a node, for a checksum
//!                              └► shown: live values for the log, in µm
//! ```
//!
//! Nothing here touches hardware, allocates, reads a clock, or panics on any input.
#![no_std]
#![forbid(unsafe_code)]
// A test that overflows fails, which is what a test is for.
#![cfg_attr(test, allow(clippy::arithmetic_side_effects))]

#[cfg(test)]
extern crate std;

pub mod configuration;
pub(crate) mod display_values;
pub mod node;
pub mod reset_info;
pub mod test_vectors;
