//! The residuals of each correction on runs that it has not seen: the figures of the report.
//!
//! The runs are left out in turn (in at most [`MAX_FOLDS`] blocks of consecutive runs); each
//! correction is fitted to the others and judged on the one left out by its mean square error, as the
//! machine's own model has it, with the table at its own points. Whether a correction is worth it is
//! decided elsewhere ([`trueup_numerics::repeats`]). Why one that is refused has no gain is said with two
//! compared run by run, so that what both leave alike (drift, scatter) cancels:
//!
//! ```text
//! dⱼ = MSEⱼ(simpler) − MSEⱼ(richer)      gain, if  d̄ − t₀.₉₅(m − 1)·s_d/√m  >  0
//! ```
//!
//! with t the one-sided 95 % point of Student's distribution for m blocks. A gain below a square
//! nanometre is none: tables are written to the nanometre.

use statrs::distribution::{ContinuousCDF, StudentsT};
use trueup_machine::{
    file::Pitch,
    file::write::rounded,
    model::{is_reverse, pitch_um},
};

use trueup_numerics::repeats;

use super::{
    readings::{Reading, Readings},
    table::{DECIMALS, Grid, Line},
};

/// More runs than this are left out in blocks.
const MAX_FOLDS: usize = 20;

/// Mean squares nearer than this, in µm², are equal.
const RESOLUTION_UM2: f64 = 1e-6;

/// The corrections that may be taken off the readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Law {
    Nothing,
    /// The mean of all readings: a measurement's zero is arbitrary.
    Constant,
    OneTable,
    TableAndBacklash,
    BothTables,
}

impl Law {
    /// Returns the table that it is; none of what has none.
    pub(super) fn table(self) -> Option<repeats::Law> {
        match self {
            Self::Nothing | Self::Constant => None,
            Self::OneTable => Some(repeats::Law::Table),
            Self::TableAndBacklash => Some(repeats::Law::TableAndStep),
            Self::BothTables => Some(repeats::Law::EachSide),
        }
    }
}

impl From<repeats::Law> for Law {
    fn from(law: repeats::Law) -> Self {
        match law {
            repeats::Law::Table => Self::OneTable,
            repeats::Law::TableAndStep => Self::TableAndBacklash,
            repeats::Law::EachSide => Self::BothTables,
        }
    }
}

/// A law with its constants.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Fitted {
    pub constant_um: f64,
    pub pitch: Option<Pitch>,
    pub width_um: Option<f64>,
}

impl Fitted {
    /// Returns the error in µm at `position_mm`, approached in the direction `way`: as the machine's model
    /// has it.
    pub(super) fn at(&self, position_mm: f64, way: usize) -> f64 {
        let direction = if way == 0 { 1.0 } else { -1.0 };
        let table = self.pitch.as_ref().map_or(0.0, |it| pitch_um(it, position_mm, direction));
        let width = if is_reverse(direction) { self.width_um.unwrap_or(0.0) } else { 0.0 };
        self.constant_um + table + width
    }
}

/// Readings gathered by target and direction.
#[derive(Clone, Debug)]
pub(super) struct Sums {
    sum: [Vec<f64>; 2],
    count: [Vec<f64>; 2],
}

impl Sums {
    pub(super) fn of<'r>(targets: usize, readings: impl Iterator<Item = &'r Reading>) -> Self {
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
    pub(super) fn line(&self, targets_mm: &[f64], way: usize) -> Line {
        self.merged(targets_mm, &[(way, 0.0)])
    }

    /// Returns the means of the named directions together, each less its shift.
    fn merged(&self, targets_mm: &[f64], ways: &[(usize, f64)]) -> Line {
        let points = targets_mm.iter().enumerate().filter_map(|(target, &x)| {
            let count: f64 = ways.iter().map(|&(way, _)| self.count[way][target]).sum();
            let sum: f64 = ways
                .iter()
                .map(|&(way, shift)| self.sum[way][target] - shift * self.count[way][target])
                .sum();
            (count > 0.5).then(|| (x, sum / count, count))
        });
        Line { points: points.collect() }
    }

    /// Reverse minus forward at each target that has both, in µm.
    pub(super) fn widths(&self) -> Vec<f64> {
        let mean = |way: usize, n: usize| self.sum[way][n] / self.count[way][n];
        (0..self.sum[0].len())
            .filter(|&n| self.count[0][n] > 0.5 && self.count[1][n] > 0.5)
            .map(|n| mean(1, n) - mean(0, n))
            .collect()
    }

    /// Returns the constants of `law`.
    pub(super) fn fit(&self, targets_mm: &[f64], grid: &Grid, law: Law) -> Fitted {
        let both = [(0, 0.0), (1, 0.0)];
        let mut fitted = Fitted { constant_um: 0.0, pitch: None, width_um: None };
        match law {
            Law::Nothing => {}
            Law::Constant => {
                let line = self.merged(targets_mm, &both);
                let sum: f64 = line.points.iter().map(|point| point.1 * point.2).sum();
                fitted.constant_um = sum / line.points.iter().map(|point| point.2).sum::<f64>();
            }
            Law::OneTable => {
                fitted.pitch = Some(grid.pitch(&self.merged(targets_mm, &both), None));
            }
            Law::TableAndBacklash => {
                let widths = self.widths();
                let mean = widths.iter().sum::<f64>() / widths.len().max(1) as f64;
                let width = rounded(mean, DECIMALS);
                let line = self.merged(targets_mm, &[(0, 0.0), (1, width)]);
                fitted.pitch = Some(grid.pitch(&line, None));
                fitted.width_um = Some(width);
            }
            Law::BothTables => {
                let [up, down] = [0, 1].map(|way| self.line(targets_mm, way));
                // A direction that none of these runs has is taken for the other one.
                let (up, down) = match (up.points.is_empty(), down.points.is_empty()) {
                    (true, _) => (down.clone(), down),
                    (_, true) => (up.clone(), up),
                    _ => (up, down),
                };
                fitted.pitch = Some(grid.pitch(&up, Some(&down)));
            }
        }
        fitted
    }
}

