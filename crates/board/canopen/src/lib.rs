//! The bridge as a CANopen node (CiA 301): what a master can ask of it, and what it says unasked.
//!
//! ```text
//!   a master                                       the bridge
//!   sdo::client ── request ──► sdo::Server ── reads, writes ──► dictionary = trueup.eds
//!               ◄── answer ──                                        │ sdo::Objects
//!   network     ── reset ────►                                  the node's own values
//!               ◄── emergency, heartbeat ──
//! ```
//!
//! `dictionary` is what a master can read and write, `sdo` how, `nmt` what it can command,
//! `emergency` how the bridge reports its faults, `fault` which there are, `heartbeat` whose silence it reports.
//! Nothing here touches hardware, allocates, reads a clock, or panics on any input.
#![no_std]
#![forbid(unsafe_code)]
// A test that overflows fails, which is what a test is for.
#![cfg_attr(test, allow(clippy::arithmetic_side_effects))]

#[cfg(test)]
extern crate std;

pub mod dictionary;
pub mod emergency;
mod fault;
pub mod heartbeat;
pub mod nmt;
pub mod sdo;

/// The electronic data sheet that CANopen tools read, printed from `dictionary`.
pub const EDS: &str = include_str!("../trueup.eds");
