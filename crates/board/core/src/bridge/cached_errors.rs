//! The errors of the axes: computed whole once before the first tick, kept from message to message, and added up when
//! they are requested.

use super::{Bridge, state::BridgeState};
use crate::{
    axis_errors::{CachedErrors, ErrorSums},
    cnc::LinearAxis,
    machine_position::MachinePosition,
    thermal_state::MachineThermalState,
};

impl Bridge<'_> {
    /// Returns the state of a bridge that has just been switched on.
    #[must_use]
    pub fn initial_state(&self) -> BridgeState {
        let errors = CachedErrors::from_position(
            &self.calibration,
            &MachineThermalState::default(),
            &MachinePosition::default(),
        );
        BridgeState::with_errors(errors)
    }

    /// Computes all errors. No tick and no message does: it takes as long as all the messages that change a part.
    pub fn compute_errors(&self, state: &mut BridgeState) {
        state.errors = CachedErrors::from_position(&self.calibration, &state.heat, &state.place);
        state.error_sums = None;
    }

    /// Returns the errors of the axes at the present place.
    #[inline]
    pub(super) fn axis_errors(&self, state: &mut BridgeState) -> ErrorSums {
        match state.error_sums {
            Some(sums) => sums,
            None => self.sum_errors(state),
        }
    }

    #[inline(never)]
    fn sum_errors(&self, state: &mut BridgeState) -> ErrorSums {
        let sums = self.compute_error_sums(&mut state.errors, &state.place);
        *state.error_sums.insert(sums)
    }

    fn compute_error_sums(&self, errors: &mut CachedErrors, place: &MachinePosition) -> ErrorSums {
        errors.sum_parts(&self.calibration, place);
        errors.errors().clamped_sums(self.largest)
    }

    /// Applies a change in an input of the errors to the cached ones.
    ///
    /// Those of a volume are added up by the tick that asks for them, once however many messages came before it;
    /// without one that is done here, and the tick has none of it.
    #[inline]
    pub(super) fn update_errors(
        &self,
        state: &mut BridgeState,
        change: impl FnOnce(&mut CachedErrors, &MachineThermalState, &MachinePosition),
    ) {
        change(&mut state.errors, &state.heat, &state.place);
        state.error_sums = match &self.calibration.volume {
            None => Some(self.compute_error_sums(&mut state.errors, &state.place)),
            Some(_) => None,
        };
    }

    /// An axis has moved or turned round.
    pub(super) fn update_axis_position(&self, state: &mut BridgeState, axis: LinearAxis) {
        let calibration = &self.calibration;
        self.update_errors(state, |errors, heat, place| {
            errors.update_axis_position(calibration, heat, place, axis)
        });
    }

    /// The heat of an axis has been stepped.
    pub(super) fn update_axis_thermal_error(&self, state: &mut BridgeState, axis: LinearAxis) {
        let calibration = &self.calibration;
        self.update_errors(state, |errors, heat, place| {
            errors.update_axis_thermal_error(calibration, heat, place, axis)
        });
    }

    /// A term over temperature or time has been stepped.
    pub(super) fn update_term_errors(&self, state: &mut BridgeState) {
        let calibration = &self.calibration;
        self.update_errors(state, |errors, heat, place| {
            errors.update_terms(calibration, heat, place)
        });
    }
}
