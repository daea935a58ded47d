//! The promise of an answer: the error at the tool on a day, with the current and with the extended file on the
//! board.
//!
//! A reading holds the noise of the gauge, the tool does not; and another day needs more or less of what
//! was found. So the promise is reckoned from the inputs of the day that it is for (temperatures, speeds,
//! positions; its readings are not looked at), and from nothing that this day will show:
//!
//! ```text
//! left²   = mean gᵀ·C·g      the values are not known better    (g: change by each value on that day, C: their covariance)
//!         + mean δ²          the inputs are noisy, and the board passes that on (δ: what their noise changes)
//!         + u²               what wanders slowly and depends on no input, where the first record shows that; what the
//!                            machine does that is explained and the board does not run (a drift, a jump)
//! before² = mean c² + left²  c: what the extended file corrects more than the current file
//! ```
//!
//! The zero of an axis's measurement is arbitrary and does not count. Errors that are not the machine's are not
//! predicted: a promise is for what the board corrects.

use std::sync::Arc;

use nalgebra::DMatrix;
use trueup_machine::{InputFileError, RunFile, machine_file::is_temperature_column};
use trueup_numerics::{parallel::parallel_join, random::RandomGenerator, robust::median};

use crate::{
    data::{DataTable, RowGroups},
    diagnosis::{
        report::{ErrorAtTool, ErrorReduction},
        residuals::remove_zero_offset,
        slow_drift::has_slow_drift,
    },
    fit::{FitProblem, FittedModel, ParameterCovariance, estimate_parameter_covariance, jacobian},
    model::Model,
    search::SearchOutcome,
};

/// This many rows of a day are looked at, and noise is drawn into as many: a mean square of as many that are independent is
/// known to 1 %.
const MAX_EVALUATED_ROWS: usize = 20_000;

/// The model that a promise is computed from, and its uncertainty.
#[derive(Clone, Debug)]
pub(crate) struct ErrorPredictor {
    /// As the board runs it.
    model: Model,
    /// How well its values are known.
    spread: ParameterCovariance,
    /// Mean square of what stays whatever is corrected, in µm²: what wanders, and what is explained and not run.
    stays: f64,
}

impl ErrorPredictor {
    /// Of `compensated`, the model as the board runs it on `problem`; `not_run`: the mean square of what the
    /// machine does that is explained and the board does not run, in µm².
    pub(super) fn new(
        problem: &FitProblem,
        found: &SearchOutcome,
        compensated: &Model,
        not_run: f64,
    ) -> Self {
        let residual = problem.residual(compensated);
        let sum = residual.iter().map(|r| r * r).sum();
        let fitted = FittedModel {
            model: compensated.clone(),
            residual,
            sum,
            degrees: found.fitted.degrees,
        };
        let rows = found.fitted.residual.len() as f64;
        let variance = found.fitted.sum / (rows - found.fitted.degrees as f64).max(1.0);
        Self {
            model: compensated.clone(),
            spread: estimate_parameter_covariance(problem, &fitted, found.noise),
            stays: not_run
                + if has_slow_drift(problem, found) {
                    (1.0 - found.noise.white) * variance
                } else {
                    0.0
                },
        }
    }

    /// On the days of `runs`; `training`: the data of the fit.
    ///
    /// # Errors
    /// A column is missing.
    pub(crate) fn predict_error(
        &self,
        training: &DataTable,
        runs: &[RunFile],
    ) -> Result<ErrorAtTool, InputFileError> {
        self.predict_error_on_table(&Arc::new(build_evaluation_data(training, runs)?), runs, None)
    }

    /// Returns the error on the days of `runs`, which are in `table`; never less than `held_out` parts gave.
    ///
    /// # Errors
    /// A column is missing.
    pub(super) fn predict_error_on_table(
        &self,
        table: &Arc<DataTable>,
        runs: &[RunFile],
        held_out: Option<ErrorReduction>,
    ) -> Result<ErrorAtTool, InputFileError> {
        let step = table.rows.div_ceil(MAX_EVALUATED_ROWS);
        let data = if step > 1 {
            let mask: Vec<bool> = (0..table.rows).map(|row| row % step == 0).collect();
            Arc::new(table.subset(&mask))
        } else {
            table.clone()
        };
        let [believed, extended] =
            [&Model::default(), &self.model].map(|model| model.predict(&data));
        let corrected = mean_square(&data, &subtract(&extended, &believed));
        let is_axis = data.setting.quantity.axis().is_some();
        let values = || {
            let groups = RowGroups::new(&data, &data.used, 1);
            self.spread.mean_prediction_variance(
                &FitProblem::new(data.clone(), groups),
                &self.model,
                is_axis,
            )
        };
        let (values, noise) = parallel_join(values, || self.input_noise_mean_squares(table, runs));
        let noise = noise?;
        let left = values + noise[1] + self.stays;
        let before = corrected + values + noise[0] + self.stays;
        let mut error = ErrorAtTool::new(before.sqrt(), left.sqrt());
        held_out.into_iter().for_each(|errors| error.apply_held_out_bounds(errors));
        Ok(error)
    }

