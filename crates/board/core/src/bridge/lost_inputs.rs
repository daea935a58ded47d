//! Which inputs are lost, each by itself: the flags of an offset say only that some are.

use super::{Bridge, BridgeState};
use crate::index_set::IndexSet;

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
    pub fn lost_inputs(&self, state: &BridgeState) -> LostInputs {
        let limits = &self.calibration.limits;
        let is_received = state.control.fresh_value(limits.link_timeout_ms).is_some();
        LostInputs {
            sensor: self.is_sensor_lost(state, self.are_samples_missing(state)),
            thermometers: state.channels.faulty_channels().intersection(self.needs.watched),
            too_fast: state.channels.uncertain_channels(),
            place: is_received && !self.has_cnc_inputs(state),
            conditions: is_received && self.needs.conditions && self.are_conditions_lost(state),
        }
    }
}
