//! Least squares: linear, nonlinear, and the mixture of both, with intervals.
//!
//! | module | solves |
//! |---|---|
//! | [`linear`] | y = c₁·x₁ + … + cₚ·xₚ, row by row, in memory of p² |
//! | [`nonlinear`] | y = f(p), by Levenberg-Marquardt, from a start |
//! | [`separable`] | y = c₁·f₁(q) + …: a grid over q, the c by linear least squares inside, then all together |
//!
//! All of them fold the rows one by one into a triangle R by Givens rotations, the QR factorisation
//! of rows that need not be kept: no normal equations, so no square of the condition number, and
//! no matrix with a row for each observation. Intervals are value ± t·√(s²·(RᵀR)⁻¹ⱼⱼ), with t the
//! 97.5 % quantile of Student's distribution and s² the residuals' variance. They take the
//! residuals as independent; where they are correlated, as those of warm machines are, the true
//! intervals are wider.

pub mod linear;
pub mod nonlinear;
pub mod separable;

pub use linear::{Dependent, Solution, Triangle};
pub use nonlinear::{Fit, Model, Options, SolveError, fit};
pub use separable::{Separable, fit_separable};

use statrs::distribution::{ContinuousCDF, StudentsT};

/// The `probability` quantile of Student's t; infinite without degrees of freedom.
///
/// ```
/// assert!((trueup_fit::solve::t_quantile(0.975, 10.0) - 2.228_138_9).abs() < 1e-6);
/// ```
#[must_use]
pub fn t_quantile(probability: f64, degrees_of_freedom: f64) -> f64 {
    match StudentsT::new(0.0, 1.0, degrees_of_freedom) {
        Ok(t) if degrees_of_freedom > 0.0 => t.inverse_cdf(probability),
        _ => f64::INFINITY,
    }
}
