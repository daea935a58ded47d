//! A first-order lag: the screw follows its thermometer.
//!
//! y += (x − y)·(1 − e^(−Δt/τ)), with a fixed step of [`THERMAL_STEP_MS`](crate::design_parameters::THERMAL_STEP_MS) and the smoothing factor 1 − e^(−Δt/τ) in
//! Q32, computed by the host. It is exact for an input that is constant over the step.
//!
//! The state has 28 binary places below its input, which may be any `i32`, so it fills 60 bits; a
//! step takes the upper part of a product of 61 by 32 bits, rounded to the nearest.
//!
//! Measured worst error for temperatures against `f64`, over six hours of steps, ramps and swings
//! of 20 K, τ from 0.2 s to 10⁶ s, with the rounded smoothing factor: 0.00013 mK, the rounding of
//! the value. The rounding of the smoothing factor makes τ wrong by at most 1.2·10⁻⁹/s of itself: with the
//! exact smoothing factor the reference is 0.009 mK away at 1630 s, 0.13 mK at 10⁴ s and 0.24 mK at 10⁶ s,
//! where days would make it at most 9 mK (0.12 % of τ).
//!
//! Steps that were missed count as if the first input that is seen again had held all the time: from n of them
//! remains (1 − α)ⁿ of the difference, by squaring, as α of two steps is 2α − α². That is Newton's law of cooling
//! (`docs/physics.md` section 7) and exact for a temperature that was constant. If it was up to D away from the
//! one seen again, the value is wrong by at most D·(1 − e^(−t/τ)).

use crate::fixed_point::{mul_q32, rounding_shift_right, saturate_to_i32};

/// 1 − e^(−Δt/τ) for one step, in Q32.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SmoothingFactor(pub u32);

impl SmoothingFactor {
    /// No lag: the value is the input.
    pub const NO_LAG: Self = Self(u32::MAX);
    /// The value stays unchanged.
    pub const HOLD: Self = Self(0);
    /// A time constant of 1 s: 1 − e^(−0.1) in Q32.
    pub const TIME_CONSTANT_1_S: Self = Self(408_720_177);

    /// Steps after which a difference is down to one of `parts`, or less. It is counted in half-lives,
    /// ln 2/α of them at most.
    #[must_use]
    pub fn steps_to_fraction(self, parts: u32) -> u32 {
        /// ln 2 in Q32.
        const LN_2_Q32: u64 = 2_977_044_472;
        let halvings = u64::from(u32::BITS.saturating_sub(parts.saturating_sub(1).leading_zeros()));
        let steps = halvings.saturating_mul(LN_2_Q32).checked_div(self.0.into());
        steps.map_or(u32::MAX, |steps| u32::try_from(steps).unwrap_or(u32::MAX).saturating_add(1))
    }
}

/// A value that follows its input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lag {
    /// The value with [`Lag::FRACTION_BITS`] binary places below those of the input.
    state: i64,
    /// Steps that it has not followed yet.
    missed: u32,
}

impl Lag {
    /// Binary places below the input's.
    const FRACTION_BITS: u32 = 28;

    /// Returns a lag that has followed `x` for ever.
    #[must_use]
    pub const fn settled_at(x: i32) -> Self {
        Self { state: (x as i64) << Self::FRACTION_BITS, missed: 0 }
    }

    /// Its state, for keeping.
    #[must_use]
    pub const fn to_bits(self) -> i64 {
        self.state
    }

    /// Returns the lag with this state, which any `i64` of 60 bits and a sign is; more saturates.
    #[must_use]
    pub const fn from_bits(bits: i64) -> Self {
        let (least, most) = (Self::settled_at(i32::MIN).state, Self::settled_at(i32::MAX).state);
        Self {
            state: if bits < least {
                least
            } else if bits > most {
                most
            } else {
                bits
            },
            missed: 0,
        }
    }

    /// Counts this many steps in which the input is not seen. The next input counts for them.
    ///
    /// ```
    /// use trueup_core::lag::{Lag, SmoothingFactor};
    /// let mut lag = Lag::settled_at(0);
    /// lag.record_missed_steps(3);
    /// assert_eq!(lag.value(), 0);
    /// // As four steps to 1000: 1000·(1 − 0.75⁴).
    /// lag.step(1000, SmoothingFactor(1 << 30));
    /// assert_eq!((lag.value(), lag.missed_steps()), (684, 0));
    /// ```
    pub const fn record_missed_steps(&mut self, steps: u32) {
        self.missed = self.missed.saturating_add(steps);
    }

    /// Steps that it has not followed yet.
    #[must_use]
    pub const fn missed_steps(self) -> u32 {
        self.missed
    }

