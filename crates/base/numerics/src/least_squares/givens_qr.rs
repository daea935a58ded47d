//! Linear least squares, one row at a time.
//!
//! Each row (x | y) is rotated into the triangle (R | z) column by column (Givens):
//!
//! ```text
//! r = √(Rⱼⱼ² + xⱼ²),  c = Rⱼⱼ/r,  s = xⱼ/r,   (Rⱼ | zⱼ) ← c·(Rⱼ | zⱼ) + s·(x | y),   (x | y) ← c·(x | y) − s·(Rⱼ | zⱼ)
//! ```
//!
//! The part of y left after the last column is orthogonal to all columns: its square adds to the
//! residual sum of squares. Then R·c = z.

use crate::t_quantile;

/// Below this share of a column's length, what the columns before leave of it is rounding.
const RANK_TOLERANCE: f64 = 1e-11;

/// The rows so far.
#[derive(Clone, Debug)]
pub struct GivensQr {
    columns: usize,
    /// R and z, row by row, each `columns + 1` long.
    rotated: Vec<f64>,
    /// The squared length of each column.
    lengths: Vec<f64>,
    residual_squares: f64,
    rows: usize,
    /// The row that is being rotated in.
    row: Vec<f64>,
}

/// A column is a combination of those before it, or 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("column {} follows from the columns before it", .column + 1)]
pub struct DependentColumn {
    /// The column, from 0.
    pub column: usize,
}

impl GivensQr {
    /// No row yet, of this many columns.
    #[must_use]
    pub fn new(columns: usize) -> Self {
        Self {
            columns,
            rotated: vec![0.0; columns * (columns + 1)],
            lengths: vec![0.0; columns],
            residual_squares: 0.0,
            rows: 0,
            row: vec![0.0; columns + 1],
        }
    }

    /// Adds a row; `x` has the columns, all finite.
    ///
    /// # Panics
    /// `x` has another number of columns.
    pub fn add_row(&mut self, x: &[f64], y: f64) {
        assert_eq!(x.len(), self.columns, "a row has as many values as there are columns");
        let width = self.columns + 1;
        self.row[..self.columns].copy_from_slice(x);
        self.row[self.columns] = y;
        self.rows += 1;
        for column in 0..self.columns {
            let own = self.row[column];
            self.lengths[column] += x[column] * x[column];
            if own == 0.0 {
                continue;
            }
            let rotated = &mut self.rotated[column * width..(column + 1) * width];
            let there = rotated[column];
            let length = (there * there + own * own).sqrt();
            let (cosine, sine) = (there / length, own / length);
            rotated[column] = length;
            for (above, below) in
                rotated[column + 1..].iter_mut().zip(&mut self.row[column + 1..width])
            {
                let turned = cosine * *above + sine * *below;
                *below = cosine * *below - sine * *above;
                *above = turned;
            }
        }
        self.residual_squares += self.row[self.columns] * self.row[self.columns];
    }

    /// Rows so far.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// R's element, 0 below the diagonal; column `columns` is z.
    pub(super) fn element(&self, row: usize, column: usize) -> f64 {
        if column < row { 0.0 } else { self.rotated[row * (self.columns + 1) + column] }
    }

    /// Returns the length of what no combination of the columns reaches.
    pub(super) fn residual_norm(&self) -> f64 {
        self.residual_squares.sqrt()
    }

    /// Returns the coefficients of least squares.
    ///
    /// # Errors
    /// A column follows from those before it, to within 1e-11 of its own length: its coefficient
    /// could be anything.
    pub fn solve(&self) -> Result<QrSolution, DependentColumn> {
        let n = self.columns;
        if let Some(column) = (0..n).find(|&column| {
            // Not `<=`: a column of NaN is caught as well.
            let is_independent =
                self.element(column, column).abs() > RANK_TOLERANCE * self.lengths[column].sqrt();
            !is_independent
        }) {
            return Err(DependentColumn { column });
        }
        let mut coefficients = vec![0.0; n];
        for row in (0..n).rev() {
            let known: f64 = (row + 1..n).map(|at| self.element(row, at) * coefficients[at]).sum();
            coefficients[row] = (self.element(row, n) - known) / self.element(row, row);
        }
        let mut inverse = vec![0.0; n * n];
        for column in 0..n {
            inverse[column * n + column] = 1.0 / self.element(column, column);
            for row in (0..column).rev() {
                let known: f64 = (row + 1..=column)
                    .map(|at| self.element(row, at) * inverse[at * n + column])
                    .sum();
                inverse[row * n + column] = -known / self.element(row, row);
            }
        }
        let residual_squares = self.residual_squares;
        Ok(QrSolution { coefficients, inverse, residual_squares, rows: self.rows })
    }
}

/// Coefficients and how well they are known.
#[derive(Clone, Debug, PartialEq)]
pub struct QrSolution {
    /// One for each column.
    pub coefficients: Vec<f64>,
    /// R⁻¹, row by row.
    inverse: Vec<f64>,
    /// The sum of the squares of the residuals.
    pub residual_squares: f64,
    /// Rows that were fitted.
    pub rows: usize,
}

