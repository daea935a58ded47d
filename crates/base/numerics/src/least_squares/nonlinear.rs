//! Nonlinear least squares by Levenberg-Marquardt.
//!
//! The crate `levenberg-marquardt` (MINPACK's algorithm: trust region, scaled variables) does the
//! steps. It is given neither the residuals nor the Jacobian but the triangle of both, into which
//! the rows are folded one by one: it has the same norm, the same gradient and the same JᵀJ, and
//! p + 1 rows however many observations there are.
//!
//! Proved on the NIST sets of certified nonlinear regression, each from its hard start, to at least
//! 6 digits in every parameter (`tests/nist.rs` prints them).

use std::{cell::RefCell, rc::Rc};

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt, TerminationReason};
use nalgebra::{DMatrix, DVector, Dyn, storage::Owned};

use super::givens_qr::{DependentColumn, GivensQr, QrSolution};

/// A model of a column of measured values.
pub trait Model {
    /// Returns the number of parameters.
    fn parameter_count(&self) -> usize;

    /// The model's value for each row at these parameters; false where it has none (a negative
    /// time constant), which the solver takes as a step too far.
    fn evaluate(&self, parameters: &[f64], values: &mut [f64]) -> bool;

    /// The derivative of each row's value, one column for each parameter; false as above. Unless
    /// it is given: by central differences.
    fn evaluate_derivatives(&self, parameters: &[f64], columns: &mut [Vec<f64>]) -> bool {
        evaluate_central_differences(self, parameters, columns)
    }

    /// Returns the size of a change that matters in a parameter that is 0: for the step of the differences.
    fn typical_magnitude(&self, _parameter: usize) -> f64 {
        1.0
    }
}

/// (f(p + h) − f(p − h))/2h in each parameter, h the cube root of the machine's precision, relative:
/// there truncation and rounding are both about 1e-10.
pub(crate) fn evaluate_central_differences<M: Model + ?Sized>(
    model: &M,
    parameters: &[f64],
    columns: &mut [Vec<f64>],
) -> bool {
    let relative = f64::EPSILON.cbrt();
    let mut moved = parameters.to_vec();
    let mut below = vec![0.0; columns.first().map_or(0, Vec::len)];
    for (index, column) in columns.iter_mut().enumerate() {
        let parameter = parameters[index];
        let size = if parameter == 0.0 { model.typical_magnitude(index) } else { parameter.abs() };
        let (low, high) = (parameter - relative * size, parameter + relative * size);
        moved[index] = low;
        if !model.evaluate(&moved, &mut below) {
            return false;
        }
        moved[index] = high;
        if !model.evaluate(&moved, column) {
            return false;
        }
        moved[index] = parameter;
        let width = high - low;
        column.iter_mut().zip(&below).for_each(|(high, low)| *high = (*high - low) / width);
    }
    true
}

/// How to solve.
#[derive(Clone, Debug)]
pub struct SolverOptions {
    /// Steps that are allowed, for each parameter.
    pub patience: usize,
    /// The first step is at most this many times the start, tried in turn. The best end is taken: a
    /// long first step finds more from far away, a short one does not leave the start's valley.
    pub first_steps: Vec<f64>,
    /// The best points of a grid that are followed to their end.
    pub followed: usize,
    /// The relative change of the sum of squares and of the parameters at which it ends.
    pub tolerance: f64,
}

impl Default for SolverOptions {
    fn default() -> Self {
        Self { patience: 500, first_steps: vec![100.0, 1.0, 0.01], followed: 4, tolerance: 1e-14 }
    }
}

/// Why there is no fit.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SolveError {
    /// Fewer rows than parameters.
    #[error("{rows} rows cannot decide {parameters} parameters")]
    TooFewRows {
        /// Rows with a measured value.
        rows: usize,
        /// Parameters to be fitted.
        parameters: usize,
    },
    /// The model has no value, or an infinite one, at the start.
    #[error("the model has no value at the start")]
    BadStart,
    /// No start led to a minimum.
    #[error("no minimum was found: {reason}")]
    NotConverged {
        /// The reason why the last of them ended.
        reason: String,
    },
}

