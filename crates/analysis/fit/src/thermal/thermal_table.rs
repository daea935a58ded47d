//! K₀(T) and tanβ(T) as a table, linear between its rows: a sum of hat functions over T.

use trueup_machine::machine_file::{ThermalMode, ThermalRow};
use trueup_numerics::{
    least_squares::{QrSolution, SeparableModel},
    t_quantile,
};

use super::{CONFIDENCE_LEVEL, ThermalData};
use crate::{
    pooled_rows::{self, PooledRows},
    report::{FitDetail, FitReport},
};

/// A table must leave at least this share less than the lines do.
const MIN_RELATIVE_RMS_REDUCTION: f64 = 0.1;

/// y = (a + b·P)·(T − T₀).
pub(super) struct CommonReferenceTemperatureModel<'a> {
    pub(super) lagged_c: Vec<f64>,
    pub(super) arm_m: &'a [f64],
}

impl SeparableModel for CommonReferenceTemperatureModel<'_> {
    fn nonlinear_count(&self) -> usize {
        1
    }

    fn linear_count(&self) -> usize {
        2
    }

    fn basis(&self, q: &[f64], columns: &mut [Vec<f64>]) -> bool {
        for (row, lagged_c) in self.lagged_c.iter().enumerate() {
            columns[0][row] = lagged_c - q[0];
            columns[1][row] = self.arm_m[row] * (lagged_c - q[0]);
        }
        true
    }
}

/// A fitted table.
pub(super) struct FittedTable {
    pub(super) rows: Vec<ThermalRow>,
    solution: QrSolution,
}

/// Returns the temperatures at which whole runs were measured, rising, each the mean of its runs; empty
/// where a run's own temperature moves by more than a quarter of the way to the next.
pub(super) fn temperature_levels_c(rows: &PooledRows<'_>, data: &ThermalData) -> Vec<f64> {
    let is_used: Vec<bool> = data.y.iter().map(|y| !y.is_nan()).collect();
    let Some(groups) = rows.run_indices() else { return Vec::new() };
    let mut spans: Vec<(f64, f64)> = Vec::new();
    for group in 0..=groups.iter().copied().max().unwrap_or(0) {
        let within = groups
            .iter()
            .zip(&data.temperature_c)
            .zip(&is_used)
            .filter(|((of, _), used)| **of == group && **used)
            .map(|((_, t), _)| *t);
        let span = within
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
        if span.0 <= span.1 {
            spans.push(span);
        }
    }
    spans.sort_by(|a, b| a.0.total_cmp(&b.0));
    let coldest = spans.first().map_or(0.0, |span| span.0);
    let warmest = spans.iter().map(|span| span.1).fold(f64::NEG_INFINITY, f64::max);
    let near = 0.02 * (warmest - coldest);
    let mut levels: Vec<(f64, f64)> = Vec::new();
    for (low, high) in spans {
        match levels.last_mut() {
            Some(level) if low <= level.1 + near => level.1 = level.1.max(high),
            _ => levels.push((low, high)),
        }
    }
    let narrow = levels.windows(2).all(|pair| {
        let gap = pair[1].0 - pair[0].1;
        let widest = (pair[0].1 - pair[0].0).max(pair[1].1 - pair[1].0);
        widest <= 0.25 * gap
    });
    if narrow { levels.iter().map(|(low, high)| 0.5 * (low + high)).collect() } else { Vec::new() }
}

impl FittedTable {
    /// With rows at the `temperature_levels_c`, or, if `requested`, that many rows between the coldest and the
    /// warmest temperature; `None` where the data does not decide it.
    pub(super) fn fit(
        data: &ThermalData,
        mode: ThermalMode,
        lag_s: f64,
        levels: &[f64],
        requested: Option<usize>,
    ) -> Option<Self> {
        let knots = match requested {
            Some(count) if count == levels.len() => levels.to_vec(),
            None if levels.len() >= 3 => levels.to_vec(),
            None => return None,
            Some(count) => {
                let lagged_c = data.lagged_temperatures_c(lag_s);
                let used = || lagged_c.iter().zip(&data.y).filter(|(_, y)| !y.is_nan());
                let low = used().map(|(t, _)| *t).fold(f64::INFINITY, f64::min);
                let high = used().map(|(t, _)| *t).fold(f64::NEG_INFINITY, f64::max);
                let last = count.checked_sub(1).filter(|last| *last > 0)?;
                (0..count).map(|at| low + (high - low) * at as f64 / last as f64).collect()
            }
        };
        Self::fit_with_knots(data, mode, lag_s, &knots)
    }

    /// With rows at these temperatures.
    pub(super) fn fit_with_knots(
        data: &ThermalData,
        mode: ThermalMode,
        lag_s: f64,
        knots: &[f64],
    ) -> Option<Self> {
        let columns = design_columns(&data.lagged_temperatures_c(lag_s), &data.arm_m, mode, knots);
        let solution = pooled_rows::solve_least_squares(&columns, &data.y, |_| true)?;
        let count = knots.len();
        let constant =
            |at: usize| if mode.has_constant_term() { solution.coefficients[at] } else { 0.0 };
        let first_slope = if mode.has_constant_term() { count } else { 0 };
        let slope = |at: usize| {
            if mode.has_position_term() { solution.coefficients[first_slope + at] } else { 0.0 }
        };
        let row = |(at, &temperature_c): (usize, &f64)| ThermalRow {
            temperature_c,
            constant_um: constant(at),
            slope_um_per_m: slope(at),
        };
        let rows = knots.iter().enumerate().map(row).collect();
        Some(Self { rows, solution })
    }

