//! Fixed point: rounding shifts, high words of products, and narrowing that saturates.
//!
//! A number in Qn is an integer that stands for itself divided by 2ⁿ. A product of Qm and Qn is
//! Q(m + n); a shift by n brings it back. Everything here is that, in the forms for which the
//! Cortex-M4 has an instruction or a short sequence:
//!
//! | function | value | cost there |
//! |---|---|---|
//! | [`widening_mul`] | a·b, exact in 64 bits | `smull` |
//! | [`mul_high`] | ⌊a·b/2³²⌋ | `smmul` |
//! | [`mul_high_rounded`] | a·b/2³² to the nearest | `smmulr`, with a sum `smmlar` |
//! | [`mul_high_unsigned`] | ⌊a·b/2³²⌋ of words without a sign | `umull` |
//! | [`mul_q32`] | a 64-bit number times a Q32 factor below 1 | two products |
//! | [`rounding_shift_right`], [`rounding_shift_right_i32`] | x/2ⁿ to the nearest, halves upwards | add, shift |
//! | [`saturate_to_i32`] | the nearest of 32 bits | 3 instructions |
//!
//! Worst error: half of the last place where it says "to the nearest", one below where it says ⌊⌋;
//! measured below against 128 bits over the extremes.

/// a·b. Exact: at most 2⁶².
///
/// ```
/// assert_eq!(trueup_core::fixed_point::widening_mul(i32::MIN, i32::MIN), 1 << 62);
/// ```
#[must_use]
#[inline]
pub const fn widening_mul(a: i32, b: i32) -> i64 {
    // Widening; `From` is not const.
    (a as i64).wrapping_mul(b as i64)
}

/// ⌊a·b/2³²⌋, the high word of the product: of Qm and Qn in Q(m + n − 32).
///
/// ```
/// use trueup_core::fixed_point::mul_high;
/// // A half in Q31 times 6 is 3, of which one place is lost: 1.5, rounded down.
/// assert_eq!(mul_high(1 << 30, 6), 1);
/// assert_eq!(mul_high(1 << 30, -6), -2);
/// ```
#[must_use]
#[inline]
#[allow(clippy::cast_possible_truncation, reason = "the high word of a product of two words")]
pub const fn mul_high(a: i32, b: i32) -> i32 {
    (widening_mul(a, b) >> 32) as i32
}

/// a·b/2³² to the nearest, halves upwards: of Qm and Qn in Q(m + n − 32).
///
/// ```
/// use trueup_core::fixed_point::mul_high_rounded;
/// assert_eq!(mul_high_rounded(1 << 30, 6), 2); // 1.5
/// assert_eq!(mul_high_rounded(1 << 30, -6), -1);
/// ```
#[must_use]
#[inline]
#[allow(clippy::cast_possible_truncation, reason = "the high word of a product of two words")]
pub const fn mul_high_rounded(a: i32, b: i32) -> i32 {
    rounding_shift_right(widening_mul(a, b), 32) as i32
}

/// ⌊a·b/2³²⌋ of two words without a sign: a whole number times a Q32 factor below 1. With a power
/// of two it is a shift to the right, in one instruction whatever the amount.
///
/// ```
/// use trueup_core::fixed_point::mul_high_unsigned;
/// assert_eq!(mul_high_unsigned(1_000, 1 << 30), 250);
/// ```
#[must_use]
#[inline]
#[allow(clippy::cast_possible_truncation, reason = "the high word of a product of two words")]
pub const fn mul_high_unsigned(a: u32, b: u32) -> u32 {
    // Widening; `From` is not const.
    ((a as u64).wrapping_mul(b as u64) >> 32) as u32
}

/// value·factor/2³² to the nearest, for a factor below 1 in Q32, from two products of 32 by 32 bits.
///
/// ```
/// use trueup_core::fixed_point::mul_q32;
/// assert_eq!(mul_q32(1 << 60, 1 << 30), 1 << 58);
/// assert_eq!(mul_q32(-3, 1 << 31), -1); // −1.5
/// ```
#[must_use]
#[inline]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the two halves of a 64-bit number, and a number below 2³² back"
)]
pub const fn mul_q32(value: i64, factor: u32) -> i64 {
    const ROUNDING_HALF: u64 = 1 << 31;
    let upper = (value >> 32).wrapping_mul(factor as i64);
    // (2³² − 1)² + 2³¹ is below 2⁶⁴.
    let lower = (value as u32 as u64).wrapping_mul(factor as u64).wrapping_add(ROUNDING_HALF) >> 32;
    upper.wrapping_add(lower as i64)
}

