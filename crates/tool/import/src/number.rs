//! Numbers as people write them: decimal comma or point, thousands separators, a unit behind them.

/// The sign before the decimals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecimalSeparator {
    /// 1234.5
    Point,
    /// 1234,5
    Comma,
}

/// Evidence of a number for the decimal sign of its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum DecimalEvidence {
    /// It has neither sign.
    None,
    /// It can only be read with this one.
    Sure(DecimalSeparator),
    /// It reads with this one as a decimal sign, or as a thousands separator: `1.234`.
    Either(DecimalSeparator),
}

/// Returns the number without what groups its digits (blanks, apostrophes) and with an ASCII minus; `None` if it has
/// other characters than a number.
fn normalise_number(text: &str) -> Option<String> {
    const GROUP_SEPARATORS: &str = " '\u{a0}\u{202f}\u{2009}\u{2019}";
    let text = text.trim();
    let mut out = String::with_capacity(text.len());
    let chars: Vec<char> = text.chars().collect();
    for (at, &c) in chars.iter().enumerate() {
        if GROUP_SEPARATORS.contains(c) {
            // `1 234`: three digits follow, no more.
            let digits = chars[at + 1..].iter().take_while(|c| c.is_ascii_digit()).count();
            let is_after_digit = at > 0 && chars[at - 1].is_ascii_digit();
            if digits != 3 || !is_after_digit || out.contains(['.', ',']) {
                return None;
            }
        } else {
            out.push(if c == '\u{2212}' { '-' } else { c });
        }
    }
    let is_number = out.starts_with(|c: char| c.is_ascii_digit() || "+-.,".contains(c))
        && out.contains(|c: char| c.is_ascii_digit())
        && out.chars().all(|c| c.is_ascii_digit() || "+-.,eE".contains(c));
    is_number.then_some(out)
}

/// Returns what `text` says about the decimal sign; `None` if it is no number.
pub(crate) fn decimal_evidence(text: &str) -> Option<DecimalEvidence> {
    let number = normalise_number(text)?;
    let reads = |decimal| normalise_number_separators(&number, decimal).is_some();
    let of = |c| number.matches(c).count();
    let (points, commas) = (of('.'), of(','));
    let first = match (points, commas) {
        (0, 0) => return reads(DecimalSeparator::Point).then_some(DecimalEvidence::None),
        (_, 0) => DecimalSeparator::Point,
        (0, _) => DecimalSeparator::Comma,
        _ if number.rfind('.') > number.rfind(',') => DecimalSeparator::Point,
        _ => DecimalSeparator::Comma,
    };
    let other = if first == DecimalSeparator::Point {
        DecimalSeparator::Comma
    } else {
        DecimalSeparator::Point
    };
    match (reads(first), reads(other)) {
        (true, true) => Some(DecimalEvidence::Either(first)),
        (true, false) => Some(DecimalEvidence::Sure(first)),
        (false, true) => Some(DecimalEvidence::Sure(other)),
        (false, false) => None,
    }
}

/// Returns the value of `text`; `None` if it is no number in this writing.
pub(crate) fn parse(text: &str, decimal: DecimalSeparator) -> Option<f64> {
    let value: f64 =
        normalise_number_separators(&normalise_number(text)?, decimal)?.parse().ok()?;
    value.is_finite().then_some(value)
}

/// Returns the number with a point for its decimals and without thousands separators.
fn normalise_number_separators(number: &str, decimal: DecimalSeparator) -> Option<String> {
    let (sign, group) = match decimal {
        DecimalSeparator::Point => ('.', ','),
        DecimalSeparator::Comma => (',', '.'),
    };
    let (mantissa, exponent) = match number.find(['e', 'E']) {
        Some(at) => number.split_at(at),
        None => (number, ""),
    };
    let (whole, decimals) = match mantissa.split_once(sign) {
        Some((whole, decimals)) => (whole, Some(decimals)),
        None => (mantissa, None),
    };
    if decimals.is_some_and(|decimals| !decimals.chars().all(|c| c.is_ascii_digit())) {
        return None;
    }
    let digits = whole.trim_start_matches(['+', '-']);
    let mut groups = digits.split(group);
    let first = groups.next().unwrap_or_default();
    let mut has_groups = false;
    for group in groups {
        has_groups = true;
        if group.len() != 3 || !group.chars().all(|c| c.is_ascii_digit()) {
            return None;
        }
    }
    // `0.123` has no thousands.
    if has_groups && (first.is_empty() || first.len() > 3 || first.starts_with('0')) {
        return None;
    }
    let mut plain: String = whole.chars().filter(|c| *c != group).collect();
    if let Some(decimals) = decimals {
        plain.push('.');
        plain.push_str(decimals);
    }
    plain.push_str(exponent);
    plain.parse::<f64>().is_ok().then_some(plain)
}

