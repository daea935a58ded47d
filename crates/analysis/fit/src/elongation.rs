//! `[spindle.sensor]` and `[spindle.temperature]`: the spindle's growth from what is measured at it.
//!
//! By the displacement sensor, ΔK = K₀ + (V − V₀)·tanβ: a straight line. V₀ and K₀ are one constant
//! in two places: V₀ is the machine file's where there is one, else the smallest reading of the
//! run, and K₀ is fitted to it. By a temperature, s = k·(T − T₀), T behind its sensor by a lag.
//!
//! Rows far from the rest are found first ([`robust`]) and listed. Where rows are a
//! time series their residuals are correlated, and all intervals are widened by what the
//! correlation of neighbours says.
//!
//! A run of 10⁶ rows is fitted by the sensor in a process of 120 MB, the run and its text included
//! (the ignored test `a_million_rows_are_fitted`).

use trueup_machine::{
    InputFileError, Machine,
    applied_offsets::UncompensatedRun,
    machine_file::writer::{MachineFileEdit, NewSection, Value},
    machine_file::{ElongationSource, SensorModel, is_temperature_column},
    model::elongation_um,
};
use trueup_numerics::{least_squares::QrSolution, robust};

use crate::{
    lagged_regression::{self, LaggedRegression, RegressionTerm},
    pooled_rows::{self, PooledRows},
    report::{FitDetail, FitParameter, FitReport, FitVerdict, ResidualStatistics},
};

/// The column that is explained.
pub(crate) const MEASURED_ELONGATION_COLUMN: &str = "measured_elongation_um";

/// Source and column of the fit.
#[derive(Clone, Debug, Default)]
pub struct ElongationFitOptions {
    /// The sensor or a temperature; `None`: what the machine file's source says, else the sensor
    /// where the run has its column, else its temperature.
    pub source: Option<ElongationSource>,
    /// The column of the temperature; `None`: the machine file's, else the run's only one.
    pub temperature: Option<String>,
}

