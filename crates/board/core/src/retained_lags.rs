//! The heat that outlasts a reset: what each lag has reached, by what it follows and how fast.
//!
//! A machine does not cool because its board restarts. A lag is known again by the channel that it
//! follows and its time constants, not by the calibration that it stood in: another one may be
//! loaded meanwhile, and a part is as warm as it was.
//!
//! Nor does it stop cooling because the power is gone. Where a clock says for how long it was, each lag goes on
//! over that time ([`RetainedLag::after_power_off`]). All of this is done once a second at most, so its size counts and not its
//! time: nothing is inlined.

use crate::{
    design_parameters::MAX_TERMS,
    lag::{Lag, SmoothingFactor},
    term::SpeedExponent,
};

/// Lags of a calibration at most: three axes, the spindle, its running time, the terms.
pub const MAX_LAGS: usize = 5 + MAX_TERMS;

/// The input of a lag, and its time constants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RetainedLagKey {
    /// A temperature channel, 0…7, or one of the numbers below.
    pub input: u8,
    /// α while it rises.
    pub rising: SmoothingFactor,
    /// α while it falls.
    pub falling: SmoothingFactor,
}

impl RetainedLagKey {
    /// In place of a channel: whether the spindle runs.
    pub const SPINDLE_RUNNING_INPUT: u8 = 255;
    /// In place of a channel: time since the start.
    pub const TIME_INPUT: u8 = 254;
    /// In place of a channel: a condition of the machine, with its bit, 0…15.
    pub const CONDITION_FLAG: u8 = 128;
    /// In place of a channel: the spindle's speed.
    pub const SPEED_INPUT: u8 = 253;
    /// In place of a channel: its square.
    pub const SPEED_SQUARED_INPUT: u8 = 252;

    /// Returns the input of heat by this power of the spindle's speed.
    #[must_use]
    pub const fn speed_input(power: SpeedExponent) -> u8 {
        match power {
            SpeedExponent::First => Self::SPEED_INPUT,
            SpeedExponent::Second => Self::SPEED_SQUARED_INPUT,
        }
    }
}

/// One lag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RetainedLag {
    /// Which.
    pub key: RetainedLagKey,
    /// The value it has reached.
    pub lag: Lag,
    /// How long the spindle has run, for [`RetainedLagKey::SPINDLE_RUNNING_INPUT`]; else 0.
    pub running_ms: u32,
}

/// All of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RetainedLags {
    /// As many as there are, from the first on.
    pub lags: [Option<RetainedLag>; MAX_LAGS],
}

impl RetainedLag {
    /// Returns the same after this many steps of [`THERMAL_STEP_MS`](crate::design_parameters::THERMAL_STEP_MS) without power: the spindle
    /// stood, and what had grown since the start went back as fast. A lag of a temperature makes up for them with
    /// the first reading that it sees. The same at once after none: a reset is no stop.
    #[must_use]
    #[inline(never)]
    pub fn after_power_off(mut self, steps: u32) -> Self {
        match self.key.input {
            _ if steps == 0 => {}
            RetainedLagKey::SPINDLE_RUNNING_INPUT
            | RetainedLagKey::TIME_INPUT
            | RetainedLagKey::SPEED_INPUT
            | RetainedLagKey::SPEED_SQUARED_INPUT => {
                self.lag.follow(0, self.key.falling, steps);
                self.running_ms = 0;
            }
            _ => self.lag.record_missed_steps(steps),
        }
        self
    }
}

impl Default for RetainedLags {
    fn default() -> Self {
        Self { lags: [None; MAX_LAGS] }
    }
}

impl RetainedLags {
    /// Takes in one more; the same one again is no more.
    #[inline(never)]
    pub fn insert(&mut self, retained: RetainedLag) {
        let is_its =
            |place: &&mut Option<RetainedLag>| place.is_none_or(|there| there.key == retained.key);
        if let Some(place) = self.lags.iter_mut().find(is_its) {
            *place = Some(retained);
        }
    }

    /// Returns what the lag with this key had reached.
    #[must_use]
    #[inline(never)]
    pub fn find(&self, key: RetainedLagKey) -> Option<RetainedLag> {
        self.lags.into_iter().flatten().find(|retained| retained.key == key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::warmup::{WarmupModel, WarmupModelState};

    /// 1 − e^(−0.1/20) in Q32.
    const SLOW: SmoothingFactor = SmoothingFactor(21_421_336);
    /// Twice as fast.
    const FAST: SmoothingFactor = SmoothingFactor(42_735_832);

    fn retained_lag(input: u8) -> RetainedLag {
        let key = RetainedLagKey { input, rising: SLOW, falling: FAST };
        RetainedLag { key, lag: Lag::settled_at(200_000_000), running_ms: 90_000 }
    }

    #[test]
    fn a_spindle_that_stood_has_cooled_and_begins_its_lag_anew() {
        let law = WarmupModel {
            lag_ms: 0,
            max: crate::units::FineNanometres(1),
            smoothing_heating: SLOW,
            smoothing_cooling: FAST,
            full: 0,
        };
        let RetainedLag { lag, running_ms, .. } =
            retained_lag(RetainedLagKey::SPINDLE_RUNNING_INPUT);
        let mut state = WarmupModelState { running_ms, heat: lag };
        for steps in 1..2_000 {
            law.step(&mut state, 0);
            let after = retained_lag(RetainedLagKey::SPINDLE_RUNNING_INPUT).after_power_off(steps);
            assert_eq!(after.running_ms, 0);
            let apart = after.lag.value().abs_diff(state.heat.value());
            assert!(apart <= 20, "{steps}: {apart} of 200 000 000");
        }
        assert!(state.heat.value() < 20_000);
    }

    #[test]
    fn what_grows_with_time_goes_back_a_lag_of_a_temperature_waits_for_it_and_a_reset_is_no_time() {
        let time = retained_lag(RetainedLagKey::TIME_INPUT).after_power_off(200);
        let expected = 200_000_000.0 * (-20.0_f64 / 10.0).exp();
        assert!((f64::from(time.lag.value()) - expected).abs() < 20_000.0, "{time:?}");
        let channel = retained_lag(7).after_power_off(200).after_power_off(50);
        assert_eq!((channel.lag.value(), channel.lag.missed_steps()), (200_000_000, 250));
        for input in [RetainedLagKey::SPINDLE_RUNNING_INPUT, RetainedLagKey::TIME_INPUT, 7] {
            assert_eq!(retained_lag(input).after_power_off(0), retained_lag(input));
        }
    }

    #[test]
    fn what_is_kept_again_takes_its_own_place_and_no_other() {
        let mut memory = RetainedLags::default();
        let later = |input| RetainedLag { running_ms: 5, ..retained_lag(input) };
        for one in [retained_lag(1), retained_lag(2), retained_lag(3), later(2), later(3)] {
            memory.insert(one);
        }
        assert_eq!(memory.lags.iter().flatten().count(), 3);
        assert_eq!(
            [1, 2, 3].map(|input| memory.find(retained_lag(input).key)),
            [Some(retained_lag(1)), Some(later(2)), Some(later(3))]
        );
        assert_eq!(memory.find(retained_lag(4).key), None);
    }
}
