//! The bridge on the bench: its real firmware in QEMU, an analogue front end before it, and the
//! CNC's end of its link.
//!
//! ```text
//!  run file, plant ─► replay ─► front_end ─► board (QEMU) ─► cnc ─► serve ─► virtual_bridge, tests
//! ```
//!
//! `setup` gets what a fresh machine lacks and `firmware` builds the images, so that each command
//! of the project does its own preparation.
#![forbid(unsafe_code)]

pub mod binary;
pub mod board;
pub mod busy;
pub mod call_graph;
pub mod chip;
pub mod chip_live;
pub mod cnc;
mod compile;
pub mod firmware;
mod frames;
pub mod front_end;
pub mod gauge;
pub mod hand;
pub mod images;
pub mod linuxcnc;
pub mod log;
pub mod measure;
pub mod plant;
pub mod plc;
pub mod process;
pub mod programs;
pub mod qemu;
pub mod replay;
pub mod rtt;
pub mod seal;
pub mod serve;
pub mod setup;
pub mod size;
pub mod slots;
pub mod stand_in;
pub mod virtual_bridge;
