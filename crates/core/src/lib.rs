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

pub mod angle;
pub mod bridge;
pub mod calibration;
pub mod channels;
pub mod cnc;
pub mod curve;
pub mod dimensions;
pub mod filter;
pub mod fixed;
pub mod geometry;
pub mod gradient;
pub mod health;
pub mod heat;
pub mod kinematics;
pub mod lag;
pub mod limits;
pub mod pitch;
pub mod place;
pub mod pt100;
pub mod revolution_mean;
pub mod sensor;
pub mod set;
pub mod term;
#[cfg(test)]
mod testing;
pub mod thermal;
pub mod thermometer;
pub mod tip;
pub mod tool;
pub mod travel;
pub mod units;
pub mod warmup;
pub mod window;
