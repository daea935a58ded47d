//! The change of the prediction with each value of a model.

use trueup_machine::effect::Nonlinear;
use trueup_numerics::parallel::on_all_cores;

use super::problem::Problem;
use crate::{kind::Part, model::Model};

/// Which value of which part a column of the Jacobian belongs to; none: the constant.
pub(crate) type Parameter = Option<(usize, usize)>;

/// Returns the change of the prediction with each value (in groups); logarithmic values by their logarithm.
pub(crate) fn jacobian(problem: &Problem, model: &Model) -> (Vec<Parameter>, Vec<Vec<f64>>) {
    let has_shift = model.has_shift(&problem.data);
    let is_linear = |part: &Part| part.kind.is_added() && !has_shift;
    let here =
        if model.parts.iter().all(is_linear) { Vec::new() } else { problem.predicted(model) };
    let parts: Vec<usize> = (0..model.parts.len()).collect();
    let of = |&index: &usize| {
        if is_linear(&model.parts[index]) {
            of_added(problem, &model.parts[index])
        } else {
            of_any(problem, model, index, &here)
        }
    };
    let all = on_all_cores(&parts, problem.is_large(), of);
    let mut parameters: Vec<Parameter> = Vec::new();
    let mut columns = Vec::new();
    for (index, of_part) in all.into_iter().enumerate() {
        for (number, column) in of_part {
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
pub(crate) fn of_part(problem: &Problem, model: &Model, index: usize) -> Vec<(usize, Vec<f64>)> {
    let part = &model.parts[index];
    if part.kind.is_added() && !model.has_shift(&problem.data) {
        of_added(problem, part)
    } else {
        of_any(problem, model, index, &problem.predicted(model))
    }
}

/// Returns the step of the difference for a value, as the fit counts it, and the value at the step's end.
fn moved(problem: &Problem, part: &Part, number: usize) -> (f64, f64) {
    let value = part.values[number];
    let step = derivative_step(problem, part.kind.nonlinear().get(number), value);
    (step, if part.kind.is_logarithmic(number) { value * step.exp() } else { value + step })
}

/// Returns the same of what is only added: it is its own derivative.
fn of_added(problem: &Problem, part: &Part) -> Vec<(usize, Vec<f64>)> {
    let kind = &part.kind;
    let nonlinear = kind.nonlinear().len();
    let (values, amplitudes) = part.values.split_at(nonlinear);
    let unit = problem.columns(kind, values, nonlinear == 0);
    let mut columns: Vec<(usize, Vec<f64>)> = unit
        .iter()
        .enumerate()
        .map(|(number, column)| (nonlinear + number, column.clone()))
        .collect();
    for number in 0..nonlinear {
        let (step, there) = moved(problem, part, number);
        let mut values = values.to_vec();
        values[number] = there;
        let moved = problem.columns(kind, &values, false);
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
fn of_any(problem: &Problem, model: &Model, index: usize, here: &[f64]) -> Vec<(usize, Vec<f64>)> {
    let values: Vec<usize> = (0..model.parts[index].values.len()).collect();
    on_all_cores(&values, problem.is_large(), |&number| {
        let (step, there) = moved(problem, &model.parts[index], number);
        let mut model = model.clone();
        model.parts[index].values[number] = there;
        let there = problem.predicted(&model);
        (number, there.iter().zip(here).map(|(there, here)| (there - here) / step).collect())
    })
}

fn derivative_step(problem: &Problem, what: Option<&Nonlinear>, value: f64) -> f64 {
    match what {
        Some(Nonlinear::Period | Nonlinear::TimePeriod | Nonlinear::ReadingPeriod) => 1e-7,
        Some(Nonlinear::TimeConstant | Nonlinear::FallingTimeConstant) => 1e-4,
        // Between two rows a temperature is straight: over more of it its noise is less of a slope.
        Some(Nonlinear::Late) => 0.02,
        // Half of a group of rows: within it the noise of the inputs is slope. Of single rows, between
        // which the prediction is straight, a part.
        Some(Nonlinear::Shift) => {
            let rows = match problem.groups.size {
                1 => 0.05,
                size => 0.5 * size as f64,
            };
            rows * problem.bounds.step_s
        }
        Some(Nonlinear::Limit) => {
            1e-4 * (problem.bounds.prediction_um[1] - problem.bounds.prediction_um[0])
        }
        Some(Nonlinear::Origin | Nonlinear::Instant | Nonlinear::Bend) | None => {
            1e-6 * value.abs().max(1e-3)
        }
    }
}
