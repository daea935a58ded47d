//! How far the fitted values may be off, under noise with a memory.

use nalgebra::DMatrix;
use trueup_numerics::{
    least_squares::normal_equations,
    noise::{self, NoiseModel},
};

use super::{
    jacobian::{ParameterIndex, jacobian},
    levenberg_marquardt::FittedModel,
    problem::FitProblem,
    undetermined_parameters::{find_parameter_substitutions, retain_by_mask},
};

/// The covariance of the fitted values, under noise of this memory: of logarithmic ones that of the
/// logarithm.
#[derive(Clone, Debug)]
pub(crate) struct ParameterCovariance {
    /// Without values that nothing determines.
    parameters: Vec<ParameterIndex>,
    covariance: DMatrix<f64>,
    /// Independent rows less the fitted values, at least 3.
    pub freedom: f64,
}

impl ParameterCovariance {
    /// Returns the row of the covariance in which a part's value stands; none where nothing determines it.
    pub(crate) fn value_row(&self, part: usize, value: usize) -> Option<usize> {
        self.parameters.iter().position(|at| *at == Some((part, value)))
    }

    /// Returns the row of the covariance in which a value of the model stands, or its constant.
    pub(crate) fn parameter_row(&self, parameter: &ParameterIndex) -> Option<usize> {
        self.parameters.iter().position(|at| at == parameter)
    }

    /// Returns the covariance of two rows.
    pub(crate) fn covariance(&self, one: usize, other: usize) -> f64 {
        self.covariance[(one, other)]
    }
}

/// Returns the sandwich (XᵀX)⁻¹·XᵀVX·(XᵀX)⁻¹ about `fitted`, V the covariance of `noise`.
pub(crate) fn estimate_parameter_covariance(
    problem: &FitProblem,
    fitted: &FittedModel,
    noise: NoiseModel,
) -> ParameterCovariance {
    let (mut parameters, mut columns) = jacobian(problem, &fitted.model);
    let substitutes = find_parameter_substitutions(&fitted.model, &parameters, &columns, None);
    let known: Vec<bool> = parameters
        .iter()
        .map(|at| {
            !substitutes.iter().any(|substitute| *at == Some((substitute.part, substitute.value)))
        })
        .collect();
    retain_by_mask(&mut parameters, &known);
    retain_by_mask(&mut columns, &known);
    let steps = &problem.groups.steps;
    let rows = fitted.residual.len() as f64;
    let effective = noise::effective_sample_size(noise, steps);
    // Noise that is used up by the fit is given back, as much of it as was independent.
    let freedom = (rows - columns.len() as f64).max(1.0);
    let slow_share = (1.0 - noise.white) * columns.len() as f64 / effective.max(1.0);
    let variance = fitted.sum / freedom / (1.0 - slow_share.min(0.5));
    let weighted: Vec<Vec<f64>> =
        columns.iter().map(|column| noise::multiply_by_covariance(noise, steps, column)).collect();
    let count = columns.len();
    let middle =
        DMatrix::from_fn(count, count, |i, j| normal_equations::dot(&columns[i], &weighted[j]));
    let inverse =
        normal_equations::solve(&columns, &fitted.residual, None, 0.0).unscaled_covariance();
    let covariance = &inverse * middle * &inverse * variance;
    ParameterCovariance { parameters, covariance, freedom: (effective - count as f64).max(3.0) }
}
