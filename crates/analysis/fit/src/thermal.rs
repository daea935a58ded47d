//! `[axis.x.thermal]`: how an axis grows with a temperature.
//!
//! ```text
//! Δ = K₀(T) + tanβ(T)·(P − P₀),   K₀ = a·(T − T₀),   tanβ = b·(T − T₀)
//! ```
//!
//! T is behind its sensor by a lag, which is searched ([`ThermalFitOptions`], and only kept where rows that
//! were held out are better with it). Each of K₀ and tanβ is fitted as a line over T; where it
//! crosses zero is T₀. If both modes count and the two lines cross zero at different temperatures,
//! beyond what chance does, one T₀ cannot serve both, and a table of the same two lines is written
//! instead. A table of more rows is fitted as its own interpolation (least squares of hat functions
//! over T), so that it need not pass through the levels' own noise, and no level need be exactly
//! constant.
//!
//! The report says what cannot be distinguished: a constant error per metre that the axis has at every
//! temperature shifts T₀, and so does the arbitrary zero of an instrument where K₀ counts.
//!
//! No matrix has a row for each observation and a column for each parameter more than once: a run
//! of 10⁶ rows is fitted in a process of 281 MB, the run and its text included (the ignored test
//! `a_million_rows_are_fitted`).

mod outliers;
mod piecewise_linear;
mod section;
mod thermal_table;

use trueup_machine::{
    InputFileError, Machine,
    applied_offsets::UncompensatedRun,
    machine_file::writer::MachineFileEdit,
    machine_file::{LinearAxis, ThermalLaw, ThermalMode, ThermalRow},
    model::thermal_error_um,
};
use trueup_numerics::{
    least_squares::{self, fit_separable},
    t_quantile,
};

use self::{
    section::{report_inseparable_constants, thermal_section},
    thermal_table::FittedTable,
};
use crate::{
    elongation::{
        add_residual_statistics, reject_insufficient_input, resolve_temperature_column,
        set_fit_verdict,
    },
    lagged_regression::{LaggedFit, LaggedRegression, RegressionTerm},
    pooled_rows::{self, PooledRows},
    report::{FitDetail, FitParameter, FitReport, ResidualStatistics},
};

/// Two T₀ differ, or a table or both terms are needed, beyond this probability of chance.
const CONFIDENCE_LEVEL: f64 = 0.999;

/// The terms, the column and the form of the fit.
#[derive(Clone, Debug, Default)]
pub struct ThermalFitOptions {
    /// Which terms; `None`: the machine file's, else what held-out rows favour.
    pub mode: Option<ThermalMode>,
    /// The column of the temperature; `None`: the machine file's, else the run's only one.
    pub temperature: Option<String>,
    /// The rows of a table, at least 2; `None`: constants, unless runs at three temperatures or
    /// more do not lie on a line.
    pub table_rows: Option<usize>,
    /// The prediction of the other sections of the machine file for each row of all runs, in µm: it is taken
    /// off before the fit.
    pub known_um: Option<Vec<f64>>,
}

/// The columns of the runs.
struct ThermalData {
    measured: String,
    sensor: String,
    temperature_c: Vec<f64>,
    time_s: Option<Vec<f64>>,
    starts: Vec<bool>,
    /// P − P₀ in m; empty without positions, or where all are equal and no mode requires them.
    arm_m: Vec<f64>,
    /// NaN where the row takes no part.
    y: Vec<f64>,
    origin_mm: f64,
}