/// The result of a fit.
#[derive(Clone, Debug)]
pub struct NonlinearFit {
    /// The fitted parameters, in the order and the units of the model.
    pub parameters: Vec<f64>,
    /// Measured minus model, by row; NaN where there is no measured value.
    pub residuals: Vec<f64>,
    /// The model's derivatives at the minimum, a column for each parameter.
    pub derivatives: Vec<Vec<f64>>,
    /// The model as a linear one about the minimum: intervals come from it.
    ///
    /// # Errors
    /// The rows do not decide the parameter: it could be anything.
    pub linear: Result<QrSolution, DependentColumn>,
    /// The sum of the squares of the residuals.
    pub residual_squares: f64,
}

impl NonlinearFit {
    /// From a parameter to either end of its 95 % interval; infinite where the rows do not decide
    /// all parameters.
    #[must_use]
    pub fn confidence_half_width(&self, parameter: usize) -> f64 {
        self.linear.as_ref().map_or(f64::INFINITY, |linear| linear.confidence_half_width(parameter))
    }

    /// Returns each row's residual from the fit to all other rows, to first order; NaN where there is no
    /// measured value.
    #[must_use]
    pub fn leave_one_out_residuals(&self) -> Vec<f64> {
        let Ok(linear) = &self.linear else { return vec![f64::NAN; self.residuals.len()] };
        let mut at = vec![0.0; self.parameters.len()];
        let held_out = |(row, residual): (usize, &f64)| {
            at.iter_mut().zip(&self.derivatives).for_each(|(at, column)| *at = column[row]);
            residual / (1.0 - linear.leverage(&at)).max(f64::EPSILON)
        };
        self.residuals.iter().enumerate().map(held_out).collect()
    }
}

/// Fits `model` to `measured` from `start`. Rows whose measured value is NaN take no part.
///
/// # Errors
/// See [`SolveError`].
///
/// # Panics
/// `start` has not as many values as the model has parameters.
pub fn fit(
    model: &(impl Model + ?Sized),
    measured: &[f64],
    start: &[f64],
    options: &SolverOptions,
) -> Result<NonlinearFit, SolveError> {
    let parameters = model.parameter_count();
    assert_eq!(start.len(), parameters, "a start has as many values as the model has parameters");
    let rows = measured.iter().filter(|value| !value.is_nan()).count();
    if rows < parameters {
        return Err(SolveError::TooFewRows { rows, parameters });
    }
    let folded = SolverProblem::new(model, measured, start);
    if folded.jacobian_qr(start).is_none() {
        return Err(SolveError::BadStart);
    }
    let mut best: Option<(f64, Vec<f64>)> = None;
    let mut reason = String::new();
    for &first_step in &options.first_steps {
        let solver = LevenbergMarquardt::new()
            .with_patience(options.patience)
            .with_stepbound(first_step)
            .with_ftol(options.tolerance)
            .with_xtol(options.tolerance)
            .with_gtol(options.tolerance);
        let (end, report) = solver.minimize(folded.with_parameters(start));
        let squares = 2.0 * report.objective_function;
        match report.termination {
            // Rounding keeps it from the tolerance that was requested: as good as it gets.
            TerminationReason::NoImprovementPossible(_) => {}
            ref ended if ended.was_successful() => {}
            ended => {
                reason = format!("{ended:?}");
                continue;
            }
        }
        // Equal but for rounding is not better: the first stays.
        let is_better = best.as_ref().is_none_or(|(least, _)| squares < least * (1.0 - 1e-9));
        if squares.is_finite() && is_better {
            best = Some((squares, end.parameters));
        }
    }
    let Some((_, parameters)) = best else { return Err(SolveError::NotConverged { reason }) };
    let polished = folded.refine_by_gauss_newton(parameters);
    Ok(folded.finish(polished))
}

/// Buffers, a value for each row: the model's values, and its derivatives by parameter.
type SolverWorkspace = (Vec<f64>, Vec<Vec<f64>>);