/// value/2^shift to the nearest, halves upwards. The shift is 0…62; a value above
/// 2⁶³ − 1 − 2^(shift − 1) wraps, and each caller says why it has none.
///
/// ```
/// use trueup_core::fixed_point::rounding_shift_right;
/// assert_eq!([6, 5, -6, -7].map(|x| rounding_shift_right(x, 2)), [2, 1, -1, -2]);
/// ```
#[must_use]
#[inline]
pub const fn rounding_shift_right(value: i64, shift: u32) -> i64 {
    let half = 1_i64.wrapping_shl(shift) >> 1;
    value.wrapping_add(half).wrapping_shr(shift)
}

/// As [`rounding_shift_right`], of a value without a sign; one above 2⁶⁴ − 1 − 2^(shift − 1) wraps.
///
/// ```
/// assert_eq!(trueup_core::fixed_point::rounding_shift_right_unsigned(6, 2), 2);
/// ```
#[must_use]
#[inline]
pub const fn rounding_shift_right_unsigned(value: u64, shift: u32) -> u64 {
    let half = 1_u64.wrapping_shl(shift) >> 1;
    value.wrapping_add(half).wrapping_shr(shift)
}

/// value/2^shift to the nearest, halves upwards; the shift is 0…30. The top 2^(shift − 1) values
/// count as the highest of them that can be rounded.
///
/// ```
/// use trueup_core::fixed_point::rounding_shift_right_i32;
/// assert_eq!(rounding_shift_right_i32(-384, 8), -1); // −1.5
/// assert_eq!(rounding_shift_right_i32(i32::MAX, 8), (1 << 23) - 1);
/// ```
#[must_use]
#[inline]
pub const fn rounding_shift_right_i32(value: i32, shift: u32) -> i32 {
    let half = 1_i32.wrapping_shl(shift) >> 1;
    value.saturating_add(half).wrapping_shr(shift)
}

/// Returns the nearest number of 32 bits.
///
/// A number that fits is recognised by its high word, which then repeats the sign of the low one: 3
/// instructions, where two comparisons of 64 bits are 10.
///
/// ```
/// use trueup_core::fixed_point::saturate_to_i32;
/// assert_eq!([7, 1 << 31, -1 << 40].map(saturate_to_i32), [7, i32::MAX, i32::MIN]);
/// ```
#[must_use]
#[inline]
#[allow(clippy::cast_possible_truncation, reason = "the two words, one by one")]
pub const fn saturate_to_i32(value: i64) -> i32 {
    let (high, low) = ((value >> 32) as i32, value as i32);
    if high == low >> 31 { low } else { i32::MAX ^ (high >> 31) }
}

/// A coefficient with a binary point of its own: mantissa/2^shift. One of any size keeps 30 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ScaledCoefficient {
    /// With the sign; ±2³⁰, so that a product with 33 bits fits.
    pub mantissa: i32,
    /// Binary places of the mantissa, 0…62; more count as 62.
    pub shift: u8,
}

