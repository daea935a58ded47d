//! The bridge without a board: its node runs in the servo thread of LinuxCNC.
//!
//! ```text
//!  HAL pins ─► hal/trueup_node.c ─► abi ─► servo ─► sensor, temperature ─► node (the board's application)
//!  HAL pins ◄─ hal/trueup_node.c ◄─ abi ◄─────── component ◄─ frames ◄──────┘
//! ```
//!
//! The node is the same as on the board, and so is what LinuxCNC does with its offsets (`trueup-linuxcnc-core`): both
//! exchange the frames of the link, within one call a servo period ([`servo`]). Here analogue inputs
//! of LinuxCNC replace the measuring inputs of a board: [`sensor`] makes codes of volts, [`temperature`] the
//! deliveries of thermometers of degrees.
//!
//! The crate is linked as a static library to a component in C, which has the pins ([`ffi`], the only file with
//! `unsafe`). Nothing in a servo period allocates, makes a system call or panics, and every loop has a bound.
#![no_std]
#![deny(unsafe_code)]

pub mod component;
pub mod ffi;
#[cfg(trueup_library)]
mod panic_handler;
pub mod sensor;
pub mod servo;
pub mod temperature;

#[cfg(test)]
extern crate std;

pub use servo::{ComponentOutputs, ServoBridge, ServoInputs, ServoSettings};
