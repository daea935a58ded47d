//! Errors of a prediction, by row.

use trueup_numerics::block_resampling::rms;

use crate::{data::DataTable, fit::FitProblem, model::Model};

/// The errors of the runs without and with what was found.
pub(super) struct Residuals {
    /// The machine file's prediction of each row, in µm.
    pub before: Vec<f64>,
    /// That of the model as it is handed out.
    pub after: Vec<f64>,
    /// Errors of the rows that count, in µm.
    pub before_rows: Vec<f64>,
    /// The same, without those that are excluded as outliers.
    pub after_rows: Vec<f64>,
    /// Groups are means of rows: the mean square that they average away, in µm², is in each row again.
    pub within: f64,
}

impl Residuals {
    pub(super) fn new(
        data: &DataTable,
        problem: &FitProblem,
        model: &Model,
        aside: &[bool],
    ) -> Self {
        let (before, after) = (Model::default().predict(data), model.predict(data));
        let before_rows = remove_zero_offset(data, compute_residuals(data, &before, None));
        let after_rows = remove_zero_offset(data, compute_residuals(data, &after, Some(aside)));
        let within = within_group_mean_square(data, problem, &after, aside);
        Self { before, after, before_rows, after_rows, within }
    }
}

/// Errors of the rows that count, in µm, but for those that are set `aside`.
pub(crate) fn compute_residuals(
    data: &DataTable,
    predicted: &[f64],
    aside: Option<&[bool]>,
) -> Vec<f64> {
    compute_residuals_by_row(data, predicted, aside)
        .into_iter()
        .filter(|error| error.is_finite())
        .collect()
}

/// The error of each row in µm, NaN where one does not count or is set `aside`.
pub(crate) fn compute_residuals_by_row(
    data: &DataTable,
    predicted: &[f64],
    aside: Option<&[bool]>,
) -> Vec<f64> {
    let counts = |row: usize| data.used[row] && aside.is_none_or(|aside| !aside[row]);
    let error = |row: usize| data.measured[row] - predicted[row];
    (0..data.rows).map(|row| if counts(row) { error(row) } else { f64::NAN }).collect()
}

/// Errors of the runs about their mean where the zero of the measurement is arbitrary, as that of an axis
/// is; else as they are.
pub(crate) fn remove_zero_offset(data: &DataTable, mut errors: Vec<f64>) -> Vec<f64> {
    if data.setting.quantity.axis().is_some() {
        let mean = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
        errors.iter_mut().for_each(|error| *error -= mean);
    }
    errors
}

/// Returns the largest of some errors.
pub(crate) fn max_abs_error(errors: &[f64]) -> f64 {
    errors.iter().fold(0.0, |most: f64, error| most.max(error.abs()))
}

/// Mean square of the errors that the groups of a problem average away, in µm².
fn within_group_mean_square(
    data: &DataTable,
    problem: &FitProblem,
    predicted: &[f64],
    aside: &[bool],
) -> f64 {
    if problem.groups.size == 1 {
        // Rows of their own, or a draw of them.
        return 0.0;
    }
    let rows = compute_residuals(data, predicted, Some(aside));
    let residual: Vec<f64> =
        (0..data.rows).map(|row| data.measured[row] - predicted[row]).collect();
    let own = problem.data.whole.as_ref().map(|whole| whole.aggregate_values(&residual));
    let groups = problem.groups.means(&own.unwrap_or(residual));
    (rms(&rows).powi(2) - rms(&groups).powi(2)).max(0.0)
}
