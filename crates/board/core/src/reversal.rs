//! Which way an axis was approached, and the backlash that depends on it.
//!
//! The CNC sends a position and a direction: +1, −1, or 0 for standing or unknown. The state keeps
//! the furthest point of the present direction. A move the other way first has to go back by the
//! hysteresis, which is play that does nothing; the rest of it, and every later advance, moves the
//! progress from one end of the ramp towards the other:
//!
//! ```text
//! progress ← progress + advance (negative direction), − advance (positive),  held to 0…ramp
//! β = progress/ramp        0: approached in the positive direction, 1: in the negative
//! ```
//!
//! So a reversal in the middle of a ramp goes back the way it came, and with a ramp β never
//! changes by more than the travel divided by the ramp. Without one it is 0 or 1 at once; the slew
//! limit of the offsets smooths that.
//!
//! β is Q31; positions and progress are exact, β is at most 2 of its last places low, measured
//! below over the whole range of ramps. [`Fraction::interpolate`] rounds to the nearest 1/256 nm over the
//! whole range of a length.

use crate::{
    fixed_point::{mul_high_unsigned, rounding_shift_right},
    units::{FineNanometres, Position},
};

/// A fraction from 0 to 1 in Q31: 2³¹ is 1, and more counts as 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Fraction(pub u32);

impl Fraction {
    /// Binary places of a fraction.
    pub const FRACTION_BITS: u32 = 31;
    /// Nothing: approached in the positive direction.
    pub const ZERO: Self = Self(0);
    /// All: approached in the negative direction.
    pub const ONE: Self = Self(1 << Self::FRACTION_BITS);

    /// Returns the value at this fraction of the way from `a` to `b`, exact at both ends.
    ///
    /// ```
    /// use trueup_core::{reversal::Fraction, units::FineNanometres};
    /// let quarter = Fraction(1 << 29);
    /// assert_eq!(quarter.interpolate(FineNanometres(100), FineNanometres(-300)), FineNanometres(0));
    /// ```
    #[must_use]
    #[inline]
    #[allow(clippy::cast_possible_truncation, reason = "between two values of 32 bits")]
    pub fn interpolate(self, a: FineNanometres, b: FineNanometres) -> FineNanometres {
        // |b − a| < 2³² and the fraction is at most 2³¹: below 2⁶³ with the half.
        let fraction = i64::from(self.0.min(Self::ONE.0));
        let rise = i64::from(b.0).wrapping_sub(i64::from(a.0));
        let part = rounding_shift_right(rise.wrapping_mul(fraction), Self::FRACTION_BITS);
        FineNanometres(i64::from(a.0).wrapping_add(part) as i32)
    }
}

/// A length of which fractions are taken, without a division: its reciprocal is kept.
///
/// The length is shifted up until its top bit is set; with m the result, the reciprocal is
/// ⌊(2⁶³ − 1)/m⌋, and a part shifted alike times it, the high word, is the fraction in Q31.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Interval {
    length: u32,
    reciprocal: u32,
}

impl Interval {
    /// Returns the length, in position units; 0 is allowed.
    ///
    /// Costs some hundred instructions: meant for loading, not for every tick. One copy of them in
    /// the board's image is enough.
    #[must_use]
    #[inline(never)]
    pub const fn new(length: u32) -> Self {
        let Some(normal) = length.checked_shl(length.leading_zeros()) else {
            return Self { length, reciprocal: 0 };
        };
        // Long division: the board has none of 64 bits.
        // Widening; `From` is not const.
        let normal = normal as u64;
        let mut rest = i64::MAX.cast_unsigned();
        let mut reciprocal = 0_u32;
        let mut place = 32_u32;
        while place > 0 {
            place = place.wrapping_sub(1);
            let multiple = normal << place;
            if rest >= multiple {
                rest = rest.wrapping_sub(multiple);
                reciprocal |= 1 << place;
            }
        }
        Self { length, reciprocal }
    }

    /// Returns an interval whose reciprocal was kept with it, [`Self::reciprocal`]; another one gives wrong
    /// fractions, but nothing worse.
    #[must_use]
    pub const fn from_parts(length: u32, reciprocal: u32) -> Self {
        Self { length, reciprocal }
    }

