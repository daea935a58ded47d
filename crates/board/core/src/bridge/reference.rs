//! The error that counts as none: when `Zero` may take it, and how large it may be.

use super::{Bridge, Reference, State, joint::SelectedSource};
use crate::units::Fine;

impl Bridge<'_> {
    /// The present error becomes the reference, if it is known and no larger than a correction may be; whether it
    /// does.
    pub(super) fn zero(&self, state: &mut State) -> bool {
        if state.joint.selected == SelectedSource::Missing
            || !self.knows_temperatures(state)
            || self.holds_temperature(state, state.joint.selected)
            || !self.knows_place(state)
        {
            return false;
        }
        self.join(state);
        let axes = self.axis_errors(state).sums;
        let reference = Reference { elongation: self.elongation(state), axes };
        let is_permitted = self.permits(&reference);
        if is_permitted {
            state.reference = reference;
        }
        is_permitted
    }

    /// Returns whether a reference is no larger than a correction may be: the error of an axis its largest offset, the
    /// elongation the largest of the three.
    #[must_use]
    pub fn permits(&self, reference: &Reference) -> bool {
        let largest = self.largest.into_iter().max().unwrap_or_default();
        let elongation = i64::from(reference.elongation.0).unsigned_abs();
        let within =
            |(error, largest): (Fine, Fine)| error.0.unsigned_abs() <= largest.0.unsigned_abs();
        reference.axes.into_iter().zip(self.largest).all(within)
            && elongation.saturating_mul(256) <= largest.0.unsigned_abs().into()
    }
}
