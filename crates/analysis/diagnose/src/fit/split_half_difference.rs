//! Whether a value is the same in both halves of a record.

use nalgebra::DMatrix;
use trueup_numerics::{
    least_squares::normal_equations,
    noise::{self, NoiseModel},
    t_quantile,
};

use super::{
    CONFIDENCE_LEVEL, jacobian::jacobian, levenberg_marquardt::FittedModel, problem::FitProblem,
};

/// Returns the value of part number `part` of `fitted` that differs most between the groups of the second half
/// and the others, in each; none where no value differs by more than its 95 % intervals in the two halves,
/// which then lie apart:
///
/// ```text
/// r = J·b + J_p·1[second half]·δ        |δ| > √2·t·σ(δ),  t at 1 − 0.025/k
/// ```
///
/// σ by the sandwich under `noise`, everything else fitted to both halves; k values in all (Bonferroni):
/// of many values some differ by chance.
pub(crate) fn find_largest_half_difference(
    problem: &FitProblem,
    fitted: &FittedModel,
    part: usize,
    noise: NoiseModel,
    is_second: &[bool],
) -> Option<[f64; 2]> {
    let (parameters, columns) = jacobian(problem, &fitted.model);
    let steps = &problem.groups.steps;
    let kind = &fitted.model.parts[part].kind;
    let share = is_second.iter().filter(|second| **second).count() as f64 / is_second.len() as f64;
    let level = 1.0 - 0.5 * (1.0 - CONFIDENCE_LEVEL) / parameters.len().max(1) as f64;
    let mut most: Option<(f64, [f64; 2])> = None;
    for (at, column) in parameters.iter().zip(&columns) {
        let Some((_, value)) = at.filter(|(of, _)| *of == part) else { continue };
        let mut all = columns.clone();
        all.push(
            column
                .iter()
                .zip(is_second)
                .map(|(c, second)| if *second { *c } else { 0.0 })
                .collect(),
        );
        let count = all.len();
        let solved = normal_equations::solve(&all, &fitted.residual, None, 0.0);
        let difference = solved.coefficients[count - 1];
        let weighted: Vec<Vec<f64>> =
            all.iter().map(|column| noise::multiply_by_covariance(noise, steps, column)).collect();
        let middle =
            DMatrix::from_fn(count, count, |i, j| normal_equations::dot(&all[i], &weighted[j]));
        let inverse = solved.unscaled_covariance();
        let freedom = (noise::effective_sample_size(noise, steps) - count as f64).max(3.0);
        let left = (fitted.residual.len() as f64 - count as f64).max(1.0);
        let variance = (&inverse * middle * &inverse)[(count - 1, count - 1)] * fitted.sum / left;
        let limit = std::f64::consts::SQRT_2 * t_quantile(level, freedom) * variance.sqrt();
        if difference.abs() > limit
            && most.is_none_or(|(ratio, _)| difference.abs() / limit > ratio)
        {
            let centre = fitted.model.parts[part].values[value];
            let of = |change: f64| {
                if kind.is_log_scaled(value) { centre * change.exp() } else { centre + change }
            };
            let halves = [of(-share * difference), of((1.0 - share) * difference)];
            most = Some((difference.abs() / limit, halves));
        }
    }
    most.map(|(_, halves)| halves)
}
