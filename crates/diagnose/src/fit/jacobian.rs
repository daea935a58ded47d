//! The change of the prediction with each value of a model.

use super::problem::Problem;
use trueup_machine::effect::Nonlinear;

use crate::model::Model;

/// Which value of which part a column of the Jacobian belongs to; none: the constant.
pub(crate) type Parameter = Option<(usize, usize)>;

/// The change of the prediction with each value (in groups); logarithmic values by their logarithm.
pub(crate) fn jacobian(problem: &Problem, model: &Model) -> (Vec<Parameter>, Vec<Vec<f64>>) {
    let mut parameters: Vec<Parameter> = Vec::new();
    let mut columns = Vec::new();
    let mut here: Option<Vec<f64>> = None;
    for index in 0..model.parts.len() {
        for (number, column) in of_part(problem, model, index, &mut here) {
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

/// The change of the prediction with each value of one part of `model`, whose prediction is worked out
/// into `here` if it is needed.
pub(crate) fn of_part(
    problem: &Problem,
    model: &Model,
    index: usize,
    here: &mut Option<Vec<f64>>,
) -> Vec<(usize, Vec<f64>)> {
    let part = &model.parts[index];
    let (kind, nonlinear) = (&part.kind, part.kind.nonlinear());
    let step = |number: usize| {
        let value = part.values[number];
        let step = derivative_step(problem, nonlinear.get(number), value);
        (step, if kind.is_logarithmic(number) { value * step.exp() } else { value + step })
    };
    let mut columns = Vec::new();
    // What is only added is its own derivative.
    if kind.is_added() && !model.has_shift(&problem.data) {
        let (values, amplitudes) = part.values.split_at(nonlinear.len());
        let unit = problem.columns(kind, values, nonlinear.is_empty());
        for (number, column) in unit.iter().enumerate() {
            columns.push((nonlinear.len() + number, column.clone()));
        }
        for number in 0..nonlinear.len() {
            let (step, there) = step(number);
            let mut moved = values.to_vec();
            moved[number] = there;
            let moved = problem.columns(kind, &moved, false);
            let mut column = vec![0.0; problem.groups.len()];
            for ((unit, moved), amplitude) in unit.iter().zip(&*moved).zip(amplitudes) {
                for ((sum, u), m) in column.iter_mut().zip(unit).zip(moved) {
                    *sum += amplitude * (m - u) / step;
                }
            }
            columns.push((number, column));
        }
        return columns;
    }
    for number in 0..part.values.len() {
        let (step, there) = step(number);
        let mut moved = model.clone();
        moved.parts[index].values[number] = there;
        let base = here.get_or_insert_with(|| problem.predicted(model));
        let there = problem.predicted(&moved);
        let column = there.iter().zip(base.iter()).map(|(t, b)| (t - b) / step).collect();
        columns.push((number, column));
    }
    columns
}

fn derivative_step(problem: &Problem, what: Option<&Nonlinear>, value: f64) -> f64 {
    match what {
        Some(Nonlinear::Period | Nonlinear::ReadingPeriod) => 1e-7,
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
        Some(Nonlinear::Origin | Nonlinear::Instant) | None => 1e-6 * value.abs().max(1e-3),
    }
}
