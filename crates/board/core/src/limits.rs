//! Clamp and slew limit: how far and how fast an offset may go.

use crate::{learned_changes::LearnedLimits, units::Nanometres};

/// How far and how fast an offset may go, and how long silence is tolerated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CompensationLimits {
    /// The largest offset on X, Y and Z, either way; at least 0.
    pub max: [Nanometres; 3],
    /// The fastest change of an offset in nanometres a second, on each axis.
    pub slew_nm_per_s: u32,
    /// After this time without a valid `Control` the CNC counts as lost.
    pub link_timeout_ms: u32,
    /// How long the last offset is held before it is taken back to 0.
    pub hold_ms: u32,
    /// How fast the difference between two sources of the elongation is taken back, in nanometres a second.
    pub rejoin_nm_per_s: u32,
    /// How far what was learned may change the parts of the correction.
    pub learned: LearnedLimits,
}

/// Picometres in a nanometre; also (nanometres a second)·milliseconds in one.
const PICOMETRES_PER_NANOMETRE: i32 = 1_000;

/// The offset that is applied now, kept to the picometre, so that the slowest slew rate (1 nm/s in
/// a millisecond) still moves it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AppliedOffset([Length; 3]);

/// A length in nanometres and the rest in picometres, −500…499: the nanometres are the length
/// rounded, and nothing has to be divided for them. (A count of picometres would need a division of
/// 64 bits for each axis and tick, for which a Cortex-M4 has no instruction.)
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Length {
    nanometres: Nanometres,
    rest: i32,
}

/// How far an offset may go in a step: nanometres, and a rest of 0…999 pm.
#[derive(Clone, Copy, Debug)]
struct MaxStep {
    nanometres: u32,
    rest: i32,
}

/// The limits that acted on a step towards a target.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LimitStatus {
    /// A target lay beyond the largest permitted offset.
    pub clamped: bool,
    /// An axis has not reached its (clamped) target yet.
    pub slewing: bool,
}

impl AppliedOffset {
    /// Moves one step towards `target`, never beyond the clamp, never faster than the slew limit.
    ///
    /// ```
    /// use trueup_core::{limits::{AppliedOffset, CompensationLimits}, units::Nanometres};
    /// let limits = CompensationLimits {
    ///     max: [Nanometres(200_000); 3],
    ///     slew_nm_per_s: 20_000,
    ///     link_timeout_ms: 500,
    ///     hold_ms: 2_000,
    ///     rejoin_nm_per_s: 10,
    ///     learned: Default::default(),
    /// };
    /// let mut applied = AppliedOffset::default();
    /// // 20 µm/s are 20 nm in a millisecond.
    /// let status = applied.step(&limits, [Nanometres(0), Nanometres(0), Nanometres(1_000)], 1);
    /// assert_eq!(applied.offset(), [Nanometres(0), Nanometres(0), Nanometres(20)]);
    /// assert!(status.slewing && !status.clamped);
    /// ```
    pub fn step(
        &mut self,
        limits: &CompensationLimits,
        target: [Nanometres; 3],
        elapsed_ms: u32,
    ) -> LimitStatus {
        let reach = MaxStep::from_slew_rate(limits.slew_nm_per_s, elapsed_ms);
        let mut status = LimitStatus::default();
        for ((applied, target), max) in self.0.iter_mut().zip(target).zip(limits.max) {
            let (goal, _) = target.clamped(max);
            status.clamped |= goal != target;
            status.slewing |= !applied.move_towards(goal, reach);
        }
        status
    }

    /// Returns the offset on X, Y and Z, rounded to the nanometre.
    #[must_use]
    #[inline]
    pub fn offset(&self) -> [Nanometres; 3] {
        self.0.map(|length| length.nanometres)
    }

    /// Returns whether nothing is applied on any axis.
    #[must_use]
    pub fn is_zero(&self) -> bool {
        *self == Self::default()
    }
}

impl Length {
    /// Goes towards `goal` as far as it may; whether it has arrived.
    #[inline]
    fn move_towards(&mut self, goal: Nanometres, reach: MaxStep) -> bool {
        let Self { nanometres: from, rest } = *self;
        // The rests together are less than 2 nm, and decide where the nanometres do not.
        let arrives = match from.0.abs_diff(goal.0).checked_sub(reach.nanometres) {
            None => true,
            Some(0 | 1) => self.is_within(goal, reach),
            Some(2..) => false,
        };
        if arrives {
            *self = Self { nanometres: goal, rest: 0 };
            return true;
        }
        let is_behind = goal < from || (goal == from && rest > 0);
        let sign = if is_behind { -1 } else { 1 };
        // Between where it was and its goal, so that no sum leaves its range.
        let rest = rest.wrapping_add(reach.rest.wrapping_mul(sign));
        let nanometres = reach.nanometres.cast_signed().wrapping_mul(sign);
        let nanometres = from.0.wrapping_add(nanometres);
        let (carry, back) = match rest {
            500.. => (1, PICOMETRES_PER_NANOMETRE),
            ..-500 => (-1, -PICOMETRES_PER_NANOMETRE),
            _ => (0, 0),
        };
        *self = Self {
            nanometres: Nanometres(nanometres.wrapping_add(carry)),
            rest: rest.wrapping_sub(back),
        };
        false
    }

