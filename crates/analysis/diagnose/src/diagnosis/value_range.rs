//! How far the values of a column go.

/// Returns the largest rise from a value to a later one.
pub(super) fn largest_rise(values: impl Iterator<Item = f64>) -> f64 {
    let (mut low, mut most) = (f64::INFINITY, 0.0_f64);
    for value in values {
        low = low.min(value);
        most = most.max(value - low);
    }
    most
}

/// Returns the smallest and the largest of the values that are there.
pub(super) fn min_max(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values
        .filter(|value| value.is_finite())
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
            [low.min(value), high.max(value)]
        })
}
