//! The error that counts as none: when `Zero` may take it, and how large it may be.

use super::{Bridge, BridgeState, ReferenceErrors, bumpless_transfer::SelectedSource};
use crate::units::FineNanometres;

impl Bridge<'_> {
    /// The present error becomes the reference, if it is known and no larger than a correction may be; whether it
    /// does.
    pub(super) fn try_set_reference(&self, state: &mut BridgeState) -> bool {
        if state.joint.selected == SelectedSource::Missing
            || !self.has_temperatures(state)
            || self.is_temperature_held(state, state.joint.selected)
            || !self.has_cnc_inputs(state)
        {
            return false;
        }
        self.apply_received_conditions(state);
        self.clear_source_shift(state);
        let axes = self.axis_errors(state).sums;
        let reference = ReferenceErrors { elongation: self.elongation(state), axes };
        let is_permitted = self.is_reference_permitted(&reference);
        if is_permitted {
            state.reference = reference;
        }
        is_permitted
    }

    /// Returns whether a reference is no larger than a correction may be: the error of an axis its largest offset, the
    /// elongation the largest of the three.
    #[must_use]
    pub fn is_reference_permitted(&self, reference: &ReferenceErrors) -> bool {
        let largest = self.largest.into_iter().max().unwrap_or_default();
        let elongation = i64::from(reference.elongation.0).unsigned_abs();
        let within = |(error, largest): (FineNanometres, FineNanometres)| {
            error.0.unsigned_abs() <= largest.0.unsigned_abs()
        };
        reference.axes.into_iter().zip(self.largest).all(within)
            && elongation.saturating_mul(256) <= largest.0.unsigned_abs().into()
    }
}
