//! Gross errors among the rows that count, by what a model leaves of them: judged so, a cause with
//! quick changes is named before its rows are suspected. Only repeats at one place say so before any
//! cause is known.

use std::collections::HashMap;

use trueup_numerics::{
    repeats::SIGNIFICANCE_LEVEL,
    robust::{
        NEIGHBOURS_PER_SIDE, flag_residual_outliers, median, noise_tail_probability,
        poisson_tail_probability,
    },
};

use crate::{
    data::{DataTable, MIN_PAUSE_INTERVALS},
    repeats::TargetPositions,
    search::model_comparison::MAJORITY_FRACTION,
};

/// Rows that stand alone among the repeats of their place, by what `predicted` leaves.
pub(crate) fn find_repeat_outliers(data: &DataTable, predicted: &[f64]) -> Vec<bool> {
    let used = (0..data.rows).filter(|&row| data.used[row]);
    let residual = |row: usize| data.measured[row] - predicted[row];
    let Some(targets) = TargetPositions::from_rows(data, used) else {
        return vec![false; data.rows];
    };
    let found = targets.find_gross_errors(data, residual);
    find_isolated_outliers(data, predicted, &found)
}

/// Rows that are to be excluded as outliers, by what `predicted` leaves.
pub(crate) fn find_gross_errors(data: &DataTable, predicted: &[f64]) -> Vec<bool> {
    let rows: Vec<usize> = (0..data.rows).filter(|&row| data.used[row]).collect();
    let far = {
        let residual: Vec<f64> =
            rows.iter().map(|&row| data.measured[row] - predicted[row]).collect();
        let series: Vec<u32> = rows.iter().map(|&row| data.places.series[row]).collect();
        flag_residual_outliers(&residual, &series, estimate_instrument_resolution_um(data, &rows))
    };
    let mut found = vec![false; data.rows];
    rows.into_iter().zip(far).for_each(|(row, is_far)| found[row] = is_far);
    find_isolated_outliers(data, predicted, &found)
}

/// The rows that are excluded as outliers.
pub(crate) struct ExcludedRows {
    pub rows: Vec<bool>,
    pub known: OutlierJudgement,
}

/// The judgement of the rows that are excluded as outliers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OutlierJudgement {
    /// There are none, or they stand at a start, a pause or a change, where the reading may be right and what
    /// happened is not known.
    AtChanges,
    /// Noise alone may have such a reading.
    MayBeNoise,
    /// Readings are wrong.
    Wrong,
}

/// Chance of a record of noise that something is claimed of it. Rows that noise would have by chance are excluded, which
/// costs nothing; that readings are wrong is claimed if noise whose tails are exponential, heavier than normal ones, has
/// such readings less often.
pub(crate) const FALSE_POSITIVE_PROBABILITY: f64 = 1e-3;

/// Returns what is known of the rows `aside`. Noise is what is left of the others by the answer with curves over its
/// rest, both as it is and from the neighbours' level; or, where an axis comes back, about its places (by the
/// answer alone).
pub(crate) fn classify_outliers(
    data: &DataTable,
    aside: &[bool],
    predicted: impl FnOnce() -> [Vec<f64>; 2],
) -> OutlierJudgement {
    let mut of_readings = reading_error_mask(data, aside);
    if !of_readings.contains(&true) {
        return OutlierJudgement::AtChanges;
    }
    let [with_curves, plain] = predicted();
    (0..data.rows).for_each(|row| of_readings[row] &= !is_nearer_to_neighbour(data, row, &plain));
    if !of_readings.contains(&true) {
        return OutlierJudgement::AtChanges;
    }
    let rows: Vec<usize> = (0..data.rows).filter(|&row| data.used[row]).collect();
    let step_um = estimate_instrument_resolution_um(data, &rows);
    let chance = |distance_um: &[f64]| {
        let known = || rows.iter().copied().filter(|&row| !distance_um[row].is_nan());
        let of = |is_far: bool| -> Vec<f64> {
            let selected =
                known().filter(|&row| if is_far { of_readings[row] } else { !aside[row] });
            selected.map(|row| distance_um[row].abs()).collect()
        };
        noise_tail_probability(&of(false), &of(true), step_um)
    };
    let left_um = row_residuals(data, &with_curves);
    let by_level =
        chance(&deviations_from_local_median(data, &rows, aside, &left_um)).max(chance(&left_um));
    let targets = TargetPositions::from_rows(data, rows.iter().copied());
    let by_place = targets.map_or(1.0, |targets| {
        chance(&targets.deviations_from_target_median(&row_residuals(data, &plain), aside))
    });
    if by_level.min(by_place) < FALSE_POSITIVE_PROBABILITY {
        OutlierJudgement::Wrong
    } else {
        OutlierJudgement::MayBeNoise
    }
}

