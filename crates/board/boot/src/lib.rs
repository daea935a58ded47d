//! Two firmware slots, and the decision which of them starts.
//!
//! ```text
//!   0x0800_0000  boot program        sectors 0, 1      32 KB   never written by an update
//!   0x0800_8000  records             sectors 2, 3      2 × 16 KB
//!   0x0801_0000  slot A              sectors 4, 5      192 KB
//!   0x0804_0000  slot B              sectors 6, 7      192 KB of 256
//!   0x0808_0000  calibrations, log   sectors 8 to 11   not touched by an update
//! ```
//!
//! `flash_layout` has these places once, `header` the 512 bytes in front of an image, `image_check` whether a slot holds
//! an image that may run, `record` the state of the slots and `journal` its way into the flash, `start` the
//! decision, `handover` its way to the image that starts, `update` the way of a new image into the spare slot and its confirmation, `refusal` why one is refused, `key` the signature.
//!
//! # An update
//!
//! | step | who | state of the spare slot |
//! |---|---|---|
//! | the header is accepted, then the slot is erased | application | [`boot_state::ImageStatus::Loading`] |
//! | all bytes are written; CRC and signature hold in the flash | application | [`boot_state::ImageStatus::Verified`] |
//! | it is the newest, and starts | boot program | [`boot_state::ImageStatus::Trial`], at most [`boot_state::MAX_TRIAL_STARTS`] starts |
//! | it ran well for a minute after an engage | application | [`boot_state::ImageStatus::Confirmed`], and the floor rises |
//! | or: it crashed, hung, or was not confirmed in time | boot program | [`boot_state::ImageStatus::Rejected`] |
//!
//! The state is committed before the step that it permits, and settled before it is believed: see `journal`.
//! So a power cut at any word leaves a slot that starts.
//!
//! Nothing here touches hardware, allocates, reads a clock, or panics on any input.
#![no_std]
#![forbid(unsafe_code)]
// A test that overflows fails, which is what a test is for.
#![cfg_attr(test, allow(clippy::arithmetic_side_effects, clippy::cast_possible_truncation))]

#[cfg(test)]
extern crate std;

pub mod boot_state;
mod crc;
#[cfg(test)]
mod cuts;
pub mod flash_layout;
pub mod handover;
mod hash;
pub mod image_check;
pub mod image_header;
pub mod journal;
pub mod public_key;
pub mod reject_reason;
pub mod start;
#[cfg(test)]
mod testing;
pub mod update;
