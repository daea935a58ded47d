//! An axis's offset as a constant and a slope, for a control that multiplies by its own position.
//!
//! offset = constant + slope·(P − P₀), P₀ the origin of the axis's thermal law.
//!
//! The slope is that of the law, minus tanβ(T) with what was learned of it, in 0.1 µm/m. The constant is everything else:
//! what is applied now less what the *sent* slope makes at the present position, in 0.1 µm, so that the sum is the applied
//! offset to half a bit wherever the slope was rounded or is still on its way. A position that is 50 ms old costs
//! 25 mm · 270 µm/m = 6.8 µm at 30 m/min where the product is sent, and nothing where the slope is.
//!
//! The slope that is sent follows the law's, or goes to 0 while the offset is taken back, no faster than the slew limit
//! within the distance of the axis from P₀ (at least a metre), so that a control that moves meanwhile sees no step.

use super::{Bridge, BridgeState};
use crate::{
    cnc::{LinearAxis, OffsetQuality, Output},
    fixed_point::rounding_shift_right,
    gradient::Gradient,
    units::{FineNanometres, Nanometres, Position},
};

/// Nanometres of a bit of the constant, and nm/m of a bit of the slope.
pub const SLOPE_RESOLUTION_NM: i32 = 100;
/// The largest constant and slope, either way, in bits.
pub const MAX_WIRE_VALUE: i16 = i16::MAX;

/// Position units in a metre.
const POSITION_UNITS_PER_METRE: u32 = 1_000 * Position::PER_MILLIMETRE.unsigned_abs();

/// An offset as a constant and a slope.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ConstantAndSlope {
    /// In 0.1 µm; `None`: nothing is available, or it is beyond the integer.
    pub constant: Option<i16>,
    /// In 0.1 µm/m.
    pub slope: i16,
}

impl Bridge<'_> {
    /// Returns whether the offset of any axis grows along it by a law of its temperature.
    #[must_use]
    pub fn has_slope(&self) -> bool {
        let mut thermal = self.calibration.axes.iter().filter_map(|axis| axis.thermal.as_ref());
        thermal.any(|thermal| thermal.law.depends_on_position())
    }

    /// Returns the offset of an axis in its two parts. `sent` is the slope that was last sent, `elapsed_ms` ago.
    #[must_use]
    pub fn constant_and_slope(
        &self,
        state: &BridgeState,
        last: &Output,
        axis: LinearAxis,
        sent: i16,
        elapsed_ms: u32,
    ) -> ConstantAndSlope {
        let number = axis as usize;
        let thermal = self.calibration.axes.get(number).and_then(|axis| axis.thermal.as_ref());
        let origin = thermal.map_or(Position::default(), |thermal| thermal.origin);
        let position = state.place.axis_position(axis);
        let goal = match (thermal, last.quality) {
            (
                Some(_),
                OffsetQuality::Live | OffsetQuality::TemperatureModel | OffsetQuality::WarmUpModel,
            ) => {
                let (_, gradient) = state.heat.axis_expansion(number);
                slope_from_error(
                    state.heat.learned.apply_to_expansion(number, slope_from_gradient(gradient)),
                )
            }
            (Some(_), OffsetQuality::Hold) => sent,
            _ => 0,
        };
        let away = position.0.abs_diff(origin.0).max(POSITION_UNITS_PER_METRE);
        let step = max_slope_step(self.calibration.limits.slew_nm_per_s, elapsed_ms, away);
        // Not `clamp`, which could panic.
        let slope = goal.max(sent.saturating_sub(step)).min(sent.saturating_add(step));
        let offset = last.offset.and_then(|offset| offset.get(number).copied());
        let constant = offset.and_then(|Nanometres(offset)| {
            let Nanometres(of_slope) =
                gradient_from_slope(slope).error_over_travel(origin, position).rounded();
            let constant = i64::from(offset).wrapping_sub(i64::from(of_slope));
            let half = i64::from(SLOPE_RESOLUTION_NM / 2);
            i16::try_from(constant.wrapping_add(half).div_euclid(SLOPE_RESOLUTION_NM.into())).ok()
        });
        ConstantAndSlope { constant: constant.filter(|bits| *bits != i16::MIN), slope }
    }
}

