//! Changes learned since the calibration was made: small changes of its parts, in RAM, on their way.
//!
//! A machine ages by its amplitudes: how much it grows for what its sensor, its thermometers and its clock
//! say. So a change is a share by which a part is more than the calibration says, and for the growth of the
//! spindle its zero. That is all that readings of a reference teach of these parts, and it needs five numbers;
//! a table, a backlash, a time constant is a new calibration, at rest.
//!
//! ```text
//! s  = s₀·(1 + a₀) + z          growth of the spindle by the first source, before the terms of a diagnosis
//! ΔK = ΔK₀·(1 + aᵢ)             expansion of X, Y, Z
//! aᵢ, z ← one unit towards what is requested, every 100 ms
//! ```
//!
//! The units are 10⁻⁵ and 1 nm. So a change never steps: 80 µm of growth move by 0.8 nm in 100 ms, 500 µm by
//! 5 nm, both below the 10 nm of the wire; the slew limit holds as ever. And a frame of a stranger
//! that has guessed the counter moves no more than one unit before the master's next takes it back. Beyond its [caps](LearnedLimits),
//! which the calibration states, nothing is taken; they are 0 unless the user has written them.
//!
//! It starts at nothing and is lost with the RAM: the sender that has learned it says it again.
//!
//! a·x is x times a·42 950 in Q32, which is a to 8·10⁻⁶ of itself: 1 nm of 500 µm at 25 %.

use crate::{
    fixed_point::mul_high_rounded,
    units::{FineNanometres, Nanometres},
};

/// The parts: growth of the spindle, expansion of X, Y and Z, zero of the growth.
pub const LEARNED_PART_COUNT: usize = 5;
/// The place of the zero among them.
pub const ZERO_PART_INDEX: usize = 4;
/// 10⁻⁵ in Q32.
const CHANGE_UNIT_Q32: i32 = 42_950;

/// A requested change of a part of the correction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LearnedChangeRequest {
    /// Which part, 1…5 in the order of [`LEARNED_PART_COUNT`]; 0: nothing is requested.
    pub part: u8,
    /// By this much is it to be more: in 10⁻⁵ of itself, the zero in nm.
    pub amount: i16,
    /// The lower half of the CRC of the calibration that it is a change of.
    pub calibration: u16,
}

/// Returns how a [`LearnedChangeRequest`] names the calibration with this CRC.
#[must_use]
pub const fn calibration_id(crc: u32) -> u16 {
    let [low, high, ..] = crc.to_le_bytes();
    u16::from_le_bytes([low, high])
}

/// The most that is taken, either way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LearnedLimits {
    /// Of the growth of the spindle, in 0.1 %.
    pub growth: u8,
    /// Of the expansion of each axis, in 0.1 %.
    pub axes: u8,
    /// Of the zero of the growth, in 0.1 µm.
    pub zero: u8,
}

impl LearnedLimits {
    /// Units of a change in one of a cap.
    pub const CHANGE_UNITS_PER_LIMIT_UNIT: u16 = 100;

    /// Returns the most of this part, in its units.
    #[must_use]
    pub fn max_change(self, part: usize) -> u16 {
        let cap = match part {
            0 => self.growth,
            ZERO_PART_INDEX => self.zero,
            _ => self.axes,
        };
        u16::from(cap).saturating_mul(Self::CHANGE_UNITS_PER_LIMIT_UNIT)
    }
}

/// The requested changes, and how far each has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LearnedChanges {
    goal: [i16; LEARNED_PART_COUNT],
    now: [i16; LEARNED_PART_COUNT],
}

impl LearnedChanges {
    /// Takes what is requested; whether it was: there is such a part, and its cap permits it.
    pub fn request(&mut self, change: LearnedChangeRequest, caps: LearnedLimits) -> bool {
        let part = usize::from(change.part).wrapping_sub(1);
        match self.goal.get_mut(part) {
            Some(goal) if change.amount.unsigned_abs() <= caps.max_change(part) => {
                *goal = change.amount
            }
            _ => return false,
        }
        true
    }

    /// A step of 100 ms of a part, 0…4: one unit towards what is requested.
    pub fn step(&mut self, part: usize) {
        if let (Some(now), Some(goal)) = (self.now.get_mut(part), self.goal.get(part)) {
            let way = i32::from(*goal).wrapping_sub((*now).into());
            // Towards a goal there is room.
            *now = match way {
                1.. => now.saturating_add(1),
                0 => *now,
                ..0 => now.saturating_sub(1),
            };
        }
    }

    /// Returns how far each part has come, in its units.
    #[must_use]
    pub const fn current_amounts(&self) -> [i16; LEARNED_PART_COUNT] {
        self.now
    }

    /// Returns the growth of the spindle with what was learned of it.
    ///
    /// ```
    /// use trueup_core::{learned_changes::{LearnedLimits, LearnedChangeRequest, LearnedChanges}, units::Nanometres};
    /// let mut learned = LearnedChanges::default();
    /// let caps = LearnedLimits { growth: 20, axes: 0, zero: 0 };
    /// // 1 % more of the growth: a thousand units, 100 s.
    /// assert!(learned.request(LearnedChangeRequest { part: 1, amount: 1_000, calibration: 0 }, caps));
    /// (0..1_000).for_each(|_| learned.step(0));
    /// assert_eq!(learned.apply_to_growth(Nanometres(50_000)), Nanometres(50_500));
    /// ```
    #[must_use]
    #[inline]
    pub fn apply_to_growth(&self, plain: Nanometres) -> Nanometres {
        let [share, .., zero] = self.now;
        Nanometres(
            plain.0.saturating_add(change_of_length(plain.0, share)).saturating_add(zero.into()),
        )
    }