    /// Returns the length in position units (10 nm).
    #[must_use]
    pub const fn length(self) -> u32 {
        self.length
    }

    /// Returns the reciprocal, normalised.
    #[must_use]
    pub const fn reciprocal(self) -> u32 {
        self.reciprocal
    }

    /// Returns the fraction that `part` is of the length, held to 1; of a length of 0 everything is all.
    ///
    /// ```
    /// use trueup_core::reversal::{Fraction, Interval};
    /// // 75 of 300 are a quarter, 2²⁹ in Q31; at most 2 of the last places too low.
    /// assert!(Interval::new(300).fraction(75).0.abs_diff(1 << 29) <= 2);
    /// assert_eq!(Interval::new(300).fraction(300), Fraction::ONE);
    /// ```
    #[must_use]
    #[inline]
    pub fn fraction(self, part: u32) -> Fraction {
        if part >= self.length {
            return Fraction::ONE;
        }
        let normal = part.wrapping_shl(self.length.leading_zeros());
        Fraction(mul_high_unsigned(normal, self.reciprocal))
    }
}

/// The distances that a reversal of this axis takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReversalConfig {
    /// How far back a position must lie before the reversal counts, in position units.
    pub hysteresis: u32,
    /// The travel, after that, over which β goes from one end to the other.
    pub ramp: Interval,
}

/// The direction of approach of one axis. A changed [`ReversalConfig`] needs a new one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReversalTracker {
    /// +1, −1, or 0 while no direction has been seen.
    direction: i8,
    /// The furthest point in the present direction.
    furthest: Position,
    /// How much of the ramp is passed towards the negative end.
    progress: u32,
    reversal: Fraction,
}

impl ReversalTracker {
    /// No direction seen yet; β is 0.
    #[must_use]
    pub const fn new() -> Self {
        Self { direction: 0, furthest: Position(0), progress: 0, reversal: Fraction::ZERO }
    }

    /// Takes the commanded position and direction (its sign; 0 changes nothing at all).
    ///
    /// A position may jump by any amount. A jump back by more than the hysteresis in the present
    /// direction hides two reversals: travel is then counted from the new position.
    ///
    /// ```
    /// use trueup_core::{reversal::{backlash_error, ReversalConfig, ReversalTracker, Interval}, units::{FineNanometres, Position}};
    /// // Reversal counts after 10 µm, and then takes 100 µm; backlash 4 µm.
    /// let config = ReversalConfig { hysteresis: 1_000, ramp: Interval::new(10_000) };
    /// let width = FineNanometres(4_000 * 256);
    /// let mut travel = ReversalTracker::new();
    /// travel.update(&config, Position(500_000), 1);
    /// assert_eq!(backlash_error(width, travel.reversal()), FineNanometres(0));
    /// travel.update(&config, Position(494_000), -1); // 60 µm back: half way
    /// assert_eq!(backlash_error(width, travel.reversal()).rounded().0, 2_000);
    /// travel.update(&config, Position(489_000), -1); // 110 µm back
    /// assert_eq!(backlash_error(width, travel.reversal()), width);
    /// ```
    pub fn update(&mut self, config: &ReversalConfig, p: Position, direction: i8) {
        let direction = direction.signum();
        if direction == 0 {
            return;
        }
        if self.direction == 0 {
            self.progress = if direction < 0 { config.ramp.length } else { 0 };
            self.direction = direction;
            self.furthest = p;
        } else {
            if self.is_beyond_furthest(p) {
                self.advance(config, self.furthest.0.abs_diff(p.0));
                self.furthest = p;
            }
            let back = self.furthest.0.abs_diff(p.0);
            if let Some(advance) = back.checked_sub(config.hysteresis) {
                if direction != self.direction {
                    self.direction = direction;
                    self.advance(config, advance);
                }
                self.furthest = p;
            }
        }
        // Of no ramp everything is passed at once, in either direction.
        let at_once = config.ramp.length == 0 && self.direction > 0;
        self.reversal = if at_once { Fraction::ZERO } else { config.ramp.fraction(self.progress) };
    }

