//! Which rows of a thermal run are gross errors: those that stand alone, not a range of the temperature in
//! which the law is another one.

use trueup_numerics::robust::{self, Outlier};

use super::ThermalData;
use crate::{lagged_regression, pooled_rows::PooledRows, report::FitReport};

impl ThermalData {
    pub(super) fn exclude_outliers(&mut self, rows: &PooledRows<'_>, report: &mut FitReport) {
        let found = match &self.time_s {
            Some(time_s) if !self.has_varying_positions() => {
                lagged_regression::find_outliers(time_s, &self.starts, &self.y)
            }
            _ => self.find_run_outliers(rows),
        };
        report.excluded = rows.list_excluded_rows(&found, &self.y, &self.measured);
        found.iter().for_each(|outlier| self.y[outlier.row] = f64::NAN);
    }

    /// Rows that are off what the other rows of their own run follow, at temperatures near theirs. The law may
    /// bend with the temperature: held against one line through all of them, whole runs and whole ranges of
    /// the temperature would be gross errors.
    fn find_run_outliers(&self, rows: &PooledRows<'_>) -> Vec<Outlier> {
        let ones = vec![1.0; self.y.len()];
        let warm = &self.temperature_c;
        let both: Vec<f64> = self.arm_m.iter().zip(warm).map(|(p, t)| p * t).collect();
        let law: &[&[f64]] = if self.has_varying_positions() {
            &[&ones, &self.arm_m, warm, &both]
        } else {
            &[&ones, warm]
        };
        let runs = rows.run_indices().unwrap_or_else(|| self.temperature_range_indices());
        let of_run = |run: usize| -> Vec<f64> {
            let own = |(y, of): (&f64, &usize)| if *of == run { *y } else { f64::NAN };
            self.y.iter().zip(&runs).map(own).collect()
        };
        let off = |y: &[f64]| {
            // A short run is at one temperature, or shows no more than a line.
            let columns = (y.iter().filter(|y| !y.is_nan()).count() / robust::MIN_ROWS_PER_COLUMN)
                .min(law.len());
            robust::find_regression_outliers(&law[..columns], y)
        };
        let last = runs.iter().copied().max().unwrap_or(0);
        let by_run: Vec<Vec<f64>> = (0..=last).map(of_run).collect();
        let is_reported = |y: &Vec<f64>| {
            y.iter().filter(|y| !y.is_nan()).count() >= 2 * robust::MIN_ROWS_PER_COLUMN
        };
        if !by_run.iter().any(is_reported) {
            return robust::find_regression_outliers(law, &self.y);
        }
        let found = by_run.iter().flat_map(|y| off(y)).collect();
        robust::retain_isolated_outliers(found, warm, &self.y)
    }

    /// Returns the rows that are used, by their temperature.
    fn rows_by_temperature(&self) -> Vec<usize> {
        let mut used: Vec<usize> = (0..self.y.len()).filter(|row| !self.y[*row].is_nan()).collect();
        used.sort_by(|a, b| self.temperature_c[*a].total_cmp(&self.temperature_c[*b]));
        used
    }

    /// Returns for each row which range of the temperature it is in; each range has as many rows, as they are
    /// used.
    fn temperature_range_indices(&self) -> Vec<usize> {
        /// Rows of a range, at least: five for each column of the law.
        const MIN_ROWS_PER_RANGE: usize = 20;
        const MAX_RANGES: usize = 8;
        let used = self.rows_by_temperature();
        let count = (used.len() / MIN_ROWS_PER_RANGE).clamp(1, MAX_RANGES);
        let mut ranges = vec![0; self.y.len()];
        for (at, row) in used.iter().enumerate() {
            ranges[*row] = at * count / used.len();
        }
        ranges
    }
}
