//! How the bridge, the CNC and the host speak to each other: the one definition that the board,
//! the host tool and the tests share.
//!
//! ```text
//!            Output                          Command
//!              │                                ▲
//!   frames ────▼── encode           decode ─────┴──── frames      layout = trueup.dbc
//!   e2e    ────▼── protect           check ─────▲──── receiver
//!   frame  ────▼──────── CAN 2.0 ───────────────┴──── frame
//!   slcan  ────▼──────── ASCII lines ───────────┴──── slcan
//! ```
//!
//! `calibration` is the layout of what the host compiles for the board, `reference` of what the
//! board stores of itself, `max31865` what it says to its temperature converters, `bench` the
//! stream between the host and the emulated board, `node` the whole bridge as it stands on the bus.
//! For a CANopen master, `dictionary` (= trueup.eds) is what it can read and write, `sdo` how,
//! `load` what becomes of a calibration it writes, `slots` where a board keeps it, and `emergency`
//! what the bridge tells unasked. `status` is what it tells of itself ten times a second.
//! Nothing here touches hardware, allocates, reads a clock, or panics on any input.
#![no_std]
#![forbid(unsafe_code)]
// A test that overflows fails, which is what a test is for.
#![cfg_attr(test, allow(clippy::arithmetic_side_effects))]

#[cfg(test)]
extern crate std;

pub mod bench;
pub mod bits;
pub mod calibration;
pub mod dictionary;
pub mod e2e;
pub mod emergency;
pub mod frame;
pub mod frames;
pub mod layout;
pub mod load;
pub mod max31865;
pub mod node;
pub mod receiver;
pub mod reference;
pub mod sdo;
pub mod slcan;
pub mod slots;
pub mod status;
#[cfg(test)]
mod strict_flash;
pub mod vectors;

/// The signal description that CAN tools read; `layout` holds the same numbers for the code.
pub const DBC: &str = include_str!("../trueup.dbc");

/// The electronic data sheet that CANopen tools read, printed from `dictionary`.
pub const EDS: &str = include_str!("../trueup.eds");
