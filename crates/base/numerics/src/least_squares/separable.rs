//! Models that are linear in most of their parameters: y = c₁·f₁(q) + … + cₚ·fₚ(q).
//!
//! For each q of a grid the best c is found by linear least squares (variable projection), so that
//! only q has to be searched, and no start for c is needed. From the best points of the grid the
//! whole is then solved by [`fit`], q and c together, which also gives the intervals.

use super::{
    givens_qr::{GivensQr, QrSolution},
    nonlinear::{Model, NonlinearFit, SolveError, SolverOptions, fit},
};

/// A model with linear parameters.
pub trait SeparableModel {
    /// Returns the number of the parameters that are not linear, q.
    fn nonlinear_count(&self) -> usize;

    /// Returns the number of those that are, c.
    fn linear_count(&self) -> usize;

    /// f at q: a column for each linear parameter; false where there is no such q.
    fn basis(&self, q: &[f64], columns: &mut [Vec<f64>]) -> bool;

    /// Returns the size of a change that matters in a parameter that is 0, q first, then c.
    fn typical_magnitude(&self, _parameter: usize) -> f64 {
        1.0
    }
}

/// Returns the best c at `q`; `None` where there is no such q or the columns depend on each other.
/// Rows whose measured value is NaN take no part.
#[must_use]
pub(crate) fn solve_linear_parameters(
    model: &(impl SeparableModel + ?Sized),
    q: &[f64],
    measured: &[f64],
    columns: &mut [Vec<f64>],
) -> Option<QrSolution> {
    if !model.basis(q, columns) {
        return None;
    }
    let mut triangle = GivensQr::new(columns.len());
    let mut row_of = vec![0.0; columns.len()];
    for (row, &measured) in measured.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
        row_of.iter_mut().zip(&*columns).for_each(|(at, column)| *at = column[row]);
        if row_of.iter().any(|value| !value.is_finite()) {
            return None;
        }
        triangle.add_row(&row_of, measured);
    }
    triangle.solve().ok()
}

/// Fits `model` to `measured`, its nonlinear parameters searched on the points of `grid` and from
/// there. The parameters of the result are q, then c.
///
/// # Errors
/// See [`SolveError`]; [`SolveError::BadStart`] where no point of the grid has a fit.
pub fn fit_separable(
    model: &(impl SeparableModel + ?Sized),
    measured: &[f64],
    grid: &[Vec<f64>],
    options: &SolverOptions,
) -> Result<NonlinearFit, SolveError> {
    let rows = measured.iter().filter(|value| !value.is_nan()).count();
    let parameters = model.nonlinear_count() + model.linear_count();
    if rows < parameters {
        return Err(SolveError::TooFewRows { rows, parameters });
    }
    let mut columns = vec![vec![0.0; measured.len()]; model.linear_count()];
    let mut starts: Vec<(f64, Vec<f64>)> = grid
        .iter()
        .filter_map(|q| {
            let solution = solve_linear_parameters(model, q, measured, &mut columns)?;
            let start = [q.as_slice(), &solution.coefficients].concat();
            Some((solution.residual_squares, start))
        })
        .collect();
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let joint = JointModel(model);
    let mut best: Option<NonlinearFit> = None;
    let mut failed = SolveError::BadStart;
    for (_, start) in starts.iter().take(options.followed) {
        match fit(&joint, measured, start, options) {
            Ok(fit) if best.as_ref().is_none_or(|b| fit.residual_squares < b.residual_squares) => {
                best = Some(fit);
            }
            Ok(_) => {}
            Err(error) => failed = error,
        }
    }
    best.ok_or(failed)
}

/// q and c as parameters of one model.
struct JointModel<'m, S: ?Sized>(&'m S);

