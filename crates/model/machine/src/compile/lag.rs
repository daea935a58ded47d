//! First-order lags: a time constant and the share of a step that the board takes every 100 ms.

use trueup_core::{design_parameters::THERMAL_STEP_MS, lag::SmoothingFactor};

use super::curve::ErrorMessage;
use crate::unit_conversion::{round_to_u32, shortest_decimal};

const SMOOTHING_FACTOR_SCALE: f64 = (1_u64 << 32) as f64;
const THERMAL_STEP_S: f64 = THERMAL_STEP_MS as f64 / 1_000.0;

/// 1 − e^(−Δt/τ) for the board's step; all of it where there is no lag.
pub(super) fn smoothing_factor(time_constant_s: f64) -> Result<SmoothingFactor, ErrorMessage> {
    if time_constant_s == 0.0 {
        return Ok(SmoothingFactor::NO_LAG);
    }
    // exp_m1 keeps the digits of a long time constant.
    let factor = (-(-THERMAL_STEP_S / time_constant_s).exp_m1() * SMOOTHING_FACTOR_SCALE).round();
    if factor < 1_000.0 {
        return Err(format!("{time_constant_s} s is longer than the board can follow (5 days)"));
    }
    Ok(SmoothingFactor(round_to_u32(factor).unwrap_or(u32::MAX)))
}

/// Returns the smoothing factors while it rises and while it falls, which is the same unless it is given.
pub(super) fn smoothing_factors(
    rising_s: f64,
    falling_s: Option<f64>,
) -> Result<[SmoothingFactor; 2], ErrorMessage> {
    Ok([smoothing_factor(rising_s)?, smoothing_factor(falling_s.unwrap_or(rising_s))?])
}

/// τ of 1 − e^(−Δt/τ), in s.
pub(crate) fn time_constant_s(smoothing: SmoothingFactor) -> f64 {
    -THERMAL_STEP_S / (-f64::from(smoothing.0) / SMOOTHING_FACTOR_SCALE).ln_1p()
}

/// Returns whether a lag of this time constant is stored as `smoothing`.
pub(super) fn compiles_to(time_constant_s: f64, smoothing: SmoothingFactor) -> bool {
    let stored = -(-THERMAL_STEP_S / time_constant_s).exp_m1() * SMOOTHING_FACTOR_SCALE;
    (stored - f64::from(smoothing.0)).abs() < 0.49
}

/// Returns the time constant that a user writes for `smoothing`; 0: no lag.
pub(super) fn decompile_time_constant_s(smoothing: SmoothingFactor) -> f64 {
    if smoothing == SmoothingFactor::NO_LAG {
        return 0.0;
    }
    shortest_decimal(time_constant_s(smoothing), |time_s| compiles_to(time_s, smoothing))
}