impl ScaledCoefficient {
    /// Returns the product with `x`, rounded to the nearest; saturates. |x| up to 2³².
    ///
    /// ```
    /// use trueup_core::fixed_point::ScaledCoefficient;
    /// let three_eighths = ScaledCoefficient { mantissa: 3, shift: 3 };
    /// assert_eq!(three_eighths.multiply(100), 38); // 37.5, rounded up
    /// assert_eq!(three_eighths.multiply(-100), -37);
    /// ```
    #[must_use]
    pub fn multiply(self, x: i64) -> i32 {
        let shift = u32::from(self.shift.min(62));
        let half = 1_i64.wrapping_shl(shift) >> 1;
        // Beyond |x| of 2³² the product is held; it is far out of range then, whatever is added.
        let product = x.saturating_mul(i64::from(self.mantissa)).saturating_add(half);
        saturate_to_i32(product.wrapping_shr(shift))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;

    const WORDS: [i32; 11] = [
        i32::MIN,
        i32::MIN + 1,
        -(1 << 30),
        -65_537,
        -1,
        0,
        1,
        65_535,
        1 << 30,
        i32::MAX - 1,
        i32::MAX,
    ];

    /// ⌊(value + 2^(shift − 1))/2^shift⌋ in 128 bits.
    fn nearest(value: i128, shift: u32) -> i128 {
        (value + ((1 << shift) >> 1)) >> shift
    }

    #[test]
    fn high_words_are_those_of_the_exact_product() {
        for a in WORDS {
            for b in WORDS {
                let exact = i128::from(a) * i128::from(b);
                assert_eq!(i128::from(widening_mul(a, b)), exact);
                assert_eq!(i128::from(mul_high(a, b)), exact >> 32);
                assert_eq!(i128::from(mul_high_rounded(a, b)), nearest(exact, 32));
                let (a, b) = (a.cast_unsigned(), b.cast_unsigned());
                let exact = u128::from(a) * u128::from(b);
                assert_eq!(u128::from(mul_high_unsigned(a, b)), exact >> 32);
            }
        }
    }

    #[test]
    fn a_number_of_61_bits_times_a_factor_below_1_is_right_to_half_a_unit() {
        for a in WORDS {
            for value in [i64::from(a), i64::from(a) << 28, (i64::from(a) << 29) + 12_345] {
                for factor in [0, 1, 77, 1 << 31, u32::MAX - 1, u32::MAX] {
                    let exact = i128::from(value) * i128::from(factor);
                    assert_eq!(i128::from(mul_q32(value, factor)), nearest(exact, 32));
                }
            }
        }
    }

    #[test]
    fn shifts_round_to_the_nearest_over_their_whole_range() {
        for a in WORDS {
            for shift in 0..=62 {
                let half = (1_i64 << shift) >> 1;
                for value in [i64::from(a), i64::from(a) << 31, i64::MIN, i64::MAX - half] {
                    let exact = nearest(value.into(), shift);
                    assert_eq!(i128::from(rounding_shift_right(value, shift)), exact);
                    let value = value.cast_unsigned().min(u64::MAX - half.cast_unsigned());
                    let exact = nearest(value.into(), shift);
                    assert_eq!(i128::from(rounding_shift_right_unsigned(value, shift)), exact);
                }
            }
            for shift in 0..=30 {
                let highest = i32::MAX - ((1_i32 << shift) >> 1);
                let exact = nearest(a.min(highest).into(), shift);
                assert_eq!(i128::from(rounding_shift_right_i32(a, shift)), exact);
            }
        }
    }

    #[test]
    fn narrowing_gives_the_nearest_end() {
        for a in WORDS {
            for value in [i64::from(a), i64::from(a) + 1, i64::from(a) - 1, i64::from(a) << 32] {
                let exact = value.clamp(i32::MIN.into(), i32::MAX.into());
                assert_eq!(i64::from(saturate_to_i32(value)), exact);
            }
        }
        assert_eq!([i64::MIN, i64::MAX].map(saturate_to_i32), [i32::MIN, i32::MAX]);
    }

    /// Returns the nearest coefficient to `value`, as the host makes it.
    fn scaled(value: f64) -> ScaledCoefficient {
        let mut shift = 62_u8;
        while (value * 2_f64.powi(shift.into())).abs() >= 1_073_741_823.0 {
            shift -= 1;
        }
        let mantissa = (value * 2_f64.powi(shift.into())).round() as i32;
        ScaledCoefficient { mantissa, shift }
    }

    #[test]
    fn products_are_right_to_half_a_unit_over_all_coefficients() {
        let mut worst: f64 = 0.0;
        for exponent in -40..20 {
            for mantissa in [1.0, -1.234_567, 1.999_999] {
                let value = mantissa * 2_f64.powi(exponent);
                for x in [1_i64, -77, 3_456_789, -(1 << 31), 1 << 32] {
                    let exact = x as f64 * value;
                    if exact.abs() < 2e9 {
                        let got = f64::from(scaled(value).multiply(x));
                        // The coefficient itself is right to 2⁻³⁰ of its size.
                        let bound = 0.5 + exact.abs() * 2_f64.powi(-29);
                        assert!((got - exact).abs() <= bound, "{value}·{x}: {got}, {exact}");
                        worst = worst.max((got - exact).abs() - exact.abs() * 2_f64.powi(-29));
                    }
                }
            }
        }
        std::println!("largest error of a product: {worst:.3} units of 1/256 nm");
        assert_eq!(ScaledCoefficient { mantissa: i32::MAX, shift: 0 }.multiply(i64::MAX), i32::MAX);
        assert_eq!(ScaledCoefficient { mantissa: i32::MIN, shift: 255 }.multiply(i64::MAX), -2);
    }
}
