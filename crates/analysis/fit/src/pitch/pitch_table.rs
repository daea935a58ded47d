//! The table of a machine file from errors at any targets: equal steps, linear between the points.
//!
//! ISO 230-2 requires targets at uneven distances, a machine file has a table of equal steps. The
//! line f through the measured means is brought to the table g that is nearest to it both at the
//! targets tᵢ (with as much weight as they have readings) and between them:
//!
//! ```text
//! Σ nᵢ·(g(tᵢ) − f(tᵢ))² / Σ nᵢ  +  1/L·∫ (g − f)² dx  →  least
//! ```
//!
//! The integral keeps every point of the table determined, however few targets are near it; it is
//! exact, because f and g are straight between the points of either. Where f is straight between
//! the points of the table, as with targets of equal steps, g = f.

use trueup_machine::{
    machine_file::PitchErrorTable, machine_file::writer::round_to_decimals, model::pitch_error_um,
};

/// The board counts positions in 10 nm.
const POSITION_UNITS_PER_MM: f64 = 1e5;

/// Digits after the point of a table in µm: a nanometre.
pub(super) const TABLE_DECIMALS: i32 = 3;

/// The targets of one direction that have a mean, rising.
#[derive(Clone, Debug, Default)]
pub(super) struct TargetMeans {
    /// Position in mm, mean in µm, number of readings.
    pub points: Vec<(f64, f64, f64)>,
}

impl TargetMeans {
    /// Its value at `x`: straight between the points, the ends held outside. NaN without a point.
    fn interpolate(&self, x: f64) -> f64 {
        let after = self.points.partition_point(|point| point.0 <= x);
        match (after.checked_sub(1).and_then(|n| self.points.get(n)), self.points.get(after)) {
            (Some(low), Some(high)) => low.1 + (high.1 - low.1) * (x - low.0) / (high.0 - low.0),
            (Some(end), None) | (None, Some(end)) => end.1,
            (None, None) => f64::NAN,
        }
    }
}

/// The points of a table: at least two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TableGrid {
    pub start_mm: f64,
    pub step_mm: f64,
    pub points: usize,
}

impl TableGrid {
    /// This many points from the first target to the last, at whole units of the board, so that its
    /// table stands where this one does.
    pub(super) fn with_point_count(targets_mm: &[f64], points: usize) -> Self {
        let (start, end) = target_endpoints_mm(targets_mm);
        let start_mm = round_to_board_unit(start, f64::floor);
        let step_mm = round_to_board_unit((end - start_mm) / (points - 1) as f64, f64::ceil);
        Self { start_mm, step_mm, points }
    }

    /// Steps of `step_mm` from the first target to at least the last.
    pub(super) fn with_step(targets_mm: &[f64], step_mm: f64) -> Self {
        // A last step of a rounding error's length is none.
        const STEP_ROUNDING_TOLERANCE: f64 = 1e-9;
        let (start, end) = target_endpoints_mm(targets_mm);
        let steps = ((end - start) / step_mm - STEP_ROUNDING_TOLERANCE).ceil().max(1.0);
        Self { start_mm: start, step_mm, points: (steps as usize).saturating_add(1) }
    }

    /// Returns the targets themselves, if their distances are equal to a ten-thousandth: they may have been
    /// written in few digits.
    pub(super) fn from_equally_spaced_targets(targets_mm: &[f64]) -> Option<Self> {
        const RELATIVE_SPACING_TOLERANCE: f64 = 1e-4;
        let grid = Self::with_point_count(targets_mm, targets_mm.len());
        let off = |(n, &target): (usize, &f64)| (target - grid.position_mm(n)).abs();
        let worst = targets_mm.iter().enumerate().map(off).fold(0.0, f64::max);
        (worst <= RELATIVE_SPACING_TOLERANCE * grid.step_mm).then_some(grid)
    }

    fn position_mm(&self, point: usize) -> f64 {
        self.start_mm + self.step_mm * point as f64
    }

    /// Returns the table nearest to `line`, in µm to [`TABLE_DECIMALS`].
    pub(super) fn fit_table_values(&self, line: &TargetMeans) -> Vec<f64> {
        self.least_squares_fit(line)
            .into_iter()
            .map(|um| round_to_decimals(um, TABLE_DECIMALS))
            .collect()
    }