/// Returns a gradient in 1/256 bits of a slope: 0.1 µm/m are 10⁻⁶ nm per position unit.
fn slope_from_gradient(gradient: Gradient) -> FineNanometres {
    const FRACTION_SHIFT: u32 = Gradient::FRACTION_BITS - FineNanometres::FRACTION_BITS;
    // 32 bits by 20: below 2⁶³.
    FineNanometres::saturating_from(rounding_shift_right(
        i64::from(gradient.0).wrapping_mul(1_000_000),
        FRACTION_SHIFT,
    ))
}

/// Returns the slope of the offset against an error that grows by this much.
fn slope_from_error(error: FineNanometres) -> i16 {
    let bits = error.rounded().saturating_neg().0;
    let held = bits.clamp(i32::from(MAX_WIRE_VALUE).saturating_neg(), MAX_WIRE_VALUE.into());
    i16::try_from(held).unwrap_or_default()
}

/// Returns the gradient of a slope in bits.
fn gradient_from_slope(slope: i16) -> Gradient {
    // 16 bits by 36, at most 2⁵¹, and the quotient is within 32.
    let scaled = i64::from(slope).wrapping_shl(Gradient::FRACTION_BITS);
    let quotient = scaled.wrapping_add(500_000).div_euclid(1_000_000);
    Gradient(i32::try_from(quotient).unwrap_or(if slope < 0 { i32::MIN } else { i32::MAX }))
}

/// Returns the largest step of the slope in this many milliseconds, in bits, at least one.
fn max_slope_step(slew_nm_per_s: u32, elapsed_ms: u32, away: u32) -> i16 {
    // nm of the step · metres⁻¹ / 100: 32 bits by 32 fit in 64, and so does the product with 10⁵ of what is left.
    let nm = u64::from(slew_nm_per_s).wrapping_mul(elapsed_ms.into()) / 1_000;
    let per_metre =
        nm.saturating_mul(POSITION_UNITS_PER_METRE.into()).checked_div(away.into()).unwrap_or(0);
    let bits = per_metre.checked_div(SLOPE_RESOLUTION_NM.unsigned_abs().into()).unwrap_or(0);
    i16::try_from(bits).unwrap_or(MAX_WIRE_VALUE).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_slope_is_27_micrometres_a_metre_at_1_9_kelvin() {
        // 14.21 µm/m·K · 1.9 K = 26.999 µm/m = 2.6999e-4 nm per 10 nm; times 2³⁶: 18 553 571.
        let error = Gradient(18_553_571);
        assert_eq!(slope_from_error(slope_from_gradient(error)), -270);
        // Back: 27.0 µm/m over 1 m are 27.0 µm.
        let metre = Position(1_000 * Position::PER_MILLIMETRE);
        let Nanometres(um) =
            gradient_from_slope(-270).error_over_travel(Position(0), metre).rounded();
        assert!((um + 27_000).abs() <= 1, "{um}");
    }

    #[test]
    fn the_ends_saturate() {
        assert_eq!(slope_from_error(slope_from_gradient(Gradient(i32::MAX))), -31_250);
        assert_eq!(slope_from_error(slope_from_gradient(Gradient(i32::MIN))), 31_250);
        assert_eq!(gradient_from_slope(i16::MIN).0, i32::MIN, "-3276.8 µm/m is beyond ±3125");
    }

    #[test]
    fn a_step_is_the_slew_limit_at_the_distance_of_the_axis() {
        // 20 µm/s for 1.5 s are 30 µm: 30 µm/m at a metre, 3 at ten.
        assert_eq!(max_slope_step(20_000, 1_500, POSITION_UNITS_PER_METRE), 300);
        assert_eq!(max_slope_step(20_000, 1_500, 10 * POSITION_UNITS_PER_METRE), 30);
        assert_eq!(max_slope_step(1, 100, POSITION_UNITS_PER_METRE), 1);
        assert_eq!(max_slope_step(u32::MAX, u32::MAX, POSITION_UNITS_PER_METRE), MAX_WIRE_VALUE);
    }
}
