//! What the trueup bridge computes, in integers, on any machine.
//!
//! ```text
//! bridge = health ─► filter (window, revolution_mean) ─► sensor ─► tool ─► limits
//! ```
//!
//! Configuration ([`calibration`]) and state ([`bridge::State`]) are apart, time is an argument,
//! and nothing here knows hardware, allocates or panics.
#![no_std]
#![forbid(unsafe_code)]
// A test that overflows fails, which is what a test is for.
#![cfg_attr(
    test,
    allow(
        clippy::arithmetic_side_effects,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )
)]

pub mod bridge;
pub mod calibration;
pub mod cnc;
pub mod filter;
pub mod health;
pub mod limits;
pub mod revolution_mean;
pub mod sensor;
pub mod tool;
pub mod units;
pub mod window;
