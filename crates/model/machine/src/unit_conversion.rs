//! Between the user's numbers and the board's integers: units, rounding, and the way back.
//!
//! A number on its way back is the one with the fewest decimals that the board stores as the same
//! integer; most are then what the user wrote.
#![warn(clippy::cast_possible_truncation, clippy::cast_sign_loss)]

use trueup_core::{
    gradient::Gradient,
    thermal::{SLOPE_FRACTION_BITS, SLOPE_UNIT_BITS},
    units::{FineNanometres, NANOMETRES_PER_MICROMETRE, Position, Temperature},
};

pub(crate) const NM_PER_UM: f64 = NANOMETRES_PER_MICROMETRE as f64;
pub(crate) const FINE_UNITS_PER_NM: f64 = FineNanometres::PER_NANOMETRE as f64;
pub(crate) const FINE_UNITS_PER_UM: f64 = FINE_UNITS_PER_NM * NM_PER_UM;
pub(crate) const POSITION_UNITS_PER_MM: f64 = Position::PER_MILLIMETRE as f64;
pub(crate) const TEMPERATURE_UNITS_PER_KELVIN: f64 = Temperature::PER_KELVIN as f64;
/// Gradient units in 1 µm/m: nanometres for 10 nm of travel, Q36.
pub(crate) const GRADIENT_UNITS_PER_UM_PER_M: f64 =
    1e-5 * (1_u64 << Gradient::FRACTION_BITS) as f64;
/// A slope of 1 a kelvin in the board's integers.
pub(crate) const SLOPE_UNITS_PER_INVERSE_KELVIN: f64 =
    (1_u64 << (SLOPE_UNIT_BITS + SLOPE_FRACTION_BITS)) as f64 / TEMPERATURE_UNITS_PER_KELVIN;

/// Returns the nearest integer, or `None` where `i32` does not reach.
pub(crate) fn round_to_i32(value: f64) -> Option<i32> {
    let nearest = value.round();
    #[expect(clippy::cast_possible_truncation, reason = "held to the range of i32")]
    (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&nearest).then_some(nearest as i32)
}

/// Returns the nearest integer, or `None` where `u32` does not reach.
pub(crate) fn round_to_u32(value: f64) -> Option<u32> {
    let nearest = value.round();
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "held to the range of u32"
    )]
    (0.0..=f64::from(u32::MAX)).contains(&nearest).then_some(nearest as u32)
}

/// Returns the number with the fewest decimals near `exact` that is `same` for the board.
pub(crate) fn shortest_decimal(exact: f64, same: impl Fn(f64) -> bool) -> f64 {
    const MAX_DECIMALS: i32 = 15;
    let rounded = |decimals: i32| {
        let scale = 10_f64.powi(decimals);
        // + 0.0 turns −0 into 0.
        (exact * scale).round() / scale + 0.0
    };
    (0..=MAX_DECIMALS).map(rounded).find(|&number| same(number)).unwrap_or(exact)
}

/// Returns what a user writes for `stored`, of which `per_unit` are one of the user's unit.
pub(crate) fn to_user_value(stored: impl Into<f64>, per_unit: f64) -> f64 {
    let stored = stored.into();
    shortest_decimal(stored / per_unit, |number| (number * per_unit - stored).abs() < 0.49)
}
