//! From readings to sites: what was read at one position, once or often, becomes its mean.
//!
//! Readings at one position differ by noise alone, so their scatter about the mean is an estimate
//! of the noise that no curve has a part in.

use trueup_machine::machine_file::BSpline;

use super::{ReferenceLine, StraightnessFitError};

/// Positions nearer to each other than this share of the travel are the same position.
const POSITION_RELATIVE_TOLERANCE: f64 = 1e-7;

/// Readings by position.
#[derive(Clone, Debug)]
pub(super) struct Sites {
    /// Positions in mm, rising.
    pub(super) x: Vec<f64>,
    /// The mean of the readings there, in µm.
    pub(super) y: Vec<f64>,
    /// How many readings.
    pub(super) weight: Vec<f64>,
    /// Sum of squares of the readings about the means of their sites, in µm².
    pub(super) within: f64,
    /// Readings in all.
    pub(super) rows: usize,
}

/// A straight line, in µm over mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StraightLine {
    /// At position 0, in µm.
    pub offset_um: f64,
    /// In µm per mm.
    pub slope_um_per_mm: f64,
}

impl StraightLine {
    /// Returns the line's value, in µm.
    #[must_use]
    pub fn evaluate(&self, x_mm: f64) -> f64 {
        self.offset_um + self.slope_um_per_mm * x_mm
    }

    fn through_points([x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) -> Self {
        let slope_um_per_mm = (y1 - y0) / (x1 - x0);
        Self { offset_um: y0 - slope_um_per_mm * x0, slope_um_per_mm }
    }
}

impl Sites {
    /// Sorts and merges readings.
    pub(super) fn from_readings(
        along_mm: &[f64],
        error_um: &[f64],
    ) -> Result<Self, StraightnessFitError> {
        if along_mm.len() != error_um.len() {
            let (positions, errors) = (along_mm.len(), error_um.len());
            return Err(StraightnessFitError::LengthsDiffer { positions, errors });
        }
        for (row, (&x, &y)) in along_mm.iter().zip(error_um).enumerate() {
            for (is_position, value) in [(true, x), (false, y)] {
                if !value.is_finite() {
                    return Err(StraightnessFitError::NotFinite { row, is_position, value });
                }
            }
        }
        let mut order: Vec<usize> = (0..along_mm.len()).collect();
        order.sort_by(|&a, &b| along_mm[a].total_cmp(&along_mm[b]));
        let ends = order.first().zip(order.last()).map(|(&a, &b)| [along_mm[a], along_mm[b]]);
        let [first, last] = ends.ok_or(StraightnessFitError::TooFewPositions { positions: 0 })?;
        let same = POSITION_RELATIVE_TOLERANCE * (last - first);

        let mut sites =
            Self { x: vec![], y: vec![], weight: vec![], within: 0.0, rows: order.len() };
        for group in order.chunk_by(|&a, &b| along_mm[b] - along_mm[a] <= same) {
            let count = group.len() as f64;
            let mean = group.iter().map(|&row| error_um[row]).sum::<f64>() / count;
            let scatter = group.iter().map(|&row| (error_um[row] - mean).powi(2)).sum::<f64>();
            sites.x.push(along_mm[group[0]]);
            sites.y.push(mean);
            sites.weight.push(count);
            sites.within += scatter;
        }
        match sites.len() {
            1 => Err(StraightnessFitError::OnePosition { position_mm: first }),
            positions @ (0 | 2 | 3) => Err(StraightnessFitError::TooFewPositions { positions }),
            _ => Ok(sites),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.x.len()
    }

    pub(super) fn end_positions_mm(&self) -> [f64; 2] {
        [self.x[0], self.x[self.len() - 1]]
    }

    /// Position, mean and weight of each site.
    pub(super) fn points(&self) -> impl Iterator<Item = (f64, f64, f64)> {
        self.x.iter().zip(&self.y).zip(&self.weight).map(|((&x, &y), &weight)| (x, y, weight))
    }

    /// Degrees of freedom of the scatter within sites.
    pub(super) fn within_site_degrees_of_freedom(&self) -> usize {
        self.rows - self.len()
    }

    /// Returns what lies between the means and a curve.
    pub(super) fn residuals(&self, spline: &BSpline) -> Vec<f64> {
        let value = |x| trueup_machine::model::spline_value_um(spline, x);
        self.x.iter().zip(&self.y).map(|(&x, &y)| y - value(x)).collect()
    }

    /// Takes a reference line away from all readings, and says which.
    pub(super) fn subtract_reference_line(&mut self, reference: ReferenceLine) -> StraightLine {
        let last = self.len() - 1;
        let line = match reference {
            ReferenceLine::AsMeasured => return StraightLine::default(),
            ReferenceLine::EndPoints => {
                StraightLine::through_points([self.x[0], self.y[0]], [self.x[last], self.y[last]])
            }
            ReferenceLine::LeastSquares => self.least_squares_line(),
        };
        for (y, x) in self.y.iter_mut().zip(&self.x) {
            *y -= line.evaluate(*x);
        }
        line
    }

    pub(super) fn least_squares_line(&self) -> StraightLine {
        let rows = self.rows as f64;
        let mean = |of: fn((f64, f64, f64)) -> f64| self.points().map(of).sum::<f64>() / rows;
        let (x_mean, y_mean) = (mean(|(x, _, w)| w * x), mean(|(_, y, w)| w * y));
        let (mut across, mut along) = (0.0, 0.0);
        for (x, y, weight) in self.points() {
            across += weight * (x - x_mean) * (y - y_mean);
            along += weight * (x - x_mean).powi(2);
        }
        let slope_um_per_mm = across / along;
        StraightLine { offset_um: y_mean - slope_um_per_mm * x_mean, slope_um_per_mm }
    }

    /// At most `most` sites: neighbours are joined, equally many in each. To look for knots in; the
    /// fit itself takes all.
    pub(super) fn merge_neighbours(&self, most: usize) -> Self {
        let size = self.len().div_ceil(most);
        let mut thin = Self { x: vec![], y: vec![], weight: vec![], within: 0.0, rows: self.rows };
        let all: Vec<_> = self.points().collect();
        for cell in all.chunks(size) {
            let weight: f64 = cell.iter().map(|(_, _, w)| w).sum();
            thin.x.push(cell.iter().map(|(x, _, w)| x * w).sum::<f64>() / weight);
            thin.y.push(cell.iter().map(|(_, y, w)| y * w).sum::<f64>() / weight);
            thin.weight.push(weight);
        }
        thin
    }

    /// Returns every second site, from the first on or from the second.
    pub(super) fn every_second(&self, from: usize) -> Self {
        let take = |values: &[f64]| values.iter().skip(from).step_by(2).copied().collect();
        let weight: Vec<f64> = take(&self.weight);
        let rows = weight.iter().sum::<f64>() as usize;
        // The scatter within is shared out by degrees of freedom.
        let freedom = self.within_site_degrees_of_freedom().max(1) as f64;
        let within = self.within * (rows - weight.len()) as f64 / freedom;
        Self { x: take(&self.x), y: take(&self.y), weight, within, rows }
    }
}

/// Sites for tests, every 10 mm from 0 on.
#[cfg(test)]
pub(super) fn every_10_mm(count: usize, error_um: impl Fn(f64) -> f64) -> Sites {
    let x: Vec<f64> = (0..count).map(|n| 10.0 * n as f64).collect();
    let y: Vec<f64> = x.iter().map(|&x| error_um(x)).collect();
    Sites::from_readings(&x, &y).expect("sound")
}
