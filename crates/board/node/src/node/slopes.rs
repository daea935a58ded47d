//! The items of the status that are sent in turn, and the slopes among them.

use trueup_core::cnc::LinearAxis;
use trueup_link::{
    layout::STATUS_PERIOD_MS,
    status::{Item, ORDER, PLACES, WITHOUT_SLOPES},
};

use super::Node;

/// Milliseconds from one slope of an axis to the next.
const PERIOD_MS: u32 = STATUS_PERIOD_MS.wrapping_mul(PLACES as u32);

impl Node<'_> {
    /// Returns the next item of the status. A bridge without a slope leaves out what follows the others.
    // Ten a second: not in what sends them.
    #[inline(never)]
    pub(super) fn next_item(&mut self) -> Item {
        let has_slope = self.bridge.as_ref().is_some_and(trueup_core::bridge::Bridge::has_slope);
        let count = if has_slope { PLACES } else { WITHOUT_SLOPES };
        let place = self.status_item;
        let next = place.saturating_add(1);
        self.status_item = if next < count { next } else { 0 };
        let number = ORDER.get(usize::from(place)).copied().unwrap_or_default();
        match number.checked_sub(WITHOUT_SLOPES) {
            Some(axis) => self.slope(axis),
            None => self.item(number),
        }
    }

    /// Returns the offset of an axis as constant and slope.
    fn slope(&mut self, axis: u8) -> Item {
        let number = usize::from(axis);
        let (Some(bridge), Some(name), Some(sent)) =
            (&self.bridge, LinearAxis::ALL.get(number), self.slopes.get_mut(number))
        else {
            return Item::Slope { axis, constant: None, slope: 0 };
        };
        let parts = bridge.constant_and_slope(&self.state, &self.last, *name, *sent, PERIOD_MS);
        *sent = parts.slope;
        Item::Slope { axis, constant: parts.constant, slope: parts.slope }
    }
}
