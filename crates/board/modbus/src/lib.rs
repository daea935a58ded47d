//! The bridge as registers, for every control whose PLC speaks Modbus, and, with the same bytes, for a
//! data block of an S7.
//!
//! ```text
//!   offsets, state ──► input::Input ──► block of registers ─┐            ┌── TCP (trueup gateway)
//!                                          (table)          ├─ server ───┤
//!   Control, positions ◄── cnc::Checker ◄── block ──────────┘            └── rtu::Slave (a serial line)
//! ```
//!
//! [`register_map`] is the one description of both blocks: code, documentation and the PLC programs of
//! `integrations` have their numbers from it. Each block is read or written whole, in one request, and
//! carries a counter and a CRC, so that a copy of it in two halves is detected.
//!
//! Nothing here allocates, reads a clock, or panics on any input.
#![no_std]
#![forbid(unsafe_code)]
// A test that overflows fails, which is what a test is for.
#![cfg_attr(test, allow(clippy::arithmetic_side_effects))]

#[cfg(test)]
extern crate std;

pub mod e2e;
pub mod holding_block;
pub mod input_block;
pub mod input_block_with_slopes;
pub mod register_map;
pub mod rtu;
pub mod server;