    /// Returns whether `p` is further in the present direction than any position before.
    fn is_beyond_furthest(&self, p: Position) -> bool {
        if self.direction < 0 { p < self.furthest } else { p > self.furthest }
    }

    /// Moves the progress by travel in the present direction.
    fn advance(&mut self, config: &ReversalConfig, travel: u32) {
        let moved = if self.direction < 0 {
            self.progress.saturating_add(travel)
        } else {
            self.progress.saturating_sub(travel)
        };
        self.progress = moved.min(config.ramp.length);
    }

    /// β: 0 approached in the positive direction or unknown, 1 in the negative.
    #[must_use]
    pub const fn reversal(&self) -> Fraction {
        self.reversal
    }

    /// Returns the direction of approach: +1, −1, or 0 while none has been seen.
    #[must_use]
    pub const fn direction(&self) -> i8 {
        self.direction
    }
}

/// Returns the error that backlash of `width` makes: 0 approached in the positive direction, the width in
/// the negative one, in which the table is left behind. A width below 0 is over-compensation.
///
/// ```
/// use trueup_core::{reversal::{backlash_error, Fraction}, units::FineNanometres};
/// assert_eq!(backlash_error(FineNanometres(1_024), Fraction::ZERO), FineNanometres(0));
/// assert_eq!(backlash_error(FineNanometres(1_024), Fraction::ONE), FineNanometres(1_024));
/// ```
#[must_use]
#[inline]
pub fn backlash_error(width: FineNanometres, reversal: Fraction) -> FineNanometres {
    reversal.interpolate(FineNanometres::ZERO, width)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::next_random;
    extern crate std;

    const UM: i32 = Position::PER_MILLIMETRE / 1_000;
    const AT_ONCE: ReversalConfig = ReversalConfig { hysteresis: 0, ramp: Interval::new(0) };

    fn config(hysteresis: u32, ramp: u32) -> ReversalConfig {
        ReversalConfig { hysteresis, ramp: Interval::new(ramp) }
    }

    /// β as a number after each of the updates.
    fn betas<const N: usize>(config: &ReversalConfig, updates: [(i32, i8); N]) -> [f64; N] {
        let mut travel = ReversalTracker::new();
        updates.map(|(p, direction)| {
            travel.update(config, Position(p), direction);
            f64::from(travel.reversal().0) / 2f64.powi(31)
        })
    }

    fn near<const N: usize>(got: [f64; N], requested: [f64; N]) {
        for (got, requested) in got.into_iter().zip(requested) {
            assert!((got - requested).abs() < 1e-8, "{got} instead of {requested}");
        }
    }

    #[test]
    fn approached_forwards_the_error_is_nought_and_backwards_it_is_the_width() {
        let width = FineNanometres(4_000 * FineNanometres::PER_NANOMETRE);
        let mut travel = ReversalTracker::new();
        assert_eq!(
            (travel.direction(), backlash_error(width, travel.reversal())),
            (0, FineNanometres(0))
        );
        travel.update(&AT_ONCE, Position(0), 1);
        assert_eq!(
            (travel.direction(), backlash_error(width, travel.reversal())),
            (1, FineNanometres(0))
        );
        // At once, even without travel.
        travel.update(&AT_ONCE, Position(0), -1);
        assert_eq!((travel.direction(), backlash_error(width, travel.reversal())), (-1, width));
        travel.update(&AT_ONCE, Position(0), 1);
        assert_eq!(
            (travel.direction(), backlash_error(width, travel.reversal())),
            (1, FineNanometres(0))
        );
    }

    #[test]
    fn a_cnc_that_over_compensates_has_a_negative_width() {
        let width = FineNanometres(-3_000 * FineNanometres::PER_NANOMETRE);
        assert_eq!(backlash_error(width, Fraction::ONE), width);
        assert_eq!(backlash_error(width, Fraction(1 << 30)).rounded().0, -1_500);
        assert_eq!(
            backlash_error(FineNanometres(i32::MIN), Fraction::ONE),
            FineNanometres(i32::MIN)
        );
    }

    #[test]
    fn the_first_direction_is_taken_at_its_end_value() {
        near(betas(&config(500, 10_000), [(7, 0), (7, -1)]), [0.0, 1.0]);
        near(betas(&config(500, 10_000), [(7, 0), (7, 1)]), [0.0, 0.0]);
        near(betas(&AT_ONCE, [(7, 0), (7, -1)]), [0.0, 1.0]);
    }

    #[test]
    fn a_stop_keeps_the_direction_wherever_the_position_is() {
        let updates = [(0, -1), (0, 0), (90_000, 0), (-90_000, 0)];
        near(betas(&AT_ONCE, updates), [1.0; 4]);
    }

    #[test]
    fn dither_below_the_hysteresis_changes_nothing() {
        let config = config(100, 1_000);
        let updates = [(5_000, 1), (4_901, -1), (5_000, 1), (4_950, -1), (4_901, 1), (4_901, -1)];
        near(betas(&config, updates), [0.0; 6]);
        // The same in the middle of a ramp.
        let updates = [(5_000, 1), (4_400, -1), (4_499, 1), (4_401, -1), (4_400, 1), (4_400, -1)];
        near(betas(&config, updates), [0.0, 0.5, 0.5, 0.5, 0.5, 0.5]);
        // The reversal is measured from the furthest point, not from the last one.
        near(betas(&config, [(5_000, 1), (4_960, 1), (4_850, -1)]), [0.0, 0.0, 0.05]);
    }

    #[test]
    fn the_ramp_is_linear_and_goes_back_the_same_way() {
        let config = config(0, 1_000);
        let updates = [(0, 1), (0, -1), (-250, -1), (-500, -1), (-400, 1), (-100, 1), (100, 1)];
        near(betas(&config, updates), [0.0, 0.0, 0.25, 0.5, 0.4, 0.1, 0.0]);
        let updates = [(0, -1), (300, 1), (200, -1), (0, -1), (1_100, 1)];
        near(betas(&config, updates), [1.0, 0.7, 0.8, 1.0, 0.0]);
    }

    #[test]
    fn a_stop_in_the_middle_of_the_ramp_holds_it_there() {
        let updates = [(0, 1), (-500, -1), (-500, 0), (-500, 0), (-700, -1), (-700, 0), (-600, 1)];
        near(betas(&config(0, 1_000), updates), [0.0, 0.5, 0.5, 0.5, 0.7, 0.7, 0.6]);
    }

    #[test]
    fn a_far_jump_is_fully_there() {
        let config = config(5 * UM.unsigned_abs(), 50 * UM.unsigned_abs());
        near(betas(&config, [(0, 1), (-1_500_000_000, -1)]), [0.0, 1.0]);
        near(betas(&config, [(i32::MIN, -1), (i32::MAX, 1), (i32::MIN, -1)]), [1.0, 0.0, 1.0]);
        // Unseen, the axis went on to 100 and then turned.
        near(betas(&config, [(0, 1), (60 * UM, -1), (30 * UM, -1)]), [0.0, 0.0, 0.5]);
        // Unseen, it went far back and turned again: what follows counts from there.
        near(
            betas(&config, [(0, -1), (30 * UM, 1), (-900 * UM, 1), (-890 * UM, 1)]),
            [1.0, 0.5, 0.5, 0.3],
        );
    }

    #[test]
    fn with_a_ramp_beta_never_jumps() {
        let mut seed = 1;
        for (hysteresis, ramp) in [(0, 1), (0, 1_000), (7, 300), (400, 40), (0, u32::MAX)] {
            let config = config(hysteresis, ramp);
            let mut travel = ReversalTracker::new();
            let mut p = 0_i32;
            travel.update(&config, Position(p), 1);
            for _ in 0..200_000 {
                let (step, direction) = (next_random(&mut seed) % 61, next_random(&mut seed) % 3);
                let (before, moved) = (travel.reversal(), step as i32 - 30);
                p += moved;
                travel.update(
                    &config,
                    Position(p),
                    if direction == 0 { 1 } else { moved.signum() as i8 },
                );
                let change = f64::from(travel.reversal().0) - f64::from(before.0);
                let most = f64::from(moved.unsigned_abs()) / f64::from(ramp) * 2f64.powi(31);
                assert!(change.abs() <= most + 4.0, "{change} {most}");
            }
        }
    }

    #[test]
    fn a_share_is_f64_within_two_last_places() {
        let (mut worst, mut seed) = (0.0_f64, 2);
        let mut check = |length: u32, part: u32| {
            let fraction = f64::from(Interval::new(length).fraction(part).0);
            let exact = (f64::from(part) / f64::from(length)).min(1.0) * 2f64.powi(31);
            assert!(fraction <= exact + 1e-6, "{part}/{length}");
            worst = worst.max(exact - fraction);
        };
        for bits in 0..32 {
            for length in [1_u32 << bits, (1_u64 << (bits + 1)).wrapping_sub(1) as u32] {
                for part in [0, 1, length / 2, length - 1, length, u32::MAX] {
                    check(length, part);
                }
            }
        }
        for _ in 0..1_000_000 {
            let length = (next_random(&mut seed) >> (next_random(&mut seed) % 32)).max(1);
            check(length, next_random(&mut seed) % length);
        }
        std::println!("largest error of a fraction: {worst:.3} of 2^-31");
        assert!(worst <= 2.0);
        assert_eq!(Interval::new(0).fraction(0), Fraction::ONE);
    }

    #[test]
    fn a_blend_is_f64_rounded_over_the_whole_range() {
        let (mut worst, mut seed) = (0.0_f64, 3);
        for _ in 0..1_000_000 {
            let (a, b) = (next_random(&mut seed) as i32, next_random(&mut seed) as i32);
            let reversal = Fraction(next_random(&mut seed) >> 1);
            let fraction = f64::from(reversal.0) / 2f64.powi(31);
            let exact = f64::from(a) + (f64::from(b) - f64::from(a)) * fraction;
            worst = worst.max(
                (f64::from(reversal.interpolate(FineNanometres(a), FineNanometres(b)).0) - exact)
                    .abs(),
            );
        }
        std::println!("largest error of a reversal: {worst:.3} of 1/256 nm");
        assert!(worst <= 0.501);
        for (a, b) in [(i32::MIN, i32::MAX), (i32::MAX, i32::MIN), (7, -9)] {
            assert_eq!(
                Fraction::ZERO.interpolate(FineNanometres(a), FineNanometres(b)),
                FineNanometres(a)
            );
            assert_eq!(
                Fraction::ONE.interpolate(FineNanometres(a), FineNanometres(b)),
                FineNanometres(b)
            );
            assert_eq!(
                Fraction(u32::MAX).interpolate(FineNanometres(a), FineNanometres(b)),
                FineNanometres(b),
                "more is all"
            );
        }
    }

    #[test]
    fn anything_may_come() {
        let mut seed = 4;
        let extremes = [i32::MIN, i32::MIN + 1, -1, 0, 1, i32::MAX];
        for _ in 0..100_000 {
            let mut any = |n: u32| (next_random(&mut seed) % n) as usize;
            let lengths = [0, 1, 1_000, 1 << 31, u32::MAX];
            let config = config(lengths[any(5)], lengths[any(5)]);
            let mut travel = ReversalTracker::new();
            for _ in 0..6 {
                let direction = [i8::MIN, -1, 0, 1, i8::MAX][any(5)];
                // A new configuration may come at any time.
                let config = if any(4) == 0 { AT_ONCE } else { config };
                travel.update(&config, Position(extremes[any(6)]), direction);
                assert!(travel.reversal() <= Fraction::ONE);
            }
        }
    }

    #[test]
    fn an_interval_that_was_kept_with_its_reciprocal_is_the_same() {
        for length in [0, 1, 77, 100_000, u32::MAX] {
            let interval = Interval::new(length);
            let again = Interval::from_parts(interval.length(), interval.reciprocal());
            assert_eq!(again, interval);
        }
    }
}