impl<S: SeparableModel + ?Sized> Model for JointModel<'_, S> {
    fn parameter_count(&self) -> usize {
        self.0.nonlinear_count() + self.0.linear_count()
    }

    fn evaluate(&self, parameters: &[f64], values: &mut [f64]) -> bool {
        let (q, c) = parameters.split_at(self.0.nonlinear_count());
        let mut columns = vec![vec![0.0; values.len()]; c.len()];
        self.evaluate_linear_combination(q, c, &mut columns, values)
    }

    /// In c the derivatives are the columns themselves; in q by central differences.
    fn evaluate_derivatives(&self, parameters: &[f64], columns: &mut [Vec<f64>]) -> bool {
        let (q, c) = parameters.split_at(self.0.nonlinear_count());
        let (in_q, in_c) = columns.split_at_mut(q.len());
        let relative = f64::EPSILON.cbrt();
        let mut moved = q.to_vec();
        let mut below = vec![0.0; in_q.first().map_or(0, Vec::len)];
        for (index, column) in in_q.iter_mut().enumerate() {
            let size =
                if q[index] == 0.0 { self.0.typical_magnitude(index) } else { q[index].abs() };
            let (low, high) = (q[index] - relative * size, q[index] + relative * size);
            moved[index] = low;
            if !self.evaluate_linear_combination(&moved, c, in_c, &mut below) {
                return false;
            }
            moved[index] = high;
            if !self.evaluate_linear_combination(&moved, c, in_c, column) {
                return false;
            }
            moved[index] = q[index];
            column.iter_mut().zip(&below).for_each(|(high, low)| {
                *high = (*high - low) / (2.0 * relative * size);
            });
        }
        self.0.basis(q, in_c)
    }

    fn typical_magnitude(&self, parameter: usize) -> f64 {
        self.0.typical_magnitude(parameter)
    }
}

impl<S: SeparableModel + ?Sized> JointModel<'_, S> {
    /// The values c₁·f₁(q) + …; `columns` is space for f.
    fn evaluate_linear_combination(
        &self,
        q: &[f64],
        c: &[f64],
        columns: &mut [Vec<f64>],
        values: &mut [f64],
    ) -> bool {
        if !self.0.basis(q, columns) {
            return false;
        }
        values.fill(0.0);
        for (c, column) in c.iter().zip(&*columns) {
            values.iter_mut().zip(column).for_each(|(value, f)| *value += c * f);
        }
        true
    }
}

/// Points from `least` to `most`, both above 0, each the same factor above the one before.
#[must_use]
pub fn geometric_sequence(least: f64, most: f64, points: usize) -> Vec<f64> {
    let factor = (most / least).ln() / points.saturating_sub(1).max(1) as f64;
    (0..points).map(|point| least * (factor * point as f64).exp()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// c₁ + c₂·e^(−x/q₁) + c₃·e^(−x/q₂)
    struct TwoDecays(Vec<f64>);

    impl SeparableModel for TwoDecays {
        fn nonlinear_count(&self) -> usize {
            2
        }

        fn linear_count(&self) -> usize {
            3
        }

        fn basis(&self, q: &[f64], columns: &mut [Vec<f64>]) -> bool {
            columns[0].fill(1.0);
            for (column, q) in columns[1..].iter_mut().zip(q) {
                column.iter_mut().zip(&self.0).for_each(|(f, x)| *f = (-x / q).exp());
            }
            q.iter().all(|&q| q > 0.0)
        }
    }

    #[test]
    fn two_decays_are_parted_without_a_start_for_their_amplitudes() {
        let x: Vec<f64> = (0..200).map(f64::from).collect();
        let y: Vec<f64> =
            x.iter().map(|x| 3.0 - 8.0 * (-x / 60.0).exp() + 5.0 * (-x / 9.0).exp()).collect();
        let points = geometric_sequence(1.0, 500.0, 12);
        let grid: Vec<Vec<f64>> = points
            .iter()
            .flat_map(|&a| points.iter().filter(move |&&b| b < a).map(move |&b| vec![a, b]))
            .collect();
        let fit =
            fit_separable(&TwoDecays(x), &y, &grid, &SolverOptions::default()).expect("exact data");
        for (value, truth) in fit.parameters.iter().zip([60.0, 9.0, 3.0, -8.0, 5.0]) {
            assert!((value - truth).abs() < 1e-6 * truth.abs(), "{:?}", fit.parameters);
        }
    }

    #[test]
    fn a_geometric_grid_has_both_its_ends() {
        let grid = geometric_sequence(0.1, 1000.0, 5);
        assert_eq!(grid.len(), 5);
        assert!((grid[0] - 0.1).abs() < 1e-15 && (grid[4] - 1000.0).abs() < 1e-9);
    }
}
