//! The bridge on the bench: its real firmware in QEMU, an analogue front end before it, and the
//! CNC's end of its link.
//!
//! ```text
//!  run file, plant ─► replay ─► front_end ─► board (QEMU) ─► cnc ─► tests
//! ```
//!
//! The board, its front end and the replay are the virtual bridge's (`trueup-virtual-bridge`), which users have, too.
//! `setup` gets what a fresh machine lacks and `firmware` builds the images, so that each command
//! of the project does its own preparation.
#![forbid(unsafe_code)]

pub mod benchmark;
pub mod binary;
pub mod call_graph;
pub mod chip;
pub mod cnc;
mod compile;
pub mod firmware;
pub mod full_load;
pub mod host_programs;
pub mod images;
pub mod linuxcnc;
pub mod lockstep_chip;
pub mod plc;
pub mod process;
pub mod rtt;
pub mod seal;
pub mod setup;
pub mod size;
pub mod slots;
mod stack_frames;

pub use trueup_virtual_bridge::{board, cnc_emulator, front_end, log, plant, qemu, replay, serve};
