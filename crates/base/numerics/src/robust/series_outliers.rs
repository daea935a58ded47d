//! Rows of a time series that leave it and come back.

use std::collections::BTreeSet;

use super::statistics::{
    MIN_CUTOFF_SCALES, Outlier, median, median_step, outlier_cutoff, robust_scale,
};

/// Neighbours on each side of a row of a series.
const NEIGHBOURS_PER_SIDE: usize = 7;
/// A burst of more rows is not excluded: it has become the level.
const MAX_BURST_ROWS: usize = 5;
/// Fewer rows than this have no neighbours to speak of.
pub const MIN_SERIES_ROWS: usize = 2 * NEIGHBOURS_PER_SIDE + 1;

/// Rows of a time series that leave it and come back. `time` does not run back; rows where either
/// is NaN take no part. Nothing is found in fewer than [`MIN_SERIES_ROWS`] rows.
#[must_use]
pub fn find_series_outliers(time: &[f64], y: &[f64]) -> Vec<Outlier> {
    let present = |row: &usize| !time[*row].is_nan() && !y[*row].is_nan();
    let rows: Vec<usize> = (0..y.len().min(time.len())).filter(present).collect();
    if rows.len() < MIN_SERIES_ROWS {
        return Vec::new();
    }
    let floor = median_step(rows.iter().map(|&row| y[row]));
    let most = outlier_cutoff(rows.len(), 2);
    let mut found: Vec<Outlier> = Vec::new();
    // A burst hides behind itself: without the rows found so far the others stand out.
    for _ in 0..MAX_BURST_ROWS {
        let known: BTreeSet<usize> = found.iter().map(|outlier| outlier.row).collect();
        let clean: Vec<usize> = rows.iter().copied().filter(|row| !known.contains(row)).collect();
        if clean.len() < MIN_SERIES_ROWS {
            break;
        }
        let local: Vec<NeighbourFit> =
            (0..clean.len()).map(|at| NeighbourFit::from_row(&clean, at, time, y)).collect();
        let global = robust_scale(local.iter().map(|local| local.distance / local.widening));
        let mut new: Vec<Outlier> = Vec::new();
        for (local, &row) in local.iter().zip(&clean) {
            let scale = local.widening * global.max(local.scale).max(floor);
            let scales = local.distance.abs() / scale;
            if scales > most {
                new.push(Outlier { row, distance: local.distance, scales });
            }
        }
        if new.is_empty() {
            break;
        }
        found.extend(new);
    }
    found.sort_unstable_by_key(|outlier| outlier.row);
    discard_level_shifts(found, &rows, time, y)
}

/// Takes back what may be the machine: bursts so long that they are a level, and at either end of
/// the series, where no return was recorded, all but a single row that does not continue its
/// neighbours' curve either. A cold machine moves fastest in its first rows.
fn discard_level_shifts(
    found: Vec<Outlier>,
    rows: &[usize],
    time: &[f64],
    y: &[f64],
) -> Vec<Outlier> {
    let place = |outlier: &Outlier| rows.binary_search(&outlier.row).unwrap_or(usize::MAX);
    let follows = |a: &Outlier, b: &Outlier| {
        place(a) + 1 == place(b) && a.distance.signum() == b.distance.signum()
    };
    let last = rows.len() - 1;
    let is_retained = |burst: &&[Outlier]| {
        let (from, to) = (place(&burst[0]), place(&burst[burst.len() - 1]));
        match (from, to) {
            (0, 0) => deviates_from_parabola(&burst[0], &rows[1..4], time, y),
            (from, to) if from == last && to == last => {
                deviates_from_parabola(&burst[0], &rows[last - 3..last], time, y)
            }
            (from, to) => from != 0 && to != last && burst.len() <= MAX_BURST_ROWS,
        }
    };
    found.chunk_by(follows).filter(is_retained).flatten().copied().collect()
}

/// Returns whether a row at an end is far from the parabola through its three neighbours as well.
fn deviates_from_parabola(outlier: &Outlier, three: &[usize], time: &[f64], y: &[f64]) -> bool {
    let at = time[outlier.row];
    let (mut value, mut squares) = (0.0, 1.0);
    for &row in three {
        let others = three.iter().filter(|other| **other != row);
        let weight: f64 =
            others.map(|&other| (at - time[other]) / (time[row] - time[other])).product();
        value += weight * y[row];
        squares += weight * weight;
    }
    let scale = (outlier.distance / outlier.scales).abs();
    // Rows at one time have no parabola: then nothing speaks for the row.
    let away = (y[outlier.row] - value).abs();
    away.is_nan() || away > MIN_CUTOFF_SCALES * scale * squares.sqrt()
}

/// A row of a series next to its neighbours.
struct NeighbourFit {
    /// From the line through the neighbours.
    distance: f64,
    /// The neighbours' own scale about that line.
    scale: f64,
    /// How much wider than its own scatter the row lies about the line, because the line is not
    /// known exactly: more where the row is at an end.
    widening: f64,
}

impl NeighbourFit {
    fn from_row(rows: &[usize], at: usize, time: &[f64], y: &[f64]) -> Self {
        let requested = 2 * NEIGHBOURS_PER_SIDE;
        let first = at.saturating_sub(NEIGHBOURS_PER_SIDE).min(rows.len() - requested - 1);
        let others =
            || rows[first..=first + requested].iter().copied().filter(|&row| row != rows[at]);
        let own = time[rows[at]];
        // Slopes of all pairs of neighbours; two rows at one time have none.
        let mut slopes = Vec::with_capacity(requested * (requested - 1) / 2);
        for (index, a) in others().enumerate() {
            for b in others().skip(index + 1) {
                let elapsed = time[b] - time[a];
                if elapsed > 0.0 {
                    slopes.push((y[b] - y[a]) / elapsed);
                }
            }
        }
        let slope = if slopes.is_empty() { 0.0 } else { median(&mut slopes) };
        let mut heights: Vec<f64> =
            others().map(|row| y[row] - slope * (time[row] - own)).collect();
        let height = median(&mut heights);
        let scale = robust_scale(heights.iter().map(|there| there - height));
        let count = requested as f64;
        let mean = others().map(|row| time[row] - own).sum::<f64>() / count;
        let spread: f64 = others().map(|row| (time[row] - own - mean).powi(2)).sum();
        // Medians know a line about 1.57 times worse than least squares.
        let share = if spread > 0.0 { mean * mean / spread } else { 0.0 };
        let widening = (1.0 + 1.57 * (1.0 / count + share)).sqrt();
        Self { distance: y[rows[at]] - height, scale, widening }
    }
}
