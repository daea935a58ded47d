//! The angles of the rotary axes: the tool direction and the errors of the volume depend on them.

use super::{Bridge, cached_errors::ErrorInput, state::BridgeState};
use crate::units::MicroDegrees;

impl Bridge<'_> {
    /// Takes angles from the CNC. The direction and the errors are computed when they have changed.
    pub(super) fn receive_angles(&self, state: &mut BridgeState, angles: [MicroDegrees; 2]) {
        if state.receive_angles(angles, self.calibration.kinematics.zero) {
            self.update_or_defer_errors(state, ErrorInput::Angles);
        }
    }

    /// Computes what depends on the angles, on reception.
    // A function of its own in the image: its time is bounded by how often it is called (`cargo xtask bounds`), which `update_or_defer_errors`
    // limits.
    #[inline(never)]
    pub(super) fn update_angles(&self, state: &mut BridgeState) {
        if self.apply_received_angles(state) {
            state.error_sums = None;
        }
    }

    /// Computes the direction of the tool and the errors of the rotary axes at the angles that were last received. Returns whether
    /// these errors have changed.
    pub(super) fn apply_received_angles(&self, state: &mut BridgeState) -> bool {
        let Some((angles, direction)) = state.tool_orientation_mut() else { return false };
        let angles = *angles;
        if self.needs.rotary {
            *direction = self.calibration.kinematics.tool_direction(angles);
        }
        let has_turned = self.needs.volume_angles && state.place.angles != angles;
        if has_turned {
            state.place.angles = angles;
            state.errors.update_rotary_angles(&self.calibration, &state.place);
        }
        has_turned
    }
}