    fn least_squares_fit(&self, line: &TargetMeans) -> Vec<f64> {
        let mut sums = TridiagonalSystem::new(self.points);
        let readings: f64 = line.points.iter().map(|point| point.2).sum();
        for &(x, um, weight) in &line.points {
            self.add_observation(&mut sums, x, um, weight / readings);
        }
        // Simpson's rule is exact for the product of two straight pieces.
        let length = self.position_mm(self.points - 1) - self.start_mm;
        let mut breaks: Vec<f64> = (0..self.points).map(|point| self.position_mm(point)).collect();
        let inside = |x: &f64| (self.start_mm..self.position_mm(self.points - 1)).contains(x);
        breaks.extend(line.points.iter().map(|point| point.0).filter(inside));
        breaks.sort_by(f64::total_cmp);
        for pair in breaks.windows(2) {
            let &[from, to] = pair else { continue };
            let share = (to - from) / length / 6.0;
            for (x, weight) in [(from, share), ((from + to) / 2.0, 4.0 * share), (to, share)] {
                self.add_observation(&mut sums, x, line.interpolate(x), weight);
            }
        }
        sums.solve()
    }

    /// Adds `weight`·(g(x) − um)².
    fn add_observation(&self, sums: &mut TridiagonalSystem, x: f64, um: f64, weight: f64) {
        let at = ((x - self.start_mm) / self.step_mm).clamp(0.0, (self.points - 1) as f64);
        let low = (at.floor() as usize).min(self.points - 2);
        let share = at - low as f64;
        sums.add_observation(low, [1.0 - share, share], um, weight);
    }

    /// Returns the table of `lines`, one for both directions or one for each.
    pub(super) fn fit_pitch_table(
        &self,
        forward: &TargetMeans,
        reverse: Option<&TargetMeans>,
    ) -> PitchErrorTable {
        PitchErrorTable {
            start_mm: self.start_mm,
            step_mm: self.step_mm,
            forward_um: self.fit_table_values(forward),
            reverse_um: reverse.map(|line| self.fit_table_values(line)),
        }
    }

    /// Returns the root mean square of what the table misses at the targets of `lines`, in µm.
    pub(super) fn rms_loss_um(&self, lines: &[&TargetMeans]) -> f64 {
        let (mut squares, mut weights) = (0.0, 0.0);
        for line in lines {
            let pitch = self.fit_pitch_table(line, None);
            for &(x, um, weight) in &line.points {
                squares += weight * (pitch_error_um(&pitch, x, 1.0) - um).powi(2);
                weights += weight;
            }
        }
        (squares / weights).sqrt()
    }
}

/// Returns the board's unit of position below or above `mm`; itself if it is one but for rounding.
fn round_to_board_unit(mm: f64, towards: fn(f64) -> f64) -> f64 {
    const ROUNDING_TOLERANCE: f64 = 1e-6;
    let units = mm * POSITION_UNITS_PER_MM;
    let nearest = units.round();
    let whole = if (units - nearest).abs() < ROUNDING_TOLERANCE { nearest } else { towards(units) };
    whole / POSITION_UNITS_PER_MM
}

fn target_endpoints_mm(targets_mm: &[f64]) -> (f64, f64) {
    let first = targets_mm.first().copied().unwrap_or(f64::NAN);
    (first, targets_mm.last().copied().unwrap_or(f64::NAN))
}

/// Normal equations in which only neighbours meet.
struct TridiagonalSystem {
    diagonal: Vec<f64>,
    neighbours: Vec<f64>,
    right: Vec<f64>,
}

impl TridiagonalSystem {
    fn new(unknowns: usize) -> Self {
        Self {
            diagonal: vec![0.0; unknowns],
            neighbours: vec![0.0; unknowns],
            right: vec![0.0; unknowns],
        }
    }

    fn add_observation(&mut self, low: usize, shares: [f64; 2], value: f64, weight: f64) {
        for (n, share) in shares.into_iter().enumerate() {
            self.diagonal[low + n] += weight * share * share;
            self.right[low + n] += weight * share * value;
        }
        self.neighbours[low] += weight * shares[0] * shares[1];
    }