    /// The same question, in picometres.
    #[cold]
    #[inline(never)]
    fn is_within(self, goal: Nanometres, reach: MaxStep) -> bool {
        let picometres = |nanometres: i64, rest: i32| {
            nanometres.wrapping_mul(PICOMETRES_PER_NANOMETRE.into()).wrapping_add(rest.into())
        };
        let way = i64::from(goal.0).wrapping_sub(self.nanometres.0.into());
        let missing = picometres(way, self.rest.wrapping_neg());
        let reach = picometres(reach.nanometres.into(), reach.rest);
        (reach.wrapping_neg()..=reach).contains(&missing)
    }
}

impl MaxStep {
    /// Beyond any distance.
    const UNLIMITED: Self = Self { nanometres: u32::MAX, rest: 999 };

    /// Returns how far something comes at this speed in this time.
    ///
    /// Speed and time are divided by 1000 before they are multiplied, each a word and by a
    /// constant: (1000·w + r)·(1000·s + m) pm = w·t nm + r·s nm + r·m pm, with t = 1000·s + m.
    #[inline]
    #[allow(clippy::cast_possible_wrap, reason = "below 1000")]
    fn from_slew_rate(slew_nm_per_s: u32, elapsed_ms: u32) -> Self {
        const PM_PER_NM: u32 = PICOMETRES_PER_NANOMETRE.unsigned_abs();
        // nm/s times ms is pm: this is 2³² nm.
        if u64::from(slew_nm_per_s).wrapping_mul(elapsed_ms.into()) >> 32 >= u64::from(PM_PER_NM) {
            return Self::UNLIMITED;
        }
        let (whole, rest) = (slew_nm_per_s / PM_PER_NM, slew_nm_per_s % PM_PER_NM);
        let (seconds, milliseconds) = (elapsed_ms / PM_PER_NM, elapsed_ms % PM_PER_NM);
        let picometres = rest.wrapping_mul(milliseconds);
        let nanometres = whole
            .wrapping_mul(elapsed_ms)
            .wrapping_add(rest.wrapping_mul(seconds))
            .wrapping_add(picometres / PM_PER_NM);
        Self { nanometres, rest: (picometres % PM_PER_NM) as i32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: CompensationLimits = CompensationLimits {
        max: [Nanometres(1_000), Nanometres(2_000), Nanometres(3_000)],
        slew_nm_per_s: 500,
        link_timeout_ms: 500,
        hold_ms: 2_000,
        rejoin_nm_per_s: 10,
        learned: LearnedLimits { growth: 0, axes: 0, zero: 0 },
    };

    #[test]
    fn half_a_nanometre_a_millisecond_is_not_lost() {
        let mut applied = AppliedOffset::default();
        for _ in 0..1000 {
            applied.step(&LIMITS, [Nanometres(900), Nanometres(-900), Nanometres(400)], 1);
        }
        assert_eq!(applied.offset(), [Nanometres(500), Nanometres(-500), Nanometres(400)]);
    }

    /// Moves as [`AppliedOffset::step`] does, in one count of picometres, with a division of 64 bits.
    fn counted(picometres: &mut i64, target: i32, reach: i64) -> i32 {
        let missing = i64::from(target) * 1_000 - *picometres;
        *picometres += missing.clamp(-reach, reach);
        (*picometres + 500).div_euclid(1_000) as i32
    }

    #[test]
    fn no_picometre_is_lost_on_any_way() {
        for (slew_nm_per_s, elapsed_ms) in
            [(1, 1), (68, 1), (999, 1), (1_000, 1), (1_001, 7), (499_999, 1), (u32::MAX, u32::MAX)]
        {
            let limits =
                CompensationLimits { max: [Nanometres(i32::MAX); 3], slew_nm_per_s, ..LIMITS };
            let reach = (u64::from(slew_nm_per_s) * u64::from(elapsed_ms)).min(1 << 62) as i64;
            let mut applied = AppliedOffset::default();
            let mut expected = [0; 3];
            let mut random = 1_u32;
            for step in 0..100_000 {
                if step % 200 == 0 {
                    random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                }
                // Near, far, and back again before it is reached.
                let near = (random >> 28) as i32 - 8;
                let target = [near, -near, (random as i32).max(-i32::MAX)];
                applied.step(&limits, target.map(Nanometres), elapsed_ms);
                for (axis, target) in target.into_iter().enumerate() {
                    let offset = counted(&mut expected[axis], target, reach);
                    assert_eq!(applied.offset()[axis].0, offset, "{slew_nm_per_s} nm/s");
                }
                assert_eq!(applied.is_zero(), expected == [0; 3]);
            }
        }
    }

    #[test]
    fn each_axis_stops_at_its_own_clamp_and_reports_it() {
        let mut applied = AppliedOffset::default();
        let far = [Nanometres(i32::MAX), Nanometres(i32::MIN), Nanometres(3_000)];
        let status = applied.step(&LIMITS, far, u32::MAX);
        assert_eq!(applied.offset(), [Nanometres(1_000), Nanometres(-2_000), Nanometres(3_000)]);
        assert_eq!(status, LimitStatus { clamped: true, slewing: false });
    }

    #[test]
    fn no_limit_and_no_target_make_it_wrap() {
        let wild = CompensationLimits {
            max: [Nanometres(i32::MIN); 3],
            slew_nm_per_s: u32::MAX,
            ..LIMITS
        };
        let mut applied = AppliedOffset::default();
        applied.step(&wild, [Nanometres(i32::MIN); 3], u32::MAX);
        assert!(applied.is_zero(), "a negative clamp permits nothing");
    }
}