/// Returns whether a reading is nearer to what is predicted of a neighbour in time than to half of its way: it was
/// read before what happens there, or after.
fn is_nearer_to_neighbour(data: &DataTable, row: usize, predicted: &[f64]) -> bool {
    // Of an axis the neighbours stand elsewhere.
    if data.setting.quantity.axis().is_some() {
        return false;
    }
    let away_um = |other: usize| (data.measured[row] - predicted[other]).abs();
    // The larger part of the way is then what happened between the two.
    let is_nearer = |other: usize| away_um(other) < MAJORITY_FRACTION * away_um(row);
    let before = row.checked_sub(1).filter(|_| !data.places.restart[row]);
    let after = Some(row + 1).filter(|&next| next < data.rows && !data.places.restart[next]);
    before.into_iter().chain(after).any(is_nearer)
}

/// Returns what `predicted` leaves of each row.
fn row_residuals(data: &DataTable, predicted: &[f64]) -> Vec<f64> {
    data.measured.iter().zip(predicted).map(|(measured, predicted)| measured - predicted).collect()
}

/// Returns how far each of `rows` is from the median of those around it that are not excluded as outliers; NaN of the others.
fn deviations_from_local_median(
    data: &DataTable,
    rows: &[usize],
    aside: &[bool],
    left_um: &[f64],
) -> Vec<f64> {
    let mut distance_um = vec![f64::NAN; data.rows];
    for (at, &row) in rows.iter().enumerate() {
        let near = &rows[at.saturating_sub(NEIGHBOURS_PER_SIDE)
            ..(at + NEIGHBOURS_PER_SIDE + 1).min(rows.len())];
        let counts = |other: &&usize| {
            **other != row
                && !aside[**other]
                && data.places.series[**other] == data.places.series[row]
        };
        let mut around: Vec<f64> =
            near.iter().filter(counts).map(|&other| left_um[other]).collect();
        distance_um[row] = left_um[row] - median(&mut around);
    }
    distance_um
}

/// Returns which of the rows `aside` are surely no moment of the machine: of a record in time, those that have near
/// rows on both sides at the same speed and load. At a start, a pause or a change the reading may be right,
/// and what happened there is not known.
fn reading_error_mask(data: &DataTable, aside: &[bool]) -> Vec<bool> {
    let Some(time_s) = data.time_s() else { return aside.to_vec() };
    let inputs = [data.spindle_rpm(), data.load_n()];
    let is_same = |input: &[f64], row: usize| input[row] == input[row - 1] || input[row].is_nan();
    // What is another value in most rows is measured and not commanded: no row is at a change of it.
    let is_held =
        |input: &&[f64]| 2 * (1..data.rows).filter(|&row| is_same(input, row)).count() > data.rows;
    let inputs = inputs.into_iter().flatten();
    let held: Vec<&[f64]> = inputs.filter(is_held).collect();
    let inside: Vec<usize> = (1..data.rows).filter(|&row| !data.places.restart[row]).collect();
    let elapsed_s = |row: usize| time_s[row] - time_s[row - 1];
    let typical_s = median(&mut inside.iter().map(|&row| elapsed_s(row)).collect::<Vec<f64>>());
    let follows = |row: usize| {
        inside.binary_search(&row).is_ok()
            && elapsed_s(row) <= MIN_PAUSE_INTERVALS * typical_s
            && held.iter().all(|input| is_same(input, row))
    };
    (0..data.rows).map(|row| aside[row] && follows(row) && follows(row + 1)).collect()
}

/// Those of the rows `found` that are gross errors: they come one by one, and do not come back.
fn find_isolated_outliers(data: &DataTable, predicted: &[f64], found: &[bool]) -> Vec<bool> {
    let rows: Vec<usize> = (0..data.rows).filter(|&row| data.used[row]).collect();
    let residual: Vec<f64> = rows.iter().map(|&row| data.measured[row] - predicted[row]).collect();
    let series: Vec<u32> = rows.iter().map(|&row| data.places.series[row]).collect();
    let mut kept: Vec<bool> = rows.iter().map(|&row| found[row]).collect();
    retain_isolated_outliers(&mut kept, &residual, &series);
    retain_nonrecurring_outliers(&mut kept, &residual, &stop_positions(data, &rows));
    let mut aside = vec![false; data.rows];
    rows.into_iter().zip(kept).for_each(|(row, kept)| aside[row] = kept);
    aside
}

/// Gross errors come one by one. Where more of those `found` are neighbours on the same side than chance
/// would let them, what these share is something that happened, and no error of a reading: they stay.
fn retain_isolated_outliers(found: &mut [bool], residual: &[f64], series: &[u32]) {
    let is_pair = |a: usize, found: &[bool]| {
        let b = a + 1;
        b < found.len()
            && found[a]
            && found[b]
            && series[a] == series[b]
            && residual[a] * residual[b] > 0.0
    };
    let pairs: Vec<usize> = (0..found.len()).filter(|&row| is_pair(row, found)).collect();
    let far: Vec<usize> = (0..found.len()).filter(|&row| found[row]).collect();
    let count = far.len() as f64;
    // m of n rows drawn by chance make m²/n pairs.
    let by_chance =
        same_side_probability(&far, residual) * count * count / found.len().max(1) as f64;
    if poisson_tail_probability(pairs.len(), by_chance) < SIGNIFICANCE_LEVEL {
        for row in pairs {
            (found[row], found[row + 1]) = (false, false);
        }
    }
}