/// Fits the thermal law of `axis` from `measured_d<axis>_um`, a temperature, and `<axis>_mm`.
///
/// # Errors
/// A column is missing, too few rows have all values, the temperature is the same in every row, or
/// the positions do not decide the mode that is requested.
pub fn fit(
    runs: &[UncompensatedRun<'_>],
    axis: LinearAxis,
    machine: Option<&Machine>,
    options: &ThermalFitOptions,
) -> Result<FitReport, InputFileError> {
    let rows = PooledRows::new(runs)?;
    let old = machine.and_then(|machine| machine.axes[axis.index()].thermal.as_ref());
    let (mut data, mut report) = ThermalData::from_rows_with_report(&rows, axis, old, options)?;
    let requested = options.mode.or(old.map(|old| old.mode));
    data.exclude_outliers(&rows, &mut report);
    let is_used: Vec<bool> = data.y.iter().map(|y| !y.is_nan()).collect();
    reject_insufficient_input(&rows, &data.sensor, &data.temperature_c, &is_used, 4)?;

    let (groups, by) = rows.cross_validation_groups(&is_used);
    let (mode, fitted, mean_c) = data.choose_and_fit_mode(&rows, requested, groups.as_deref())?;
    let wider = pooled_rows::autocorrelation_inflation_factor(&fitted.residuals);
    report.facts.push(FitDetail::text("mode", mode.name()));
    report.facts.push(FitDetail::text("sensor", data.sensor.clone()));
    report.warnings.extend(fitted.warning.clone());
    if let Some(old) = old.filter(|old| old.sensor == data.sensor) {
        let of_old = data.residuals(old);
        if let Some(old) = ResidualStatistics::from_residuals(&of_old) {
            report.facts.push(FitDetail::number("machine_file_rms_um", old.rms_um));
            report.facts.push(FitDetail::number("machine_file_max_um", old.max_um));
        }
    }

    let law = LinearLaw { mode, fitted: &fitted, mean_c, wider };
    let mut thermal = law.derive_and_report_constants(&data, &mut report);
    let levels = thermal_table::temperature_levels_c(&rows, &data);
    if let Some(table) = FittedTable::fit(&data, mode, fitted.lag_s, &levels, options.table_rows) {
        let is_better =
            table.is_better_than_lines(&fitted.residuals, thermal.table.is_some(), mode, wider);
        if options.table_rows.is_some() || is_better {
            table.add_to_report(&mut report, mode);
            thermal.table = Some(table.rows);
        }
    } else if options.table_rows.is_none()
        && let Some((bend, table)) =
            fit_piecewise_linear_law(&data, mode, &fitted, groups.as_deref())
    {
        if bend.lag_s != fitted.lag_s {
            report.parameters.retain(|parameter| parameter.name != "lag_s");
            report.parameters.push(FitParameter::fixed("lag_s", bend.lag_s));
        }
        table.add_to_report(&mut report, mode);
        report.warnings.push(format!(
            "the growth is no line over the temperature: it is written as a table of {} rows, which \
             held-out rows are better with",
            bend.knots_c.len()
        ));
        if bend.is_once {
            report.warnings.push(
                "some of the temperatures were there in one part of the record only. Another \
                 change at that time would look the same. Pass through them again"
                    .into(),
            );
        }
        thermal.lag_s = bend.lag_s;
        thermal.table = Some(table.rows);
    } else if options.table_rows.is_some() {
        let rule = format!(
            "the rows do not decide a table of {} temperatures between the coldest and the warmest",
            options.table_rows.unwrap_or_default()
        );
        return Err(rows.input_error(rule));
    }

    let residuals = data.residuals(&thermal);
    // Groups are the same whatever the form of the law, so the held-out rows of the two lines stand
    // for it; a table is held out on its own.
    let (held_out, by) = match &thermal.table {
        Some(table) if table.len() > 2 => {
            let knots: Vec<f64> = table.iter().map(|row| row.temperature_c).collect();
            thermal_table::held_out_residuals(
                &data,
                mode,
                thermal.lag_s,
                &knots,
                (groups.as_deref(), by),
            )
        }
        _ => (fitted.held_out.clone(), by),
    };
    add_residual_statistics(&mut report, &data.y, &residuals, held_out, by, wider);
    set_fit_verdict(&mut report, &data.y, groups.as_deref());
    report_inseparable_constants(&mut report, mode, thermal.table.is_some());
    if report.verdict.is_usable() {
        report.edit = MachineFileEdit::from_section(thermal_section(axis, &thermal, &report));
    }
    Ok(report)
}

/// Returns the bend of the law and its table, where held-out rows are clearly better with it.
fn fit_piecewise_linear_law(
    data: &ThermalData,
    mode: ThermalMode,
    lines: &LaggedFit,
    groups: Option<&[usize]>,
) -> Option<(piecewise_linear::PiecewiseLinearLaw, FittedTable)> {
    let bend = piecewise_linear::find_piecewise_linear_law(data, mode, groups, lines)?;
    let table = FittedTable::fit_with_knots(data, mode, bend.lag_s, &bend.knots_c)?;
    Some((bend, table))
}

impl ThermalData {
    fn from_rows_with_report(
        rows: &PooledRows<'_>,
        axis: LinearAxis,
        old: Option<&ThermalLaw>,
        options: &ThermalFitOptions,
    ) -> Result<(Self, FitReport), InputFileError> {
        let measured = format!("measured_d{}_um", axis.name());
        let mut y = rows.require_column(&measured)?;
        let requested = options.temperature.clone().or(old.map(|old| old.sensor.clone()));
        let sensor = resolve_temperature_column(rows, requested)?;
        let temperature_c = rows.require_column(&sensor)?;
        let time_s = rows.optional_column("time_s")?;
        let starts = rows.restart_flags(time_s.as_deref());
        let position = axis.column_name();
        let requested_mode = options.mode.or(old.map(|old| old.mode));
        let needs_position = requested_mode.is_some_and(ThermalMode::has_position_term);
        let positions = if needs_position {
            Some(rows.require_column(&position)?)
        } else {
            rows.optional_column(&position)?
        };
        if let Some(known_um) = &options.known_um {
            y.iter_mut().zip(known_um).for_each(|(y, known)| *y -= known);
        }
        let incomplete = |row: usize| {
            temperature_c[row].is_nan()
                || time_s.as_ref().is_some_and(|time_s| time_s[row].is_nan())
                || positions.as_ref().is_some_and(|positions| positions[row].is_nan())
        };
        (0..y.len()).filter(|row| incomplete(*row)).for_each(|row| y[row] = f64::NAN);
        let is_used: Vec<bool> = y.iter().map(|y| !y.is_nan()).collect();
        reject_insufficient_input(rows, &sensor, &temperature_c, &is_used, 4)?;
        let origin_mm = old.map_or(0.0, |old| old.origin_mm);
        let mut used = positions.iter().flatten().zip(&is_used).filter(|(_, used)| **used);
        let first = used.next().map(|(position, _)| *position);
        let varies = used.any(|(position, _)| Some(*position) != first);
        let arm_m = match positions {
            Some(positions) if varies || needs_position => {
                positions.into_iter().map(|p| (p - origin_mm) / 1000.0).collect()
            }
            _ => Vec::new(),
        };
        let mut report = FitReport::new("thermal", measured.clone());
        report.rows_incomplete = is_used.iter().filter(|used| !**used).count();
        let data = Self { measured, sensor, temperature_c, time_s, starts, arm_m, y, origin_mm };
        Ok((data, report))
    }

    /// Returns whether the positions that are used differ.
    fn has_varying_positions(&self) -> bool {
        let mut used = self.arm_m.iter().zip(&self.y).filter(|(_, y)| !y.is_nan());
        let first = used.next().map(|(arm, _)| *arm);
        used.any(|(arm, _)| Some(*arm) != first)
    }

    /// Returns the required mode, else the simplest that held-out rows do not clearly disfavour.
    fn choose_and_fit_mode(
        &self,
        rows: &PooledRows<'_>,
        requested: Option<ThermalMode>,
        groups: Option<&[usize]>,
    ) -> Result<(ThermalMode, LaggedFit, f64), InputFileError> {
        /// A mode with more terms must be better by more than chance, and on held-out rows by this share.
        const MIN_RELATIVE_MODE_GAIN: f64 = 0.05;
        let all = [ThermalMode::Position, ThermalMode::Constant, ThermalMode::Both];
        let modes: Vec<ThermalMode> = match requested {
            Some(mode) => vec![mode],
            None if self.has_varying_positions() => all.to_vec(),
            None => vec![ThermalMode::Constant],
        };
        let mut best: Option<(f64, ThermalMode, LaggedFit, f64)> = None;
        for mode in modes {
            let terms = mode_terms(mode);
            let design = LaggedRegression::new(
                self.time_s.as_deref(),
                &self.temperature_c,
                &self.starts,
                terms,
                &self.arm_m,
            );
            let Some(fitted) = design.fit(&self.y, groups) else { continue };
            // Both are worth it only where each of them is known to be there.
            let wider = pooled_rows::autocorrelation_inflation_factor(&fitted.residuals);
            let is_there = |at: usize| {
                let size = fitted.coefficients[at].abs();
                size > wider * fitted.coefficient_half_width(at)
            };
            let is_better = |(_, _, simpler, _): &(f64, ThermalMode, LaggedFit, f64)| {
                fitted.is_significantly_better_than(simpler, CONFIDENCE_LEVEL)
            };
            let is_needed = || is_there(1) && is_there(3) && best.as_ref().is_none_or(is_better);
            if mode == ThermalMode::Both && requested.is_none() && !is_needed() {
                continue;
            }
            let held_out = fitted.held_out.as_deref().and_then(ResidualStatistics::from_residuals);
            let judged = held_out
                .or(ResidualStatistics::from_residuals(&fitted.residuals))
                .map_or(f64::NAN, |s| s.rms_um);
            // Position and constant have as many terms: the better one. Both must be worth it.
            let share = if mode == ThermalMode::Both { 1.0 - MIN_RELATIVE_MODE_GAIN } else { 1.0 };
            if best.as_ref().is_none_or(|(least, ..)| judged < share * least) {
                best = Some((judged, mode, fitted, design.mean_c));
            }
        }
        let Some((_, mode, fitted, mean_c)) = best else {
            let rule = format!(
                "the temperatures and positions do not decide mode \"{}\": it needs several \
                 temperatures{}",
                requested.unwrap_or(ThermalMode::Constant).name(),
                if requested == Some(ThermalMode::Constant) {
                    ""
                } else {
                    " and several positions"
                }
            );
            return Err(rows.input_error(rule));
        };
        Ok((mode, fitted, mean_c))
    }

    /// L_τ(T) by row.
    fn lagged_temperatures_c(&self, lag_s: f64) -> Vec<f64> {
        LaggedRegression::new(self.time_s.as_deref(), &self.temperature_c, &self.starts, &[], &[])
            .lagged_temperatures_c(lag_s)
    }

    /// Measured minus `thermal`, by row, as the model itself has it.
    fn residuals(&self, thermal: &ThermalLaw) -> Vec<f64> {
        let lagged_c = self.lagged_temperatures_c(thermal.lag_s);
        let residual = |(row, y): (usize, &f64)| {
            let arm_m = self.arm_m.get(row).copied().unwrap_or(f64::NAN);
            y - thermal_error_um(thermal, lagged_c[row], self.origin_mm + 1000.0 * arm_m)
        };
        self.y.iter().enumerate().map(residual).collect()
    }
}

/// Returns the columns of a mode, K₀'s first.
fn mode_terms(mode: ThermalMode) -> &'static [RegressionTerm] {
    match mode {
        ThermalMode::Constant => &[RegressionTerm::Constant, RegressionTerm::LaggedTemperature],
        ThermalMode::Position => {
            &[RegressionTerm::Position, RegressionTerm::PositionTimesTemperature]
        }
        ThermalMode::Both => &[
            RegressionTerm::Constant,
            RegressionTerm::LaggedTemperature,
            RegressionTerm::Position,
            RegressionTerm::PositionTimesTemperature,
        ],
    }
}