    /// Gauss without pivots: the matrix is positive definite, because the integral reaches every
    /// unknown.
    fn solve(mut self) -> Vec<f64> {
        let count = self.diagonal.len();
        for n in 1..count {
            let factor = self.neighbours[n - 1] / self.diagonal[n - 1];
            self.diagonal[n] -= factor * self.neighbours[n - 1];
            self.right[n] -= factor * self.right[n - 1];
        }
        for n in (0..count).rev() {
            let after = if n + 1 < count { self.neighbours[n] * self.right[n + 1] } else { 0.0 };
            self.right[n] = (self.right[n] - after) / self.diagonal[n];
        }
        self.right
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(points: &[(f64, f64)]) -> TargetMeans {
        TargetMeans { points: points.iter().map(|&(x, um)| (x, um, 1.0)).collect() }
    }

    fn worst(table: &[f64], expected: &[f64]) -> f64 {
        assert_eq!(table.len(), expected.len());
        table.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn equal_steps_give_the_means_themselves() {
        let targets = [-20.0, -15.0, -10.0, -5.0, 0.0];
        let grid = TableGrid::from_equally_spaced_targets(&targets).expect("they are equal");
        assert_eq!(grid, TableGrid { start_mm: -20.0, step_mm: 5.0, points: 5 });
        let means = [1.0, -7.25, 30.125, 0.0, 4.5];
        let points: Vec<_> = targets.into_iter().zip(means).collect();
        assert_eq!(grid.fit_table_values(&line(&points)), means);
    }

    #[test]
    fn a_straight_line_through_uneven_targets_is_kept_exactly() {
        let points: Vec<(f64, f64)> =
            [0.0, 13.7, 29.1, 61.0, 100.0].map(|x| (x, 0.5 * x - 3.0)).into();
        let targets: Vec<f64> = points.iter().map(|point| point.0).collect();
        assert!(TableGrid::from_equally_spaced_targets(&targets).is_none());
        let grid = TableGrid::with_point_count(&targets, 5);
        let table = grid.fit_table_values(&line(&points));
        assert!(worst(&table, &[-3.0, 9.5, 22.0, 34.5, 47.0]) < 1e-9, "{table:?}");
        assert!(grid.rms_loss_um(&[&line(&points)]) < 1e-9);
    }

    #[test]
    fn a_finer_table_loses_less_at_uneven_targets() {
        let points = line(&[(0.0, 0.0), (9.0, 4.0), (21.5, -3.0), (30.0, 5.0), (41.0, 0.0)]);
        let targets: Vec<f64> = points.points.iter().map(|point| point.0).collect();
        let loss = |count| TableGrid::with_point_count(&targets, count).rms_loss_um(&[&points]);
        let losses = [3, 6, 20, 80].map(loss);
        println!("loss in µm with 3, 6, 20, 80 points: {losses:.3?}");
        assert!(losses.is_sorted_by(|a, b| a > b), "{losses:?}");
        assert!(losses[3] < 0.05);
    }

    #[test]
    fn the_table_is_the_least_of_the_stated_sum() {
        // Two unknowns, worked by hand: targets 0, 1, 4 with f = 0, 3, 0 on a table of 0 and 4.
        // At the targets: (g0² + (0.75 g0 + 0.25 g1 − 3)² + g1²)/3.
        // The integral over x/4 = u: ∫(g0(1−u) + g1 u)² − 2 g f + f²; ∫f(1−u) du = 0.875,
        // ∫f u du = 0.625 (f rises to 3 at u = 1/4).
        // Normal equations: [25/48 + 1/3, 1/16 + 1/6; …, 17/48 + 1/3]·g = [0.75 + 0.875, 0.25 + 0.625]
        let (a, b, c) = (25.0 / 48.0 + 1.0 / 3.0, 1.0 / 16.0 + 1.0 / 6.0, 17.0 / 48.0 + 1.0 / 3.0);
        let (p, q) = (1.625, 0.875);
        let det = a * c - b * b;
        let by_hand = [(c * p - b * q) / det, (a * q - b * p) / det];
        let grid = TableGrid::with_point_count(&[0.0, 1.0, 4.0], 2);
        let table = grid.least_squares_fit(&line(&[(0.0, 0.0), (1.0, 3.0), (4.0, 0.0)]));
        assert!(worst(&table, &by_hand) < 1e-12, "{table:?}, by hand {by_hand:?}");
    }

    #[test]
    fn points_stand_where_the_board_can_have_them_and_cover_the_targets() {
        let targets = [-0.000_003, 1.1, 2.2, 10.0];
        for points in [2, 3, 4, 7, 100] {
            let grid = TableGrid::with_point_count(&targets, points);
            for mm in [grid.start_mm, grid.step_mm] {
                assert!((mm * 1e5 - (mm * 1e5).round()).abs() < 1e-6, "{grid:?}");
            }
            assert!(grid.start_mm <= targets[0] && grid.position_mm(points - 1) >= 10.0 - 1e-9);
        }
    }

    #[test]
    fn steps_written_in_few_digits_are_still_equal() {
        let grid = TableGrid::from_equally_spaced_targets(&[0.0, 6.6667, 13.3333, 20.0])
            .expect("thirds of 20");
        assert_eq!((grid.points, grid.step_mm), (4, 6.66667));
    }

    #[test]
    fn a_step_that_does_not_divide_the_travel_ends_beyond_it() {
        let grid = TableGrid::with_step(&[0.0, 3.0, 10.0], 4.0);
        assert_eq!(grid.points, 4);
        assert_eq!(TableGrid::with_step(&[0.0, 0.1, 0.3], 0.1).points, 4);
    }
}
