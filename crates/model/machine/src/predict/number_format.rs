//! Numbers as `write!` prints them, several times as fast: a run of a million rows has ten million cells, and
//! most are decimals of a few places, which whole numbers can print.
//!
//! Both fall back on `write!` where whole numbers would not be certain to give the same digits.

use std::io::{self, Write};

/// Whole numbers below this have at most 15 digits. No two decimals of 15 digits are the same `f64`, so one that
/// is the value is the shortest.
const MIN_16_DIGIT_INTEGER: f64 = 1e15;
/// Powers of ten up to the most decimals that are tried.
const POWERS_OF_TEN: [f64; 7] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6];

/// Writes what `{value}` prints: the fewest digits that read as the same number.
pub(super) fn write_shortest_decimal(out: &mut impl Write, value: f64) -> io::Result<()> {
    for (decimals, power) in POWERS_OF_TEN.into_iter().enumerate() {
        let scaled = (value * power).round();
        if scaled.abs() >= MIN_16_DIGIT_INTEGER {
            break;
        }
        // A quotient of two whole numbers is the nearest `f64`, as a parser would give it.
        if scaled / power == value {
            return write_fixed_point(out, value.is_sign_negative(), scaled.abs() as u64, decimals);
        }
    }
    write!(out, "{value}")
}

/// Writes what `{value:.6}` prints.
pub(super) fn write_six_decimals(out: &mut impl Write, value: f64) -> io::Result<()> {
    /// Below this the product is off by less than 1.3·10⁻⁴, half a unit in its last place.
    const FAST_ROUNDING_LIMIT: f64 = (1_u64 << 40) as f64;
    let scaled = (value * POWERS_OF_TEN[6]).abs();
    let is_near_half = (scaled.fract() - 0.5).abs() < 1e-3;
    if scaled < FAST_ROUNDING_LIMIT && !is_near_half {
        return write_fixed_point(out, value.is_sign_negative(), scaled.round() as u64, 6);
    }
    write!(out, "{value:.6}")
}

/// `whole` with a point before its last `decimals` digits.
fn write_fixed_point(
    out: &mut impl Write,
    is_negative: bool,
    mut whole: u64,
    decimals: usize,
) -> io::Result<()> {
    // 15 digits or less, a point, a sign.
    let mut text = [b'0'; 20];
    let mut at = text.len();
    let mut digits = 0;
    while whole > 0 || digits <= decimals {
        if digits == decimals && decimals > 0 {
            at -= 1;
            text[at] = b'.';
        }
        at -= 1;
        text[at] = b'0' + (whole % 10) as u8;
        whole /= 10;
        digits += 1;
    }
    if is_negative {
        at -= 1;
        text[at] = b'-';
    }
    out.write_all(&text[at..])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn both(value: f64) -> [String; 2] {
        let (mut shortest, mut micro) = (Vec::new(), Vec::new());
        write_shortest_decimal(&mut shortest, value).expect("a Vec takes everything");
        write_six_decimals(&mut micro, value).expect("a Vec takes everything");
        [shortest, micro].map(|text| String::from_utf8(text).expect("digits"))
    }

    #[test]
    fn numbers_are_printed_as_write_prints_them() {
        let mut values = vec![
            0.0,
            -0.0,
            1.0,
            -1.0,
            0.1,
            0.3,
            2.5e-7,
            5e-7,
            0.000_000_5,
            -0.000_000_4,
            1e15,
            1e16,
            -1e300,
            999_999_999_999_999.0,
            0.1 + 0.2,
            1.0 / 3.0,
            f64::MAX,
            f64::MIN_POSITIVE,
            f64::INFINITY,
            1_099_511.627_776,
            1_099_511.627_775_5,
            123_456.5,
            0.999_999_95,
            0.999_999_5,
            12.345_678_5,
        ];
        let mut seed = 0x2545_f491_4f6c_dd1d_u64;
        for _ in 0..300_000 {
            seed ^= seed << 13;
            seed ^= seed >> 7;
            seed ^= seed << 17;
            let uniform = (seed >> 11) as f64 / (1_u64 << 53) as f64 - 0.5;
            // Any number; decimals of few places; numbers near the middle between two of six.
            let power = POWERS_OF_TEN[(seed % 7) as usize];
            values.push(f64::from_bits(seed));
            values.push((uniform * 1e4 * power).round() / power);
            values.push(((uniform * 1e9).round() + 0.5) / 1e6);
            values.push(uniform * 1e3);
        }
        for value in values.into_iter().filter(|value| !value.is_nan()) {
            assert_eq!(both(value), [format!("{value}"), format!("{value:.6}")], "{value:e}");
        }
    }
}
