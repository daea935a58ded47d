//! The residuals of each correction on runs that it has not seen: the figures of the report.
//!
//! The runs are held out in turn (in at most [`MAX_FOLDS`] blocks of consecutive runs); each
//! correction is fitted to the others and judged on the one held out by its mean square error, as the
//! machine's own model has it, with the table at its own points. Whether a correction is worth it is
//! decided elsewhere ([`trueup_numerics::repeats`]). Why one that is refused has no gain is reported with two
//! compared run by run, so that what both leave alike (drift, scatter) cancels:
//!
//! ```text
//! dⱼ = MSEⱼ(simpler) − MSEⱼ(richer)      gain, if  d̄ − t₀.₉₅(m − 1)·s_d/√m  >  0
//! ```
//!
//! with t the one-sided 95 % point of Student's distribution for m blocks. A gain below a square
//! nanometre is none: tables are written to the nanometre.

use trueup_machine::{
    machine_file::PitchErrorTable,
    machine_file::writer::round_to_decimals,
    model::{is_negative_direction, pitch_error_um},
};

use trueup_numerics::{repeats, t_quantile};

use super::{
    pitch_table::{TABLE_DECIMALS, TableGrid, TargetMeans},
    readings::{PitchReading, PitchReadings},
};

/// More runs than this are held out in blocks.
const MAX_FOLDS: usize = 20;

/// Mean squares nearer than this, in µm², are equal.
const MSE_TOLERANCE_UM2: f64 = 1e-6;

/// The corrections that may be taken off the readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum CorrectionModel {
    Nothing,
    /// The mean of all readings: a measurement's zero is arbitrary.
    Constant,
    OneTable,
    TableAndBacklash,
    BothTables,
}

impl CorrectionModel {
    /// Returns the table that it is; none of what has none.
    pub(super) fn as_table_law(self) -> Option<repeats::TableLaw> {
        match self {
            Self::Nothing | Self::Constant => None,
            Self::OneTable => Some(repeats::TableLaw::Table),
            Self::TableAndBacklash => Some(repeats::TableLaw::TableAndStep),
            Self::BothTables => Some(repeats::TableLaw::EachSide),
        }
    }
}

impl From<repeats::TableLaw> for CorrectionModel {
    fn from(law: repeats::TableLaw) -> Self {
        match law {
            repeats::TableLaw::Table => Self::OneTable,
            repeats::TableLaw::TableAndStep => Self::TableAndBacklash,
            repeats::TableLaw::EachSide => Self::BothTables,
        }
    }
}

/// A law with its constants.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FittedCorrection {
    pub constant_um: f64,
    pub pitch: Option<PitchErrorTable>,
    pub width_um: Option<f64>,
}

impl FittedCorrection {
    /// Returns the error in µm at `position_mm`, approached in the direction `way`: as the machine's model
    /// has it.
    pub(super) fn evaluate(&self, position_mm: f64, way: usize) -> f64 {
        let direction = if way == 0 { 1.0 } else { -1.0 };
        let table =
            self.pitch.as_ref().map_or(0.0, |pitch| pitch_error_um(pitch, position_mm, direction));
        let width =
            if is_negative_direction(direction) { self.width_um.unwrap_or(0.0) } else { 0.0 };
        self.constant_um + table + width
    }
}

/// Readings gathered by target and direction.
#[derive(Clone, Debug)]
pub(super) struct DirectionSums {
    sum: [Vec<f64>; 2],
    count: [Vec<f64>; 2],
}

