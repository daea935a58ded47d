//! How far the fitted values may be off, under noise with a memory.

use nalgebra::DMatrix;
use trueup_numerics::{
    least_squares::normal,
    noise::{self, Noise},
};

use super::{
    jacobian::{Parameter, jacobian},
    problem::Problem,
    solve::Fitted,
    undetermined::{keep_only, substitutes},
};

/// The covariance of the fitted values, under noise of this memory: of logarithmic ones that of the
/// logarithm.
#[derive(Clone, Debug)]
pub(crate) struct Spread {
    /// Without values that nothing determines.
    parameters: Vec<Parameter>,
    covariance: DMatrix<f64>,
    /// Independent rows less the fitted values, at least 3.
    pub freedom: f64,
}

impl Spread {
    /// Returns the row of the covariance in which a part's value stands; none where nothing determines it.
    pub(crate) fn row_of(&self, part: usize, value: usize) -> Option<usize> {
        self.parameters.iter().position(|at| *at == Some((part, value)))
    }

    /// Returns the row of the covariance in which a value of the model stands, or its constant.
    pub(crate) fn place_of(&self, parameter: &Parameter) -> Option<usize> {
        self.parameters.iter().position(|at| at == parameter)
    }

    /// Returns the covariance of two rows.
    pub(crate) fn covariance(&self, one: usize, other: usize) -> f64 {
        self.covariance[(one, other)]
    }
}

/// Returns the sandwich (XᵀX)⁻¹·XᵀVX·(XᵀX)⁻¹ about `fitted`, V the covariance of `noise`.
pub(crate) fn spread(problem: &Problem, fitted: &Fitted, noise: Noise) -> Spread {
    let (mut parameters, mut columns) = jacobian(problem, &fitted.model);
    let substitutes = substitutes(&fitted.model, &parameters, &columns, None);
    let known: Vec<bool> = parameters
        .iter()
        .map(|at| !substitutes.iter().any(|it| *at == Some((it.part, it.value))))
        .collect();
    keep_only(&mut parameters, &known);
    keep_only(&mut columns, &known);
    let steps = &problem.groups.steps;
    let rows = fitted.residual.len() as f64;
    let effective = noise::effective_rows(noise, steps);
    // Noise that is used up by the fit is given back, as much of it as was independent.
    let freedom = (rows - columns.len() as f64).max(1.0);
    let slow_share = (1.0 - noise.white) * columns.len() as f64 / effective.max(1.0);
    let variance = fitted.sum / freedom / (1.0 - slow_share.min(0.5));
    let weighted: Vec<Vec<f64>> =
        columns.iter().map(|column| noise::covariance_times(noise, steps, column)).collect();
    let count = columns.len();
    let middle = DMatrix::from_fn(count, count, |i, j| normal::dot(&columns[i], &weighted[j]));
    let inverse = normal::solve(&columns, &fitted.residual, None, 0.0).inverse();
    let covariance = &inverse * middle * &inverse * variance;
    Spread { parameters, covariance, freedom: (effective - count as f64).max(3.0) }
}