/// Fits the spindle's growth. `machine` is what the user has so far.
///
/// # Errors
/// A column is missing, too few rows have both values, or the input is the same in every row.
pub fn fit_elongation(
    runs: &[UncompensatedRun<'_>],
    machine: Option<&Machine>,
    options: &ElongationFitOptions,
) -> Result<FitReport, InputFileError> {
    let rows = PooledRows::new(runs)?;
    let by_machine = machine.and_then(|machine| machine.spindle.source);
    let has_counts = runs.iter().any(|run| run.column("sensor_counts").is_some());
    let source =
        options.source.or(options.temperature.as_ref().map(|_| ElongationSource::Temperature));
    match source.or(by_machine) {
        Some(ElongationSource::Temperature) => {
            fit_elongation_by_temperature(&rows, machine, options)
        }
        Some(ElongationSource::Sensor) => fit_elongation_by_sensor(&rows, machine),
        _ if has_counts || rows.common_temperature_columns().is_empty() => {
            fit_elongation_by_sensor(&rows, machine)
        }
        _ => fit_elongation_by_temperature(&rows, machine, options),
    }
}

fn fit_elongation_by_sensor(
    rows: &PooledRows<'_>,
    machine: Option<&Machine>,
) -> Result<FitReport, InputFileError> {
    let counts = rows.require_column("sensor_counts")?;
    let mut y = rows.require_column(MEASURED_ELONGATION_COLUMN)?;
    let is_used: Vec<bool> =
        counts.iter().zip(&y).map(|(v, y)| !v.is_nan() && !y.is_nan()).collect();
    let mut report = FitReport::new("elongation", MEASURED_ELONGATION_COLUMN);
    let old = machine.and_then(|machine| machine.spindle.sensor.as_ref());
    reject_insufficient_input(rows, "sensor_counts", &counts, &is_used, 3)?;
    report.rows_incomplete = is_used.iter().filter(|used| !**used).count();

    let ones = vec![1.0; counts.len()];
    let found = robust::find_regression_outliers(&[&ones, &counts], &y);
    let found = robust::retain_isolated_outliers(found, &counts, &y);
    report.excluded = rows.list_excluded_rows(&found, &y, MEASURED_ELONGATION_COLUMN);
    found.iter().for_each(|outlier| y[outlier.row] = f64::NAN);
    y.iter_mut().zip(&counts).filter(|(_, v)| v.is_nan()).for_each(|(y, _)| *y = f64::NAN);
    let is_used: Vec<bool> = y.iter().map(|y| !y.is_nan()).collect();
    reject_insufficient_input(rows, "sensor_counts", &counts, &is_used, 3)?;

    let smallest = counts.iter().zip(&is_used).filter(|(_, used)| **used).map(|(v, _)| *v);
    let zero_counts =
        old.map_or(smallest.fold(f64::INFINITY, f64::min), |sensor| sensor.zero_counts);
    let columns = vec![ones, counts.iter().map(|v| v - zero_counts).collect()];
    let Some(line) = pooled_rows::solve_least_squares(&columns, &y, |_| true) else {
        return Err(rows.input_error("sensor_counts does not decide a line"));
    };
    let residuals = pooled_rows::compute_residuals(&columns, &y, &line);
    let wider = pooled_rows::autocorrelation_inflation_factor(&residuals);
    let (groups, by) = rows.cross_validation_groups(&is_used);
    let held_out = pooled_rows::held_out_residuals(&columns, &y, groups.as_deref());
    let model = SensorModel {
        k0_um: line.coefficients[0],
        zero_counts,
        um_per_count: line.coefficients[1],
        temperature: None,
    };

    report.parameters = vec![
        FitParameter::fitted("k0_um", model.k0_um, wider * line.confidence_half_width(0)),
        FitParameter::fixed("zero_counts", zero_counts),
        FitParameter::amplitude(
            "um_per_count",
            model.um_per_count,
            wider * line.confidence_half_width(1),
        ),
    ];
    if let Some(old) = old {
        let of_old: Vec<f64> =
            y.iter().zip(&counts).map(|(y, v)| y - elongation_um(old, *v)).collect();
        add_previous_model_statistics(&mut report, &of_old);
    }
    add_residual_statistics(&mut report, &y, &residuals, held_out, by, wider);
    warn_about_curvature(&mut report, &columns, &y, &line);
    set_fit_verdict(&mut report, &y, groups.as_deref());
    if report.verdict.is_usable() {
        let section = NewSection::new("spindle.sensor")
            .with_number("k0_um", model.k0_um)
            .with_number("zero_counts", zero_counts)
            .with_number("um_per_count", model.um_per_count)
            .with_preserved_keys(&["temperature"])
            .with_header_comment(section_comment(&report));
        report.edit = MachineFileEdit::from_section(section);
        report.edit.defaults.push(("spindle".into(), "source", Value::Text("sensor".into())));
        warn_elongation_source_mismatch(&mut report, machine, ElongationSource::Sensor);
    }
    Ok(report)
}

fn fit_elongation_by_temperature(
    rows: &PooledRows<'_>,
    machine: Option<&Machine>,
    options: &ElongationFitOptions,
) -> Result<FitReport, InputFileError> {
    let old = machine.and_then(|machine| machine.spindle.temperature.as_ref());
    let requested = options.temperature.clone().or(old.map(|model| model.sensor.clone()));
    let column = resolve_temperature_column(rows, requested)?;
    let temperature_c = rows.require_column(&column)?;
    let time_s = rows.optional_column("time_s")?;
    let mut y = rows.require_column(MEASURED_ELONGATION_COLUMN)?;
    let mut report = FitReport::new("elongation", MEASURED_ELONGATION_COLUMN);
    let complete = |row: usize, y: &[f64]| {
        !y[row].is_nan()
            && !temperature_c[row].is_nan()
            && time_s.as_ref().is_none_or(|time_s| !time_s[row].is_nan())
    };
    let is_used: Vec<bool> = (0..y.len()).map(|row| complete(row, &y)).collect();
    reject_insufficient_input(rows, &column, &temperature_c, &is_used, 4)?;
    report.rows_incomplete = is_used.iter().filter(|used| !**used).count();
    let found = match &time_s {
        Some(time_s) => {
            lagged_regression::find_outliers(time_s, &rows.restart_flags(Some(time_s)), &y)
        }
        None => {
            let found =
                robust::find_regression_outliers(&[&vec![1.0; y.len()], &temperature_c], &y);
            robust::retain_isolated_outliers(found, &temperature_c, &y)
        }
    };
    report.excluded = rows.list_excluded_rows(&found, &y, MEASURED_ELONGATION_COLUMN);
    found.iter().for_each(|outlier| y[outlier.row] = f64::NAN);
    (0..y.len()).filter(|row| !is_used[*row]).for_each(|row| y[row] = f64::NAN);
    let is_used: Vec<bool> = y.iter().map(|y| !y.is_nan()).collect();
    reject_insufficient_input(rows, &column, &temperature_c, &is_used, 4)?;

    let starts = rows.restart_flags(time_s.as_deref());
    let terms = [RegressionTerm::Constant, RegressionTerm::LaggedTemperature];
    let design = LaggedRegression::new(time_s.as_deref(), &temperature_c, &starts, &terms, &[]);
    let (groups, by) = rows.cross_validation_groups(&is_used);
    let fitted = design
        .fit(&y, groups.as_deref())
        .ok_or_else(|| rows.input_error(format!("{column} does not decide a line")))?;
    let wider = pooled_rows::autocorrelation_inflation_factor(&fitted.residuals);
    let (constant, k) = (fitted.coefficients[0], fitted.coefficients[1]);
    let reference_c = design.mean_c - constant / k;
    // T₀ = T̄ − c/k
    let half = wider * fitted.half_width_for_gradient(&[-1.0 / k, constant / (k * k)]);

    report.parameters = vec![
        FitParameter::amplitude("k_um_per_c", k, wider * fitted.coefficient_half_width(1)),
        FitParameter::fitted("reference_c", reference_c, half),
        fitted.lag_parameter(wider),
    ];
    report.facts.push(FitDetail::text("sensor", column.clone()));
    report.warnings.extend(fitted.warning.clone());
    if let Some(old) = old.filter(|old| old.sensor == column) {
        let lagged_c = design.lagged_temperatures_c(old.lag_s);
        let of_old: Vec<f64> = y
            .iter()
            .zip(&lagged_c)
            .map(|(y, t)| y - trueup_machine::model::temperature_elongation_um(old, *t))
            .collect();
        add_previous_model_statistics(&mut report, &of_old);
    }
    add_residual_statistics(&mut report, &y, &fitted.residuals, fitted.held_out.clone(), by, wider);
    set_fit_verdict(&mut report, &y, groups.as_deref());
    if report.verdict.is_usable() {
        let section = NewSection::new("spindle.temperature")
            .with_text("sensor", column)
            .with_number("reference_c", reference_c)
            .with_number("k_um_per_c", k)
            .with_number("lag_s", fitted.lag_s)
            .with_header_comment(section_comment(&report));
        report.edit = MachineFileEdit::from_section(section);
        report.edit.defaults.push(("spindle".into(), "source", Value::Text("temperature".into())));
        warn_elongation_source_mismatch(&mut report, machine, ElongationSource::Temperature);
    }
    Ok(report)
}

/// Returns the column of the required temperature, else the only one.
pub(crate) fn resolve_temperature_column(
    rows: &PooledRows<'_>,
    requested: Option<String>,
) -> Result<String, InputFileError> {
    if let Some(requested) = requested {
        if !is_temperature_column(&requested) {
            return Err(rows
                .input_error(format!("{requested} is not a temperature column (temp_<name>_c)")));
        }
        return Ok(requested);
    }
    match rows.common_temperature_columns().as_slice() {
        [] => Err(rows.input_error("no temperature column (temp_<name>_c)")),
        [only] => Ok((*only).to_string()),
        several => Err(rows.input_error(format!(
            "name the temperature that explains it with --temperature: there are {}",
            several.join(", ")
        ))),
    }
}

/// Refuses too few rows, and an input that is the same in every row.
pub(crate) fn reject_insufficient_input(
    rows: &PooledRows<'_>,
    column: &str,
    x: &[f64],
    is_used: &[bool],
    least: usize,
) -> Result<(), InputFileError> {
    let mut used = x.iter().zip(is_used).enumerate().filter(|(_, (_, used))| **used);
    let count = used.clone().count();
    if count < least {
        let rule =
            format!("{count} of {} rows are complete: the fit needs at least {least}", x.len());
        return Err(rows.input_error(rule));
    }
    if let Some((first, (value, _))) = used.next()
        && used.all(|(_, (x, _))| x == value)
    {
        let place = rows.value_location(first, column);
        let rule = format!("{column} is {value} in every row: nothing can be fitted to it");
        return Err(InputFileError::new(place, rule));
    }
    Ok(())
}

/// Adds to `report` the figures of the residuals that all fits have.
pub(crate) fn add_residual_statistics(
    report: &mut FitReport,
    y: &[f64],
    residuals: &[f64],
    held_out: Option<Vec<f64>>,
    by: String,
    wider: f64,
) {
    report.rows_used = y.iter().filter(|y| !y.is_nan()).count();
    report.before = ResidualStatistics::from_residuals(y);
    report.in_sample = ResidualStatistics::from_residuals(residuals);
    report.held_out = held_out.and_then(|held_out| ResidualStatistics::from_residuals(&held_out));
    report.held_out_by = by;
    if wider > 1.0 {
        report.facts.push(FitDetail::number("intervals_widened", wider));
    }
    if report.held_out.is_none() {
        report.warnings.push(
            "the constants cannot be judged on held-out rows: without one of the \
             parts the rest does not decide them"
                .into(),
        );
    }
    let outliers = report.excluded.len();
    if outliers * 10 > report.rows_used {
        report.warnings.push(format!(
            "{outliers} rows are excluded as outliers, more than one in ten: check the measurement first"
        ));
    }
}

/// How well the constants of the machine file did on the same rows.
pub(crate) fn add_previous_model_statistics(report: &mut FitReport, residuals: &[f64]) {
    if let Some(old) = ResidualStatistics::from_residuals(residuals) {
        report.facts.push(FitDetail::number("machine_file_rms_um", old.rms_um));
        report.facts.push(FitDetail::number("machine_file_max_um", old.max_um));
    }
}

/// Not to compensate, where the size of the effect may be 0, or where held-out rows are no better with the
/// correction than without it, or than with a constant alone.
pub(crate) fn set_fit_verdict(report: &mut FitReport, y: &[f64], groups: Option<&[usize]>) {
    let mut reasons: Vec<String> = report
        .parameters
        .iter()
        .filter(|parameter| parameter.is_insignificant_amplitude())
        .map(|parameter| {
            format!(
                "{parameter}: 0 is within the interval, so the effect may be none; measure over a larger \
                 range of the input, or more readings"
            )
        })
        .collect();
    if let (Some(before), Some(held_out)) = (report.before, report.held_out) {
        let ones = vec![vec![1.0; y.len()]];
        let constant = pooled_rows::held_out_residuals(&ones, y, groups)
            .and_then(|left| ResidualStatistics::from_residuals(&left));
        let constant = constant.map_or(before.rms_um, |constant| constant.rms_um);
        if held_out.rms_um >= before.rms_um.min(constant) {
            reasons.push(format!(
                "held-out rows ({}) are {:.3} µm RMS away with the correction",
                report.held_out_by, held_out.rms_um
            ));
            reasons.push(format!(
                "they are {:.3} µm RMS without any, and {constant:.3} µm with a constant alone",
                before.rms_um
            ));
        }
    }
    if !reasons.is_empty() {
        report.verdict = FitVerdict::DoNotCompensate(reasons);
    }
}

/// Returns a line above the section.
pub(crate) fn section_comment(report: &FitReport) -> String {
    let rms = |spread: Option<ResidualStatistics>| {
        spread.map_or("not known".to_string(), |spread| format!("{:.3} µm RMS", spread.rms_um))
    };
    format!(
        "fitted to {} rows: {}, on held-out rows {}",
        report.rows_used,
        rms(report.in_sample),
        rms(report.held_out)
    )
}

/// Warns where the machine file goes on using another source.
pub(crate) fn warn_elongation_source_mismatch(
    report: &mut FitReport,
    machine: Option<&Machine>,
    fitted: ElongationSource,
) {
    let chosen = machine.and_then(|machine| machine.spindle.source);
    if let Some(chosen) = chosen.filter(|chosen| *chosen != fitted) {
        report.warnings.push(format!(
            "[spindle] source is \"{}\" and stays so: what was fitted is not in use until it is \
             \"{}\"",
            chosen.name(),
            fitted.name()
        ));
    }
}

/// Warns where a parabola is clearly better than the line.
fn warn_about_curvature(
    report: &mut FitReport,
    columns: &[Vec<f64>],
    y: &[f64],
    line: &QrSolution,
) {
    let Some(x) = columns.get(1) else { return };
    let present = || x.iter().zip(y).filter(|(_, y)| !y.is_nan()).map(|(x, _)| *x);
    let mean = present().sum::<f64>() / present().count() as f64;
    let squares: Vec<f64> = x.iter().map(|x| (x - mean).powi(2)).collect();
    let curved = [columns, &[squares]].concat();
    let Some(parabola) = pooled_rows::solve_least_squares(&curved, y, |_| true) else { return };
    let better = 1.0 - (parabola.residual_squares / line.residual_squares).sqrt();
    let known = (parabola.coefficients[2] / parabola.standard_error(2)).abs();
    if parabola.degrees_of_freedom() >= 5 && known > 5.0 && better > 0.2 {
        report.warnings.push(format!(
            "the readings follow a curve: a parabola leaves {:.0} % less than the line; trueup \
             diagnose can add it",
            100.0 * better
        ));
    }
}