    /// Returns the expansion of an axis, 0…2, with what was learned of it.
    #[must_use]
    #[inline]
    pub fn apply_to_expansion(&self, axis: usize, plain: FineNanometres) -> FineNanometres {
        let [_, axes @ .., _] = self.now;
        let share = axes.get(axis).copied().unwrap_or_default();
        plain.saturating_add(FineNanometres(change_of_length(plain.0, share)))
    }
}

/// This share of a length.
#[inline]
fn change_of_length(length: i32, share: i16) -> i32 {
    mul_high_rounded(length, i32::from(share).wrapping_mul(CHANGE_UNIT_Q32))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEARNED_LIMITS: LearnedLimits = LearnedLimits { growth: 250, axes: 100, zero: 200 };

    fn change(part: u8, amount: i16) -> LearnedChangeRequest {
        LearnedChangeRequest { part, amount, calibration: 0 }
    }

    #[test]
    fn nothing_learned_changes_no_bit() {
        let learned = LearnedChanges::default();
        for length in [i32::MIN, -1, 0, 1, 12_345, i32::MAX] {
            assert_eq!(learned.apply_to_growth(Nanometres(length)), Nanometres(length));
            assert_eq!(
                learned.apply_to_expansion(1, FineNanometres(length)),
                FineNanometres(length).saturating_add(FineNanometres::ZERO)
            );
        }
    }

    #[test]
    fn beyond_its_cap_or_of_no_part_nothing_is_taken() {
        let all: [(u8, i16); 5] = [(1, 25_000), (2, 10_000), (3, 10_000), (4, 10_000), (5, 20_000)];
        for (part, most) in all {
            for sign in [1, -1] {
                let mut learned = LearnedChanges::default();
                assert!(
                    !learned.request(change(part, sign * (most + 1)), LEARNED_LIMITS),
                    "{part}"
                );
                assert_eq!(learned, LearnedChanges::default());
                assert!(learned.request(change(part, sign * most), LEARNED_LIMITS), "{part}");
                assert!(
                    !learned.request(change(part, sign), LearnedLimits::default()),
                    "a cap of 0"
                );
                assert!(
                    learned.request(change(part, 0), LearnedLimits::default()),
                    "back it may always"
                );
            }
        }
        let mut learned = LearnedChanges::default();
        for (part, amount) in [(0, 0), (6, 0), (7, 0), (u8::MAX, 0), (1, i16::MIN)] {
            assert!(!learned.request(change(part, amount), LEARNED_LIMITS), "{part} {amount}");
        }
        assert_eq!(learned, LearnedChanges::default());
    }

    #[test]
    fn it_goes_one_unit_a_step_and_stops_where_it_was_asked_to() {
        let mut learned = LearnedChanges::default();
        assert!(
            learned.request(change(3, -7), LEARNED_LIMITS)
                && learned.request(change(5, 4), LEARNED_LIMITS)
        );
        for step in 1..=10 {
            (0..=LEARNED_PART_COUNT).for_each(|part| learned.step(part));
            assert_eq!(learned.current_amounts(), [0, 0, (-step).max(-7), 0, step.min(4)]);
        }
        assert!(learned.request(change(3, 0), LEARNED_LIMITS));
        (0..6).for_each(|_| learned.step(2));
        assert_eq!(learned.current_amounts(), [0, 0, -1, 0, 4]);
    }

    #[test]
    fn a_share_is_that_of_the_real_numbers_over_the_whole_range() {
        let mut worst: f64 = 0.0;
        for share in [-25_000, -1, 1, 333, 25_000] {
            let learned = LearnedChanges {
                goal: [0; LEARNED_PART_COUNT],
                now: [share, share, share, share, 0],
            };
            for length in (-4_000_000..=4_000_000).step_by(997) {
                let exact = f64::from(length) * (1.0 + f64::from(share) * 1e-5);
                let growth = f64::from(learned.apply_to_growth(Nanometres(length)).0);
                worst = worst.max((growth - exact).abs() - f64::from(length).abs() * 2e-6);
            }
        }
        assert!(worst <= 0.5 + 1e-9, "beside 2 millionths only the rounding: {worst}");
        // 14.21 µm/m·K, 19 K, at 1 m: 269.99 µm; 2 % more is 5.4 µm.
        let learned = LearnedChanges { goal: [0; LEARNED_PART_COUNT], now: [0, 2_000, 0, 0, 0] };
        let expansion = learned.apply_to_expansion(0, Nanometres(269_990).to_fine());
        assert_eq!(expansion.rounded(), Nanometres(275_390));
        assert_eq!(
            learned.apply_to_expansion(1, FineNanometres(1)),
            FineNanometres(1),
            "the other axes stay"
        );
    }

    #[test]
    fn a_change_names_its_calibration_by_the_lower_half_of_the_crc() {
        assert_eq!(calibration_id(0x1234_ABCD), 0xABCD);
    }
}
