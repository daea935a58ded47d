//! Which inputs are lost, each by itself: the flags of an offset say only that some are.

use super::{Bridge, State};
use crate::set::IndexSet;

/// The inputs that are lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LostInputs {
    /// The sensor is at a rail, frozen, or not believed.
    pub sensor: bool,
    /// Channels that something depends on, and that have no temperature.
    pub thermometers: IndexSet,
    /// Channels that changed faster than their mass can.
    pub too_fast: IndexSet,
    /// A position, an angle or an operating point is missing, while `Control` comes.
    pub place: bool,
    /// Tool and conditions are missing, while `Control` comes.
    pub conditions: bool,
}

impl Bridge<'_> {
    /// Returns which inputs are lost.
    #[must_use]
    pub fn lost_inputs(&self, state: &State) -> LostInputs {
        let limits = &self.calibration.limits;
        let is_heard = state.control.value(limits.link_timeout_ms).is_some();
        LostInputs {
            sensor: self.sensor_is_lost(state, self.samples_are_missing(state)),
            thermometers: state.channels.faulty().common(self.needs.watched),
            too_fast: state.channels.doubtful(),
            place: is_heard && !self.knows_place(state),
            conditions: is_heard && self.needs.conditions && self.conditions_are_lost(state),
        }
    }
}