    /// Returns whether it leaves clearly less than the lines do, whose residuals these are: more than its
    /// further constants do by chance (F), and not by a hair.
    pub(super) fn is_better_than_lines(
        &self,
        residuals: &[f64],
        lines_are_a_table: bool,
        mode: ThermalMode,
        wider: f64,
    ) -> bool {
        let squares: f64 = residuals.iter().filter(|r| !r.is_nan()).map(|r| r * r).sum();
        let lines = match (mode, lines_are_a_table) {
            (ThermalMode::Both, true) => 4,
            (ThermalMode::Both, false) => 3,
            _ => 2,
        };
        let more = self.solution.coefficients.len().saturating_sub(lines) as f64;
        let degrees = self.solution.degrees_of_freedom() as f64;
        if more < 1.0 || degrees < 1.0 {
            return false;
        }
        let gained = (squares - self.solution.residual_squares) / more;
        let ratio = gained / (self.solution.residual_squares / degrees) / (wider * wider);
        // F of several degrees is below t² of one at the same probability, shared among them.
        let limit = t_quantile(1.0 - (1.0 - CONFIDENCE_LEVEL) / (2.0 * more), degrees).powi(2);
        let left = (self.solution.residual_squares / squares).sqrt();
        ratio > limit && left < 1.0 - MIN_RELATIVE_RMS_REDUCTION
    }

    pub(super) fn add_to_report(&self, report: &mut FitReport, mode: ThermalMode) {
        report.parameters.retain(|parameter| parameter.name == "lag_s");
        let temperatures: Vec<f64> = self.rows.iter().map(|row| row.temperature_c).collect();
        report.facts.push(FitDetail::numbers("table_c", temperatures));
        let count = self.rows.len();
        let mut first = 0;
        let mut push = |name: &str, values: Vec<f64>| {
            let halves =
                (0..count).map(|at| self.solution.confidence_half_width(first + at)).collect();
            report.facts.push(FitDetail::numbers(format!("table_{name}"), values));
            report.facts.push(FitDetail::numbers(format!("table_{name}_half_width"), halves));
            first += count;
        };
        if mode.has_constant_term() {
            push("constant_um", self.rows.iter().map(|row| row.constant_um).collect());
        }
        if mode.has_position_term() {
            push("slope_um_per_m", self.rows.iter().map(|row| row.slope_um_per_m).collect());
        }
        report.warnings.push(
            "the table is held at its first and last row beyond the temperatures that were measured"
                .into(),
        );
    }
}

/// Returns the residuals of held-out groups from a table with these knots, and how they were held out.
pub(super) fn held_out_residuals(
    data: &ThermalData,
    mode: ThermalMode,
    lag_s: f64,
    knots: &[f64],
    (groups, by): (Option<&[usize]>, String),
) -> (Option<Vec<f64>>, String) {
    let columns = design_columns(&data.lagged_temperatures_c(lag_s), &data.arm_m, mode, knots);
    match pooled_rows::held_out_residuals(&columns, &data.y, groups) {
        Some(held_out) => (Some(held_out), by),
        // Whole runs at one temperature are whole rows of the table: without such a run its row is
        // not decided, and rows must be held out singly.
        None => {
            (pooled_rows::held_out_residuals(&columns, &data.y, None), "each row in turn".into())
        }
    }
}

/// Returns the hat functions of K₀'s rows, then those of tanβ's.
pub(super) fn design_columns(
    lagged_c: &[f64],
    arm_m: &[f64],
    mode: ThermalMode,
    knots: &[f64],
) -> Vec<Vec<f64>> {
    let mut columns = Vec::new();
    if mode.has_constant_term() {
        columns.extend(knots.iter().enumerate().map(|(at, _)| {
            lagged_c.iter().map(|t| hat_function(knots, at, *t)).collect::<Vec<f64>>()
        }));
    }
    if mode.has_position_term() {
        columns.extend(knots.iter().enumerate().map(|(at, _)| {
            let values = lagged_c.iter().zip(arm_m);
            values.map(|(t, arm)| arm * hat_function(knots, at, *t)).collect::<Vec<f64>>()
        }));
    }
    columns
}

/// 1 at knot `at`, 0 at the others, linear between, held outside.
fn hat_function(knots: &[f64], at: usize, t: f64) -> f64 {
    let own = knots[at];
    let before = at.checked_sub(1).map(|before| knots[before]);
    let after = knots.get(at + 1).copied();
    match (before, after) {
        (Some(before), _) if t < own => ((t - before) / (own - before)).max(0.0),
        (_, Some(after)) if t > own => ((after - t) / (after - own)).max(0.0),
        _ if t.is_nan() => f64::NAN,
        _ => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hats_sum_to_one_everywhere() {
        let knots = [20.0, 23.0, 30.0];
        for t in [0.0, 20.0, 21.5, 23.0, 29.0, 30.0, 99.0] {
            let sum: f64 = (0..3).map(|at| hat_function(&knots, at, t)).sum();
            assert!((sum - 1.0).abs() < 1e-15, "{t}: {sum}");
        }
        assert_eq!(hat_function(&knots, 1, 21.5), 0.5);
    }
}