    /// Follows `x`, which has held over the step that ends now.
    ///
    /// ```
    /// use trueup_core::lag::{Lag, SmoothingFactor};
    /// let mut lag = Lag::settled_at(0);
    /// // A smoothing factor of a quarter: 1000·(1 − 0.75ⁿ).
    /// let quarter = SmoothingFactor(1 << 30);
    /// for expected in [250, 438, 578, 684] {
    ///     lag.step(1000, quarter);
    ///     assert_eq!(lag.value(), expected);
    /// }
    /// lag.step(1000, SmoothingFactor::NO_LAG);
    /// assert_eq!(lag.value(), 1000);
    /// ```
    pub fn step(&mut self, x: i32, smoothing: SmoothingFactor) {
        if self.missed != 0 {
            self.follow(x, smoothing, 0);
        }
        self.advance(x, smoothing);
    }

    /// Follows `x` over one step; what it has missed is none.
    fn advance(&mut self, x: i32, smoothing: SmoothingFactor) {
        let target = Self::settled_at(x).state;
        if smoothing == SmoothingFactor::NO_LAG {
            self.state = target;
            return;
        }
        // Below 2⁶⁰, and the smoothing factor below 1, so that the state stays between itself and its target.
        let difference = target.wrapping_sub(self.state);
        self.state = self.state.wrapping_add(mul_q32(difference, smoothing.0));
    }

    /// Follows `x`, which has held over this many steps and those that it has missed.
    #[cold]
    #[inline(never)]
    pub fn follow(&mut self, x: i32, smoothing: SmoothingFactor, steps: u32) {
        let missed = core::mem::take(&mut self.missed);
        let (mut several, mut left) = (smoothing.0, steps.saturating_add(missed));
        while left > 0 {
            if left & 1 == 1 {
                self.advance(x, SmoothingFactor(several));
            }
            several = two_step_smoothing(several);
            left >>= 1;
        }
    }

    /// Returns the value, rounded to the nearest.
    #[must_use]
    pub fn value(&self) -> i32 {
        saturate_to_i32(rounding_shift_right(self.state, Self::FRACTION_BITS))
    }
}

