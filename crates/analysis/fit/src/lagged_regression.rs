//! A linear law of a temperature that lags its sensor: the lag is searched, the rest is linear.
//!
//! ```text
//! y = Σ cⱼ·fⱼ,   fⱼ = position or 1, times 1 or (L_τ(T) − T̄)
//! ```
//!
//! L_τ is the model's own lag (`trueup_machine::model::Lag`), stepped through the rows. τ = 0 is
//! tried first. A lag is kept only if held-out parts of the run are better with it (on the rows that
//! are fitted it always is), the fitted rows show it beyond chance, and a run is as long.

use trueup_machine::model::Lag;
use trueup_numerics::{
    least_squares::{
        QrSolution, SeparableModel, SolverOptions, fit_separable, separable::geometric_sequence,
    },
    robust::{self, Outlier},
};

use crate::{pooled_rows, report::FitParameter};

/// Points of the grid over the lag.
const LAG_GRID_POINTS: usize = 25;
/// A lag is needed beyond this probability of chance.
const LAG_CONFIDENCE_LEVEL: f64 = 0.99;
/// On held-out rows a lag must be better by this share to be kept.
const MIN_RELATIVE_LAG_GAIN: f64 = 0.02;

/// One column of the law.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RegressionTerm {
    /// 1 in each row: a constant of the law.
    Constant,
    /// L_τ(T) − T̄, in °C.
    LaggedTemperature,
    /// The position, in mm.
    Position,
    /// The position times L_τ(T) − T̄, in mm·°C.
    PositionTimesTemperature,
}

/// The law's columns.
pub(crate) struct LaggedRegression<'a> {
    time_s: Option<&'a [f64]>,
    temperature_c: &'a [f64],
    starts: &'a [bool],
    terms: &'a [RegressionTerm],
    positions: &'a [f64],
    /// T̄: near the middle of what was measured, so that the columns are far from dependent.
    pub(crate) mean_c: f64,
}

/// A fitted law.
pub(crate) struct LaggedFit {
    /// τ; 0 without a lag.
    pub(crate) lag_s: f64,
    /// From τ to either end of its interval.
    lag_half_width: Option<f64>,
    /// Of the columns, in their order.
    pub(crate) coefficients: Vec<f64>,
    linear: QrSolution,
    pub(crate) residuals: Vec<f64>,
    pub(crate) held_out: Option<Vec<f64>>,
    /// A warning about the lag.
    pub(crate) warning: Option<String>,
}

impl LaggedFit {
    /// Returns whether its further constants leave less of the same rows than `simpler` by more than chance explains with
    /// this probability (F).
    pub(crate) fn is_significantly_better_than(&self, simpler: &Self, confidence: f64) -> bool {
        let wider = pooled_rows::autocorrelation_inflation_factor(&self.residuals);
        let squares = |fit: &Self| {
            fit.residuals.iter().filter(|um| !um.is_nan()).map(|um| um * um).sum::<f64>()
        };
        let constants =
            |fit: &Self| fit.coefficients.len() as f64 + f64::from(u8::from(fit.lag_s > 0.0));
        let more = (constants(self) - constants(simpler)).max(1.0);
        let rows = self.residuals.iter().filter(|um| !um.is_nan()).count() as f64;
        let degrees = rows - constants(self);
        let gained = (squares(simpler) - squares(self)) / (wider * wider);
        pooled_rows::f_test_p_value((gained, more), (squares(self), degrees))
            .is_some_and(|p| p < 1.0 - confidence)
    }
}

impl<'a> LaggedRegression<'a> {
    /// `positions` are in units that are near 1, and may be empty where no term needs them. States
    /// start again at `starts`.
    pub(crate) fn new(
        time_s: Option<&'a [f64]>,
        temperature_c: &'a [f64],
        starts: &'a [bool],
        terms: &'a [RegressionTerm],
        positions: &'a [f64],
    ) -> Self {
        let present = || temperature_c.iter().filter(|t| !t.is_nan());
        let mean_c = present().sum::<f64>() / present().count().max(1) as f64;
        Self { time_s, temperature_c, starts, terms, positions, mean_c }
    }

    /// L_τ(T) by row.
    pub(crate) fn lagged_temperatures_c(&self, lag_s: f64) -> Vec<f64> {
        let mut lagged = vec![0.0; self.temperature_c.len()];
        self.apply_lag(lag_s, &mut lagged);
        lagged
    }

