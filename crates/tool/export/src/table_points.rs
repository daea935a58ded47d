//! Points for a table: equidistant ones, the best few of many, and where to compare.
//!
//! **The best few.** A control that takes points at any distance but only N of them gets those N
//! of the candidates between which the straight lines stay nearest to all candidates. For a given
//! ε the fewest points are a shortest path: from point i a line may go to point j if it passes
//! within ε of every point between, that is if its slope lies in the cone
//!
//! ```text
//! max (y_k − ε − y_i)/(x_k − x_i)  ≤  slope  ≤  min (y_k + ε − y_i)/(x_k − x_i)      i < k < j
//! ```
//!
//! and the cone only narrows as j moves on, so a step costs one division. ε is then halved in
//! until the path has N points: the least largest deviation among all choices that keep both ends,
//! to 1 part in 10⁶ or 10⁻⁹ µm. Several columns that share their positions each have their cone.

use crate::report::{ApproachDirection, LargestDifference};

/// This many positions at least are compared in each direction.
const MIN_COMPARISON_POSITIONS: usize = 4000;

/// Returns the fewest of the rows `x` whose straight lines stay within `tolerance` of every column, or
/// `most` of them if that takes more; of all choices of this many rows the one that stays nearest.
/// Gives the rows, and how far the lines are off at most.
pub(crate) fn select_breakpoints(
    x: &[f64],
    columns: &[Vec<f64>],
    tolerance: f64,
    most: usize,
) -> (Vec<usize>, f64) {
    /// Nearer than this is the same, in µm.
    const MIN_TOLERANCE_UM: f64 = 1e-9;
    if x.len() <= 2 {
        return ((0..x.len()).collect(), 0.0);
    }
    let mut best = find_min_breakpoints(x, columns, tolerance);
    let mut enough = tolerance;
    let mut too_small = 0.0;
    let most = if best.len() > most {
        let spans = columns.iter().map(|column| {
            let low = column.iter().copied().fold(f64::INFINITY, f64::min);
            column.iter().copied().fold(f64::NEG_INFINITY, f64::max) - low
        });
        too_small = tolerance;
        // Two rows alone are off by the whole span at most.
        enough = spans.fold(tolerance, f64::max);
        best = find_min_breakpoints(x, columns, enough);
        most
    } else {
        best.len()
    };
    while enough - too_small > enough * 1e-6 && enough > MIN_TOLERANCE_UM {
        let middle = too_small.midpoint(enough);
        let rows = find_min_breakpoints(x, columns, middle);
        if rows.len() <= most {
            (enough, best) = (middle, rows);
        } else {
            too_small = middle;
        }
    }
    (best, enough)
}

/// Returns the fewest rows, the first and the last among them, between which the lines stay within `epsilon`.
fn find_min_breakpoints(x: &[f64], columns: &[Vec<f64>], epsilon: f64) -> Vec<usize> {
    let mut steps = vec![usize::MAX; x.len()];
    let mut from = vec![0; x.len()];
    steps[0] = 0;
    let mut cones = Vec::new();
    for i in 0..x.len() - 1 {
        // Every point is reached from the one before it, so that none is without a path.
        cones.clear();
        cones.resize(columns.len(), (f64::NEG_INFINITY, f64::INFINITY));
        for j in i + 1..x.len() {
            let run = x[j] - x[i];
            let mut is_open = true;
            let mut passes = true;
            for (column, (low, high)) in columns.iter().zip(&mut cones) {
                let rise = column[j] - column[i];
                let slope = rise / run;
                // A neighbour has no point between, whatever the rounding.
                passes &= j == i + 1 || (*low <= slope && slope <= *high);
                *low = low.max((rise - epsilon) / run);
                *high = high.min((rise + epsilon) / run);
                is_open &= *low <= *high;
            }
            if passes && steps[i] + 1 < steps[j] {
                (steps[j], from[j]) = (steps[i] + 1, i);
            }
            if !is_open {
                break;
            }
        }
    }
    let mut rows = vec![x.len() - 1];
    while let Some(&row) = rows.last().filter(|&&row| row > 0) {
        rows.push(from[row]);
    }
    rows.reverse();
    rows
}

/// Points of equal distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PointGrid {
    pub start_mm: f64,
    pub step_mm: f64,
    pub points: usize,
}

impl PointGrid {
    pub fn position_mm(&self, index: usize) -> f64 {
        self.start_mm + self.step_mm * index as f64
    }

    pub(crate) fn end_mm(&self) -> f64 {
        self.position_mm(self.points.saturating_sub(1))
    }

    pub(crate) fn positions_mm(&self) -> Vec<f64> {
        (0..self.points).map(|index| self.position_mm(index)).collect()
    }

    /// Returns the fewest points over `range_mm` whose straight lines stay within `tolerance_um` of
    /// `error_um`, or `most` points, whichever is less. The step is a whole number of
    /// `resolution_mm`, so the last point may lie a little beyond the range.
    pub(crate) fn with_tolerance(
        range_mm: (f64, f64),
        resolution_mm: f64,
        tolerance_um: f64,
        most: usize,
        error_um: impl Fn(f64) -> f64,
    ) -> Self {
        let (start_mm, last_mm) = range_mm;
        let with = |intervals: usize| {
            let step_mm = ((last_mm - start_mm) / intervals as f64 / resolution_mm - 1e-6).ceil()
                * resolution_mm;
            Self { start_mm, step_mm, points: intervals + 1 }
        };
        let most_intervals = most.saturating_sub(1).max(1);
        let mut intervals = 1;
        loop {
            let grid = with(intervals);
            if intervals == most_intervals || grid.is_within_tolerance(tolerance_um, &error_um) {
                return grid;
            }
            intervals = (intervals + intervals.div_ceil(4)).min(most_intervals);
        }
    }

