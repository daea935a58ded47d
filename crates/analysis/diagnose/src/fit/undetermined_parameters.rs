//! Values of tables and splines that the data do not determine.

use trueup_numerics::{least_squares::normal_equations::dot, repeats::DETERMINACY_THRESHOLD};

use super::jacobian::ParameterIndex;
use crate::model::Model;

/// A value of a list that nothing determines, and the one of the same list that stands for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ParameterSubstitution {
    pub part: usize,
    pub value: usize,
    pub by: usize,
}

/// Returns the values of tables and splines that the groups in `mask` do not determine: their columns are
/// hardly ever more than 0, because the axis was hardly ever there. Fitted to the hundredth of a
/// reading such a value would be anything, and wrong by as much where it is needed. The nearest
/// value that is determined stands for it.
pub(super) fn find_parameter_substitutions(
    model: &Model,
    parameters: &[ParameterIndex],
    columns: &[Vec<f64>],
    mask: Option<&[bool]>,
) -> Vec<ParameterSubstitution> {
    let squares = |column: &Vec<f64>| match mask {
        None => dot(column, column),
        Some(mask) => column.iter().zip(mask).filter(|(_, used)| **used).map(|(c, _)| c * c).sum(),
    };
    let mut all = Vec::new();
    for (part, it) in model.parts.iter().enumerate() {
        let Some(length) = it.kind.list_length() else { continue };
        for start in (it.kind.nonlinear_parameters().len()..it.values.len()).step_by(length) {
            let column = |value: usize| {
                let at = parameters.iter().position(|parameter| *parameter == Some((part, value)));
                at.map_or(0.0, |at| squares(&columns[at]))
            };
            let own: Vec<f64> = (start..start + length).map(column).collect();
            let least = DETERMINACY_THRESHOLD * own.iter().copied().fold(0.0, f64::max);
            let is_known = |n: &usize| own[*n] > least;
            for n in (0..own.len()).filter(|n| !is_known(n)) {
                let nearest = (0..own.len()).filter(is_known).min_by_key(|there| there.abs_diff(n));
                if let Some(nearest) = nearest {
                    all.push(ParameterSubstitution { part, value: start + n, by: start + nearest });
                }
            }
        }
    }
    all
}

pub(super) fn apply_parameter_substitutions(model: &mut Model, all: &[ParameterSubstitution]) {
    for it in all {
        let values = &mut model.parts[it.part].values;
        values[it.value] = values[it.by];
    }
}

/// Removes the items of `list` that are not `kept`.
pub(super) fn retain_by_mask<T>(list: &mut Vec<T>, kept: &[bool]) {
    let mut kept = kept.iter();
    list.retain(|_| kept.next().is_some_and(|kept| *kept));
}
