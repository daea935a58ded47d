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

pub mod binary;
pub mod busy;
pub mod call_graph;
pub mod chip;
pub mod chip_live;
pub mod cnc;
mod compile;
pub mod firmware;
mod frames;
pub mod images;
pub mod linuxcnc;
pub mod measure;
pub mod plc;
pub mod process;
pub mod programs;
pub mod rtt;
pub mod seal;
pub mod setup;
pub mod size;
pub mod slots;

pub use trueup_virtual_bridge::{board, front_end, log, plant, qemu, replay, serve, stand_in};