/// Lines over T, and what becomes of them in the machine file.
struct LinearLaw<'f> {
    mode: ThermalMode,
    fitted: &'f LaggedFit,
    mean_c: f64,
    wider: f64,
}

impl LinearLaw<'_> {
    /// T₀ of the line in columns `at` and `at + 1`, and the half width of its interval.
    fn reference_temperature_with_half_width(&self, at: usize) -> (f64, f64) {
        let (height, slope) = (self.fitted.coefficients[at], self.fitted.coefficients[at + 1]);
        let mut gradient = vec![0.0; self.fitted.coefficients.len()];
        gradient[at] = -1.0 / slope;
        gradient[at + 1] = height / (slope * slope);
        (self.mean_c - height / slope, self.wider * self.fitted.half_width_for_gradient(&gradient))
    }

    /// Returns the machine file's constants, reported; a table of two rows where one T₀ cannot serve.
    fn derive_and_report_constants(
        &self,
        data: &ThermalData,
        report: &mut FitReport,
    ) -> ThermalLaw {
        let c = &self.fitted.coefficients;
        let half = |at: usize| self.wider * self.fitted.coefficient_half_width(at);
        let mut thermal = ThermalLaw {
            mode: self.mode,
            sensor: data.sensor.clone(),
            reference_c: 0.0,
            constant_um_per_c: 0.0,
            slope_um_per_m_per_c: 0.0,
            origin_mm: data.origin_mm,
            lag_s: self.fitted.lag_s,
            table: None,
        };
        let (name_of_a, name_of_b) = ("constant_um_per_c", "slope_um_per_m_per_c");
        let parameters = &mut report.parameters;
        if self.mode != ThermalMode::Both {
            let (reference_c, reference_half) = self.reference_temperature_with_half_width(0);
            thermal.reference_c = reference_c;
            let name = match self.mode {
                ThermalMode::Constant => {
                    thermal.constant_um_per_c = c[1];
                    name_of_a
                }
                _ => {
                    thermal.slope_um_per_m_per_c = c[1];
                    name_of_b
                }
            };
            parameters.push(FitParameter::amplitude(name, c[1], half(1)));
            parameters.push(FitParameter::fitted("reference_c", reference_c, reference_half));
            parameters.push(FitParameter::fixed("origin_mm", data.origin_mm));
        } else {
            // a and b with one T₀: where a₀ + a·T and b₀ + b·T are zero together, a₀·b = b₀·a. The
            // difference of the two sides is a contrast whose size has its own interval.
            let contrast = c[0] * c[3] - c[2] * c[1];
            let gradient = [c[3], -c[2], -c[1], c[0]];
            let half_contrast = self.wider * self.fitted.half_width_for_gradient(&gradient);
            let limit = half_contrast * t_quantile(0.5 + CONFIDENCE_LEVEL / 2.0, 1e6)
                / t_quantile(0.975, 1e6);
            if contrast.abs() > limit {
                let rows = two_row_table(data, self, c);
                for row in &rows {
                    let at = format!("at {:.3} degC", row.temperature_c);
                    let dt = row.temperature_c - self.mean_c;
                    let k0 = self.wider * self.fitted.half_width_for_gradient(&[1.0, dt, 0.0, 0.0]);
                    let slope =
                        self.wider * self.fitted.half_width_for_gradient(&[0.0, 0.0, 1.0, dt]);
                    let name = format!("constant_um {at}");
                    parameters.push(FitParameter::fitted(name, row.constant_um, k0));
                    let name = format!("slope_um_per_m {at}");
                    parameters.push(FitParameter::fitted(name, row.slope_um_per_m, slope));
                }
                let (of_a, _) = self.reference_temperature_with_half_width(0);
                let (of_b, _) = self.reference_temperature_with_half_width(2);
                report.warnings.push(format!(
                    "the constant part is zero at {of_a:.2} degC and the slope at {of_b:.2} \
                     degC, so one reference_c cannot serve both. They are written as a table, \
                     which is held beyond the temperatures that were measured"
                ));
                thermal.table = Some(rows);
            } else {
                // T₀ from both lines, each by how well it knows it; a and b then follow from the
                // heights at T̄, which are known best.
                let ((of_a, half_a), (of_b, half_b)) = (
                    self.reference_temperature_with_half_width(0),
                    self.reference_temperature_with_half_width(2),
                );
                let (weight_a, weight_b) = (half_a.powi(-2), half_b.powi(-2));
                let reference_c = (weight_a * of_a + weight_b * of_b) / (weight_a + weight_b);
                let solution =
                    fit_common_reference_temperature(data, self.fitted.lag_s, reference_c);
                let (reference_c, a, b, halves) = solution.unwrap_or((
                    reference_c,
                    c[1],
                    c[3],
                    [(weight_a + weight_b).powf(-0.5), half(1), half(3)],
                ));
                thermal.reference_c = reference_c;
                thermal.constant_um_per_c = a;
                thermal.slope_um_per_m_per_c = b;
                parameters.push(FitParameter::amplitude(name_of_a, a, self.wider * halves[1]));
                parameters.push(FitParameter::amplitude(name_of_b, b, self.wider * halves[2]));
                let half = self.wider * halves[0];
                parameters.push(FitParameter::fitted("reference_c", reference_c, half));
                parameters.push(FitParameter::fixed("origin_mm", data.origin_mm));
            }
        }
        report.parameters.push(self.fitted.lag_parameter(self.wider));
        thermal
    }
}

