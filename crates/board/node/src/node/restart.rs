//! The state that outlasts a reset, and time that samples do not count.

use trueup_core::{design_parameters::THERMAL_STEP_MS, units::TimestampMs};
use trueup_store::retained_state::RetainedState;

use super::Node;

/// A millisecond that was lost is forgiven in this time: a converter that is restarted loses one, and
/// they must not add up over a day.
const SAMPLE_LOSS_RECOVERY_MS: u32 = 1_000;

impl Node<'_> {
    /// Returns what is to outlast a reset.
    #[must_use]
    pub fn retained_state(&self) -> RetainedState {
        let heat = self.bridge.as_ref().map(|bridge| bridge.retained_lags(&self.state));
        RetainedState { heat: heat.unwrap_or_default(), joint: self.state.retained_transfer() }
    }

    /// Goes on from before a reset, or from this many seconds without power ago; with nothing kept, the power was
    /// gone, and what heat the machine has is not known. A board that is cold at its start does not call this.
    pub fn resume(&mut self, retained: Option<&RetainedState>, off_s: u32) {
        let Some(bridge) = &self.bridge else { return };
        let RetainedState { heat, joint } = retained.copied().unwrap_or_default();
        bridge.restore_lags(&mut self.state, &heat, off_s.saturating_mul(1_000 / THERMAL_STEP_MS));
        if let Some(joint) = joint {
            self.state.restore_transfer(joint);
        }
    }

    /// This much time has passed by a clock that does not count samples. Gives for how long there were
    /// none, if that is more than a turn of the supervisor: a tick without any makes up for it.
    pub fn advance_clock(&mut self, elapsed_ms: u32) -> Option<u32> {
        self.clock = self.clock.wrapping_add_ms(elapsed_ms);
        let behind_ms = self.clock.duration_ms_since(self.now);
        if behind_ms.cast_signed() <= 0 {
            self.clock = self.now;
            return None;
        }
        self.until_forgiven_ms = self.until_forgiven_ms.saturating_add(elapsed_ms);
        if self.until_forgiven_ms >= SAMPLE_LOSS_RECOVERY_MS {
            self.until_forgiven_ms = 0;
            self.clock = TimestampMs(self.clock.0.wrapping_sub(1));
        }
        if behind_ms < elapsed_ms {
            return None;
        }
        self.state.mark_samples_lost();
        Some(behind_ms)
    }
}