    fn apply_lag(&self, lag_s: f64, lagged: &mut [f64]) {
        let mut lag = Lag::default();
        for (row, lagged) in lagged.iter_mut().enumerate() {
            if self.starts[row] {
                lag = Lag::default();
            }
            let time_s = self.time_s.map_or(f64::NAN, |time_s| time_s[row]);
            *lagged = lag.step(lag_s, time_s, self.temperature_c[row]);
        }
    }

    /// Returns the columns at `lag_s`. No more than these and one more stand in memory.
    pub(crate) fn design_columns(&self, lag_s: f64) -> Vec<Vec<f64>> {
        let mut columns = vec![vec![0.0; self.temperature_c.len()]; self.terms.len()];
        self.fill_columns(lag_s, &mut columns);
        columns
    }

    fn fill_columns(&self, lag_s: f64, columns: &mut [Vec<f64>]) {
        let lagged = self.lagged_temperatures_c(lag_s);
        for (column, term) in columns.iter_mut().zip(self.terms) {
            for (row, value) in column.iter_mut().enumerate() {
                let warm = lagged[row] - self.mean_c;
                *value = match term {
                    RegressionTerm::Constant => 1.0,
                    RegressionTerm::LaggedTemperature => warm,
                    RegressionTerm::Position => self.positions[row],
                    RegressionTerm::PositionTimesTemperature => self.positions[row] * warm,
                };
            }
        }
    }

    /// Returns the best fit, with a lag if it is worth it; `None` where the columns do not decide one.
    pub(crate) fn fit(&self, y: &[f64], groups: Option<&[usize]>) -> Option<LaggedFit> {
        let columns = self.design_columns(0.0);
        let linear = pooled_rows::solve_least_squares(&columns, y, |_| true)?;
        let residuals = pooled_rows::compute_residuals(&columns, y, &linear);
        let held_out = pooled_rows::held_out_residuals(&columns, y, groups);
        let plain = LaggedFit {
            lag_s: 0.0,
            lag_half_width: None,
            coefficients: linear.coefficients.clone(),
            linear,
            residuals,
            held_out,
            warning: None,
        };
        drop(columns);
        let Some((grid, longest_s)) = self.lag_grid(y) else { return Some(plain) };
        let (Some(groups), Some(plain_rms)) = (groups, residual_rms_um(plain.held_out.as_deref()))
        else {
            return Some(plain);
        };
        let Some(mut lagged) = self.fit_lag(y, &grid) else { return Some(plain) };
        // Without a part the lag is another, but not by far.
        let near: Vec<Vec<f64>> =
            [0.25, 0.5, 1.0, 2.0, 4.0].iter().map(|share| vec![share * lagged.lag_s]).collect();
        let held_out = pooled_rows::leave_one_group_out_residuals(y, groups, |y, group| {
            let hidden: Vec<f64> = y
                .iter()
                .zip(groups)
                .map(|(y, of)| if *of == group { f64::NAN } else { *y })
                .collect();
            let fitted = self.fit_lag(&hidden, &near)?;
            Some(pooled_rows::compute_residuals(
                &self.design_columns(fitted.lag_s),
                y,
                &fitted.linear_solution(),
            ))
        });
        let lagged_rms = residual_rms_um(held_out.as_deref());
        lagged.held_out = held_out;
        let (in_plain, in_lagged) =
            (residual_rms_um(Some(&plain.residuals)), residual_rms_um(Some(&lagged.residuals)));
        let lag_s = lagged.lag_s;
        let is_worse = lagged_rms.is_none_or(|rms| rms > (1.0 - MIN_RELATIVE_LAG_GAIN) * plain_rms);
        let reason = if lag_s > longest_s {
            Some(format!("No run is that long; the longest has {longest_s:.0} s"))
        } else if is_worse {
            Some(format!(
                "It does not fit held-out rows better ({:.3} instead of {plain_rms:.3})",
                lagged_rms.unwrap_or(f64::NAN)
            ))
        } else if !lagged.is_significantly_better_than(&plain, LAG_CONFIDENCE_LEVEL) {
            Some("That may be chance: the rows are few, or neighbours are alike".into())
        } else {
            None
        };
        if let Some(reason) = reason {
            let mut plain = plain;
            if let (Some(in_plain), Some(in_lagged)) = (in_plain, in_lagged)
                && in_lagged < 0.8 * in_plain
            {
                plain.warning = Some(format!(
                    "a lag of {lag_s:.0} s would fit these rows better ({in_lagged:.3} instead \
                     of {in_plain:.3} µm RMS). {reason}, so no lag is used"
                ));
            }
            return Some(plain);
        }
        let is_known = lagged.lag_half_width.is_some_and(|half| half < 0.5 * lag_s);
        if !is_known || lag_s > 0.5 * longest_s {
            lagged.warning = Some(format!(
                "the lag of {lag_s:.0} s is not well decided by a run of {longest_s:.0} s"
            ));
        }
        Some(lagged)
    }

