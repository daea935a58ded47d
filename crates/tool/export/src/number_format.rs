//! Numbers as controls read them: no exponent, no needless digit, no minus zero.

/// `value` with at most this many decimals.
pub(crate) fn format_number(value: f64, decimals: usize) -> String {
    let mut text = format!("{value:.decimals$}");
    if text.contains('.') {
        text.truncate(text.trim_end_matches('0').trim_end_matches('.').len());
    }
    if text == "-0" { "0".to_string() } else { text }
}

/// `value` with its sign, and at most this many decimals.
pub(crate) fn format_signed(value: f64, decimals: usize) -> String {
    let text = format_number(value, decimals);
    if text.starts_with('-') { text } else { format!("+{text}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_has_no_needless_digit_and_no_minus_zero() {
        for (value, text) in [(1.5, "1.5"), (-0.000_000_1, "0"), (100.0, "100"), (-20.25, "-20.25")]
        {
            assert_eq!(format_number(value, 6), text);
        }
        assert_eq!(format_number(100.4, 0), "100");
        assert_eq!(
            (format_signed(0.0, 4), format_signed(-0.5, 4)),
            ("+0".to_string(), "-0.5".to_string())
        );
    }
}
