//! The rows of several runs in a row, and which of them are held out together.

use statrs::distribution::{ContinuousCDF as _, FisherSnedecor};
use trueup_machine::{InputFileError, Location, applied_offsets::UncompensatedRun};
use trueup_numerics::{
    least_squares::{GivensQr, QrSolution},
    robust::Outlier,
};

use crate::report::ExcludedRow;

/// Blocks of time that are held out in turn where there is but one run.
const CROSS_VALIDATION_BLOCKS: usize = 5;

/// Runs, their rows counted through.
pub(crate) struct PooledRows<'r> {
    runs: &'r [UncompensatedRun<'r>],
}

impl<'r> PooledRows<'r> {
    /// # Errors
    /// There is no run at all.
    pub(crate) fn new(runs: &'r [UncompensatedRun<'r>]) -> Result<Self, InputFileError> {
        if runs.is_empty() {
            let rule = "no run is given: a fit needs a run file";
            return Err(InputFileError::new(Location::start_of_file("".as_ref()), rule));
        }
        Ok(Self { runs })
    }

    pub(crate) fn row_count(&self) -> usize {
        self.runs.iter().map(|run| run.row_count()).sum()
    }

    /// Returns the column `name` of all runs.
    ///
    /// # Errors
    /// A run has no such column, or no row of any has a value in it.
    pub(crate) fn require_column(&self, name: &str) -> Result<Vec<f64>, InputFileError> {
        let values = self.concatenated_column(name)?;
        if values.iter().all(|value| value.is_nan()) {
            return Err(self.runs[0].value_error(0, name, "has no value in any row"));
        }
        Ok(values)
    }

    fn concatenated_column(&self, name: &str) -> Result<Vec<f64>, InputFileError> {
        let mut values = Vec::with_capacity(self.row_count());
        for run in self.runs {
            values.extend_from_slice(run.require_column(name)?);
        }
        Ok(values)
    }

    /// Returns the column `name` of all runs, `None` where no run has it.
    ///
    /// # Errors
    /// Some runs have it and others have not.
    pub(crate) fn optional_column(&self, name: &str) -> Result<Option<Vec<f64>>, InputFileError> {
        if self.runs.iter().all(|run| run.column(name).is_none()) {
            return Ok(None);
        }
        self.concatenated_column(name).map(Some)
    }

    /// Returns the columns of temperatures that every run has.
    pub(crate) fn common_temperature_columns(&self) -> Vec<&'r str> {
        let Some((first, rest)) = self.runs.split_first() else { return Vec::new() };
        let names = first.columns().iter().map(|column| column.name.as_str());
        names
            .filter(|name| trueup_machine::machine_file::is_temperature_column(name))
            .filter(|name| rest.iter().all(|run| run.column(name).is_some()))
            .collect()
    }

    fn locate_row(&self, mut row: usize) -> (&'r UncompensatedRun<'r>, usize) {
        for run in self.runs {
            if row < run.row_count() {
                return (run, row);
            }
            row -= run.row_count();
        }
        (&self.runs[0], usize::MAX)
    }

    pub(crate) fn value_location(&self, row: usize, column: &str) -> Location {
        let (run, row) = self.locate_row(row);
        run.value_location(row, column)
    }

    /// Returns the runs as a whole break a rule.
    pub(crate) fn input_error(&self, rule: impl Into<String>) -> InputFileError {
        InputFileError::new(Location::start_of_file(self.runs[0].path()), rule)
    }

    /// Where the states start again: the first row of each file, and where time runs back.
    pub(crate) fn restart_flags(&self, time_s: Option<&[f64]>) -> Vec<bool> {
        let mut starts = vec![false; self.row_count()];
        let mut first = 0;
        for run in self.runs {
            starts[first] = true;
            first += run.row_count();
        }
        if let Some(time_s) = time_s {
            let mut before = f64::NAN;
            for (start, &time) in starts.iter_mut().zip(time_s) {
                *start |= time < before;
                if !time.is_nan() {
                    before = time;
                }
            }
        }
        starts
    }

    /// Returns the file of each row, counted from 0.
    pub(crate) fn file_indices(&self) -> Vec<usize> {
        self.runs.iter().enumerate().flat_map(|(file, run)| vec![file; run.row_count()]).collect()
    }

    /// Returns the file of each row, else its `run`, counted from 0; `None` where there is but one.
    pub(crate) fn run_indices(&self) -> Option<Vec<usize>> {
        if self.runs.len() > 1 {
            return Some(self.file_indices());
        }
        let mut known: Vec<u64> = Vec::new();
        let group = |number: &f64| {
            let bits = number.to_bits();
            known.iter().position(|k| *k == bits).unwrap_or_else(|| {
                known.push(bits);
                known.len() - 1
            })
        };
        let groups: Vec<usize> = self.runs[0].column("run")?.iter().map(group).collect();
        (known.len() > 1).then_some(groups)
    }

    /// Returns the group that each row is held out with, and how to say it: whole files, else whole `run`s,
    /// else blocks of time, else (`None`) each row in turn.
    pub(crate) fn cross_validation_groups(&self, used: &[bool]) -> (Option<Vec<usize>>, String) {
        if let Some(groups) = self.run_indices() {
            let count = groups.iter().copied().max().map_or(0, |last| last + 1);
            let what = if self.runs.len() > 1 { "files" } else { "runs" };
            return (Some(groups), format!("each of {count} {what} in turn"));
        }
        let rows = used.iter().filter(|used| **used).count();
        if self.runs[0].column("time_s").is_some() && rows >= 4 * CROSS_VALIDATION_BLOCKS {
            let mut seen = 0;
            let groups = used
                .iter()
                .map(|used| {
                    seen += usize::from(*used);
                    (seen.saturating_sub(1) * CROSS_VALIDATION_BLOCKS / rows)
                        .min(CROSS_VALIDATION_BLOCKS - 1)
                })
                .collect();
            return (
                Some(groups),
                format!("each of {CROSS_VALIDATION_BLOCKS} blocks of time in turn"),
            );
        }
        (None, "each row in turn".into())
    }

    /// Excluded rows, in words.
    pub(crate) fn list_excluded_rows(
        &self,
        found: &[Outlier],
        y: &[f64],
        column: &str,
    ) -> Vec<ExcludedRow> {
        let say = |outlier: &Outlier| ExcludedRow {
            place: self.value_location(outlier.row, column),
            measured_um: y[outlier.row],
            reason: outlier.exclusion_reason(),
        };
        found.iter().map(say).collect()
    }
}

