//! The change of the prediction with each value of a model.

use trueup_machine::effect::NonlinearParameter;
use trueup_numerics::parallel::parallel_map;

use super::problem::FitProblem;
use crate::{model::Model, term_kind::ModelPart};

/// Which value of which part a column of the Jacobian belongs to; none: the constant.
pub(crate) type ParameterIndex = Option<(usize, usize)>;

/// Returns the change of the prediction with each value (in groups); logarithmic values by their logarithm.
pub(crate) fn jacobian(
    problem: &FitProblem,
    model: &Model,
) -> (Vec<ParameterIndex>, Vec<Vec<f64>>) {
    let has_shift = model.has_time_shift(&problem.data);
    let is_linear = |part: &ModelPart| part.kind.is_additive() && !has_shift;
    let here = if model.parts.iter().all(is_linear) { Vec::new() } else { problem.predict(model) };
    let parts: Vec<usize> = (0..model.parts.len()).collect();
    let of = |&index: &usize| {
        if is_linear(&model.parts[index]) {
            additive_part_derivatives(problem, &model.parts[index])
        } else {
            finite_difference_derivatives(problem, model, index, &here)
        }
    };
    let all = parallel_map(&parts, problem.is_parallel_worthwhile(), of);
    let mut parameters: Vec<ParameterIndex> = Vec::new();
    let mut columns = Vec::new();
    for (index, part_derivatives) in all.into_iter().enumerate() {
        for (number, column) in part_derivatives {
            parameters.push(Some((index, number)));
            columns.push(column);
        }
    }
    if model.constant_um.is_some() {
        parameters.push(None);
        columns.push(vec![1.0; problem.groups.len()]);
    }
    (parameters, columns)
}

/// Returns the change of the prediction with each value of one part of `model`.
pub(crate) fn part_derivatives(
    problem: &FitProblem,
    model: &Model,
    index: usize,
) -> Vec<(usize, Vec<f64>)> {
    let part = &model.parts[index];
    if part.kind.is_additive() && !model.has_time_shift(&problem.data) {
        additive_part_derivatives(problem, part)
    } else {
        finite_difference_derivatives(problem, model, index, &problem.predict(model))
    }
}

/// Returns the step of the difference for a value, as the fit counts it, and the value at the step's end.
fn step_and_perturbed_value(problem: &FitProblem, part: &ModelPart, number: usize) -> (f64, f64) {
    let value = part.values[number];
    let step = derivative_step(problem, part.kind.nonlinear_parameters().get(number), value);
    (step, if part.kind.is_log_scaled(number) { value * step.exp() } else { value + step })
}

/// Returns the same of what is only added: it is its own derivative.
fn additive_part_derivatives(problem: &FitProblem, part: &ModelPart) -> Vec<(usize, Vec<f64>)> {
    let kind = &part.kind;
    let nonlinear = kind.nonlinear_parameters().len();
    let (values, amplitudes) = part.values.split_at(nonlinear);
    let unit = problem.basis_columns(kind, values, nonlinear == 0);
    let mut columns: Vec<(usize, Vec<f64>)> = unit
        .iter()
        .enumerate()
        .map(|(number, column)| (nonlinear + number, column.clone()))
        .collect();
    for number in 0..nonlinear {
        let (step, there) = step_and_perturbed_value(problem, part, number);
        let mut values = values.to_vec();
        values[number] = there;
        let moved = problem.basis_columns(kind, &values, false);
        let mut column = vec![0.0; problem.groups.len()];
        for ((unit, moved), amplitude) in unit.iter().zip(&*moved).zip(amplitudes) {
            for ((sum, u), m) in column.iter_mut().zip(unit).zip(moved) {
                *sum += amplitude * (m - u) / step;
            }
        }
        columns.push((number, column));
    }
    columns
}

/// Returns the same of any part of `model`, which predicts `here`.
fn finite_difference_derivatives(
    problem: &FitProblem,
    model: &Model,
    index: usize,
    here: &[f64],
) -> Vec<(usize, Vec<f64>)> {
    let values: Vec<usize> = (0..model.parts[index].values.len()).collect();
    parallel_map(&values, problem.is_parallel_worthwhile(), |&number| {
        let (step, there) = step_and_perturbed_value(problem, &model.parts[index], number);
        let mut model = model.clone();
        model.parts[index].values[number] = there;
        let there = problem.predict(&model);
        (number, there.iter().zip(here).map(|(there, here)| (there - here) / step).collect())
    })
}

fn derivative_step(problem: &FitProblem, what: Option<&NonlinearParameter>, value: f64) -> f64 {
    match what {
        Some(
            NonlinearParameter::Period
            | NonlinearParameter::TimePeriod
            | NonlinearParameter::ReadingPeriod,
        ) => 1e-7,
        Some(NonlinearParameter::TimeConstant | NonlinearParameter::FallingTimeConstant) => 1e-4,
        // Between two rows a temperature is straight: over more of it its noise is less of a slope.
        Some(NonlinearParameter::ThermometerDelay) => 0.02,
        // Half of a group of rows: within it the noise of the inputs is slope. Of single rows, between
        // which the prediction is straight, a part.
        Some(NonlinearParameter::Shift) => {
            let rows = match problem.groups.size {
                1 => 0.05,
                size => 0.5 * size as f64,
            };
            rows * problem.bounds.step_s
        }
        Some(NonlinearParameter::Limit) => {
            1e-4 * (problem.bounds.prediction_um[1] - problem.bounds.prediction_um[0])
        }
        Some(
            NonlinearParameter::Origin | NonlinearParameter::Instant | NonlinearParameter::Bend,
        )
        | None => 1e-6 * value.abs().max(1e-3),
    }
}
