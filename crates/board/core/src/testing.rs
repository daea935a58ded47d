//! Shared parts of the tests: numbers that look drawn, always the same for a seed, and a machine to begin with.

use crate::{
    calibration::{Calibration, MachineIdentity},
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    kinematics::Kinematics,
    limits::CompensationLimits,
    tool_direction::ToolDirection,
    units::{Nanometres, Temperature},
};

/// Steps a linear congruential generator. Returns its high half.
pub fn next_random(seed: &mut u64) -> u32 {
    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 32) as u32
}

/// Returns a machine with nothing but limits.
pub fn minimal_calibration() -> Calibration<'static> {
    Calibration {
        thermometers: [None; TEMPERATURE_CHANNEL_COUNT],
        spindle: Default::default(),
        kinematics: Kinematics { zero: ToolDirection::DOWN, axes: [None; 2] },
        axes: Default::default(),
        straightness: Default::default(),
        squareness: Default::default(),
        volume: None,
        terms: Default::default(),
        limits: CompensationLimits {
            max: [Nanometres(200_000), Nanometres(200_000), Nanometres(500_000)],
            slew_nm_per_s: 1_000_000,
            link_timeout_ms: 500,
            hold_ms: 2_000,
            rejoin_nm_per_s: 10,
            learned: Default::default(),
        },
        cold_within: Temperature(Temperature::PER_KELVIN / 2),
        guards: Default::default(),
        names: MachineIdentity::default(),
    }
}