impl QrSolution {
    /// Rows beyond the coefficients.
    #[must_use]
    pub fn degrees_of_freedom(&self) -> usize {
        self.rows.saturating_sub(self.coefficients.len())
    }

    /// s²: the variance of the residuals; infinite without degrees of freedom.
    #[must_use]
    pub fn residual_variance(&self) -> f64 {
        match self.degrees_of_freedom() {
            0 => f64::INFINITY,
            degrees => self.residual_squares / degrees as f64,
        }
    }

    /// Returns the covariance of two coefficients.
    #[must_use]
    pub fn covariance(&self, one: usize, other: usize) -> f64 {
        let n = self.coefficients.len();
        let rows = self.inverse[one * n..(one + 1) * n].iter().zip(&self.inverse[other * n..]);
        self.residual_variance() * rows.map(|(a, b)| a * b).sum::<f64>()
    }

    /// Returns the standard error of a coefficient.
    #[must_use]
    pub fn standard_error(&self, coefficient: usize) -> f64 {
        self.covariance(coefficient, coefficient).sqrt()
    }

    /// From a coefficient to either end of its 95 % interval.
    #[must_use]
    pub fn confidence_half_width(&self, coefficient: usize) -> f64 {
        t_quantile(0.975, self.degrees_of_freedom() as f64) * self.standard_error(coefficient)
    }

    /// From a smooth function of the coefficients, with this gradient, to either end of its 95 %
    /// interval: to first order.
    #[must_use]
    pub fn half_width_for_gradient(&self, gradient: &[f64]) -> f64 {
        t_quantile(0.975, self.degrees_of_freedom() as f64)
            * (self.residual_variance() * self.leverage(gradient)).sqrt()
    }

    /// h: the own weight of a row in its fitted value; its residual over 1 − h is the one from the
    /// fit to all other rows, exactly.
    #[must_use]
    pub fn leverage(&self, x: &[f64]) -> f64 {
        let n = self.coefficients.len();
        (0..n)
            .map(|column| {
                let z: f64 = (0..=column).map(|row| self.inverse[row * n + column] * x[row]).sum();
                z * z
            })
            .sum()
    }

    /// Returns the fitted value of a row.
    #[must_use]
    pub fn predict(&self, x: &[f64]) -> f64 {
        self.coefficients.iter().zip(x).map(|(coefficient, x)| coefficient * x).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::line::fit_line;

    fn data() -> (Vec<f64>, Vec<f64>) {
        let x = (0..25).map(|i| f64::from(i * i % 17) * 0.7 + 1e4).collect();
        let y = (0..25).map(|i| f64::from(i * 31 % 23) - 4.0).collect();
        (x, y)
    }

    #[test]
    fn two_columns_give_the_line_and_its_held_out_residuals() {
        let (x, y) = data();
        let line = fit_line(&x, &y).expect("spread data");
        let mut triangle = GivensQr::new(2);
        x.iter().zip(&y).for_each(|(&x, &y)| triangle.add_row(&[1.0, x - 1e4], y));
        let solution = triangle.solve().expect("spread data");
        assert!((solution.coefficients[1] - line.gain).abs() < 1e-12);
        let squares: f64 = line.residuals.iter().map(|residual| residual * residual).sum();
        assert!((solution.residual_squares - squares).abs() < 1e-10);
        for (row, held_out) in line.leave_one_out_residuals.iter().enumerate() {
            let at = [1.0, x[row] - 1e4];
            let own = (y[row] - solution.predict(&at)) / (1.0 - solution.leverage(&at));
            assert!((own - held_out).abs() < 1e-10, "row {row}");
        }
    }

    #[test]
    fn the_standard_errors_are_those_of_the_textbook() {
        let (x, y) = data();
        let mut triangle = GivensQr::new(2);
        x.iter().zip(&y).for_each(|(&x, &y)| triangle.add_row(&[1.0, x], y));
        let solution = triangle.solve().expect("spread data");
        let mean = x.iter().sum::<f64>() / 25.0;
        let spread: f64 = x.iter().map(|x| (x - mean).powi(2)).sum();
        let slope = (solution.residual_variance() / spread).sqrt();
        assert!((solution.standard_error(1) / slope - 1.0).abs() < 1e-6);
        let gradient = solution.half_width_for_gradient(&[0.0, 1.0]);
        assert!((gradient / solution.confidence_half_width(1) - 1.0).abs() < 1e-12);
        assert!((solution.confidence_half_width(1) / slope - 2.068_658).abs() < 1e-3);
    }

    #[test]
    fn a_column_that_follows_from_the_others_is_named() {
        let mut triangle = GivensQr::new(3);
        for i in 0..20 {
            let x = f64::from(i);
            triangle.add_row(&[1.0, x, 3.0 - 0.1 * x], x * x);
        }
        assert_eq!(triangle.solve(), Err(DependentColumn { column: 2 }));
        assert_eq!(GivensQr::new(1).solve(), Err(DependentColumn { column: 0 }));
    }
}
