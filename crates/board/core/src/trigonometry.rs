//! Sine and cosine of a rotary axis' angle, in integers.
//!
//! The tool direction multiplies elongations of up to a millimetre, so a sine that is wrong by
//! 2·10⁻⁶ is wrong by 2 nm: that is the bound, and `f32` approximations made for speed do not keep
//! it. The sine and cosine of `micromath` 2.1 err by up to 1.1·10⁻³ over the angles of the wire,
//! 1.1 µm on that millimetre; a test below measures it.
//!
//! The angle is 90°·q + r, with q the nearest whole number and |r| ≤ 45°. One product of q with
//! 90° takes the turns away, however many: no remainder and no division. Then, with
//! t = −47·r/2³¹ (|t| < 0.985, exact), a = 0.797 448 rad the angle at t = −1, and w = −t²:
//!
//! ```text
//! sin r = t·(s₀ + w·(s₁ + w·(s₂ + w·(s₃ + w·s₄))))
//! cos r = 1 − w·(c₀ + w·(c₁ + w·(c₂ + w·c₃)))
//! ```
//!
//! sₖ is close to −a²ᵏ⁺¹/(2k + 1)!, cₖ to −a²ᵏ⁺²/(2k + 2)!; the least bits differ from Taylor's so
//! that the largest error over ±45° is the smallest: 1.7·10⁻¹² and 5.4·10⁻¹¹. q turns the pair
//! (cos r, sin r) by quarters. Each product is the upper word of a 32 × 32 bit product, rounded.
//!
//! The signs are chosen for the compiler: where it can prove a factor positive it takes the product
//! for an unsigned one and needs three instructions more. With t, w and all coefficients negated,
//! each step of the recurrence is one `smmlar`. Both results cost about 55 instructions.
//!
//! Formats: t is Q31, w is Q30. A product with w loses two binary places, so that the coefficients
//! are Q31, Q33, … Q39 and Q32, Q34, Q36, Q38. The results are Q30, within ±2³⁰.
//!
//! Range: every `i32` of micro-degrees. Measured worst error: 8.2·10⁻¹⁰ over each 0.0005° of
//! ±262.144°, 9.1·10⁻¹⁰ over ±2147° in steps of 0.001 009° (half a unit of Q30 is 4.7·10⁻¹⁰).
//! Multiples of 90° are exact.

use crate::{
    fixed_point::{mul_high_rounded, rounding_shift_right_i32},
    tool_direction::ToolDirection,
    units::MicroDegrees,
};

/// A quarter of a turn in micro-degrees.
const QUARTER_TURN_MICRODEGREES: i32 = 90 * MicroDegrees::PER_DEGREE;
/// Quarter turns in a micro-degree, 1/90 000 000, Q56.
const QUARTERS_PER_MICRODEGREE_Q56: i32 = 800_639_934;
/// Binary places of a number of quarters after the upper word of the product is taken.
const QUARTERS_FRACTION_BITS: u32 = 56 - 32;
/// t of a micro-degree, Q31: 47 is the largest whole number with which 45° stay below 1.
const T_PER_MICRODEGREE_Q31: i32 = -47;
/// s₀…s₄, all negative, in Q31, Q33, Q35, Q37, Q39.
const SINE_COEFFICIENTS: [i32; 5] =
    [-1_712_534_151, -726_050_335, -92_345_367, -5_592_269, -194_576];
/// c₀…c₃, all negative, in Q32, Q34, Q36, Q38.
const COSINE_COEFFICIENTS: [i32; 4] = [-1_365_678_944, -289_498_062, -24_543_537, -1_096_566];

