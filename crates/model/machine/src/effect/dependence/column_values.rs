//! The kinds of values of a column: a category, a quantity with a zero, a range in which a line may bend.

use std::ops::RangeInclusive;

/// Largest number of levels of a column that counts as a category.
const MAX_COLUMN_LEVELS: usize = 12;
/// Smallest number of rows of a level, but of a column that is only 0 and 1.
const MIN_LEVEL_ROWS: usize = 8;
/// A column comes near 0 if its smallest value is at most this share of its largest.
const MAX_NEAR_ZERO_RATIO: f64 = 0.35;
/// Starts of the search for the value from which a hinge bends, at equal shares of the sorted rows.
const HINGE_START_COUNT: usize = 8;
/// Places of a curve, of a smooth and of a wavy one.
pub(super) const CURVE_KNOT_COUNTS: [usize; 2] = [5, 9];
/// The levels of a column that is off and on.
pub(super) const SWITCH_LEVELS: [f64; 2] = [0.0, 1.0];

/// Where a column is 0: at its own 0 if it comes near it, else at its mean. Multiplied by a column that
/// hardly varies, the other factor alone would be taken for a dependence on both.
pub(super) fn choose_reference_value(values: &[f64]) -> f64 {
    let finite = || values.iter().copied().filter(|value| value.is_finite());
    let (low, high) = finite().fold((f64::INFINITY, 0.0_f64), |(low, high), value| {
        (low.min(value.abs()), high.max(value.abs()))
    });
    if low <= MAX_NEAR_ZERO_RATIO * high {
        0.0
    } else {
        finite().sum::<f64>() / finite().count().max(1) as f64
    }
}

/// Returns the levels of a column that is a category, the most frequent one first; none of any other column.
pub(super) fn find_levels(values: &[f64]) -> Option<Vec<f64>> {
    let mut found: Vec<(f64, usize)> = Vec::new();
    for &value in values.iter().filter(|value| value.is_finite()) {
        if let Some((_, rows)) = found.iter_mut().find(|(level, _)| *level == value) {
            *rows += 1;
        } else if found.len() < MAX_COLUMN_LEVELS {
            found.push((value, 1));
        } else {
            return None;
        }
    }
    let is_switch =
        found.len() == 2 && found.iter().all(|(level, _)| SWITCH_LEVELS.contains(level));
    if !is_switch && found.iter().any(|(_, rows)| *rows < MIN_LEVEL_ROWS) {
        return None;
    }
    // The level that adds nothing comes first: off, else the one that was there most of the time.
    found.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.total_cmp(&b.0)));
    if is_switch {
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
    }
    Some(found.into_iter().map(|(level, _)| level).collect())
}

/// Returns the numbers of the tools that were used often; of the others nothing is known.
pub(super) fn find_frequent_tools(values: &[f64]) -> Option<Vec<f64>> {
    let rows = |tool: f64| values.iter().filter(|value| **value == tool).count();
    let often: Vec<f64> =
        values.iter().copied().filter(|tool| rows(*tool) >= MIN_LEVEL_ROWS).collect();
    find_levels(&often).filter(|levels| levels.len() > 1)
}

/// Values from which a line may begin: inside, at equal shares of the sorted rows, no two alike.
pub(super) fn hinge_start_values(values: &[f64]) -> Vec<f64> {
    distinct_quantiles(values, 1..=HINGE_START_COUNT, HINGE_START_COUNT + 1)
}

/// Returns `count` places of a curve: all values of a column that has this many, else the ends and equal shares of the
/// sorted rows; none if there are fewer.
pub(super) fn choose_knots(values: &[f64], count: usize) -> Option<Vec<f64>> {
    let mut different: Vec<f64> =
        values.iter().copied().filter(|value| value.is_finite()).collect();
    different.sort_unstable_by(f64::total_cmp);
    different.dedup();
    if different.len() > count {
        different = distinct_quantiles(values, 0..=count - 1, count - 1);
    }
    // Three places are the fewest that bend.
    (different.len() == count
        || (3..CURVE_KNOT_COUNTS[1]).contains(&different.len()) && count == CURVE_KNOT_COUNTS[1])
        .then_some(different)
}

/// Returns the values at these of `of` equal shares of the sorted rows, no two alike.
fn distinct_quantiles(values: &[f64], numbers: RangeInclusive<usize>, of: usize) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let last = sorted.len().saturating_sub(1);
    let mut values: Vec<f64> = numbers.filter_map(|n| sorted.get(n * last / of).copied()).collect();
    values.dedup();
    values
}