/// Returns the place at which each of `rows` stands, by its position to a micrometre and its direction; none where
/// nothing moves.
fn stop_positions(data: &DataTable, rows: &[usize]) -> Vec<(i64, bool)> {
    let (Some(position), direction) = (data.own_position_mm(), data.own_approach_direction())
    else {
        return Vec::new();
    };
    let is_back = |row: usize| direction.is_some_and(|d| d[row] < 0.0);
    rows.iter().map(|&row| ((position[row] * 1000.0).round() as i64, is_back(row))).collect()
}

/// Nor does a gross error come back: where more of those `found` are off to the same side at the same stop
/// than chance would let them, what repeats there is the machine's, and they stay.
fn retain_nonrecurring_outliers(found: &mut [bool], residual: &[f64], stops: &[(i64, bool)]) {
    let far: Vec<usize> = (0..stops.len()).filter(|&row| found[row]).collect();
    let is_same = |a: usize, b: usize| stops[a] == stops[b] && residual[a] * residual[b] > 0.0;
    let pairs = far.iter().enumerate().flat_map(|(n, &a)| far[..n].iter().map(move |&b| (a, b)));
    let pairs: Vec<(usize, usize)> = pairs.filter(|&(a, b)| is_same(a, b)).collect();
    let mut rows_at: HashMap<(i64, bool), f64> = HashMap::new();
    stops.iter().for_each(|stop| *rows_at.entry(*stop).or_default() += 1.0);
    // Two rows drawn by chance share a stop with the sum of the squares of the stops' shares.
    let rows = stops.len().max(1) as f64;
    let sharing: f64 = rows_at.values().map(|count| (count / rows).powi(2)).sum();
    let count = far.len() as f64;
    let by_chance = 0.5 * count * (count - 1.0) * sharing * same_side_probability(&far, residual);
    // Where most rows stand at one stop, it gives no information.
    if sharing < 0.5 && poisson_tail_probability(pairs.len(), by_chance) < SIGNIFICANCE_LEVEL {
        for (a, b) in pairs {
            (found[a], found[b]) = (false, false);
        }
    }
}

/// Returns the chance that two of the rows `far` are off to the same side.
fn same_side_probability(far: &[usize], residual: &[f64]) -> f64 {
    let above = far.iter().filter(|row| residual[**row] > 0.0).count() as f64;
    let share = above / far.len().max(1) as f64;
    share * share + (1.0 - share) * (1.0 - share)
}

/// Returns the instrument's last digit: the smallest step between readings, but for the rarest.
fn estimate_instrument_resolution_um(data: &DataTable, rows: &[usize]) -> f64 {
    let mut values: Vec<f64> = rows.iter().map(|&row| data.measured[row]).collect();
    values.sort_unstable_by(f64::total_cmp);
    let mut steps: Vec<f64> =
        values.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 1e-9).collect();
    steps.sort_unstable_by(f64::total_cmp);
    steps.get(steps.len() / 50).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_that_are_off_together_are_no_gross_errors_and_single_ones_are() {
        let series = vec![0; 500];
        let kept = |rows: &[usize]| {
            let mut found = vec![false; 500];
            let mut residual = vec![0.1; 500];
            for &row in rows {
                (found[row], residual[row]) = (true, 9.0);
            }
            retain_isolated_outliers(&mut found, &residual, &series);
            (0..500).filter(|&row| found[row]).collect::<Vec<usize>>()
        };
        assert_eq!(kept(&[20, 140, 300, 411]), [20, 140, 300, 411]);
        assert_eq!(kept(&[20, 21, 140, 141, 300, 411]), [300, 411]);
    }

    #[test]
    fn readings_that_are_off_again_and_again_at_one_stop_are_the_machines() {
        // Twelve cycles of thirty stops.
        let stops: Vec<(i64, bool)> = (0..360).map(|row| (row % 30, false)).collect();
        let kept = |rows: &[usize]| {
            let mut found = vec![false; 360];
            let mut residual = vec![0.1; 360];
            for &row in rows {
                (found[row], residual[row]) = (true, 9.0);
            }
            retain_nonrecurring_outliers(&mut found, &residual, &stops);
            (0..360).filter(|&row| found[row]).collect::<Vec<usize>>()
        };
        assert_eq!(kept(&[20, 147, 300, 341]), [20, 147, 300, 341]);
        assert_eq!(kept(&[30, 60, 120, 210, 300, 341]), [341]);
    }
}
