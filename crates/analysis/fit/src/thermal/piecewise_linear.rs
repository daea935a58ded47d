//! A law that bends with the temperature, where no table was required: the fewest rows that held-out
//! rows are clearly better with than with lines.
//!
//! Tried are a kink (three rows, the middle one searched) and tables of equal steps. The bend is found at rest
//! of the lag: the lag that lines need can be the shape of the bend, so it is tried with less of it, and none.

use trueup_machine::machine_file::ThermalMode;

use super::{ThermalData, thermal_table};
use crate::{lagged_regression::LaggedFit, pooled_rows, report::ResidualStatistics};

/// Held-out rows must be this share better than with lines: beyond the measured temperatures a table is
/// held where a line goes on, and that is given up for no small gain.
const MIN_RELATIVE_HELD_OUT_GAIN: f64 = 0.2;
/// The same where a part of the record alone has some of the temperatures, so that only single rows can be held
/// out: what changed in that part would pass for a bend.
const MIN_RELATIVE_UNREPEATED_GAIN: f64 = 0.5;
/// More rows than the best table are worth this share.
const MIN_RELATIVE_EXTRA_ROW_GAIN: f64 = 0.05;
/// The search looks at no more rows than these; the table that is found is fitted to all.
const MAX_SEARCHED_ROWS: usize = 20_000;
/// Rows for each of a table's values.
const MIN_ROWS_PER_VALUE: usize = 6;
/// Where a kink is tried first: this many equal parts between the coldest and the warmest.
const KINK_GRID_INTERVALS: usize = 16;
/// Tables of equal steps.
const TABLE_ROW_COUNTS: [usize; 4] = [4, 5, 6, 8];

/// A bend: the temperatures of its rows, and its lag.
#[derive(Clone, Debug)]
pub(super) struct PiecewiseLinearLaw {
    pub(super) knots_c: Vec<f64>,
    pub(super) lag_s: f64,
    /// Whether a part of the record alone has some of the temperatures.
    pub(super) is_once: bool,
}

/// Returns the bend that held-out rows are clearly better with than with the lines, if there is one.
pub(super) fn find_piecewise_linear_law(
    data: &ThermalData,
    mode: ThermalMode,
    groups: Option<&[usize]>,
    lines: &LaggedFit,
) -> Option<PiecewiseLinearLaw> {
    let groups = groups.filter(|_| lines.held_out.is_some());
    let by_groups = search_best_law(data, mode, groups, lines.lag_s)
        .map(|found| (found, lines.held_out.as_deref(), MIN_RELATIVE_HELD_OUT_GAIN));
    let once = || {
        search_best_law(data, mode, None, lines.lag_s)
            .map(|found| (found, Some(lines.residuals.as_slice()), MIN_RELATIVE_UNREPEATED_GAIN))
    };
    let is_once = by_groups.is_none() || groups.is_none();
    let ((rms_um, bend), lines_um, worth) = by_groups.or_else(once)?;
    let lines_um = lines_um.and_then(ResidualStatistics::from_residuals)?.rms_um;
    (rms_um < (1.0 - worth) * lines_um).then_some(PiecewiseLinearLaw { is_once, ..bend })
}

