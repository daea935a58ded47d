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
pub mod call_graph;
pub mod chip;
pub mod cnc_client;
mod firmware_build;
pub mod firmware_images;
pub mod flash_image;
pub mod full_load;
pub mod host_programs;
pub mod image_check;
pub mod linuxcnc;
pub mod lockstep_chip;
pub mod memory_usage;
pub mod plc_requests;
pub mod process;
pub mod release_images;
pub mod rtt;
pub mod setup;
pub mod slot_images;
mod stack_frames;
mod stale_shared_memory;

pub use trueup_virtual_bridge::{
    analogue_front_end, board, cnc_emulator, log, plant, qemu, replay, serve,
};
