//! Readings that stand alone among the repeats of their place.
//!
//! ```text
//! dᵢ = reading − median of its place and side
//! s  = median of |reading − reading| over all pairs at one place and side / 0.954
//! ```
//!
//! The difference of two readings that scatter by σ has the standard deviation √2·σ, and the median of
//! its magnitude is 0.6745·√2·σ = 0.954·σ, however many repeats a place has. One bad reading of three
//! spoils two of three pairs at its place and none elsewhere, so that two bad ones in ten places of three
//! leave 26 of 30 pairs sound.
//!
//! A reading is gross if it is further from its place's median than the limit for this many rows
//! ([`outlier_cutoff`]), and as far from what its neighbours in the same cycle, before it and after it, are from
//! theirs: a cycle, or a part of one, that was warmer than the others is no row of gross errors.

use super::reading::RepeatReading;
use crate::robust::{MIN_CUTOFF_SCALES, median, outlier_cutoff};

/// Two repeats do not say which of them is wrong.
const MIN_REPEATS: usize = 3;
/// The median magnitude of the difference of two readings of standard deviation 1: 0.6745·√2.
const MEDIAN_PAIR_DIFFERENCE_PER_STD: f64 = 0.953_872_6;
/// Readings in whole steps of an instrument scatter by at least this share of a step, wherever the
/// true value lies: 1/√12 is that of an even distribution over the step, twice it is safe.
const MIN_STD_PER_RESOLUTION: f64 = 0.6;
/// Neighbours in a cycle on each side.
const NEIGHBOURS_PER_SIDE: usize = 3;
/// More than this share of the rows, in whole readings (two of eleven to twenty), is not a few bad readings
/// but another law. Source: Hampel and others (Robust Statistics, 1986, section 1.2c) found 1–10 % of gross
/// errors in routine data.
const MAX_OUTLIER_FRACTION: f64 = 0.1;

/// Returns whether each reading is gross; `readings` in the order in which they were taken.
#[must_use]
pub fn find_gross_errors(readings: &[RepeatReading]) -> Vec<bool> {
    let none = vec![false; readings.len()];
    let groups = group_by_stop(readings);
    let Some(scale) = repeatability_scale(readings, &groups) else { return none };
    let mut deviation = vec![f64::NAN; readings.len()];
    for group in groups.iter().filter(|group| group.len() >= MIN_REPEATS) {
        let mut values: Vec<f64> = group.iter().map(|&row| readings[row].value).collect();
        let middle = median(&mut values);
        group.iter().for_each(|&row| deviation[row] = readings[row].value - middle);
    }
    let limit = outlier_cutoff(readings.len(), groups.len()).max(MIN_CUTOFF_SCALES) * scale;
    let mut found = none.clone();
    for (row, &own) in deviation.iter().enumerate() {
        // What has no repeats is NaN, and beyond no limit.
        let is_alone = |near: f64| near.is_nan() || (own - near).abs() > limit;
        found[row] = own.abs() > limit
            && smallest_neighbour_deviations(readings, &deviation, row).into_iter().all(is_alone);
    }
    let count = found.iter().filter(|found| **found).count();
    if count as f64 > (MAX_OUTLIER_FRACTION * readings.len() as f64).ceil() { none } else { found }
}

/// Returns the rows of each place and side.
fn group_by_stop(readings: &[RepeatReading]) -> Vec<Vec<usize>> {
    let mut order: Vec<usize> = (0..readings.len()).collect();
    order.sort_by_key(|&row| (readings[row].place, readings[row].side, row));
    let same = |a: &usize, b: &usize| {
        let [a, b] = [a, b].map(|&row| (readings[row].place, readings[row].side));
        a == b
    };
    order.chunk_by(same).map(<[usize]>::to_vec).collect()
}

/// Returns the scatter of one reading among its repeats; none where nothing scatters or nothing repeats.
fn repeatability_scale(readings: &[RepeatReading], groups: &[Vec<usize>]) -> Option<f64> {
    /// Pairs of the first this many repeats of a place are enough of them.
    const MAX_PAIRED_REPEATS: usize = 30;
    let mut pairs = Vec::new();
    for group in groups {
        let some = &group[..group.len().min(MAX_PAIRED_REPEATS)];
        for (n, &a) in some.iter().enumerate() {
            let others = some[n + 1..].iter();
            pairs.extend(others.map(|&b| (readings[a].value - readings[b].value).abs()));
        }
    }
    let step = pairs.iter().copied().filter(|pair| *pair > 1e-9).fold(f64::INFINITY, f64::min);
    let scale =
        (median(&mut pairs) / MEDIAN_PAIR_DIFFERENCE_PER_STD).max(MIN_STD_PER_RESOLUTION * step);
    (scale.is_finite() && scale > 0.0).then_some(scale)
}

/// Of the neighbours before and of those after `row` in its cycle, what the one that is nearest to its
/// median is from it: only where all of a side have moved has more moved than one reading. NaN where
/// there is one neighbour or none.
fn smallest_neighbour_deviations(
    readings: &[RepeatReading],
    deviation: &[f64],
    row: usize,
) -> [f64; 2] {
    let is_near = |&other: &usize| {
        readings[other].cycle == readings[row].cycle && deviation[other].is_finite()
    };
    let before: Vec<usize> = (0..row).rev().filter(is_near).take(NEIGHBOURS_PER_SIDE).collect();
    let after: Vec<usize> =
        (row + 1..readings.len()).filter(is_near).take(NEIGHBOURS_PER_SIDE).collect();
    [before, after].map(|near| match near.len() {
        0 | 1 => f64::NAN,
        _ => near
            .into_iter()
            .map(|other| deviation[other])
            .min_by(|a, b| a.abs().total_cmp(&b.abs()))
            .unwrap_or(f64::NAN),
    })
}
