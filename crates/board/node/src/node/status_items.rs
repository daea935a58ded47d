//! The items of the status that are sent in turn, and the slopes among them.

use trueup_core::cnc::LinearAxis;
use trueup_link::{
    layout::STATUS_PERIOD_MS,
    status::{ITEM_COUNT_WITHOUT_SLOPES, ITEM_SEQUENCE, STATUS_FRAMES_PER_CYCLE, StatusItem},
};

use super::Node;

/// Milliseconds from one slope of an axis to the next.
const AXIS_SLOPE_PERIOD_MS: u32 = STATUS_PERIOD_MS.wrapping_mul(STATUS_FRAMES_PER_CYCLE as u32);

impl Node<'_> {
    /// Returns the next item of the status. A bridge without a slope leaves out what follows the others.
    // Ten a second: not in what sends them.
    #[inline(never)]
    pub(super) fn next_status_item(&mut self) -> StatusItem {
        let has_slope = self.bridge.as_ref().is_some_and(trueup_core::bridge::Bridge::has_slope);
        let count = if has_slope { STATUS_FRAMES_PER_CYCLE } else { ITEM_COUNT_WITHOUT_SLOPES };
        let place = self.status.item;
        let next = place.saturating_add(1);
        self.status.item = if next < count { next } else { 0 };
        let number = ITEM_SEQUENCE.get(usize::from(place)).copied().unwrap_or_default();
        match number.checked_sub(ITEM_COUNT_WITHOUT_SLOPES) {
            Some(axis) => self.next_slope_item(axis),
            None => self.status_item(number),
        }
    }

    /// Returns the offset of an axis as constant and slope.
    fn next_slope_item(&mut self, axis: u8) -> StatusItem {
        let number = usize::from(axis);
        let (Some(bridge), Some(name), Some(sent)) =
            (&self.bridge, LinearAxis::ALL.get(number), self.status.slopes.get_mut(number))
        else {
            return StatusItem::Slope { axis, constant: None, slope: 0 };
        };
        let parts =
            bridge.constant_and_slope(&self.state, &self.last, *name, *sent, AXIS_SLOPE_PERIOD_MS);
        *sent = parts.slope;
        StatusItem::Slope { axis, constant: parts.constant, slope: parts.slope }
    }
}
