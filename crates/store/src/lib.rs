//! What the bridge stores: the calibration as one blob, and the flash that keeps what outlasts the
//! power.
//!
//! `calibration` is the layout of what the host compiles for the board, `load` the way of a new one
//! to the board, `slots` where a board keeps it, and `reference` what the board stores of itself.
//! Nothing here touches hardware, allocates, reads a clock, or panics on any input.
#![no_std]
#![forbid(unsafe_code)]
// A test that overflows fails, which is what a test is for.
#![cfg_attr(test, allow(clippy::arithmetic_side_effects))]

#[cfg(test)]
extern crate std;

pub mod calibration;
mod crc;
pub mod load;
mod log;
pub mod reference;
pub mod slots;
#[cfg(test)]
mod strict_flash;

pub use log::StoreError;

/// A bridge with a sensor and nothing else.
#[cfg(test)]
fn test_calibration() -> trueup_core::calibration::Calibration<'static> {
    use trueup_core::{
        calibration::{Calibration, ElongationSource, SpindleModel},
        kinematics::Kinematics,
        limits::Limits,
        sensor::{SensorLaw, Slope},
        tool::Direction,
        units::{Nanometres, Reading},
    };
    Calibration {
        thermometers: [None; 8],
        spindle: SpindleModel {
            chain: [Some(ElongationSource::Sensor), None, None],
            sensor: SensorLaw { k0: Nanometres(0), zero: Reading(0), slope: Slope(1 << 28) },
            ..SpindleModel::default()
        },
        kinematics: Kinematics { zero: Direction::DOWN, axes: [None; 2] },
        axes: Default::default(),
        straightness: Default::default(),
        squareness: Default::default(),
        terms: Default::default(),
        limits: Limits {
            max: [Nanometres(500_000); 3],
            slew_nm_per_s: 1_000,
            link_timeout_ms: 500,
            hold_ms: 2_000,
        },
    }
}