impl DirectionSums {
    pub(super) fn from_readings<'r>(
        targets: usize,
        readings: impl Iterator<Item = &'r PitchReading>,
    ) -> Self {
        let mut sums = Self {
            sum: [vec![0.0; targets], vec![0.0; targets]],
            count: [vec![0.0; targets], vec![0.0; targets]],
        };
        for reading in readings {
            sums.sum[reading.way][reading.target] += reading.um;
            sums.count[reading.way][reading.target] += 1.0;
        }
        sums
    }

    /// Returns the means of one direction.
    pub(super) fn direction_means(&self, targets_mm: &[f64], way: usize) -> TargetMeans {
        self.merged_means(targets_mm, &[(way, 0.0)])
    }

    /// Returns the means of the named directions together, each less its shift.
    fn merged_means(&self, targets_mm: &[f64], ways: &[(usize, f64)]) -> TargetMeans {
        let points = targets_mm.iter().enumerate().filter_map(|(target, &x)| {
            let count: f64 = ways.iter().map(|&(way, _)| self.count[way][target]).sum();
            let sum: f64 = ways
                .iter()
                .map(|&(way, shift)| self.sum[way][target] - shift * self.count[way][target])
                .sum();
            (count > 0.5).then(|| (x, sum / count, count))
        });
        TargetMeans { points: points.collect() }
    }

    /// Reverse minus forward at each target that has both, in µm.
    pub(super) fn reversal_errors_um(&self) -> Vec<f64> {
        let mean = |way: usize, n: usize| self.sum[way][n] / self.count[way][n];
        (0..self.sum[0].len())
            .filter(|&n| self.count[0][n] > 0.5 && self.count[1][n] > 0.5)
            .map(|n| mean(1, n) - mean(0, n))
            .collect()
    }

    /// Returns the constants of `law`.
    pub(super) fn fit(
        &self,
        targets_mm: &[f64],
        grid: &TableGrid,
        law: CorrectionModel,
    ) -> FittedCorrection {
        let both = [(0, 0.0), (1, 0.0)];
        let mut fitted = FittedCorrection { constant_um: 0.0, pitch: None, width_um: None };
        match law {
            CorrectionModel::Nothing => {}
            CorrectionModel::Constant => {
                let line = self.merged_means(targets_mm, &both);
                let sum: f64 = line.points.iter().map(|point| point.1 * point.2).sum();
                fitted.constant_um = sum / line.points.iter().map(|point| point.2).sum::<f64>();
            }
            CorrectionModel::OneTable => {
                fitted.pitch =
                    Some(grid.fit_pitch_table(&self.merged_means(targets_mm, &both), None));
            }
            CorrectionModel::TableAndBacklash => {
                let widths = self.reversal_errors_um();
                let mean = widths.iter().sum::<f64>() / widths.len().max(1) as f64;
                let width = round_to_decimals(mean, TABLE_DECIMALS);
                let line = self.merged_means(targets_mm, &[(0, 0.0), (1, width)]);
                fitted.pitch = Some(grid.fit_pitch_table(&line, None));
                fitted.width_um = Some(width);
            }
            CorrectionModel::BothTables => {
                let [up, down] = [0, 1].map(|way| self.direction_means(targets_mm, way));
                // A direction that none of these runs has is taken for the other one.
                let (up, down) = match (up.points.is_empty(), down.points.is_empty()) {
                    (true, _) => (down.clone(), down),
                    (_, true) => (up.clone(), up),
                    _ => (up, down),
                };
                fitted.pitch = Some(grid.fit_pitch_table(&up, Some(&down)));
            }
        }
        fitted
    }
}

/// The errors of laws on held-out runs.
#[derive(Clone, Debug)]
pub(super) struct CrossValidationScore {
    pub law: CorrectionModel,
    /// The mean square error of each block in µm².
    pub mse_um2: Vec<f64>,
    /// The residual of each reading, in the order of the readings.
    pub residuals_um: Vec<f64>,
}

impl CrossValidationScore {
    pub(super) fn rms_um(&self) -> f64 {
        let count = self.residuals_um.len() as f64;
        (self.residuals_um.iter().map(|um| um * um).sum::<f64>() / count).sqrt()
    }

    /// Returns the root mean square of each block in µm.
    pub(super) fn rms_by_fold_um(&self) -> Vec<f64> {
        self.mse_um2.iter().map(|mse| mse.sqrt()).collect()
    }

    /// Returns whether this law gains on `simpler` on the held-out blocks.
    pub(super) fn is_significantly_better_than(&self, simpler: &Self) -> bool {
        let gains: Vec<f64> = simpler
            .mse_um2
            .iter()
            .zip(&self.mse_um2)
            .map(|(before, after)| before - after)
            .collect();
        is_significant_gain(&gains)
    }
}