    /// Lags to try, and the longest run's duration; `None` without times.
    fn lag_grid(&self, y: &[f64]) -> Option<(Vec<Vec<f64>>, f64)> {
        let time_s = self.time_s?;
        let (mut longest_s, mut start, mut intervals) = (0.0_f64, f64::NAN, Vec::new());
        let mut before = f64::NAN;
        for (row, &time) in
            time_s.iter().enumerate().filter(|(row, t)| !t.is_nan() && !y[*row].is_nan())
        {
            if self.starts[row] || start.is_nan() || time < before {
                (start, before) = (time, f64::NAN);
            }
            longest_s = longest_s.max(time - start);
            if time > before {
                intervals.push(time - before);
            }
            before = time;
        }
        let middle = intervals.len() / 2;
        if intervals.is_empty() || longest_s <= 0.0 {
            return None;
        }
        let (_, &mut interval, _) = intervals.select_nth_unstable_by(middle, f64::total_cmp);
        let points = geometric_sequence(interval, longest_s.max(4.0 * interval), LAG_GRID_POINTS);
        Some((points.into_iter().map(|lag_s| vec![lag_s]).collect(), longest_s))
    }

    fn fit_lag(&self, y: &[f64], grid: &[Vec<f64>]) -> Option<LaggedFit> {
        let options =
            SolverOptions { patience: 60, first_steps: vec![1.0], followed: 1, tolerance: 1e-12 };
        let fit = fit_separable(self, y, grid, &options).ok()?;
        let (lag_s, coefficients) = (fit.parameters[0], fit.parameters[1..].to_vec());
        Some(LaggedFit {
            lag_s,
            lag_half_width: Some(fit.confidence_half_width(0)),
            coefficients,
            linear: fit.linear.ok()?,
            residuals: fit.residuals,
            held_out: None,
            warning: None,
        })
    }
}

impl SeparableModel for LaggedRegression<'_> {
    fn nonlinear_count(&self) -> usize {
        1
    }

    fn linear_count(&self) -> usize {
        self.terms.len()
    }

    fn basis(&self, q: &[f64], columns: &mut [Vec<f64>]) -> bool {
        if q[0] <= 0.0 {
            return false;
        }
        self.fill_columns(q[0], columns);
        true
    }
}

impl LaggedFit {
    /// From coefficient `at` to either end of its interval.
    pub(crate) fn coefficient_half_width(&self, at: usize) -> f64 {
        self.linear.confidence_half_width(at + usize::from(self.lag_half_width.is_some()))
    }

    /// Returns the same of a function of the coefficients with this gradient.
    pub(crate) fn half_width_for_gradient(&self, gradient: &[f64]) -> f64 {
        let lag = if self.lag_half_width.is_some() { vec![0.0] } else { Vec::new() };
        self.linear.half_width_for_gradient(&[&lag, gradient].concat())
    }

    pub(crate) fn lag_parameter(&self, wider: f64) -> FitParameter {
        match self.lag_half_width {
            Some(half) => FitParameter::fitted("lag_s", self.lag_s, wider * half),
            None => FitParameter::fixed("lag_s", 0.0),
        }
    }

    /// Returns the coefficients alone, to evaluate the columns with.
    fn linear_solution(&self) -> QrSolution {
        let mut linear = self.linear.clone();
        linear.coefficients.clone_from(&self.coefficients);
        linear
    }
}

fn residual_rms_um(residuals: Option<&[f64]>) -> Option<f64> {
    crate::report::ResidualStatistics::from_residuals(residuals?).map(|spread| spread.rms_um)
}

/// Gross errors of a series that starts again at `starts`.
pub(crate) fn find_outliers(time_s: &[f64], starts: &[bool], y: &[f64]) -> Vec<Outlier> {
    let mut found = Vec::new();
    let mut first = 0;
    for end in 1..=y.len() {
        if end == y.len() || starts[end] {
            let part = robust::find_series_outliers(&time_s[first..end], &y[first..end]);
            found.extend(part.into_iter().map(|o| Outlier { row: o.row + first, ..o }));
            first = end;
        }
    }
    found
}