/// Returns how much wider an interval is than independent residuals make it: √((1 + ρ)/(1 − ρ)), ρ the
/// correlation of neighbours in time (an autoregressive process of first order); at least 1.
pub(crate) fn autocorrelation_inflation_factor(residuals: &[f64]) -> f64 {
    let present: Vec<f64> = residuals.iter().copied().filter(|r| !r.is_nan()).collect();
    let squares: f64 = present.iter().map(|r| r * r).sum();
    let products: f64 = present.windows(2).map(|pair| pair[0] * pair[1]).sum();
    if squares <= 0.0 || present.len() < 10 {
        return 1.0;
    }
    let correlation = products / squares;
    // Within what independent residuals show by chance it is none.
    if correlation < 2.0 / (present.len() as f64).sqrt() {
        return 1.0;
    }
    let held = correlation.min(0.999);
    ((1.0 + held) / (1.0 - held)).sqrt()
}

/// Returns how likely chance alone makes the sum of squares `between` groups so large, by the one `within` them, each
/// in µm² with its degrees of freedom. Of a law with further constants `between` is what they take away, and `within` what is left.
pub(crate) fn f_test_p_value(between: (f64, f64), within: (f64, f64)) -> Option<f64> {
    let f = FisherSnedecor::new(between.1, within.1).ok()?;
    let (between, within) = (between.0 / between.1, within.0 / within.1);
    // What is equal to a nanometre is equal: rounding must not make a finding.
    const NEAR_ZERO_VARIANCE_UM2: f64 = 1e-6;
    if between <= NEAR_ZERO_VARIANCE_UM2 {
        return Some(1.0);
    }
    Some(if within > 0.0 { f.sf(between / within) } else { 0.0 })
}

/// Columns and measured values of a linear fit; a NaN in `y` is a row that takes no part.
pub(crate) fn solve_least_squares(
    columns: &[Vec<f64>],
    y: &[f64],
    keep: impl Fn(usize) -> bool,
) -> Option<QrSolution> {
    let mut triangle = GivensQr::new(columns.len());
    let mut x = vec![0.0; columns.len()];
    for (row, &y) in y.iter().enumerate() {
        if !y.is_nan() && keep(row) {
            copy_row(columns, row, &mut x);
            triangle.add_row(&x, y);
        }
    }
    triangle.solve().ok()
}

/// The columns' values in `row`.
pub(crate) fn copy_row(columns: &[Vec<f64>], row: usize, x: &mut [f64]) {
    x.iter_mut().zip(columns).for_each(|(x, column)| *x = column[row]);
}

/// y minus the fit, by row.
pub(crate) fn compute_residuals(
    columns: &[Vec<f64>],
    y: &[f64],
    solution: &QrSolution,
) -> Vec<f64> {
    let mut x = vec![0.0; columns.len()];
    y.iter()
        .enumerate()
        .map(|(row, y)| {
            copy_row(columns, row, &mut x);
            y - solution.predict(&x)
        })
        .collect()
}

/// y minus the linear fit to the other groups, by row; `None` where the other groups do not decide
/// a fit.
pub(crate) fn held_out_residuals(
    columns: &[Vec<f64>],
    y: &[f64],
    groups: Option<&[usize]>,
) -> Option<Vec<f64>> {
    let mut x = vec![0.0; columns.len()];
    let Some(groups) = groups else {
        let solution = solve_least_squares(columns, y, |_| true)?;
        let each = y.iter().enumerate().map(|(row, y)| {
            copy_row(columns, row, &mut x);
            let rest = 1.0 - solution.leverage(&x);
            if y.is_nan() { f64::NAN } else { (y - solution.predict(&x)) / rest.max(f64::EPSILON) }
        });
        return Some(each.collect());
    };
    leave_one_group_out_residuals(y, groups, |y, group| {
        let solution = solve_least_squares(columns, y, |row| groups[row] != group)?;
        Some(compute_residuals(columns, y, &solution))
    })
}

/// For each group in turn the residuals of its rows from `refit`, which must not look at them.
pub(crate) fn leave_one_group_out_residuals(
    y: &[f64],
    groups: &[usize],
    mut refit: impl FnMut(&[f64], usize) -> Option<Vec<f64>>,
) -> Option<Vec<f64>> {
    let mut held_out = vec![f64::NAN; y.len()];
    for group in 0..=groups.iter().copied().max()? {
        if !groups.iter().zip(y).any(|(of, y)| *of == group && !y.is_nan()) {
            continue;
        }
        let residuals = refit(y, group)?;
        for (row, residual) in residuals.into_iter().enumerate() {
            if groups[row] == group && !y[row].is_nan() {
                held_out[row] = residual;
            }
        }
    }
    Some(held_out)
}
