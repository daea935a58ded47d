//! A page's law over whole columns, apart for each amplitude or summed up, and at one row: the same function.

use std::borrow::Cow;

use super::cause_spec::{CauseSpec, LawInput};

/// No law reads more columns than that.
const MAX_LAW_INPUTS: usize = 4;

/// Where a law's inputs come from.
pub trait ColumnSource {
    /// Returns how many numbers are in each column.
    fn row_count(&self) -> usize;
    /// Returns the column of an input.
    fn column(&self, input: &LawInput<'_>) -> Cow<'_, [f64]>;
}

/// Returns what each amplitude of 1 adds, in µm, row by row: a column an amplitude, or the only one where
/// there is no amplitude.
pub(super) fn unit_effect_columns<P: CauseSpec>(
    page: &P,
    nonlinear: &[f64],
    source: &dyn ColumnSource,
) -> Vec<Vec<f64>> {
    let mut columns = vec![vec![0.0; source.row_count()]; page.amplitude_count().max(1)];
    for_each_unit_effect(page, nonlinear, source, |row, number, um| {
        if let Some(column) = columns.get_mut(number) {
            column[row] += um;
        }
    });
    columns
}

/// Returns what the cause of these values adds, in µm, row by row. An amplitude of 0 adds nothing, whatever its inputs
/// are.
pub(super) fn sum_effects<P: CauseSpec>(
    page: &P,
    values: &[f64],
    source: &dyn ColumnSource,
) -> Vec<f64> {
    let (nonlinear, amplitudes) =
        values.split_at(page.nonlinear_parameters().len().min(values.len()));
    let mut sum_um = vec![0.0; source.row_count()];
    for_each_unit_effect(page, nonlinear, source, |row, number, um| {
        // What has no amplitude is added unscaled.
        let amplitude = amplitudes.get(number).copied().unwrap_or(1.0);
        if amplitude != 0.0 {
            sum_um[row] += amplitude * um;
        }
    });
    sum_um
}

/// Calls `add` with each row, the number of each amplitude, and what that adds there at 1.
fn for_each_unit_effect<P: CauseSpec>(
    page: &P,
    nonlinear: &[f64],
    source: &dyn ColumnSource,
    mut add: impl FnMut(usize, usize, f64),
) {
    let inputs = page.inputs(nonlinear);
    let read: Vec<Cow<'_, [f64]>> = inputs.iter().map(|input| source.column(input)).collect();
    let mut x = [0.0; MAX_LAW_INPUTS];
    for row in 0..source.row_count() {
        for (x, column) in x.iter_mut().zip(&read) {
            *x = column[row];
        }
        page.add_unit_effects(nonlinear, &x[..read.len()], &mut |number, um| add(row, number, um));
    }
}

/// Returns what the cause of these values adds where its inputs are `x`, in µm.
pub(super) fn evaluate_at<P: CauseSpec>(page: &P, values: &[f64], x: &[f64]) -> f64 {
    let (nonlinear, amplitudes) =
        values.split_at(page.nonlinear_parameters().len().min(values.len()));
    let mut sum_um = 0.0;
    page.add_unit_effects(nonlinear, x, &mut |number, um| {
        sum_um += amplitudes.get(number).copied().unwrap_or(1.0) * um;
    });
    sum_um
}
