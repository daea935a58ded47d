//! Decisions of a component of LinuxCNC's HAL, without a HAL, allocation or clock: pins and frames in, pins and frames
//! out.
//!
//! ```text
//!  pins ─► sender ───► frames ─► bridge
//!         offsets ◄─── frames ◄─┘
//!            │ target
//!            ├─► follower ─► counts of an external offset
//!            └─► joint ────► goal of an offset between a joint and its drive
//! ```
//!
//! It runs in two places: in user space with a bridge at the end of a line (`trueup-linuxcnc`), and in the servo thread
//! with the bridge's node next to it (`trueup-servo`). So time and inputs are arguments, nothing allocates, and nothing
//! panics. [`component`] puts the parts together.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod bridge_status;
pub mod component;
pub mod engage;
pub mod joint_offsets;
pub mod offset_follower;
pub mod offset_target;
mod rounding;
pub mod sender;

pub use component::{Component, ComponentInputs, ComponentOptions, ComponentOutputs};

use trueup_core::units;

/// Offsets are counted in nanometres, the user's limits in micrometres, the axes' speeds in mm.
pub const NANOMETRES_PER_MICROMETRE: f64 = units::NANOMETRES_PER_MICROMETRE as f64;
/// Nanometres in one millimetre.
pub const NANOMETRES_PER_MILLIMETRE: f64 = 1e6;