    fn is_within_tolerance(&self, tolerance_um: f64, error_um: &impl Fn(f64) -> f64) -> bool {
        (1..self.points).all(|index| {
            let (left, right) =
                (error_um(self.position_mm(index - 1)), error_um(self.position_mm(index)));
            (1..16).all(|part| {
                let share = f64::from(part) / 16.0;
                let line = left + (right - left) * share;
                let at_mm = self.position_mm(index - 1) + self.step_mm * share;
                (error_um(at_mm) - line).abs() <= tolerance_um
            })
        })
    }
}

/// Linear between the points, the end values held outside; NaN without a point.
pub(crate) fn interpolate_linear(points: &[(f64, f64)], at: f64) -> f64 {
    let above = points.partition_point(|&(x, _)| x <= at);
    match (above.checked_sub(1).and_then(|below| points.get(below)), points.get(above)) {
        (Some(&(x0, y0)), Some(&(x1, y1))) => y0 + (y1 - y0) * (at - x0) / (x1 - x0),
        (Some(&(_, y)), None) | (None, Some(&(_, y))) => y,
        (None, None) => f64::NAN,
    }
}

/// Positions to compare at: dense over the range, and each of `special_mm`, just next to it, and
/// half way to the next. With `beyond`, also a tenth of the range outside, where tables are held.
pub(crate) fn comparison_positions_mm(
    range_mm: (f64, f64),
    special_mm: &[f64],
    beyond: bool,
) -> Vec<f64> {
    let (first, last) = range_mm;
    let span = (last - first).max(1e-3);
    let margin = if beyond { span / 10.0 } else { 0.0 };
    let step = (span + 2.0 * margin) / MIN_COMPARISON_POSITIONS as f64;
    let mut at: Vec<f64> =
        (0..=MIN_COMPARISON_POSITIONS).map(|probe| first - margin + step * probe as f64).collect();
    let mut special = special_mm.to_vec();
    special.sort_by(f64::total_cmp);
    at.extend(special.windows(2).map(|pair| pair[0].midpoint(pair[1])));
    at.extend(special.iter().flat_map(|mm| [mm - span * 1e-9, *mm, mm + span * 1e-9]));
    at.retain(|mm| (first - margin..=last + margin).contains(mm));
    at.sort_by(f64::total_cmp);
    at.dedup();
    at
}

/// Returns the largest of correction plus error, both in µm: what is left on the machine.
pub(crate) fn find_largest_residual(
    comparison_positions_mm: &[f64],
    error_um: impl Fn(f64, ApproachDirection) -> f64,
    correction_um: impl Fn(f64, ApproachDirection) -> f64,
) -> LargestDifference {
    let mut largest = LargestDifference::NONE;
    for approach in ApproachDirection::BOTH {
        for &mm in comparison_positions_mm {
            let left = correction_um(mm, approach) + error_um(mm, approach);

            largest.update_max(left, || format!("{mm:.3} mm, direction {:+}", approach.sign()));
        }
    }
    largest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_three_of_a_roof_are_its_ends_and_its_ridge() {
        let x: Vec<f64> = (0..=20).map(f64::from).collect();
        let roof = vec![x.iter().map(|x| 7.0 - (x - 7.0).abs()).collect::<Vec<_>>()];
        let (rows, off) = select_breakpoints(&x, &roof, 1e-9, 3);
        assert_eq!(rows, [0, 7, 20]);
        assert!(off <= 1e-9);
        // A tolerance that three points reach is not a reason to move the ridge.
        assert_eq!(select_breakpoints(&x, &roof, 0.5, 10).0, [0, 7, 20]);
    }

    #[test]
    fn no_other_choice_of_so_many_rows_is_nearer() {
        // Every choice of 5 of 12 points that keeps both ends, tried one by one.
        let x: Vec<f64> = (0..12_u32).map(|k| f64::from(k * k % 17 + 20 * k)).collect();
        let y: Vec<f64> = (0..12_u32).map(|k| f64::from(k * 7919 % 23) - 11.0).collect();
        let off = |rows: &[usize]| {
            let points: Vec<(f64, f64)> = rows.iter().map(|&row| (x[row], y[row])).collect();
            (0..12).map(|k| (interpolate_linear(&points, x[k]) - y[k]).abs()).fold(0.0, f64::max)
        };
        let mut least = f64::INFINITY;
        for a in 1..9 {
            for b in a + 1..10 {
                for c in b + 1..11 {
                    least = least.min(off(&[0, a, b, c, 11]));
                }
            }
        }
        let (rows, claimed) = select_breakpoints(&x, std::slice::from_ref(&y), 1e-9, 5);
        println!("5 of 12: {least} is the least, {} found with {rows:?}", off(&rows));
        assert!(rows.len() <= 5 && (off(&rows) - least).abs() < 1e-5 * least);
        assert!((claimed - least).abs() < 1e-5 * least);
    }

    #[test]
    fn an_equidistant_grid_is_as_coarse_as_the_tolerance_allows() {
        let bow = |mm: f64| mm * (1000.0 - mm) / 250_000.0 * 10.0;
        let grid = PointGrid::with_tolerance((0.0, 1000.0), 1e-4, 0.1, 5000, bow);
        // A parabola of 10 µm over n intervals is off by 10/n².
        assert!((11..=14).contains(&grid.points), "{grid:?}");
        assert!(grid.end_mm() >= 1000.0 && grid.end_mm() < 1000.01);
        assert_eq!(PointGrid::with_tolerance((0.0, 1000.0), 1e-4, 0.1, 4, bow).points, 4);
        assert_eq!(PointGrid::with_tolerance((0.0, 1000.0), 1e-4, 0.1, 5000, |mm| mm).points, 2);
    }
}
