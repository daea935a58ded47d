//! A bridge with a sensor, a thermometer and names, as boards of the tests know it.

use trueup_core::{
    calibration::{Calibration, MachineIdentity},
    limits::CompensationLimits,
    thermometer::Thermometer,
    units::Nanometres,
};

#[path = "../../src/node/example.rs"]
mod example;

/// Returns a sensor of 1024 nm a code, and a PT100 on the third channel.
pub fn calibration() -> Calibration<'static> {
    let mut thermometers = [None; 8];
    thermometers[2] = Some(Thermometer::Pt100);
    let example = example::sensor_only_calibration();
    Calibration {
        // What its codes say may be zeroed.
        limits: CompensationLimits { max: [Nanometres(4_000_000); 3], ..example.limits },
        thermometers,
        guards: Default::default(),
        names: MachineIdentity { machine: b"gantry", serial: b"17/4", board: [1, 2, 3] },
        ..example
    }
}
