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

use super::{Bridge, BridgeState, state::ReceivedConditions};
use crate::cnc::MachineConditions;

/// They may be this many times as old as the CNC's sign of life.
pub const CONDITIONS_TIMEOUT_FACTOR: u32 = 4;

impl Bridge<'_> {
    /// Takes a message.
    pub(super) fn receive_conditions(
        &self,
        state: &mut BridgeState,
        conditions: MachineConditions,
    ) {
        if !self.needs.conditions {
            return;
        }
        let received = &mut state.conditions;
        let is_changed =
            received.is_changed || received.by_default || received.last != Some(conditions);
        let last = Some(conditions);
        *received = ReceivedConditions { last, age_ms: 0, by_default: false, is_changed };
    }

    /// Applies the conditions that were last received to the terms: once for all messages since the last tick.
    pub(super) fn apply_received_conditions(&self, state: &mut BridgeState) {
        if core::mem::take(&mut state.conditions.is_changed) {
            let last = state.conditions.last;
            self.apply_conditions(state, last);
        }
    }

    /// Returns whether the time since the last one is so long that no further one is expected.
    pub(super) fn are_conditions_lost(&self, state: &BridgeState) -> bool {
        state.conditions.age_ms > self.needs.conditions_ms
    }

    /// Returns whether the offset can be followed: they are known, or were held long enough and the defaults stand
    /// in for them.
    #[inline]
    pub(super) fn step_conditions(&self, state: &mut BridgeState, elapsed_ms: u32) -> bool {
        !self.needs.conditions || self.step_required_conditions(state, elapsed_ms)
    }

    #[inline]
    fn step_required_conditions(&self, state: &mut BridgeState, elapsed_ms: u32) -> bool {
        state.conditions.advance_ages(elapsed_ms);
        // The one or the other: a tick has the time for one choice of a category (`cargo xtask bounds`).
        if self.are_conditions_lost(state) {
            return self.fall_back_to_default_conditions(state);
        }
        self.apply_received_conditions(state);
        state.conditions.last.is_some()
    }

    #[cold]
    #[inline(never)]
    fn fall_back_to_default_conditions(&self, state: &mut BridgeState) -> bool {
        if !state.conditions.by_default && !state.is_held(self.calibration.limits.hold_ms) {
            (state.conditions.by_default, state.conditions.is_changed) = (true, false);
            self.apply_conditions(state, None);
        }
        state.conditions.by_default
    }

    fn apply_conditions(&self, state: &mut BridgeState, conditions: Option<MachineConditions>) {
        state.heat.set_conditions(&self.calibration, conditions);
        self.update_term_errors(state);
    }
}
