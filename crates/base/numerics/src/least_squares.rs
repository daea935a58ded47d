//! Least squares: linear, nonlinear, and the mixture of both, with intervals.
//!
//! | module | solves |
//! |---|---|
//! | `givens_qr` | y = c₁·x₁ + … + cₚ·xₚ, row by row, in memory of p² |
//! | [`nonlinear`] | y = f(p), by Levenberg-Marquardt, from a start |
//! | [`separable`] | y = c₁·f₁(q) + …: a grid over q, the c by linear least squares inside, then all together |
//! | [`normal_equations`] | y = c₁·x₁ + … + cₚ·xₚ, columns at a time, for searches |
//!
//! All but the last fold the rows one by one into a triangle R by Givens rotations, the QR factorisation
//! of rows that need not be kept: no normal equations, so no square of the condition number, and
//! no matrix with a row for each observation. Intervals are value ± t·√(s²·(RᵀR)⁻¹ⱼⱼ), with t the
//! 97.5 % quantile of Student's distribution and s² the residuals' variance. They take the
//! residuals as independent; where they are correlated, as those of warm machines are, the true
//! intervals are wider.

pub(crate) mod givens_qr;
pub mod nonlinear;
pub mod normal_equations;
pub mod separable;

pub use givens_qr::{DependentColumn, GivensQr, QrSolution};
pub use nonlinear::{Model, NonlinearFit, SolveError, SolverOptions, fit};
pub use separable::{SeparableModel, fit_separable};
