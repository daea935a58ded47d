//! Numbers as people read them.

/// Returns a length in µm to three digits that mean something, none below a nanometre.
#[must_use]
pub fn format_micrometres(um: f64) -> String {
    if !um.is_finite() {
        return "–".into();
    }
    let decimals = decimals_for_three_digits(um, 3);
    format!("{um:.decimals$} µm")
}

/// Returns a number in three digits that mean something, in thousandths and less where it begins behind the point.
///
/// ```
/// assert_eq!(trueup_page::format_three_digits(1629.63), "1630");
/// assert_eq!(trueup_page::format_three_digits(0.9541), "0.954");
/// assert_eq!(trueup_page::format_three_digits(-0.011_394), "−11.4·10⁻³");
/// assert_eq!(trueup_page::format_three_digits(0.000_020_5), "20.5·10⁻⁶");
/// ```
#[must_use]
pub fn format_three_digits(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value == 0.0 { "0".into() } else { "–".into() };
    }
    let (value, unit) = match value.abs() {
        size if size >= 0.1 => (value, ""),
        size if size >= 1e-4 => (value * 1e3, "·10⁻³"),
        _ => (value * 1e6, "·10⁻⁶"),
    };
    let decimals = decimals_for_three_digits(value, 9);
    format!("{value:.decimals$}{unit}").replace('-', "−")
}

/// Returns the decimals with which a number has three digits that mean something, up to `most`.
fn decimals_for_three_digits(value: f64, most: usize) -> usize {
    if value == 0.0 {
        return 0;
    }
    (2.0 - value.abs().log10().floor()).clamp(0.0, most as f64) as usize
}

/// Returns a value and the ends of its interval, all to the second digit of the interval's width: more would say more
/// than is known, less would hide it.
///
/// ```
/// assert_eq!(trueup_page::format_with_interval(800.013, [799.921, 800.104]), ["800.01", "799.92", "800.10"]);
/// assert_eq!(trueup_page::format_with_interval(-12_345.6, [-13_000.0, -11_000.0]), ["−12346", "−13000", "−11000"]);
/// assert_eq!(trueup_page::format_with_interval(1.24, [1.24, 1.24]), ["1.24"; 3]);
/// ```
#[must_use]
pub fn format_with_interval(value: f64, [low, high]: [f64; 2]) -> [String; 3] {
    let width = high - low;
    if !(width > 0.0 && width.is_finite()) {
        return [value, low, high].map(format_three_digits);
    }
    let decimals = decimals_for_two_digits(width, 0);
    [value, low, high].map(|number| format!("{number:.decimals$}").replace('-', "−"))
}

/// Returns the decimals that show two digits of a half width, one at least and nine at most; four where it is none.
///
/// ```
/// assert_eq!(trueup_page::decimals_for_half_width(0.0123), 3);
/// assert_eq!(trueup_page::decimals_for_half_width(123.0), 1);
/// assert_eq!(trueup_page::decimals_for_half_width(0.0), 4);
/// ```
#[must_use]
pub fn decimals_for_half_width(half_width: f64) -> usize {
    if half_width > 0.0 && half_width.is_finite() {
        decimals_for_two_digits(half_width, 1)
    } else {
        4
    }
}

/// Returns the decimals with which a positive width has two digits, from `least` to nine.
fn decimals_for_two_digits(width: f64, least: u8) -> usize {
    (1.0 - width.log10().floor()).clamp(f64::from(least), 9.0) as usize
}

/// Returns the unit in which a time of this many seconds reads best, and how many seconds it has.
///
/// ```
/// assert_eq!(trueup_page::choose_time_unit(90.0), ("s", 1.0));
/// assert_eq!(trueup_page::choose_time_unit(3_000.0), ("min", 60.0));
/// assert_eq!(trueup_page::choose_time_unit(25_000.0), ("h", 3_600.0));
/// ```
#[must_use]
pub fn choose_time_unit(longest_s: f64) -> (&'static str, f64) {
    match longest_s {
        s if s < 300.0 => ("s", 1.0),
        s if s < 3.0 * 3600.0 => ("min", 60.0),
        _ => ("h", 3600.0),
    }
}

/// Round values for the ticks of an axis from `low` to `high`, about `count` of them, as text without a
/// digit too many.
pub(crate) fn axis_ticks(low: f64, high: f64, count: f64) -> Vec<(f64, String)> {
    let rough = (high - low) / count;
    if !(rough.is_finite() && rough > 0.0) {
        return vec![(low, format!("{low}"))];
    }
    let decade = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|round| round * decade)
        .find(|step| *step >= rough * 0.999)
        .unwrap_or(10.0 * decade);
    let decimals = (-(step * 1.000_001).log10().floor()).max(0.0) as usize;
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    let label = |value: f64| {
        // No minus before a zero.
        let value = if value == 0.0 { 0.0 } else { value };
        format!("{value:.decimals$}").replace('-', "−")
    };
    (first..=last).map(|n| (n as f64 * step, label(n as f64 * step))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_have_no_digit_too_many() {
        let labels = |low, high| -> Vec<String> {
            axis_ticks(low, high, 5.0).into_iter().map(|(_, label)| label).collect()
        };
        assert_eq!(labels(0.0, 10.0), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(labels(-0.31, 0.3), ["−0.2", "0.0", "0.2"]);
        assert_eq!(labels(0.0, 24_000.0), ["0", "5000", "10000", "15000", "20000"]);
        assert_eq!(axis_ticks(3.0, 3.0, 5.0).len(), 1);
    }

    #[test]
    fn a_length_has_the_digits_that_mean_something() {
        let formatted = [0.0, 0.0312, 12.3456, f64::NAN].map(format_micrometres);
        assert_eq!(formatted, ["0 µm", "0.031 µm", "12.3 µm", "–"]);
    }
}