/// How laws do on runs left out.
#[derive(Clone, Debug)]
pub(super) struct Judged {
    pub law: Law,
    /// The mean square error of each block in µm².
    pub mse_um2: Vec<f64>,
    /// The residual of each reading, in the order of the readings.
    pub residuals_um: Vec<f64>,
}

impl Judged {
    pub(super) fn rms_um(&self) -> f64 {
        let count = self.residuals_um.len() as f64;
        (self.residuals_um.iter().map(|um| um * um).sum::<f64>() / count).sqrt()
    }

    /// Returns the root mean square of each block in µm.
    pub(super) fn rms_by_fold(&self) -> Vec<f64> {
        self.mse_um2.iter().map(|mse| mse.sqrt()).collect()
    }

    /// Returns whether this law gains on `simpler` on the blocks left out.
    pub(super) fn gains_on(&self, simpler: &Self) -> bool {
        let gains: Vec<f64> = simpler
            .mse_um2
            .iter()
            .zip(&self.mse_um2)
            .map(|(before, after)| before - after)
            .collect();
        is_gain(&gains)
    }
}

/// Returns whether the mean of `gains`, in µm², is above 0 with a confidence of 95 %.
pub(super) fn is_gain(gains: &[f64]) -> bool {
    lower_bound(gains).is_some_and(|low| low > RESOLUTION_UM2)
}

/// Returns the one-sided 95 % lower bound of the mean of `values`; `None` below two values.
fn lower_bound(values: &[f64]) -> Option<f64> {
    if values.len() < 2 {
        return None;
    }
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|it| (it - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let t = student(values.len() - 1, 0.95)?;
    Some(mean - t * (variance / count).sqrt())
}

/// Returns the point below which Student's t of `freedom` degrees lies with `probability`.
pub(super) fn student(freedom: usize, probability: f64) -> Option<f64> {
    let t = StudentsT::new(0.0, 1.0, freedom as f64).ok()?;
    Some(t.inverse_cdf(probability))
}

/// Returns the number of blocks in which `runs` are left out.
pub(super) fn folds(runs: usize) -> usize {
    runs.min(MAX_FOLDS)
}

/// Returns the block of `run` among `runs`.
pub(super) fn fold_of(run: usize, runs: usize) -> usize {
    run * folds(runs) / runs
}

/// Returns each of `laws` on the runs left out in turn; needs at least two runs.
pub(super) fn judge(readings: &Readings, grid: &Grid, laws: &[Law]) -> Vec<Judged> {
    let (runs, targets) = (readings.runs, readings.targets_mm.len());
    let folds = folds(runs);
    let fold = |reading: &Reading| fold_of(reading.run, runs);
    let mut judged: Vec<Judged> = laws
        .iter()
        .map(|&law| Judged {
            law,
            mse_um2: vec![0.0; folds],
            residuals_um: vec![0.0; readings.list.len()],
        })
        .collect();
    for left_out in 0..folds {
        let kept = readings.list.iter().filter(|reading| fold(reading) != left_out);
        let sums = Sums::of(targets, kept);
        for judged in &mut judged {
            let fitted = sums.fit(&readings.targets_mm, grid, judged.law);
            let (mut squares, mut count) = (0.0, 0.0);
            for (residual, reading) in judged.residuals_um.iter_mut().zip(&readings.list) {
                if fold(reading) == left_out {
                    let x = readings.targets_mm[reading.target];
                    *residual = reading.um - fitted.at(x, reading.way);
                    squares += *residual * *residual;
                    count += 1.0;
                }
            }
            judged.mse_um2[left_out] = squares / count;
        }
    }
    judged
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gain_is_one_only_if_every_run_agrees_or_nearly() {
        assert!(is_gain(&[8.6, 9.6, 7.3]));
        assert!(!is_gain(&[54.0, 31.0, 66.0, 48.0, -75.0]));
        assert!(!is_gain(&[1e-12, 1e-12, 1e-12]));
        assert!(!is_gain(&[5.0]));
    }

    #[test]
    fn the_bound_is_that_of_a_table_of_students_t() {
        // Mean 2, s = 1, n = 3; t(2, 0.95) = 2.920: 2 − 2.920/√3 = 0.314
        let low = lower_bound(&[1.0, 2.0, 3.0]).expect("three values");
        assert!((low - 0.3142).abs() < 1e-3, "{low}");
    }

    #[test]
    fn many_runs_are_left_out_in_twenty_blocks_that_hold_all_of_them() {
        for runs in [1, 2, 5, 20, 21, 1000] {
            let of: Vec<usize> = (0..runs).map(|run| fold_of(run, runs)).collect();
            assert!(of.is_sorted());
            assert_eq!((of[0], of[runs - 1] + 1), (0, folds(runs)));
        }
    }
}
