//! The calibration that the tests of this folder run on.

use trueup_core::{
    calibration::{Calibration, ElongationSource, MachineIdentity, SpindleModel},
    displacement_sensor::{SensorLaw, SensorSlope},
    kinematics::Kinematics,
    limits::CompensationLimits,
    tool_direction::ToolDirection,
    units::{Nanometres, SensorReading, Temperature},
};

/// Returns a bridge with a sensor and nothing else.
pub(crate) fn sensor_only_calibration() -> Calibration<'static> {
    Calibration {
        thermometers: [None; 8],
        spindle: SpindleModel {
            chain: [Some(ElongationSource::Sensor), None, None],
            sensor: SensorLaw {
                k0: Nanometres(0),
                zero: SensorReading(0),
                slope: SensorSlope(1 << 28),
            },
            ..SpindleModel::default()
        },
        kinematics: Kinematics { zero: ToolDirection::DOWN, axes: [None; 2] },
        axes: Default::default(),
        straightness: Default::default(),
        squareness: Default::default(),
        volume: None,
        terms: Default::default(),
        limits: CompensationLimits {
            max: [Nanometres(500_000); 3],
            slew_nm_per_s: 1_000,
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
