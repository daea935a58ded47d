//! Clamp and slew limit: how far and how fast an offset may go.

use crate::units::Nanometres;

/// How far and how fast an offset may go, and how long silence is tolerated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// The largest offset on X, Y and Z, either way; at least 0.
    pub max: [Nanometres; 3],
    /// The fastest change of an offset in nanometres a second, on each axis.
    pub slew_nm_per_s: u32,
    /// Without a valid `Control` for so long the CNC counts as lost.
    pub link_timeout_ms: u32,
    /// How long the last offset is held before it is taken back to 0.
    pub hold_ms: u32,
}

/// Picometres in a nanometre; also (nanometres a second)·milliseconds in one.
const PICOMETRES_PER_NANOMETRE: i64 = 1_000;

/// The offset that is applied now, in picometres, so that the slowest slew rate (1 nm/s in a
/// millisecond) still moves it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Applied([i64; 3]);

/// What a step towards a target met.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Met {
    /// A target lay beyond the largest permitted offset.
    pub clamp: bool,
    /// An axis has not reached its (clamped) target yet.
    pub slew: bool,
}

impl Applied {
    /// One step towards `target`, never beyond the clamp, never faster than the slew limit.
    ///
    /// ```
    /// use trueup_core::{limits::{Applied, Limits}, units::Nanometres};
    /// let limits = Limits {
    ///     max: [Nanometres(200_000); 3],
    ///     slew_nm_per_s: 20_000,
    ///     link_timeout_ms: 500,
    ///     hold_ms: 2_000,
    /// };
    /// let mut applied = Applied::default();
    /// // 20 µm/s are 20 nm in a millisecond.
    /// let met = applied.step(&limits, [Nanometres(0), Nanometres(0), Nanometres(1_000)], 1);
    /// assert_eq!(applied.offset(), [Nanometres(0), Nanometres(0), Nanometres(20)]);
    /// assert!(met.slew && !met.clamp);
    /// ```
    pub fn step(&mut self, limits: &Limits, target: [Nanometres; 3], elapsed_ms: u32) -> Met {
        // nm/s times ms is pm.
        let step = i64::from(limits.slew_nm_per_s).saturating_mul(i64::from(elapsed_ms));
        let mut met = Met::default();
        for ((applied, target), max) in self.0.iter_mut().zip(target).zip(limits.max) {
            let max = max.0.max(0);
            let held = target.0.clamp(max.saturating_neg(), max);
            met.clamp |= held != target.0;
            let goal = i64::from(held).saturating_mul(PICOMETRES_PER_NANOMETRE);
            let change = goal.saturating_sub(*applied).clamp(step.saturating_neg(), step);
            *applied = applied.saturating_add(change);
            met.slew |= *applied != goal;
        }
        met
    }

    /// The offset on X, Y and Z, rounded to the nanometre.
    #[must_use]
    pub fn offset(&self) -> [Nanometres; 3] {
        self.0.map(|picometres| {
            let half = PICOMETRES_PER_NANOMETRE / 2;
            Nanometres::saturating(
                picometres.saturating_add(half).div_euclid(PICOMETRES_PER_NANOMETRE),
            )
        })
    }

    /// Whether nothing is applied on any axis.
    #[must_use]
    pub fn is_zero(&self) -> bool {
        self.0 == [0; 3]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits {
        max: [Nanometres(1_000), Nanometres(2_000), Nanometres(3_000)],
        slew_nm_per_s: 500,
        link_timeout_ms: 500,
        hold_ms: 2_000,
    };

    #[test]
    fn half_a_nanometre_a_millisecond_is_not_lost() {
        let mut applied = Applied::default();
        for _ in 0..1000 {
            applied.step(&LIMITS, [Nanometres(900), Nanometres(-900), Nanometres(400)], 1);
        }
        assert_eq!(applied.offset(), [Nanometres(500), Nanometres(-500), Nanometres(400)]);
    }

    #[test]
    fn each_axis_stops_at_its_own_clamp_and_says_so() {
        let mut applied = Applied::default();
        let far = [Nanometres(i32::MAX), Nanometres(i32::MIN), Nanometres(3_000)];
        let met = applied.step(&LIMITS, far, u32::MAX);
        assert_eq!(applied.offset(), [Nanometres(1_000), Nanometres(-2_000), Nanometres(3_000)]);
        assert_eq!(met, Met { clamp: true, slew: false });
    }

    #[test]
    fn no_limit_and_no_target_make_it_wrap() {
        let wild = Limits { max: [Nanometres(i32::MIN); 3], slew_nm_per_s: u32::MAX, ..LIMITS };
        let mut applied = Applied::default();
        applied.step(&wild, [Nanometres(i32::MIN); 3], u32::MAX);
        assert!(applied.is_zero(), "a negative clamp permits nothing");
    }
}