    /// Mean square of what the noise of the inputs changes, in µm²: with the current file, and extended. It is
    /// the same all day, and is drawn for the first rows of each run alone.
    fn input_noise_mean_squares(
        &self,
        table: &DataTable,
        runs: &[RunFile],
    ) -> Result<[f64; 2], InputFileError> {
        let most = MAX_EVALUATED_ROWS.div_ceil(runs.len());
        // Where it was read does not matter.
        let read = |name: &str, values: &mut [f64]| {
            if name.starts_with("measured_") {
                values.fill(0.0);
            }
        };
        let first: Vec<RunFile> =
            runs.iter().map(|run| run.with_altered_values(most, read)).collect();
        let data = build_evaluation_data(table, &first)?;
        let models = [&Model::default(), &self.model];
        let as_it_was = models.map(|model| model.predict(&data));
        let draws = MAX_EVALUATED_ROWS.div_ceil(data.rows);
        let mut noise = [0.0; 2];
        let mut generator = RandomGenerator::new(1);
        for _ in 0..draws {
            let noisy: Vec<RunFile> =
                first.iter().map(|run| add_input_noise(run, &mut generator)).collect();
            let noisy = build_evaluation_data(table, &noisy)?;
            for ((sum, model), was) in noise.iter_mut().zip(models).zip(&as_it_was) {
                let moved = subtract(&model.predict(&noisy), was);
                *sum += mean_square(&data, &moved) / draws as f64;
            }
        }
        Ok(noise)
    }
}

/// Returns the table of `runs`, counted from where `training` is counted from.
fn build_evaluation_data(
    training: &DataTable,
    runs: &[RunFile],
) -> Result<DataTable, InputFileError> {
    let mut day = DataTable::new(&training.setting.machine, runs, training.setting.quantity)?;
    day.copy_origin_from(training);
    Ok(day)
}

fn subtract(one: &[f64], other: &[f64]) -> Vec<f64> {
    one.iter().zip(other).map(|(one, other)| one - other).collect()
}

/// Of the rows that count; about zero, where that is arbitrary.
fn mean_square(data: &DataTable, um: &[f64]) -> f64 {
    let rows = um.iter().zip(data.used.iter()).filter(|(um, used)| **used && um.is_finite());
    let rows = remove_zero_offset(data, rows.map(|(um, _)| *um).collect());
    rows.iter().map(|um| um * um).sum::<f64>() / rows.len().max(1) as f64
}

impl ParameterCovariance {
    /// Mean square on a day of what `model` may be off because its values are not known better, in µm².
    fn mean_prediction_variance(
        &self,
        day: &FitProblem,
        model: &Model,
        is_about_zero: bool,
    ) -> f64 {
        let (parameters, columns) = jacobian(day, model);
        let known: Vec<(usize, Vec<f64>)> = parameters
            .iter()
            .zip(columns)
            .filter_map(|(parameter, mut column)| {
                let row = self.parameter_row(parameter)?;
                if is_about_zero {
                    let mean = column.iter().sum::<f64>() / column.len().max(1) as f64;
                    column.iter_mut().for_each(|um| *um -= mean);
                }
                Some((row, column))
            })
            .collect();
        let rows = day.groups.len();
        let changes = DMatrix::from_fn(rows, known.len(), |row, n| known[n].1[row]);
        let covariance = DMatrix::from_fn(known.len(), known.len(), |i, j| {
            self.covariance(known[i].0, known[j].0)
        });
        let spread = &changes * covariance;
        spread.dot(&changes).max(0.0) / rows.max(1) as f64
    }
}

/// `run` with as much noise in its inputs once more as they have.
fn add_input_noise(run: &RunFile, generator: &mut RandomGenerator) -> RunFile {
    run.with_altered_values(run.row_count(), |name, values| {
        if name == "sensor_counts" || is_temperature_column(name) {
            let noise = estimate_noise_std(values);
            values.iter_mut().for_each(|value| *value += noise * generator.normal());
        }
    })
}

/// Returns the noise of a slow input, as a standard deviation: from fourth differences, in which a course that is
/// smooth over five rows leaves nothing, by their median, so that what jumps now and then does not count. At
/// least that of its last digit (an even distribution over it).
fn estimate_noise_std(values: &[f64]) -> f64 {
    /// Of the differences 1, −4, 6, −4, 1: √(1 + 16 + 36 + 16 + 1).
    const FOURTH_DIFFERENCE_NORM: f64 = 8.366_600_265_340_756;
    /// A normal distribution's median of sizes, in standard deviations.
    const NORMAL_MAD_PER_STD: f64 = 0.674_489_750_196_082;
    let there: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    let mut differences: Vec<f64> = there
        .windows(5)
        .map(|window| {
            (window[0] - 4.0 * window[1] + 6.0 * window[2] - 4.0 * window[3] + window[4]).abs()
        })
        .collect();
    if differences.is_empty() {
        return 0.0;
    }
    let steps = there.windows(2).map(|pair| (pair[1] - pair[0]).abs()).filter(|step| *step > 1e-9);
    let digit = steps.fold(f64::INFINITY, f64::min);
    let digit = if digit.is_finite() { digit / 12_f64.sqrt() } else { 0.0 };
    (median(&mut differences) / NORMAL_MAD_PER_STD / FOURTH_DIFFERENCE_NORM).max(digit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_noise_of_an_input_is_told_from_its_course_and_its_jumps() {
        let mut generator = RandomGenerator::new(3);
        let mut drawn = |noise: f64| -> Vec<f64> {
            let course = |row: usize| {
                let warm = 40.0 * (1.0 - (-(row as f64) / 17.0).exp());
                if row > 200 { warm - 9.0 } else { warm }
            };
            (0..400).map(|row| course(row) + noise * generator.normal()).collect()
        };
        for noise in [0.01, 0.3] {
            let estimate = estimate_noise_std(&drawn(noise));
            assert!((estimate / noise - 1.0).abs() < 0.15, "{estimate} for {noise}");
        }
        let stairs: Vec<f64> = (0..400).map(|row| f64::from(row / 40) * 0.0625).collect();
        assert!((estimate_noise_std(&stairs) - 0.0625 / 12_f64.sqrt()).abs() < 1e-9);
        assert_eq!(estimate_noise_std(&[3.0; 50]), 0.0);
    }
}
