//! The errors of the axes: computed whole once before the first tick, kept from message to message, and added up when
//! they are requested.
//!
//! Once in [`super::ERROR_UPDATE_PERIOD_MS`] the errors of an axis are computed when its position is
//! received, and what depends on the angles when these are. Further messages are only stored, and the next tick computes the
//! errors once for all of them; so it does for terms that have changed. A full receive queue costs no more than that, however
//! many messages it has (`cargo xtask bounds`).

use super::{Bridge, ERROR_UPDATE_PERIOD_MS, state::BridgeState};
use crate::{
    axis_errors::{CachedErrors, ErrorSums},
    cnc::LinearAxis,
    index_set::IndexSet,
    machine_position::MachinePosition,
    thermal_state::MachineThermalState,
};

/// A received input of the errors.
#[derive(Clone, Copy)]
pub(super) enum ErrorInput {
    /// The position of an axis.
    Axis(LinearAxis),
    /// The angles of the rotary axes.
    Angles,
}

/// The number of the angles in the set of changed inputs, behind the three axes.
const ANGLES_INDEX: usize = 3;
/// The number of the terms in that set.
const TERMS_INDEX: usize = 4;

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
        self.apply_received_angles(state);
        state.errors = CachedErrors::from_position(&self.calibration, &state.heat, &state.place);
        (state.deferred, state.error_sums) = (IndexSet::default(), None);
    }

    /// Returns the errors of the axes at the present place.
    #[inline]
    pub(super) fn axis_errors(&self, state: &mut BridgeState) -> ErrorSums {
        match state.error_sums {
            Some(sums) => sums,
            None => self.refresh_error_sums(state),
        }
    }

    #[inline(never)]
    fn refresh_error_sums(&self, state: &mut BridgeState) -> ErrorSums {
        if state.deferred != IndexSet::default() {
            self.compute_deferred_errors(state);
        }
        let sums = self.compute_error_sums(state);
        *state.error_sums.insert(sums)
    }

    /// Computes what depends on inputs that have changed and was not computed on reception.
    // Apart: most ticks have none of it.
    #[inline(never)]
    fn compute_deferred_errors(&self, state: &mut BridgeState) {
        let mut changed = core::mem::take(&mut state.deferred);
        if changed.contains(ANGLES_INDEX) {
            changed.remove(ANGLES_INDEX);
            self.apply_received_angles(state);
        }
        if changed != IndexSet::default() {
            let BridgeState { errors, heat, place, .. } = state;
            errors.update_axis_positions(&self.calibration, heat, place, changed);
        }
    }

    fn compute_error_sums(&self, state: &mut BridgeState) -> ErrorSums {
        state.errors.sum_guideway_errors(&self.calibration, &state.place);
        state.errors.errors().clamped_sums(self.largest)
    }

    /// Updates the errors after a change of an input: once in [`super::ERROR_UPDATE_PERIOD_MS`]
    /// immediately, else when they are requested.
    // A part of its caller: a call costs 20 instructions, for each message.
    #[inline(always)]
    pub(super) fn update_or_defer_errors(&self, state: &mut BridgeState, input: ErrorInput) {
        let number = match input {
            ErrorInput::Axis(axis) => axis as usize,
            ErrorInput::Angles => ANGLES_INDEX,
        };
        match state.errors_updated_at.get_mut(number) {
            Some(at) if state.now.duration_ms_since(*at) >= ERROR_UPDATE_PERIOD_MS => {
                *at = state.now;
                state.deferred.remove(number);
                match input {
                    ErrorInput::Axis(axis) => self.update_axis_position(state, axis),
                    ErrorInput::Angles => self.update_angles(state),
                }
            }
            _ => {
                state.deferred.insert(number);
                state.error_sums = None;
            }
        }
    }

    /// Computes the errors of an axis where it stands now, on reception.
    ///
    /// With a volume, or where another input has changed as well, the tick adds the errors up, once for all messages before it.
    /// Else they are added up here, and the tick has none of it.
    // A function of its own in the image: its time is bounded by how often it is called (`cargo xtask bounds`), which
    // `update_or_defer_errors` limits.
    #[inline(never)]
    fn update_axis_position(&self, state: &mut BridgeState, axis: LinearAxis) {
        let BridgeState { errors, heat, place, .. } = state;
        errors.update_axis_position(&self.calibration, heat, place, axis);
        state.error_sums = None;
        if self.calibration.volume.is_none() && state.deferred == IndexSet::default() {
            state.error_sums = Some(self.compute_error_sums(state));
        }
    }

    /// The heat of an axis has been stepped.
    pub(super) fn update_axis_thermal_error(&self, state: &mut BridgeState, axis: LinearAxis) {
        let BridgeState { errors, heat, place, .. } = state;
        errors.update_axis_thermal_error(&self.calibration, heat, place, axis);
        state.error_sums = None;
    }

    /// A term over temperature, time, speed or conditions has changed.
    pub(super) fn update_term_errors(&self, state: &mut BridgeState) {
        state.deferred.insert(TERMS_INDEX);
        state.error_sums = None;
    }
}
