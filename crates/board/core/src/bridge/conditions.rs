//! The tool and the conditions that the CNC sends: known, awaited, lost.
//!
//! ```text
//! start ─► awaited ──────────┐ nothing for 4 × the link timeout
//!             │ a message    ▼
//!             ├───────► lost: held for `hold_ms`, if the offset was live ─► by the defaults
//!             ▼              ▲                                                  │ a message
//!           known ───────────┘ nothing for 4 × the link timeout                 │
//!             ▲─────────────────────────────────────────────────────────────────┘
//! ```
//!
//! They come rarely, so they may be four times as old as `Control`. Changes go through the slew limit.

use super::{Bridge, State, state::ReceivedConditions};
use crate::cnc::Conditions;

/// They may be this many times as old as the CNC's sign of life.
pub const CONDITIONS_TIMEOUTS: u32 = 4;

impl Bridge<'_> {
    /// Takes a message.
    pub(super) fn receive_conditions(&self, state: &mut State, conditions: Conditions) {
        if !self.needs.conditions {
            return;
        }
        let received = &mut state.conditions;
        let is_new = received.by_default || received.last != Some(conditions);
        *received = ReceivedConditions { last: Some(conditions), age_ms: 0, by_default: false };
        if is_new {
            self.select_category(state, Some(conditions));
        }
    }

    /// Returns whether none has come for so long that none is to be expected.
    pub(super) fn conditions_are_lost(&self, state: &State) -> bool {
        state.conditions.age_ms > self.needs.conditions_ms
    }

    /// Returns whether the offset can be followed: they are known, or were held long enough and the defaults stand
    /// in for them.
    #[inline]
    pub(super) fn knows_conditions(&self, state: &mut State, elapsed_ms: u32) -> bool {
        !self.needs.conditions || self.awaits_no_conditions(state, elapsed_ms)
    }

    #[inline]
    fn awaits_no_conditions(&self, state: &mut State, elapsed_ms: u32) -> bool {
        state.conditions.advance_ages(elapsed_ms);
        if self.conditions_are_lost(state) {
            return self.goes_by_defaults(state);
        }
        state.conditions.last.is_some()
    }

    #[cold]
    #[inline(never)]
    fn goes_by_defaults(&self, state: &mut State) -> bool {
        if !state.conditions.by_default && !state.is_held(self.calibration.limits.hold_ms) {
            state.conditions.by_default = true;
            self.select_category(state, None);
        }
        state.conditions.by_default
    }

    fn select_category(&self, state: &mut State, conditions: Option<Conditions>) {
        state.heat.select(&self.calibration, conditions);
        self.term_warmed(state);
    }
}
