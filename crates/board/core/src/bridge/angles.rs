//! The angles of the rotary axes: the tool direction goes with them, and the errors of the volume.

use super::{Bridge, state::State};
use crate::units::MicroDegrees;

impl Bridge<'_> {
    /// Takes angles from the CNC. The direction and the errors are computed when they have changed.
    pub(super) fn receive_angles(&self, state: &mut State, angles: [MicroDegrees; 2]) {
        let kinematics = &self.calibration.kinematics;
        let direction = match state.tool.latest() {
            Some((known, direction)) if known == angles => direction,
            _ if self.needs.rotary => kinematics.direction(angles),
            _ => kinematics.zero,
        };
        state.receive_angles(angles, direction);
        if self.needs.volume_angles && state.place.angles != angles {
            state.place.angles = angles;
            self.update(state, |errors, _, place| errors.turned(&self.calibration, place));
        }
    }
}
