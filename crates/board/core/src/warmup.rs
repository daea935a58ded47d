//! Growth of a spindle that has no sensor: heat as a state (`docs/physics.md` section 2).
//!
//! h follows the drive with τ = (t₂ − t₁)/k while the spindle runs, once it has run for the lag t₁;
//! else it follows 0, with a time constant of its own. The growth is
//!
//! s = Smax·min(1, h/(1 − e^(−k))),
//!
//! which from cold and at constant speed is the closed form s = Smax·(1 − e^(−k·u))/(1 − e^(−k)),
//! u = (t − t₁)/(t₂ − t₁). Unlike that it survives stops and changes of speed. The drive is
//! (n/n_rated)^p: 1 in Q28 at the rated speed, 0 when stopped; the caller computes it.
//!
//! Every stop begins the lag t₁ anew, and until it has passed the spindle goes on cooling. A step
//! counts as after the lag when at least half of it is. h is Q28 with 28 binary places more inside
//! [`Lag`]; its gain 1/(1 − e^(−k)) is Q24, so k ≥ 0.008. Measured worst error for 80 µm, lag 60 s,
//! warm 5400 s and k = 4, against the closed form in `f64` over two hours: 0.04 nm; over a day of
//! stops and changes of speed against the state in `f64`: 0.06 nm. A smoothing factor of 32 bits leaves 10 nm
//! at k = 0.05, where τ is 30 hours.

use crate::{
    design_parameters::THERMAL_STEP_MS,
    fixed_point::{rounding_shift_right, widening_mul},
    lag::{Lag, SmoothingFactor},
    units::FineNanometres,
};

/// How a spindle warms up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WarmupModel {
    /// t₁: how long the spindle has to run before its heat shows. `u32::MAX`: for ever.
    pub lag_ms: u32,
    /// Smax: the growth of a spindle that is warm through.
    pub max: FineNanometres,
    /// 1 − e^(−Δt/τ) while it heats, τ = (t₂ − t₁)/k.
    pub smoothing_heating: SmoothingFactor,
    /// The same while it cools.
    pub smoothing_cooling: SmoothingFactor,
    /// 1/(1 − e^(−k)) in Q24: with it the growth is full at t₂ rather than never.
    pub full: i32,
}

/// How warm a spindle is. The default is cold and at rest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WarmupModelState {
    /// How long it has run without a stop; stays at `u32::MAX` after 49.7 days.
    pub running_ms: u32,
    /// h in Q28.
    pub heat: Lag,
}

impl WarmupModel {
    /// Binary places of a drive and of h.
    pub const HEAT_INPUT_FRACTION_BITS: u32 = 28;
    /// The drive at the rated speed.
    pub const RATED_HEAT_INPUT: i32 = 1 << Self::HEAT_INPUT_FRACTION_BITS;
    /// Binary places of [`WarmupModel::full`].
    pub const FULL_FRACTION_BITS: u32 = 24;

    /// One step of [`THERMAL_STEP_MS`] through which the spindle was driven like this; 0 or less: stopped.
    ///
    /// ```
    /// use trueup_core::{design_parameters::THERMAL_STEP_MS, lag::SmoothingFactor, units::FineNanometres};
    /// use trueup_core::warmup::{WarmupModelState, WarmupModel};
    /// // 80 µm after a lag of 200 ms; half of what is missing comes in every step.
    /// let spindle = WarmupModel {
    ///     lag_ms: 2 * THERMAL_STEP_MS,
    ///     max: FineNanometres(80_000 * 256),
    ///     smoothing_heating: SmoothingFactor(1 << 31),
    ///     smoothing_cooling: SmoothingFactor(1 << 30),
    ///     full: 1 << WarmupModel::FULL_FRACTION_BITS,
    /// };
    /// let mut state = WarmupModelState::default();
    /// for expected_um in [0, 0, 40, 60, 70] {
    ///     spindle.step(&mut state, WarmupModel::RATED_HEAT_INPUT);
    ///     assert_eq!(spindle.elongation(&state).rounded().0, expected_um * 1_000);
    /// }
    /// // Stopped, it loses a quarter of 70 µm; and started again it goes on cooling for the lag.
    /// spindle.step(&mut state, 0);
    /// assert_eq!(spindle.elongation(&state).rounded().0, 52_500);
    /// spindle.step(&mut state, WarmupModel::RATED_HEAT_INPUT);
    /// assert_eq!(spindle.elongation(&state).rounded().0, 39_375);
    /// ```
    pub fn step(&self, state: &mut WarmupModelState, drive: i32) {
        let running = drive > 0;
        state.running_ms =
            if running { state.running_ms.saturating_add(THERMAL_STEP_MS) } else { 0 };
        if running && state.running_ms.saturating_sub(self.lag_ms) >= THERMAL_STEP_MS / 2 {
            state.heat.step(drive, self.smoothing_heating);
        } else {
            state.heat.step(0, self.smoothing_cooling);
        }
    }

