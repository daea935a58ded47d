//! What the trueup bridge computes, in integers, on any machine.
#![no_std]
#![forbid(unsafe_code)]

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