/// T₀, a and b of y = (a + b·P)·(T − T₀), with the half widths of their intervals.
fn fit_common_reference_temperature(
    data: &ThermalData,
    lag_s: f64,
    start_c: f64,
) -> Option<(f64, f64, f64, [f64; 3])> {
    let model = thermal_table::CommonReferenceTemperatureModel {
        lagged_c: data.lagged_temperatures_c(lag_s),
        arm_m: &data.arm_m,
    };
    let options = least_squares::SolverOptions { first_steps: vec![1.0], ..Default::default() };
    let fit = fit_separable(&model, &data.y, &[vec![start_c]], &options).ok()?;
    let half = |at| fit.confidence_half_width(at);
    let &[reference_c, a, b] = fit.parameters.as_slice() else { return None };
    Some((reference_c, a, b, [half(0), half(1), half(2)]))
}

/// Returns the two lines between the coldest and the warmest temperature.
fn two_row_table(data: &ThermalData, law: &LinearLaw<'_>, c: &[f64]) -> Vec<ThermalRow> {
    let lagged_c = data.lagged_temperatures_c(law.fitted.lag_s);
    let used = || lagged_c.iter().zip(&data.y).filter(|(_, y)| !y.is_nan()).map(|(t, _)| *t);
    let ends = [used().fold(f64::INFINITY, f64::min), used().fold(f64::NEG_INFINITY, f64::max)];
    let row = |temperature_c: f64| ThermalRow {
        temperature_c,
        constant_um: c[0] + c[1] * (temperature_c - law.mean_c),
        slope_um_per_m: c[2] + c[3] * (temperature_c - law.mean_c),
    };
    ends.map(row).to_vec()
}