    /// Returns the growth now, at most Smax; positive when the tool grows out of the spindle.
    #[must_use]
    pub fn elongation(&self, state: &WarmupModelState) -> FineNanometres {
        let heated = widening_mul(state.heat.value(), self.full) >> Self::FULL_FRACTION_BITS;
        let part = heated.clamp(0, i64::from(Self::RATED_HEAT_INPUT));
        // 29 bits by 32: nothing can wrap.
        let growth = part.wrapping_mul(i64::from(self.max.0));
        FineNanometres::saturating_from(rounding_shift_right(
            growth,
            Self::HEAT_INPUT_FRACTION_BITS,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Nanometres;
    extern crate std;

    const LAG_S: f64 = 60.0;
    const WARM_S: f64 = 5400.0;
    const MAX_NM: f64 = 80_000.0;
    const COOL_S: f64 = 2_900.0;

    fn smoothing(tau_s: f64) -> f64 {
        -(-f64::from(THERMAL_STEP_MS) / 1e3 / tau_s).exp_m1()
    }

    fn q(value: f64, bits: i32) -> f64 {
        (value * 2.0_f64.powi(bits)).round()
    }

    fn spindle(lag_s: f64, k: f64) -> WarmupModel {
        WarmupModel {
            lag_ms: (lag_s * 1e3).round() as u32,
            max: FineNanometres((MAX_NM * 256.0) as i32),
            smoothing_heating: SmoothingFactor(q(smoothing((WARM_S - lag_s) / k), 32) as u32),
            smoothing_cooling: SmoothingFactor(q(smoothing(COOL_S), 32) as u32),
            full: q(1.0 / -(-k).exp_m1(), 24) as i32,
        }
    }

    fn closed_form(t: f64, lag_s: f64, k: f64) -> f64 {
        let u = ((t - lag_s) / (WARM_S - lag_s)).clamp(0.0, 1.0);
        MAX_NM * (-k * u).exp_m1() / (-k).exp_m1()
    }

    /// Returns the worst error in nm over two hours from cold at the rated speed.
    fn worst_from_cold(lag_s: f64, k: f64) -> f64 {
        let spindle = spindle(lag_s, k);
        let mut state = WarmupModelState::default();
        let mut worst = 0.0_f64;
        for step in 1..=2 * 36_000 {
            spindle.step(&mut state, WarmupModel::RATED_HEAT_INPUT);
            let got = f64::from(spindle.elongation(&state).0) / 256.0;
            let t = f64::from(step) * f64::from(THERMAL_STEP_MS) / 1e3;
            worst = worst.max((got - closed_form(t, lag_s, k)).abs());
        }
        worst
    }

    #[test]
    fn from_cold_at_constant_speed_it_is_the_closed_form() {
        for k in [0.05, 0.5, 2.0, 4.0, 8.0] {
            let worst = worst_from_cold(LAG_S, k);
            std::println!("k = {k}: {worst:.4} nm against the closed form");
            // Every step of the two hours, the minutes among them. The smoothing factor is Q32, which makes
            // τ wrong by 1.2e-9/s of itself.
            let tau_s = (WARM_S - LAG_S) / k;
            assert!(worst < 0.05 + MAX_NM * tau_s * 1.2e-9);
        }
        assert!(worst_from_cold(LAG_S, 4.0) < 0.05);
        assert!(worst_from_cold(0.0, 4.0) < 0.05, "without a lag");
    }

    #[test]
    fn a_lag_between_two_steps_costs_at_most_half_a_step_of_growth() {
        for lag_s in [59.96, 60.01, 60.049, 60.05, 60.051, 60.09] {
            let worst = worst_from_cold(lag_s, 4.0);
            std::println!("lag {lag_s} s: {worst:.3} nm");
            assert!(worst < 5.0);
        }
    }

    #[test]
    fn the_papers_spindle_is_cold_for_a_minute_and_full_after_90() {
        let spindle = spindle(LAG_S, 4.0);
        let mut state = WarmupModelState::default();
        for _ in 0..600 {
            spindle.step(&mut state, WarmupModel::RATED_HEAT_INPUT);
        }
        assert_eq!(spindle.elongation(&state), FineNanometres::ZERO);
        spindle.step(&mut state, WarmupModel::RATED_HEAT_INPUT);
        assert!(spindle.elongation(&state) > FineNanometres::ZERO);
        for _ in 601..54_000 {
            spindle.step(&mut state, WarmupModel::RATED_HEAT_INPUT);
        }
        assert_eq!(spindle.elongation(&state).rounded(), Nanometres(80_000));
        for _ in 0..36_000 {
            spindle.step(&mut state, WarmupModel::RATED_HEAT_INPUT);
            assert!(spindle.elongation(&state) <= spindle.max, "it never grows beyond Smax");
        }
    }

    /// The drive in a day of work: (steps, drive).
    const DAY: [(u32, f64); 10] = [
        (20_000, 1.0),
        (9_000, 0.0),
        (300, 1.0),
        (50, 0.0),
        (30_000, 0.4),
        (12_000, 1.3),
        (100_000, 0.0),
        (601, 1.0),
        (1, 0.0),
        (60_000, 0.85),
    ];

    #[test]
    fn stops_restarts_and_speeds_follow_the_state_in_f64() {
        let k = 4.0;
        let spindle = spindle(LAG_S, k);
        let (heat, cool) = (smoothing((WARM_S - LAG_S) / k), smoothing(COOL_S));
        let mut state = WarmupModelState::default();
        let (mut h, mut running_s) = (0.0_f64, 0.0_f64);
        let mut worst = 0.0_f64;
        for (steps, drive) in DAY {
            for _ in 0..steps {
                spindle.step(&mut state, q(drive, 28) as i32);
                running_s = if drive > 0.0 { running_s + 0.1 } else { 0.0 };
                h += if running_s > LAG_S + 0.01 { (drive - h) * heat } else { -h * cool };
                let expected = MAX_NM * (h / -(-k).exp_m1()).min(1.0);
                let got = f64::from(spindle.elongation(&state).0) / 256.0;
                worst = worst.max((got - expected).abs());
            }
        }
        std::println!("a day of stops and speeds: {worst:.4} nm against the state");
        assert!(worst < 0.5);
    }

    #[test]
    fn a_restart_goes_on_cooling_until_its_own_lag_has_passed() {
        let spindle = spindle(LAG_S, 4.0);
        let mut state = WarmupModelState::default();
        let run = |state: &mut WarmupModelState, steps: u32, drive| {
            for _ in 0..steps {
                spindle.step(state, drive);
            }
            spindle.elongation(state)
        };
        let warm = run(&mut state, 20_000, WarmupModel::RATED_HEAT_INPUT);
        let stopped = run(&mut state, 100, 0);
        assert!(stopped < warm);
        assert_eq!(state.running_ms, 0);
        let restarted = run(&mut state, 600, WarmupModel::RATED_HEAT_INPUT);
        assert!(restarted < stopped);
        assert!(run(&mut state, 1, WarmupModel::RATED_HEAT_INPUT) > restarted);
    }

    #[test]
    fn a_longer_spindle_is_a_positive_elongation() {
        let spindle = WarmupModel { max: FineNanometres(-256_000), ..spindle(0.0, 4.0) };
        let mut state = WarmupModelState {
            running_ms: 0,
            heat: Lag::settled_at(WarmupModel::RATED_HEAT_INPUT),
        };
        spindle.step(&mut state, WarmupModel::RATED_HEAT_INPUT);
        assert_eq!(
            spindle.elongation(&state),
            FineNanometres(-256_000),
            "a negative Smax is a shorter one"
        );
    }

    #[test]
    fn the_extremes_neither_wrap_nor_panic() {
        for lag_ms in [0, 1, u32::MAX] {
            for max in [i32::MIN, -1, 0, i32::MAX] {
                for full in [i32::MIN, 0, 1 << 24, i32::MAX] {
                    for smoothing in [0, 1, u32::MAX] {
                        let (smoothing_heating, smoothing_cooling) =
                            (SmoothingFactor(smoothing), SmoothingFactor(u32::MAX - smoothing));
                        let max = FineNanometres(max);
                        let wild =
                            WarmupModel { lag_ms, max, smoothing_heating, smoothing_cooling, full };
                        for running_ms in [0, u32::MAX] {
                            let heat = Lag::settled_at(i32::MIN);
                            let mut state = WarmupModelState { running_ms, heat };
                            for drive in [i32::MIN, -1, 0, 1, i32::MAX, i32::MAX] {
                                wild.step(&mut state, drive);
                                let grown = wild.elongation(&state).0;
                                assert!(grown.unsigned_abs() <= max.0.unsigned_abs());
                            }
                        }
                    }
                }
            }
        }
    }
}