/// 2α − α², rounded to the nearest.
fn two_step_smoothing(smoothing: u32) -> u32 {
    let twice = u64::from(smoothing).wrapping_mul(2);
    // α² is below 2⁶⁴ − 2³³, so the half of a unit does not wrap, and below 2α.
    let square = u64::from(smoothing).wrapping_mul(smoothing.into()).wrapping_add(1 << 31) >> 32;
    u32::try_from(twice.wrapping_sub(square)).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design_parameters::THERMAL_STEP_MS;
    extern crate std;
    use crate::units::Temperature;

    const PER_MILLIKELVIN: f64 = Temperature::PER_MILLIKELVIN as f64;

    fn smoothing(tau_s: f64) -> f64 {
        -(-f64::from(THERMAL_STEP_MS) / 1e3 / tau_s).exp_m1()
    }

    fn rounded(smoothing: f64) -> SmoothingFactor {
        SmoothingFactor((smoothing * 4_294_967_296.0).round() as u32)
    }

    /// Returns a room that warms by 20 K in a step, falls slowly, swings, and rests.
    fn input(step: u32) -> i32 {
        let hours = f64::from(step) * f64::from(THERMAL_STEP_MS) / 3.6e6;
        let celsius = match hours {
            ..0.01 => 20.0,
            ..1.5 => 40.0,
            ..3.0 => 40.0 - (hours - 1.5) * 9.0,
            ..4.5 => 25.0 + 3.0 * (hours * 40.0).sin(),
            _ => -12.345,
        };
        (celsius * 1e3 * PER_MILLIKELVIN) as i32
    }

    /// Returns the worst error in mK over 6 hours, with the exact smoothing factor and with the rounded one.
    fn worst(tau_s: f64) -> (f64, f64) {
        let exact = smoothing(tau_s);
        let smoothing = rounded(exact);
        let given = f64::from(smoothing.0) / 4_294_967_296.0;
        let first = input(0);
        let mut lag = Lag::settled_at(first);
        let (mut with_exact, mut with_given) = (f64::from(first), f64::from(first));
        let mut worst = (0.0_f64, 0.0_f64);
        for step in 0..6 * 36_000 {
            let x = input(step);
            lag.step(x, smoothing);
            with_exact += (f64::from(x) - with_exact) * exact;
            with_given += (f64::from(x) - with_given) * given;
            let y = f64::from(lag.value());
            worst.0 = worst.0.max((y - with_exact).abs() / PER_MILLIKELVIN);
            worst.1 = worst.1.max((y - with_given).abs() / PER_MILLIKELVIN);
        }
        worst
    }

    #[test]
    fn hours_of_steps_and_ramps_leave_a_ten_thousandth_of_a_millikelvin() {
        for tau_s in [0.2, 1.0, 10.0, 163.0, 1_630.0, 1e4, 1e5, 1e6] {
            let (with_exact, with_given) = worst(tau_s);
            std::println!(
                "τ {tau_s} s: {with_given:.6} mK, with the exact smoothing factor {with_exact:.6}"
            );
            assert!(with_given < 1.5e-4);
            // 1.2e-9/s of τ in the time constant, of which 1/e of 20 K can show.
            assert!(with_exact < 1.5e-4 + tau_s * 1.2e-9 * 20_000.0, "τ {tau_s} s");
        }
    }

    #[test]
    fn steps_that_were_missed_are_made_up_for_as_well_as_the_smoothing_factor_is_rounded() {
        // Of what the room has changed by: with the rounded smoothing factor, and by the time constant.
        let (mut worst, mut worst_by_tau) = (0.0_f64, 0.0_f64);
        for tau_s in [0.2, 10.0, 163.0, 1_630.0, 1e4, 1e5, 1e6] {
            let smoothing = rounded(smoothing(tau_s));
            let given = f64::from(smoothing.0) / 4_294_967_296.0;
            for steps in [1, 2, 3, 599, 36_000, 864_000, 6_048_000, 25_920_000, 316_224_000] {
                for (from_k, to_k) in [(60.0, 20.0), (20.0, 60.0), (-40.0, 80.0)] {
                    let [from, to] =
                        [from_k, to_k].map(|kelvin| (kelvin * 1e3 * PER_MILLIKELVIN) as i32);
                    let mut lag = Lag::settled_at(from);
                    lag.record_missed_steps(steps);
                    lag.step(to, smoothing);
                    let got = f64::from(lag.value()) / PER_MILLIKELVIN / 1e3;
                    let steps = f64::from(steps) + 1.0;
                    let left = (got - to_k) / (from_k - to_k);
                    let error = (left - (steps * (-given).ln_1p()).exp()).abs();
                    let time_s = steps * f64::from(THERMAL_STEP_MS) / 1e3;
                    let by_tau = (left - (-time_s / tau_s).exp()).abs();
                    (worst, worst_by_tau) = (worst.max(error), worst_by_tau.max(by_tau));
                    assert!(error < 5e-5, "τ {tau_s} s, {steps} steps: {error}");
                    // 1.2e-9/s of τ in the time constant, of which 1/e shows.
                    assert!(by_tau < 5e-5 + tau_s * 1.2e-9 / 2.7, "τ {tau_s} s, {steps} steps");
                }
            }
        }
        std::println!(
            "worst error {worst:.2e} of the change, by the time constant {worst_by_tau:.2e}"
        );
    }

    /// The thermometer falls by 20 K with 1200 s while it is not read, the part lags by 1630 s.
    #[test]
    fn what_an_unseen_temperature_did_is_missed_by_as_much_as_the_page_says_and_never_by_more() {
        let (fall_k, tau_s, source_s, time_s) = (20.0, 1_630.0, 1_200.0, 3_600.0_f64);
        let smoothing = rounded(smoothing(tau_s));
        let counts = |kelvin: f64| (kelvin * 1e3 * PER_MILLIKELVIN) as i32;
        let mut seen = Lag::settled_at(counts(fall_k));
        let mut unseen = seen;
        let steps = (time_s * 1e3) as u32 / THERMAL_STEP_MS;
        for step in 0..steps {
            // In the middle of the step.
            let at_s = (f64::from(step) + 0.5) * f64::from(THERMAL_STEP_MS) / 1e3;
            seen.step(counts(fall_k * (-at_s / source_s).exp()), smoothing);
        }
        let last = fall_k * (-time_s / source_s).exp();
        unseen.follow(counts(last), smoothing, steps);
        let kelvin = |lag: Lag| f64::from(lag.value()) / PER_MILLIKELVIN / 1e3;
        let missed = kelvin(seen) - kelvin(unseen);
        let [part, source] = [tau_s, source_s].map(|tau| (-time_s / tau).exp());
        // `docs/physics.md` section 7.
        let expected =
            fall_k * (source_s / (tau_s - source_s) * (part - source) - source * (1.0 - part));
        let bound = (fall_k - last) * (1.0 - part);
        std::println!("missed {missed:.2} K of {fall_k} K, at most {bound:.1} K");
        assert!((missed - expected).abs() < 1e-3, "{missed} for {expected}");
        assert!(missed > 0.0 && missed < bound);
    }

    #[test]
    fn many_steps_at_once_are_as_many_steps() {
        let smoothing = rounded(smoothing(30.0));
        for steps in 0..2_000 {
            let mut one_by_one = Lag::settled_at(-9_000_000);
            let mut at_once = one_by_one;
            for _ in 0..=steps {
                one_by_one.step(7_000_000, smoothing);
            }
            at_once.record_missed_steps(steps / 3);
            at_once.record_missed_steps(steps - steps / 3);
            at_once.step(7_000_000, smoothing);
            let apart = one_by_one.value().abs_diff(at_once.value());
            assert!(apart <= 8, "{steps} steps: {apart} apart");
        }
        // However long, it arrives and goes no further.
        for smoothing in [1, 429, u32::MAX - 1, u32::MAX] {
            let mut lag = Lag::settled_at(i32::MIN);
            lag.record_missed_steps(u32::MAX);
            lag.step(i32::MAX, SmoothingFactor(smoothing));
            assert!(lag.value() > i32::MIN && lag.missed_steps() == 0);
        }
    }

    #[test]
    fn the_slowest_lag_still_arrives() {
        // 10⁶ s: within 0.02 of a unit the rounding stops it.
        let smoothing = rounded(smoothing(1e6));
        for (from, to) in [(0, 100), (100, 0), (i32::MIN, i32::MAX), (i32::MAX, i32::MIN)] {
            let mut lag = Lag::settled_at(from);
            // Most of the way in halves, the last bit of it slowly.
            for _ in 0..64 {
                lag.step(to, SmoothingFactor(1 << 31));
            }
            assert_eq!(lag.value(), to);
            lag.step(to, smoothing);
            assert_eq!(lag.value(), to);
        }
        let mut lag = Lag::settled_at(0);
        for _ in 0..12_000_000 {
            lag.step(1, smoothing);
        }
        assert_eq!(lag.value(), 1, "1 − e^(−1.2) of a unit rounds to it");
    }

    #[test]
    fn it_never_overshoots_nor_wraps_at_the_extremes() {
        for smoothing in [0, 1, 1 << 31, u32::MAX - 1, u32::MAX] {
            for (from, to) in [(i32::MIN, i32::MAX), (i32::MAX, i32::MIN), (-1, 0), (0, -1)] {
                let mut lag = Lag::settled_at(from);
                let mut last = from;
                for _ in 0..100 {
                    lag.step(to, SmoothingFactor(smoothing));
                    let now = lag.value();
                    assert!(now >= last.min(to) && now <= last.max(to));
                    last = now;
                }
            }
        }
    }

    #[test]
    fn a_full_share_is_no_lag_and_no_share_holds() {
        let mut lag = Lag::settled_at(5);
        for x in [i32::MIN, -1, 0, 7, i32::MAX] {
            lag.step(x, SmoothingFactor::NO_LAG);
            assert_eq!(lag, Lag::settled_at(x));
            lag.step(12_345, SmoothingFactor::HOLD);
            assert_eq!(lag.value(), x);
        }
    }

    #[test]
    fn a_kept_state_that_no_lag_can_have_is_held_to_the_nearest_that_one_can() {
        for x in [i32::MIN, -1, 0, i32::MAX] {
            assert_eq!(Lag::from_bits(Lag::settled_at(x).to_bits()), Lag::settled_at(x));
        }
        for (bits, x) in [(i64::MIN, i32::MIN), (i64::MAX, i32::MAX)] {
            assert_eq!(Lag::from_bits(bits), Lag::settled_at(x));
        }
        let [least, most] = [i32::MIN, i32::MAX].map(|x| Lag::settled_at(x).to_bits());
        assert_eq!(Lag::from_bits(least - 1), Lag::settled_at(i32::MIN));
        assert_eq!(Lag::from_bits(most + 1), Lag::settled_at(i32::MAX));
    }

    #[test]
    fn two_steps_at_once_are_those_of_the_factor_that_is_nearest() {
        let mut seed = 3;
        for _ in 0..100_000 {
            let smoothing = crate::testing::next_random(&mut seed);
            let one = u128::from(smoothing);
            // 2α − α², in Q64, to the nearest of Q32.
            let exact = ((one << 33) - one * one).min(u128::from(u32::MAX) << 32);
            let apart = (u128::from(two_step_smoothing(smoothing)) << 32).abs_diff(exact);
            assert!(apart <= 1 << 31, "{smoothing}: off by {apart} of 2³²");
        }
    }
}