/// The problem as the solver sees it.
struct SolverProblem<'a, M: Model + ?Sized> {
    model: &'a M,
    measured: &'a [f64],
    parameters: Vec<f64>,
    space: Rc<RefCell<SolverWorkspace>>,
}

impl<'a, M: Model + ?Sized> SolverProblem<'a, M> {
    fn new(model: &'a M, measured: &'a [f64], start: &[f64]) -> Self {
        let column = vec![0.0; measured.len()];
        let columns = vec![column.clone(); start.len()];
        let space = Rc::new(RefCell::new((column, columns)));
        Self { model, measured, parameters: start.to_vec(), space }
    }

    fn with_parameters(&self, start: &[f64]) -> Self {
        let space = Rc::clone(&self.space);
        SolverProblem {
            model: self.model,
            measured: self.measured,
            parameters: start.to_vec(),
            space,
        }
    }

    /// Returns the triangle of derivatives and residuals (measured minus model) at `parameters`; `None`
    /// where the model has no finite value.
    fn jacobian_qr(&self, parameters: &[f64]) -> Option<GivensQr> {
        let mut space = self.space.borrow_mut();
        let (values, columns) = &mut *space;
        if !self.model.evaluate(parameters, values)
            || !self.model.evaluate_derivatives(parameters, columns)
        {
            return None;
        }
        let mut triangle = GivensQr::new(parameters.len());
        let mut row_of = vec![0.0; parameters.len()];
        for (row, (&measured, &value)) in self.measured.iter().zip(&*values).enumerate() {
            if measured.is_nan() {
                continue;
            }
            row_of.iter_mut().zip(&*columns).for_each(|(at, column)| *at = column[row]);
            if !value.is_finite() || row_of.iter().any(|derivative| !derivative.is_finite()) {
                return None;
            }
            triangle.add_row(&row_of, measured - value);
        }
        Some(triangle)
    }

    /// Returns a few steps of Gauss and Newton from the minimum. The solver ends where the sum of squares
    /// moves no more, which is half the digits that the parameters could have: there the sum is
    /// flat.
    fn refine_by_gauss_newton(&self, mut parameters: Vec<f64>) -> Vec<f64> {
        const MAX_ITERATIONS: usize = 30;
        let Some(mut triangle) = self.jacobian_qr(&parameters) else { return parameters };
        let mut longest = f64::INFINITY;
        for _ in 0..MAX_ITERATIONS {
            let Ok(step) = triangle.solve() else { break };
            // In units of the parameters' standard errors, so that each step can be compared.
            let length = (0..parameters.len())
                .map(|at| (step.coefficients[at] / step.standard_error(at)).abs())
                .fold(0.0, f64::max);
            // Steps that no longer shrink are rounding. Where the residuals are large they shrink by
            // less than half at a time.
            if !(length < 0.95 * longest && length < 1e-2) {
                break;
            }
            longest = length;
            let moved: Vec<f64> =
                parameters.iter().zip(&step.coefficients).map(|(p, step)| p + step).collect();
            let Some(there) = self.jacobian_qr(&moved) else { break };
            (parameters, triangle) = (moved, there);
        }
        parameters
    }

    fn finish(self, parameters: Vec<f64>) -> NonlinearFit {
        let linear = match self.jacobian_qr(&parameters) {
            Some(triangle) => triangle.solve(),
            None => Err(DependentColumn { column: 0 }),
        };
        let mut space = self.space.borrow_mut();
        let (values, columns) = std::mem::take(&mut *space);
        let residuals: Vec<f64> =
            self.measured.iter().zip(values).map(|(measured, value)| measured - value).collect();
        let present = residuals.iter().filter(|residual| !residual.is_nan());
        let residual_squares = present.map(|residual| residual * residual).sum();
        NonlinearFit { parameters, residuals, derivatives: columns, linear, residual_squares }
    }
}