/// Returns whether the mean of `gains`, in µm², is above 0 with a confidence of 95 %.
pub(super) fn is_significant_gain(gains: &[f64]) -> bool {
    mean_lower_bound(gains).is_some_and(|low| low > MSE_TOLERANCE_UM2)
}

/// Returns the one-sided 95 % lower bound of the mean of `values`; `None` below two values.
fn mean_lower_bound(values: &[f64]) -> Option<f64> {
    mean_and_half_width(values, 0.95).map(|(mean, half_width)| mean - half_width)
}

/// Returns the mean of `values`, and how far its bound of this `probability` is from it; `None` below two values.
pub(super) fn mean_and_half_width(values: &[f64], probability: f64) -> Option<(f64, f64)> {
    if values.len() < 2 {
        return None;
    }
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    Some((mean, t_quantile(probability, count - 1.0) * (variance / count).sqrt()))
}

/// Returns the number of blocks in which `runs` are held out.
pub(super) fn fold_count(runs: usize) -> usize {
    runs.min(MAX_FOLDS)
}

/// Returns the block of `run` among `runs`.
pub(super) fn fold_index(run: usize, runs: usize) -> usize {
    run * fold_count(runs) / runs
}

/// Returns each of `laws` on the runs held out in turn; needs at least two runs.
pub(super) fn cross_validate(
    readings: &PitchReadings,
    grid: &TableGrid,
    laws: &[CorrectionModel],
) -> Vec<CrossValidationScore> {
    let (runs, targets) = (readings.runs, readings.targets_mm.len());
    let folds = fold_count(runs);
    let fold = |reading: &PitchReading| fold_index(reading.run, runs);
    let mut judged: Vec<CrossValidationScore> = laws
        .iter()
        .map(|&law| CrossValidationScore {
            law,
            mse_um2: vec![0.0; folds],
            residuals_um: vec![0.0; readings.list.len()],
        })
        .collect();
    for held_out in 0..folds {
        let retained = readings.list.iter().filter(|reading| fold(reading) != held_out);
        let sums = DirectionSums::from_readings(targets, retained);
        for judged in &mut judged {
            let fitted = sums.fit(&readings.targets_mm, grid, judged.law);
            let (mut squares, mut count) = (0.0, 0.0);
            for (residual, reading) in judged.residuals_um.iter_mut().zip(&readings.list) {
                if fold(reading) == held_out {
                    let x = readings.targets_mm[reading.target];
                    *residual = reading.um - fitted.evaluate(x, reading.way);
                    squares += *residual * *residual;
                    count += 1.0;
                }
            }
            judged.mse_um2[held_out] = squares / count;
        }
    }
    judged
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gain_is_one_only_if_every_run_agrees_or_nearly() {
        assert!(is_significant_gain(&[8.6, 9.6, 7.3]));
        assert!(!is_significant_gain(&[54.0, 31.0, 66.0, 48.0, -75.0]));
        assert!(!is_significant_gain(&[1e-12, 1e-12, 1e-12]));
        assert!(!is_significant_gain(&[5.0]));
    }

    #[test]
    fn the_bound_is_that_of_a_table_of_students_t() {
        // Mean 2, s = 1, n = 3; t(2, 0.95) = 2.920: 2 − 2.920/√3 = 0.314
        let low = mean_lower_bound(&[1.0, 2.0, 3.0]).expect("three values");
        assert!((low - 0.3142).abs() < 1e-3, "{low}");
    }

    #[test]
    fn many_runs_are_held_out_in_twenty_blocks_that_hold_all_of_them() {
        for runs in [1, 2, 5, 20, 21, 1000] {
            let of: Vec<usize> = (0..runs).map(|run| fold_index(run, runs)).collect();
            assert!(of.is_sorted());
            assert_eq!((of[0], of[runs - 1] + 1), (0, fold_count(runs)));
        }
    }
}
