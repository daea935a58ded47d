//! The angles of the rotary axes: the tool direction and the errors of the volume depend on them.

use super::{Bridge, state::BridgeState};
use crate::units::MicroDegrees;

impl Bridge<'_> {
    /// Takes angles from the CNC. The direction and the errors are computed when they have changed.
    pub(super) fn receive_angles(&self, state: &mut BridgeState, angles: [MicroDegrees; 2]) {
        let kinematics = &self.calibration.kinematics;
        let direction = match state.tool.latest() {
            Some((known, direction)) if known == angles => direction,
            _ if self.needs.rotary => kinematics.tool_direction(angles),
            _ => kinematics.zero,
        };
        state.receive_angles(angles, direction);
        if self.needs.volume_angles && state.place.angles != angles {
            state.place.angles = angles;
            self.update_errors(state, |errors, _, place| {
                errors.update_rotary_angles(&self.calibration, place)
            });
        }
    }
}
