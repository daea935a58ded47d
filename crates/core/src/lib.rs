//! What the trueup bridge computes, in integers, on any machine.
#![no_std]
#![forbid(unsafe_code)]

pub mod calibration;
pub mod cnc;
pub mod limits;
pub mod sensor;
pub mod tool;
pub mod units;
