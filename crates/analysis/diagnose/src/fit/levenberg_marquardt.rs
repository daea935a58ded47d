//! The fit of all values of a model: Gauss, Newton, Levenberg and Marquardt.

use trueup_numerics::least_squares::normal_equations::{dot, solve};

use super::{
    jacobian::{ParameterIndex, jacobian},
    problem::FitProblem,
    undetermined_parameters::{
        apply_parameter_substitutions, find_parameter_substitutions, retain_by_mask,
    },
};
use crate::model::Model;

/// A fitted model, and what it leaves.
#[derive(Clone, Debug)]
pub(crate) struct FittedModel {
    pub model: Model,
    /// Measured minus predicted, in groups.
    pub residual: Vec<f64>,
    /// Σ residual² over the groups that were fitted to.
    pub sum: f64,
    /// How many values were fitted.
    pub degrees: usize,
}

impl FittedModel {
    pub(crate) fn rms(&self) -> f64 {
        (dot(&self.residual, &self.residual) / self.residual.len().max(1) as f64).sqrt()
    }
}

/// Fits all values of `model` by least squares over the groups in `mask` (all where there is none).
/// The time of a step is not moved: it is searched, not fitted.
pub(crate) fn fit(problem: &FitProblem, model: &Model, mask: Option<&[bool]>) -> FittedModel {
    match mask {
        None => (*problem.memoise("fit", model, || fit_uncached(problem, model, None))).clone(),
        Some(_) => fit_uncached(problem, model, mask),
    }
}

fn fit_uncached(problem: &FitProblem, model: &Model, mask: Option<&[bool]>) -> FittedModel {
    // From the fit to all, the fit to most is near.
    let iterations = if mask.is_some() { 6 } else { 25 };
    let masked = |residual: &[f64]| match mask {
        None => dot(residual, residual),
        Some(mask) => {
            residual.iter().zip(mask).filter(|(_, used)| **used).map(|(r, _)| r * r).sum()
        }
    };
    let mut model = model.clone();
    problem.constrain_values(&mut model);
    let mut residual = problem.residual(&model);
    let mut sum = masked(&residual);
    let mut damping: f64 = 0.0;
    let is_linear = model.parts.iter().all(|part| {
        let nonlinear = part.kind.nonlinear_parameters().len();
        part.kind.is_additive() && (nonlinear == 0 || part.kind.has_instant())
    });
    let mut degrees = 0;
    for _ in 0..if is_linear { 1 } else { iterations } {
        let (mut parameters, mut columns) = jacobian(problem, &model);
        let substitutes = find_parameter_substitutions(&model, &parameters, &columns, mask);
        if !substitutes.is_empty() {
            apply_parameter_substitutions(&mut model, &substitutes);
            residual = problem.residual(&model);
            sum = masked(&residual);
        }
        let is_fitted = |parameter: &ParameterIndex| {
            parameter.is_none_or(|(part, value)| {
                let is_step = model.parts[part].kind.has_instant() && value == 0;
                !is_step
                    && !substitutes
                        .iter()
                        .any(|substitute| (substitute.part, substitute.value) == (part, value))
            })
        };
        let fitted: Vec<bool> = parameters.iter().map(is_fitted).collect();
        retain_by_mask(&mut parameters, &fitted);
        retain_by_mask(&mut columns, &fitted);
        degrees = parameters.len();
        let mut improved = false;
        for _ in 0..6 {
            let solution = solve(&columns, &residual, mask, damping);
            let mut moved = model.clone();
            for (parameter, change) in parameters.iter().zip(&solution.coefficients) {
                match parameter {
                    None => moved.constant_um = Some(moved.constant_um.unwrap_or(0.0) + change),
                    Some((part, value)) => {
                        let part = &mut moved.parts[*part];
                        let is_log = part.kind.is_log_scaled(*value);
                        let value = &mut part.values[*value];
                        if is_log {
                            // At most by a factor e² at once.
                            *value *= change.clamp(-2.0, 2.0).exp();
                        } else {
                            *value += change;
                        }
                    }
                }
            }
            apply_parameter_substitutions(&mut moved, &substitutes);
            problem.constrain_values(&mut moved);
            let there = problem.residual(&moved);
            let there_sum = masked(&there);
            if there_sum <= sum {
                improved = sum - there_sum > 1e-6 * sum;
                (model, residual, sum) = (moved, there, there_sum);
                damping *= 0.2;
                if damping < 1e-9 {
                    damping = 0.0;
                }
                break;
            }
            damping = if damping == 0.0 { 1e-3 } else { damping * 8.0 };
        }
        if !improved {
            break;
        }
    }
    FittedModel { model, residual, sum, degrees }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use trueup_machine::{
        MachineFile, RunFile,
        effect::BoardTerm,
        machine_file::{LinearAxis, PitchErrorTable, Quantity},
    };

    use super::*;
    use crate::{
        data::{DataTable, RowGroups},
        term_kind::{ModelPart, TermKind},
    };

    #[test]
    fn a_point_of_a_table_where_the_axis_never_was_has_the_value_of_its_neighbour() {
        // Backwards the axis turns at 300 mm, a hundredth of a micrometre beyond it in the file.
        let mut text = String::from("x_mm,dir_x,measured_dx_um\n");
        for noise in [0.2, -0.1, -0.1] {
            for (mm, um) in [(0.0, 1.0), (100.0, 3.0), (200.0, 2.0), (300.0, 5.0), (400.0, 4.0)] {
                text += &format!("{mm},1,{}\n", um + noise);
                if mm < 400.0 {
                    text += &format!("{},-1,{}\n", mm + 1e-5, um + 6.0 - noise);
                }
            }
        }
        let file = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";
        let machine = MachineFile::parse(file, Path::new("m.toml")).expect("a machine file");
        let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
        let data = DataTable::new(&machine, &[run], Quantity::Dx).expect("comparable");
        let groups = RowGroups::new(&data, &data.used.clone(), 1);
        let problem = FitProblem::new(data, groups);
        let table = PitchErrorTable {
            start_mm: 0.0,
            step_mm: 100.0,
            forward_um: vec![0.0; 5],
            reverse_um: Some(vec![0.0; 5]),
        };
        let kind = TermKind::from_board_term(Some(LinearAxis::X), &BoardTerm::Table(table))
            .expect("a table");
        let part = ModelPart { values: vec![0.0; 10], kind };
        let model = Model { parts: vec![part], constant_um: None };
        let values = &fit(&problem, &model, None).model.parts[0].values;
        let exact = [1.0, 3.0, 2.0, 5.0, 4.0, 7.0, 9.0, 8.0, 11.0, 11.0];
        for (value, exact) in values.iter().zip(exact) {
            assert!((value - exact).abs() < 1e-5, "{values:?}");
        }
    }
}