/// Sine and cosine of an angle, Q30: [`ToolDirection::ONE`] is 1.
///
/// ```
/// use trueup_core::{trigonometry::sin_cos, units::MicroDegrees};
/// const ONE: i32 = 1 << 30;
/// // sin 30° = 1/2, cos 30° = √3/2 = 0.866 025 404.
/// let (sine, cosine) = sin_cos(MicroDegrees(30_000_000));
/// assert!((sine - ONE / 2).abs() <= 1);
/// assert!((f64::from(cosine) / f64::from(ONE) - 0.866_025_404).abs() < 2e-9);
/// // −90° and 5 turns and a half.
/// assert_eq!(sin_cos(MicroDegrees(-90_000_000)), (-ONE, 0));
/// assert_eq!(sin_cos(MicroDegrees(1_980_000_000)), (0, -ONE));
/// ```
#[must_use]
pub fn sin_cos(angle: MicroDegrees) -> (i32, i32) {
    let quarters = mul_high_rounded(angle.0, QUARTERS_PER_MICRODEGREE_Q56);
    let quarters = rounding_shift_right_i32(quarters, QUARTERS_FRACTION_BITS);
    // At the ends of i32 the product alone wraps, the difference is right.
    let remainder = angle.0.wrapping_sub(quarters.wrapping_mul(QUARTER_TURN_MICRODEGREES));
    // |remainder| ≤ 45.000 006°, so that t and all below stays within 32 bits.
    let t = remainder.wrapping_mul(T_PER_MICRODEGREE_Q31);
    // −t² rather than t²: for the signs see above.
    let w = mul_high_rounded(t, t.wrapping_neg());

    let [s0, s1, s2, s3, s4] = SINE_COEFFICIENTS;
    let series = s3.wrapping_add(mul_high_rounded(s4, w));
    let series = s2.wrapping_add(mul_high_rounded(series, w));
    let series = s1.wrapping_add(mul_high_rounded(series, w));
    let series = s0.wrapping_add(mul_high_rounded(series, w));
    let sine = mul_high_rounded(series, t);

    let [c0, c1, c2, c3] = COSINE_COEFFICIENTS;
    let series = c2.wrapping_add(mul_high_rounded(c3, w));
    let series = c1.wrapping_add(mul_high_rounded(series, w));
    let series = c0.wrapping_add(mul_high_rounded(series, w));
    let cosine = ToolDirection::ONE.wrapping_sub(mul_high_rounded(series, w));

    match quarters & 3 {
        0 => (sine, cosine),
        1 => (cosine, sine.wrapping_neg()),
        2 => (sine.wrapping_neg(), cosine.wrapping_neg()),
        _ => (cosine.wrapping_neg(), sine),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;

    /// Returns what the wire carries: 20 bits of 0.0005°, −262.144…+262.1435°.
    fn angles_of_the_wire() -> impl Iterator<Item = i32> {
        (-(1 << 19)..1 << 19).map(|step| step * 500)
    }

    fn exact(angle: i32) -> (f64, f64) {
        (f64::from(angle) / f64::from(MicroDegrees::PER_DEGREE)).to_radians().sin_cos()
    }

    fn error(angle: i32) -> f64 {
        let one = f64::from(ToolDirection::ONE);
        let (sine, cosine) = sin_cos(MicroDegrees(angle));
        let (exact_sine, exact_cosine) = exact(angle);
        (f64::from(sine) / one - exact_sine)
            .abs()
            .max((f64::from(cosine) / one - exact_cosine).abs())
    }

    #[test]
    fn every_angle_of_the_wire_is_within_one_part_in_a_billion() {
        let worst = angles_of_the_wire().map(error).fold(0.0, f64::max);
        std::println!("largest error over the wire's angles: {worst:.3e}");
        assert!(worst <= 1e-9);
    }

    #[test]
    fn every_i32_is_an_angle() {
        let sweep = (i32::MIN..=i32::MAX).step_by(1_009);
        let worst = sweep.chain([i32::MAX]).map(error).fold(0.0, f64::max);
        std::println!("largest error over the whole i32: {worst:.3e}");
        assert!(worst <= 1e-9);
    }

    #[test]
    fn quarters_are_exact_and_nothing_exceeds_1() {
        const ONE: i32 = ToolDirection::ONE;
        let values = [(0, ONE), (ONE, 0), (0, -ONE), (-ONE, 0)];
        for quarter in -23_i32..=23 {
            let expected = values[quarter.rem_euclid(4) as usize];
            assert_eq!(
                sin_cos(MicroDegrees(quarter * QUARTER_TURN_MICRODEGREES)),
                expected,
                "{quarter}"
            );
            for near in -1_000..=1_000 {
                let (sine, cosine) =
                    sin_cos(MicroDegrees(quarter * QUARTER_TURN_MICRODEGREES + near));
                assert!(sine.abs() <= ONE && cosine.abs() <= ONE);
            }
        }
    }

    #[test]
    fn the_change_of_quarter_at_45_degrees_is_no_step() {
        for middle in (-47..=47).step_by(2).map(|odd| odd * (QUARTER_TURN_MICRODEGREES / 2)) {
            for near in -20..=20 {
                let Some(angle) = middle.checked_add(near) else { continue };
                assert!(error(angle) <= 1e-9, "{angle}");
            }
        }
    }

    #[test]
    fn micromath_would_err_by_more_than_2_nm_on_a_millimetre() {
        use micromath::F32Ext;
        let worst = angles_of_the_wire().map(|angle| {
            let (exact_sine, exact_cosine) = exact(angle);
            // The angle is rounded to f32 once, at the end, to its advantage.
            let radians = (f64::from(angle) * 1e-6).to_radians() as f32;
            // By its path: `std` has methods of the same names.
            let (sine, cosine) = (F32Ext::sin(radians), F32Ext::cos(radians));
            (f64::from(sine) - exact_sine).abs().max((f64::from(cosine) - exact_cosine).abs())
        });
        let worst = worst.fold(0.0, f64::max);
        std::println!("largest error of micromath over the wire's angles: {worst:.3e}");
        assert!(worst > 2e-6);
    }
}
