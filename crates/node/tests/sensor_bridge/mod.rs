//! A bridge with a sensor, a thermometer and names, as boards of the tests know it.

use trueup_core::{
    calibration::{Calibration, ElongationSource, Names, SpindleModel},
    kinematics::Kinematics,
    limits::Limits,
    sensor::{SensorLaw, Slope},
    thermometer::Thermometer,
    tool::Direction,
    units::{Nanometres, Reading, Temperature},
};

/// A sensor of 1024 nm a code, and a PT100 on the third channel.
pub fn calibration() -> Calibration<'static> {
    let mut thermometers = [None; 8];
    thermometers[2] = Some(Thermometer::Pt100);
    Calibration {
        thermometers,
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
            rejoin_nm_per_s: 10,
            learned: Default::default(),
        },
        cold_within: Temperature(Temperature::PER_KELVIN / 2),
        names: Names { machine: b"gantry", serial: b"17/4", board: [1, 2, 3] },
    }
}
