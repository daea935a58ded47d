//! The virtual bridge: the real firmware in QEMU, an analogue front end before it, and its line on a TCP port.
//!
//! ```text
//!  run file, plant ─► replay ─► front_end ─► board (QEMU) ─► serve ─► any client
//! ```
//!
//! `trueup virtual` and `cargo virtual` run it; the bench plays single boards of it ([`board`]).
#![forbid(unsafe_code)]

pub mod analogue_front_end;
pub mod board;
mod bridge;
pub mod cnc_emulator;
pub mod gauge;
pub mod log;
pub(crate) mod operator_controls;
pub mod plant;
pub mod program;
pub mod qemu;
pub mod replay;
pub mod serve;

pub use bridge::{BridgeOptions, run};