/// Splits `12,5 µm` into its number and what stands behind it, which begins with no digit.
pub(crate) fn split_unit(text: &str) -> (&str, &str) {
    let text = text.trim();
    let of_number =
        |c: char| c.is_ascii_digit() || "+-.,' \u{a0}\u{202f}\u{2009}\u{2019}\u{2212}".contains(c);
    let end = text.find(|c| !of_number(c)).unwrap_or(text.len());
    // `1.5e-3 mm`: the exponent is of the number.
    let tail = &text[end..];
    let exponent = tail.strip_prefix(['e', 'E']).map_or(0, |rest| {
        let digits = rest.trim_start_matches(['+', '-']);
        let count = digits.chars().take_while(char::is_ascii_digit).count();
        if count > 0 { tail.len() - digits.len() + count } else { 0 }
    });
    let (number, unit) = text.split_at(end + exponent);
    (number.trim(), unit.trim())
}

/// Returns true for what stands where there is no value.
pub(crate) fn is_missing(text: &str) -> bool {
    const MISSING_VALUE_MARKERS: [&str; 26] = [
        "", "-", "--", "---", "–", "—", "n/a", "na", "#n/a", "#na", "nan", "null", "none", "k.a.",
        "#nv", "#wert!", "#value!", "#div/0!", "#ref!", "#bezug!", "#num!", "#zahl!", "ol",
        "overload", "overflow", "n.a.",
    ];
    MISSING_VALUE_MARKERS.contains(&text.trim().to_lowercase().as_str())
}

#[cfg(test)]
mod tests {
    use super::*;
    use DecimalSeparator::{Comma, Point};

    #[test]
    fn a_number_reads_as_it_is_written_or_not_at_all() {
        for (text, decimal, value) in [
            ("1,5", Comma, Some(1.5)),
            ("1.5", Comma, None),
            ("1.234,5", Comma, Some(1234.5)),
            ("1,234.5", Point, Some(1234.5)),
            ("1.234", Comma, Some(1234.0)),
            ("1.234", Point, Some(1.234)),
            ("1'234.5", Point, Some(1234.5)),
            ("1\u{a0}234,5", Comma, Some(1234.5)),
            ("\u{2212}0,25", Comma, Some(-0.25)),
            ("1,5E-03", Comma, Some(0.0015)),
            ("+.5", Point, Some(0.5)),
            ("12.34.56", Point, None),
            ("12,34", Point, None),
            ("1 2", Point, None),
            ("inf", Point, None),
            ("1e999", Point, None),
            ("0.123", Comma, None),
            ("-", Point, None),
        ] {
            assert_eq!(parse(text, decimal), value, "{text}");
        }
    }

    #[test]
    fn what_may_be_a_thousand_is_evidence_of_neither() {
        for (text, expected) in [
            ("12", Some(DecimalEvidence::None)),
            ("1.234", Some(DecimalEvidence::Either(Point))),
            ("1,234", Some(DecimalEvidence::Either(Comma))),
            ("0.123", Some(DecimalEvidence::Sure(Point))),
            ("1.23", Some(DecimalEvidence::Sure(Point))),
            ("1234.567", Some(DecimalEvidence::Sure(Point))),
            ("1.234.567", Some(DecimalEvidence::Sure(Comma))),
            ("1.234,5", Some(DecimalEvidence::Sure(Comma))),
            ("03.04.2026", None),
            ("a", None),
        ] {
            assert_eq!(decimal_evidence(text), expected, "{text}");
        }
        assert_eq!(split_unit("12,5 µm"), ("12,5", "µm"));
        assert_eq!(split_unit("1.5e-3mm"), ("1.5e-3", "mm"));
        assert_eq!(split_unit("20 °C"), ("20", "°C"));
    }
}
