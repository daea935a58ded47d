//! How the bridge, the CNC and the host speak to each other: the one definition that the board,
//! the host tool and the tests share.
//!
//! ```text
//!            Output                          Command
//!              │                                ▲
//!   frames ────▼── encode           decode ─────┴──── frames      layout = trueup.dbc
//!   e2e    ────▼── protect           check ─────▲──── stream, receiver
//!   frame  ────▼──────── CAN 2.0 ───────────────┴──── frame
//!   slcan  ────▼──────── ASCII lines ───────────┴──── slcan
//! ```
//!
//! `byte_queue` holds the serial line's bytes until a task reads them. `bits` places a signal in a frame, `status` is what the bridge reports of itself ten times a
//! second. The CANopen side of the bridge stands in `trueup-canopen`, what the bridge
//! stores in `trueup-store`, and the whole of it, as it stands on the bus, in `trueup-node`.
//! Nothing here touches hardware, allocates, reads a clock, or panics on any input.
#![no_std]
#![forbid(unsafe_code)]
// A test that overflows fails, which is what a test is for.
#![cfg_attr(test, allow(clippy::arithmetic_side_effects))]

#[cfg(test)]
extern crate std;

pub mod byte_queue;
pub mod e2e;
pub mod e2e_state_machine;
pub mod frame;
pub mod frames;
pub mod layout;
pub mod receiver;
pub mod signal;
pub mod slcan;
pub mod status;

/// The signal description that CAN tools read, printed from the table of `layout`.
pub const DBC: &str = include_str!("../trueup.dbc");