impl<M: Model + ?Sized> LeastSquaresProblem<f64, Dyn, Dyn> for SolverProblem<'_, M> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, parameters: &DVector<f64>) {
        self.parameters = parameters.as_slice().to_vec();
    }

    fn params(&self) -> DVector<f64> {
        DVector::from_vec(self.parameters.clone())
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let n = self.parameters.len();
        let triangle = self.jacobian_qr(&self.parameters);
        Some(match triangle {
            Some(triangle) => DVector::from_fn(n + 1, |row, _| {
                if row < n { triangle.element(row, n) } else { triangle.residual_norm() }
            }),
            // Larger than any sum that is left: the step is taken back, and a shorter one tried.
            None => DVector::from_element(n + 1, 1e150),
        })
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let n = self.parameters.len();
        let triangle = self.jacobian_qr(&self.parameters)?;
        // Residuals fall as the model's values rise.
        Some(DMatrix::from_fn(
            n + 1,
            n,
            |row, column| {
                if row < n { -triangle.element(row, column) } else { 0.0 }
            },
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// y = a·e^(−x/τ), τ above 0.
    struct Decay(Vec<f64>);

    impl Model for Decay {
        fn parameter_count(&self) -> usize {
            2
        }

        fn evaluate(&self, parameters: &[f64], values: &mut [f64]) -> bool {
            values
                .iter_mut()
                .zip(&self.0)
                .for_each(|(y, x)| *y = parameters[0] * (-x / parameters[1]).exp());
            parameters[1] > 0.0
        }
    }

    fn decay() -> (Decay, Vec<f64>) {
        let x: Vec<f64> = (0..60).map(f64::from).collect();
        let y = x.iter().map(|x| 7.0 * (-x / 12.5).exp()).collect();
        (Decay(x), y)
    }

    #[test]
    fn a_curve_without_noise_is_found_from_afar() {
        let (model, mut y) = decay();
        y[3] = f64::NAN;
        let fit = fit(&model, &y, &[1.0, 100.0], &SolverOptions::default()).expect("a plain curve");
        assert!((fit.parameters[0] - 7.0).abs() < 1e-8 && (fit.parameters[1] - 12.5).abs() < 1e-7);
        assert!(fit.residuals[3].is_nan() && fit.residual_squares < 1e-15);
    }

    #[test]
    fn central_differences_are_good_to_nine_digits() {
        let (model, y) = decay();
        let mut columns = vec![vec![0.0; y.len()]; 2];
        assert!(evaluate_central_differences(&model, &[7.0, 12.5], &mut columns));
        for (row, x) in model.0.iter().enumerate() {
            let e = (-x / 12.5).exp();
            assert!((columns[0][row] - e).abs() < 1e-9);
            assert!((columns[1][row] - 7.0 * e * x / 12.5 / 12.5).abs() < 1e-9);
        }
    }

    #[test]
    fn what_cannot_be_fitted_is_refused() {
        let (model, y) = decay();
        let bad = fit(&model, &y, &[1.0, -1.0], &SolverOptions::default()).expect_err("no value");
        assert_eq!(bad, SolveError::BadStart);
        let few = fit(&Decay(vec![1.0]), &[1.0], &[1.0, 1.0], &SolverOptions::default());
        let few = few.expect_err("one row").to_string();
        assert_eq!(few, "1 rows cannot decide 2 parameters");
    }

    #[test]
    fn the_held_out_residuals_are_those_of_fitting_again() {
        let (model, mut y) = decay();
        let noise = |row: usize| ((row * 7919 % 101) as f64 / 101.0 - 0.5) * 0.1;
        y.iter_mut().enumerate().for_each(|(row, y)| *y += noise(row));
        let whole =
            fit(&model, &y, &[5.0, 10.0], &SolverOptions::default()).expect("a plain curve");
        for row in [0, 5, 30] {
            let mut rest = y.clone();
            rest[row] = f64::NAN;
            let refit =
                fit(&model, &rest, &[5.0, 10.0], &SolverOptions::default()).expect("a curve");
            let mut values = vec![0.0; y.len()];
            assert!(model.evaluate(&refit.parameters, &mut values));
            let difference = (y[row] - values[row]) - whole.leave_one_out_residuals()[row];
            assert!(difference.abs() < 5e-4, "row {row}: {difference:e}");
        }
    }
}
