//! Rounding of numbers: `core` has none, and the servo thread should not need a library for it.

/// From here on every number is whole: 2⁵².
const TWO_POW_52: f64 = 4_503_599_627_370_496.0;

/// Rounds towards zero.
#[allow(clippy::cast_possible_truncation, reason = "below 2⁵²")]
pub(crate) fn trunc(value: f64) -> f64 {
    if value.abs() < TWO_POW_52 { (value as i64) as f64 } else { value }
}

/// Rounds down.
pub fn floor(value: f64) -> f64 {
    let whole = trunc(value);
    if whole > value { whole - 1.0 } else { whole }
}

/// Rounds to the nearest whole number, halves away from zero.
pub fn round(value: f64) -> f64 {
    let whole = trunc(value);
    if (value - whole).abs() >= 0.5 { whole + 1.0_f64.copysign(value) } else { whole }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_is_rounded_as_the_standard_library_rounds_it() {
        let near = [0.0, 0.5, 0.499_999_999_999_999_94, 1.0, 1.5, 2.5, 1e9 + 0.5, TWO_POW_52 - 0.5];
        let more = [TWO_POW_52, TWO_POW_52 + 1.0, 1e300, f64::INFINITY, f64::MIN_POSITIVE];
        let spread = (0..100_000).map(|n| f64::from(n) * 0.123_456_789);
        for value in near.into_iter().chain(more).chain(spread) {
            for value in [value, -value] {
                assert_eq!(trunc(value), value.trunc(), "{value}");
                assert_eq!(floor(value), value.floor(), "{value}");
                assert_eq!(round(value), value.round(), "{value}");
            }
        }
        assert!(trunc(f64::NAN).is_nan() && floor(f64::NAN).is_nan() && round(f64::NAN).is_nan());
    }
}