/// Returns the best bend with what it leaves of held-out rows in µm RMS.
fn search_best_law(
    data: &ThermalData,
    mode: ThermalMode,
    groups: Option<&[usize]>,
    lines_lag_s: f64,
) -> Option<(f64, PiecewiseLinearLaw)> {
    let used: Vec<usize> = (0..data.y.len()).filter(|row| !data.y[*row].is_nan()).collect();
    let rows: Vec<usize> =
        used.iter().copied().step_by(used.len().div_ceil(MAX_SEARCHED_ROWS).max(1)).collect();
    let pick =
        |of: &[f64]| -> Vec<f64> { rows.iter().filter_map(|row| of.get(*row)).copied().collect() };
    let groups: Option<Vec<usize>> = groups.map(|of| rows.iter().map(|row| of[*row]).collect());
    let (y, arm_m) = (pick(&data.y), pick(&data.arm_m));
    let mut lags: Vec<f64> = [0.0, 0.5, 1.0, 2.0].iter().map(|share| share * lines_lag_s).collect();
    lags.dedup();
    let mut found: Vec<(f64, PiecewiseLinearLaw)> = Vec::new();
    for lag_s in lags {
        let trial = FixedLagData {
            lagged_c: pick(&data.lagged_temperatures_c(lag_s)),
            arm_m: &arm_m,
            y: &y,
            mode,
        };
        let tables =
            TABLE_ROW_COUNTS.iter().map(|count| trial.evenly_spaced_temperatures_c(*count));
        for knots_c in trial.find_best_kink_knots_c().into_iter().chain(tables) {
            if let Some(rms_um) = trial.held_out_rms_um(&knots_c, groups.as_deref()) {
                found.push((rms_um, PiecewiseLinearLaw { knots_c, lag_s, is_once: false }));
            }
        }
    }
    let best = found.iter().map(|(rms_um, _)| *rms_um).min_by(f64::total_cmp)?;
    found.retain(|(rms_um, _)| *rms_um <= (1.0 + MIN_RELATIVE_EXTRA_ROW_GAIN) * best);
    found.sort_by(|a, b| a.1.knots_c.len().cmp(&b.1.knots_c.len()).then(a.0.total_cmp(&b.0)));
    found.into_iter().next()
}

/// The rows that are looked at, at one lag.
struct FixedLagData<'d> {
    lagged_c: Vec<f64>,
    arm_m: &'d [f64],
    y: &'d [f64],
    mode: ThermalMode,
}

impl FixedLagData<'_> {
    /// Returns the coldest and the warmest temperature.
    fn temperature_range_c(&self) -> (f64, f64) {
        let fold = |(low, high): (f64, f64), t: &f64| (low.min(*t), high.max(*t));
        self.lagged_c.iter().fold((f64::INFINITY, f64::NEG_INFINITY), fold)
    }

    /// Returns `count` temperatures at equal steps from the coldest to the warmest.
    fn evenly_spaced_temperatures_c(&self, count: usize) -> Vec<f64> {
        let (low, high) = self.temperature_range_c();
        (0..count).map(|at| low + (high - low) * at as f64 / (count - 1) as f64).collect()
    }

    fn design_columns(&self, knots_c: &[f64]) -> Vec<Vec<f64>> {
        thermal_table::design_columns(&self.lagged_c, self.arm_m, self.mode, knots_c)
    }

    /// Returns the best kink: by sixteenths first, then around the best of them.
    fn find_best_kink_knots_c(&self) -> Option<Vec<f64>> {
        let (low, high) = self.temperature_range_c();
        let part = 1.0 / KINK_GRID_INTERVALS as f64;
        let mut best: Option<(f64, f64)> = None;
        let look = |share: f64, best: &mut Option<(f64, f64)>| {
            let knots_c = [low, low + share * (high - low), high];
            let left =
                pooled_rows::solve_least_squares(&self.design_columns(&knots_c), self.y, |_| true);
            let left = left.map_or(f64::INFINITY, |solution| solution.residual_squares);
            if best.is_none_or(|(least, _)| left < least) {
                *best = Some((left, share));
            }
        };
        (1..KINK_GRID_INTERVALS).for_each(|at| look(part * at as f64, &mut best));
        for step in [0.5 * part, 0.25 * part, 0.125 * part] {
            let (_, middle) = best?;
            look(middle - step, &mut best);
            look(middle + step, &mut best);
        }
        let (left, share) = best?;
        left.is_finite().then(|| vec![low, low + share * (high - low), high])
    }

    /// Returns what a table with these rows leaves of held-out rows, in µm RMS; `None` where the rows do
    /// not decide it.
    fn held_out_rms_um(&self, knots_c: &[f64], groups: Option<&[usize]>) -> Option<f64> {
        let columns = self.design_columns(knots_c);
        if self.y.len() < MIN_ROWS_PER_VALUE * columns.len() {
            return None;
        }
        let held_out = pooled_rows::held_out_residuals(&columns, self.y, groups)?;
        ResidualStatistics::from_residuals(&held_out).map(|spread| spread.rms_um)
    }
}
