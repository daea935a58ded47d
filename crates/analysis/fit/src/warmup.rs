//! `[spindle.warmup]`: t₁, t₂, Smax and k of a spindle without a sensor, from recorded warm-ups.
//!
//! At constant speed from cold the model is (`docs/physics.md` section 2)
//!
//! ```text
//! s = Smax·(1 − e^(−k·u))/(1 − e^(−k)),   u = (t − t₁)/(t₂ − t₁)
//!   = A·(1 − e^(−(t − t₁)/τ)),            τ = (t₂ − t₁)/k,   A = Smax/(1 − e^(−k))
//! ```
//!
//! A record shows A, τ and t₁. It shows t₂ and k, each alone, only if it has the kink in which the
//! growth ends at t₂: at k = 4 the last 2 % of A are all that is cut off, which noise may hide. So
//! the kink is taken for real only where it is clearly better (F, 999 of 1000). Otherwise k is set,
//! to 4 or to what puts t₂ at the end of the record, whichever is later, and the report says that
//! τ and A are what was measured. Within the record both say the same.
//!
//! Runs at several speeds give the exponent of the speed, stops the time constant of cooling. The
//! fit steps the model's own state through the rows, so that `trueup predict` gives the residuals
//! that are reported.

mod warmup_model;

use trueup_machine::{
    InputFileError, Machine,
    applied_offsets::UncompensatedRun,
    machine_file::writer::{MachineFileEdit, NewSection, Value},
    machine_file::{ElongationSource, Warmup},
    model::WarmupState,
};
use trueup_numerics::{
    least_squares::{NonlinearFit, SeparableModel as _},
    t_quantile,
};

use self::warmup_model::{FreeParameters, WarmupModel, WarmupRecord};
use crate::{
    elongation::{
        MEASURED_ELONGATION_COLUMN, add_previous_model_statistics, add_residual_statistics,
        reject_insufficient_input, section_comment, set_fit_verdict,
        warn_elongation_source_mismatch,
    },
    lagged_regression,
    pooled_rows::{self, PooledRows},
    report::{FitDetail, FitParameter, FitReport, ResidualStatistics},
};

/// A further constant is taken where chance gives its gain less than once in this many.
const CONFIDENCE_LEVEL: f64 = 0.999;
/// The smallest exponent that is set where the record does not show one.
const MIN_FIXED_EXPONENT: f64 = 4.0;
/// Speeds nearer than this share are one.
const SPEED_RELATIVE_TOLERANCE: f64 = 0.02;

/// Fits the warm-up of all `runs`. Each file begins cold.
///
/// # Errors
/// A column is missing, too few rows have all values, or all times are equal.
pub fn fit(
    runs: &[UncompensatedRun<'_>],
    machine: Option<&Machine>,
) -> Result<FitReport, InputFileError> {
    let rows = PooledRows::new(runs)?;
    let old = machine.and_then(|machine| machine.spindle.warmup.as_ref());
    let time_s = rows.require_column("time_s")?;
    let spindle_rpm = rows.optional_column("spindle_rpm")?;
    let mut y = rows.require_column(MEASURED_ELONGATION_COLUMN)?;
    let starts = rows.restart_flags(Some(&time_s));
    let mut report = FitReport::new("warmup", MEASURED_ELONGATION_COLUMN);
    let is_complete = |row: usize| {
        !time_s[row].is_nan() && spindle_rpm.as_ref().is_none_or(|rpm| !rpm[row].is_nan())
    };
    (0..y.len()).filter(|row| !is_complete(*row)).for_each(|row| y[row] = f64::NAN);
    report.rows_incomplete = y.iter().filter(|y| y.is_nan()).count();
    let found = lagged_regression::find_outliers(&time_s, &starts, &y);
    report.excluded = rows.list_excluded_rows(&found, &y, MEASURED_ELONGATION_COLUMN);
    found.iter().for_each(|outlier| y[outlier.row] = f64::NAN);
    let is_used: Vec<bool> = y.iter().map(|y| !y.is_nan()).collect();
    reject_insufficient_input(&rows, "time_s", &time_s, &is_used, 8)?;

    let speeds = distinct_speeds_rpm(spindle_rpm.as_deref(), &y);
    if spindle_rpm.is_some() && speeds.is_empty() {
        let place = rows.value_location(0, "spindle_rpm");
        let rule = "spindle_rpm is 0 in every row: a spindle that stands does not warm up";
        return Err(InputFileError::new(place, rule));
    }
    // One speed says nothing of others: what the user has believed of them stays.
    let retained = old.filter(|old| speeds.len() == 1 && old.speed_exponent != 0.0);
    let files = rows.file_indices();
    let record = WarmupRecord {
        time_s: &time_s,
        spindle_rpm: spindle_rpm.as_deref(),
        starts: &starts,
        files: &files,
        rated_rpm: retained.and_then(|old| old.rated_rpm).or(speeds.last().copied()),
        set_speed_exponent: retained.map_or(0.0, |old| old.speed_exponent),
        set_cool_s: None,
    };
    let base = FreeParameters {
        speed: speeds.len() > 1,
        cool: has_cooling(&record, &y),
        ..FreeParameters::default()
    };
    let span = RecordTimeScales::from_record(&record, &y);
    let (shape, fit) = select_model(record, base, &y, &span)
        .ok_or_else(|| rows.input_error("no warm-up can be fitted to these rows"))?;
    let wider = pooled_rows::autocorrelation_inflation_factor(&fit.residuals);

    let (groups, by) = rows.cross_validation_groups(&is_used);
    let held_out = groups.as_ref().and_then(|groups| {
        pooled_rows::leave_one_group_out_residuals(&y, groups, |y, group| {
            let pairs = y.iter().zip(groups);
            let hide = |(y, of): (&f64, &usize)| if *of == group { f64::NAN } else { *y };
            let hidden: Vec<f64> = pairs.map(hide).collect();
            let start = fit.parameters[..shape.nonlinear_count()].to_vec();
            let refit = shape.fit(&hidden, &[start])?;
            let values = shape.evaluate(&refit.parameters, y.len());
            Some(y.iter().zip(values).map(|(y, value)| y - value).collect())
        })
    });
    let model = report_constants(&mut report, &shape, &fit, &span, wider);
    if let Some(old) = old {
        add_previous_model_statistics(&mut report, &previous_model_residuals(&record, old, &y));
    }
    fit_and_report_each_run(&mut report, &rows, &record, &y);
    add_residual_statistics(&mut report, &y, &fit.residuals, held_out, by, wider);
    set_fit_verdict(&mut report, &y, groups.as_deref());
    if report.verdict.is_usable() {
        report.edit = MachineFileEdit::from_section(warmup_section(&model, &report));
        report.edit.defaults.push(("spindle".into(), "source", Value::Text("warmup".into())));
        warn_elongation_source_mismatch(&mut report, machine, ElongationSource::Warmup);
    }
    Ok(report)
}

/// How long and how often the record looks.
struct RecordTimeScales {
    /// The usual time from row to row.
    interval_s: f64,
    /// The longest that the spindle ran without a break.
    longest_s: f64,
}

impl RecordTimeScales {
    fn from_record(record: &WarmupRecord<'_>, y: &[f64]) -> Self {
        let (mut longest_s, mut since, mut before) = (0.0_f64, None, f64::NAN);
        let mut intervals = Vec::new();
        for (row, &time) in record.time_s.iter().enumerate().filter(|(_, time)| !time.is_nan()) {
            if record.starts[row] {
                (since, before) = (Some(time), f64::NAN);
            }
            if record.spindle_rpm.is_some_and(|rpm| rpm[row] == 0.0) {
                since = None;
            } else {
                // It has run since the row before.
                let start = *since.get_or_insert(if before.is_nan() { time } else { before });
                if !y[row].is_nan() {
                    longest_s = longest_s.max(time - start);
                }
            }
            if time > before {
                intervals.push(time - before);
            }
            before = time;
        }
        intervals.sort_unstable_by(f64::total_cmp);
        let interval_s = intervals.get(intervals.len() / 2).copied().unwrap_or(1.0);
        Self { interval_s, longest_s: longest_s.max(interval_s) }
    }
}

/// Returns the speeds at which it ran, rising, those within a hair of each other as one: its largest.
fn distinct_speeds_rpm(spindle_rpm: Option<&[f64]>, y: &[f64]) -> Vec<f64> {
    let mut all: Vec<f64> = spindle_rpm
        .into_iter()
        .flatten()
        .zip(y)
        .filter(|(rpm, y)| **rpm != 0.0 && !rpm.is_nan() && !y.is_nan())
        .map(|(rpm, _)| rpm.abs())
        .collect();
    all.sort_unstable_by(f64::total_cmp);
    let mut speeds: Vec<f64> = Vec::new();
    for rpm in all {
        match speeds.last_mut() {
            Some(last) if rpm <= *last * (1.0 + SPEED_RELATIVE_TOLERANCE) => *last = rpm,
            _ => speeds.push(rpm),
        }
    }
    speeds
}

/// Returns whether the record has enough of a spindle that stands after it has run.
fn has_cooling(record: &WarmupRecord<'_>, y: &[f64]) -> bool {
    let Some(rpm) = record.spindle_rpm else { return false };
    let (mut has_run, mut rows) = (false, 0);
    for (row, &rpm) in rpm.iter().enumerate() {
        has_run = (has_run && !record.starts[row]) || rpm != 0.0;
        rows += usize::from(has_run && rpm == 0.0 && !y[row].is_nan());
    }
    rows >= 5
}

/// Returns the simplest shape that no further constant makes clearly better: of the lag, the end of the
/// growth and the zero of the instrument the one that gains most is taken first, as each of them
/// can pass for another as long as that is missing.
fn select_model<'a>(
    record: WarmupRecord<'a>,
    base: FreeParameters,
    y: &[f64],
    span: &RecordTimeScales,
) -> Option<(WarmupModel<'a>, NonlinearFit)> {
    let search = |free: FreeParameters| {
        let shape = WarmupModel { record, free, longest_tau_s: 50.0 * span.longest_s };
        let fit = shape.fit(y, &shape.start_grid(span.interval_s, span.longest_s))?;
        Some((shape, fit))
    };
    let is_within = |shape: &WarmupModel<'_>, fit: &NonlinearFit| {
        let constants = shape.decode_parameters(&fit.parameters);
        let end_s = constants.lag_s + constants.exponent * constants.tau_s;
        // An end beyond the record is none that was seen.
        !shape.free.ends || end_s < span.longest_s
    };
    let mut best = search(base)?;
    loop {
        let free = best.0.free;
        let further = [
            FreeParameters { lag: true, ..free },
            FreeParameters { ends: true, ..free },
            FreeParameters { zero: true, ..free },
        ];
        let more = further
            .into_iter()
            .filter(|more| *more != free)
            .filter_map(search)
            .filter(|(shape, fit)| fit.linear.is_ok() && is_within(shape, fit))
            .filter(|(_, fit)| is_significantly_better(&best.1, fit))
            .min_by(|a, b| a.1.residual_squares.total_cmp(&b.1.residual_squares));
        match more {
            Some(more) => best = more,
            None => return Some(best),
        }
    }
}

/// Returns whether `more` gains more than chance does, its residuals' correlation considered.
fn is_significantly_better(less: &NonlinearFit, more: &NonlinearFit) -> bool {
    let further = more.parameters.len().saturating_sub(less.parameters.len()).max(1) as f64;
    let rows = more.residuals.iter().filter(|residual| !residual.is_nan()).count();
    let degrees = rows.saturating_sub(more.parameters.len()) as f64;
    let wider = pooled_rows::autocorrelation_inflation_factor(&more.residuals);
    let degrees = (degrees / (wider * wider)).max(1.0);
    let variance = more.residual_squares / degrees;
    let gained = (less.residual_squares - more.residual_squares) / further;
    gained
        > variance * t_quantile(1.0 - (1.0 - CONFIDENCE_LEVEL) / (2.0 * further), degrees).powi(2)
}

/// Returns the machine file's constants, reported.
fn report_constants(
    report: &mut FitReport,
    shape: &WarmupModel<'_>,
    fit: &NonlinearFit,
    span: &RecordTimeScales,
    wider: f64,
) -> Warmup {
    let constants = shape.decode_parameters(&fit.parameters);
    let [tau, lag, ends, speed, cool] = shape.parameter_indices();
    let size_at = shape.nonlinear_count();
    let size = fit.parameters[size_at];
    let half = |at: usize| wider * fit.confidence_half_width(at);
    let shown = |name: &str, at: Option<usize>, value: f64| match at {
        Some(at) => FitParameter::fitted(name, value, half(at)),
        None => FitParameter::fixed(name, value),
    };
    let exponent = if ends.is_some() {
        constants.exponent
    } else {
        MIN_FIXED_EXPONENT.max((span.longest_s - constants.lag_s) / constants.tau_s)
    };
    let share = if ends.is_some() { 1.0 } else { -(-exponent).exp_m1() };
    let warm_s = constants.lag_s + exponent * constants.tau_s;
    // t₂ = t₁ + k·τ
    let mut gradient = vec![0.0; fit.parameters.len()];
    for (at, derivative) in [(tau, exponent), (lag, 1.0), (ends, constants.tau_s)] {
        if let Some(at) = at {
            gradient[at] = derivative;
        }
    }
    let half_warm = fit
        .linear
        .as_ref()
        .map_or(f64::INFINITY, |linear| linear.half_width_for_gradient(&gradient));
    let rated_rpm = shape.record.rated_rpm;
    let model = Warmup {
        lag_s: constants.lag_s,
        warm_s,
        max_um: size * share,
        exponent,
        cool_s: constants.cool_s,
        rated_rpm,
        speed_exponent: constants.speed_exponent,
    };
    let parameters = &mut report.parameters;
    parameters.push(shown("lag_s", lag, constants.lag_s));
    parameters.push(FitParameter::fitted("warm_s", warm_s, wider * half_warm));
    parameters.push(FitParameter::amplitude("max_um", model.max_um, share * half(size_at)));
    parameters.push(shown("exponent", ends, exponent));
    parameters.push(shown("time_constant_s", tau, constants.tau_s));
    if let Some(cool_s) = constants.cool_s {
        parameters.push(shown("cool_s", cool, cool_s));
    }
    if let Some(rated_rpm) = rated_rpm {
        parameters.push(FitParameter::fixed("rated_rpm", rated_rpm));
        parameters.push(shown("speed_exponent", speed, constants.speed_exponent));
    }
    if shape.free.zero {
        let zeros = fit.parameters[size_at + 1..].to_vec();
        report.warnings.push(
            "the measurement does not begin at 0. What the instrument showed with a cold \
             spindle (instrument_zero_um) was taken off and is not in the machine file"
                .into(),
        );
        report.facts.push(FitDetail::numbers("instrument_zero_um", zeros));
    }
    if ends.is_none() {
        report.warnings.push(format!(
            "the record does not show a kink at which the growth ends, so exponent is set. \
             Measured were the time constant of {:.0} s and the final growth of {size:.2} µm; \
             warm_s and max_um follow from them",
            constants.tau_s
        ));
        let reached = -(-(span.longest_s - constants.lag_s) / constants.tau_s).exp_m1();
        let known = half(size_at) / size.abs();
        if reached < 0.9 || known.is_nan() || known > 0.1 {
            report.warnings.push(format!(
                "the longest warm-up of {:.0} s reaches {:.0} % of the growth: max_um is an \
                 extrapolation, +/- {:.0} %; record for longer",
                span.longest_s,
                100.0 * reached,
                100.0 * known
            ));
        }
    }
    model
}

/// Measured minus what the machine file's model has predicted so far.
fn previous_model_residuals(record: &WarmupRecord<'_>, old: &Warmup, y: &[f64]) -> Vec<f64> {
    let mut state = WarmupState::default();
    let mut value = |row: usize| {
        if record.starts[row] {
            state = WarmupState::default();
        }
        let running = old.rated_rpm.unwrap_or(1.0);
        let rpm = record.spindle_rpm.map_or(running, |rpm| rpm[row]);
        state.step(old, record.time_s[row], rpm)
    };
    y.iter().enumerate().map(|(row, y)| y - value(row)).collect()
}

/// t₁, t₂ and Smax of each run alone, where there are several.
fn fit_and_report_each_run(
    report: &mut FitReport,
    rows: &PooledRows<'_>,
    record: &WarmupRecord<'_>,
    y: &[f64],
) {
    let Some(groups) = rows.run_indices() else { return };
    let mut squares = 0.0;
    let mut count = 0;
    for group in 0..=groups.iter().copied().max().unwrap_or(0) {
        let alone: Vec<f64> =
            y.iter().zip(&groups).map(|(y, of)| if *of == group { *y } else { f64::NAN }).collect();
        let name = format!("run_{}", group + 1);
        if alone.iter().filter(|y| !y.is_nan()).count() < 8 {
            continue;
        }
        let speeds = distinct_speeds_rpm(record.spindle_rpm, &alone);
        let record =
            WarmupRecord { rated_rpm: speeds.last().copied(), set_speed_exponent: 0.0, ..*record };
        let span = RecordTimeScales::from_record(&record, &alone);
        let base =
            FreeParameters { cool: has_cooling(&record, &alone), ..FreeParameters::default() };
        if let (1 | 0, Some((shape, fit))) =
            (speeds.len(), select_model(record, base, &alone, &span))
        {
            let mut own = FitReport::new("warmup", "");
            let model = report_constants(&mut own, &shape, &fit, &span, 1.0);
            squares += fit.residual_squares;
            count += fit.residuals.iter().filter(|residual| !residual.is_nan()).count();
            let speed = speeds.last().map_or(String::new(), |rpm| format!("{rpm:.0} r/min: "));
            let rms = ResidualStatistics::from_residuals(&fit.residuals)
                .map_or(0.0, |spread| spread.rms_um);
            let text = format!(
                "{speed}lag_s {:.1}, warm_s {:.1}, max_um {:.2}, exponent {:.2}, time constant \
                 {:.1} s, {rms:.3} µm RMS",
                model.lag_s,
                model.warm_s,
                model.max_um,
                model.exponent,
                model.time_constant_s()
            );
            report.facts.push(FitDetail::text(name, text));
        }
    }
    if count > 0 {
        report
            .facts
            .push(FitDetail::number("each_run_alone_rms_um", (squares / count as f64).sqrt()));
    }
}

fn warmup_section(model: &Warmup, report: &FitReport) -> NewSection {
    let mut section = NewSection::new("spindle.warmup")
        .with_number("lag_s", model.lag_s)
        .with_number("warm_s", model.warm_s)
        .with_number("max_um", model.max_um)
        .with_number("exponent", model.exponent);
    if let Some(cool_s) = model.cool_s {
        section = section.with_number("cool_s", cool_s);
    }
    if let Some(rated_rpm) = model.rated_rpm {
        section = section
            .with_number("rated_rpm", rated_rpm)
            .with_number("speed_exponent", model.speed_exponent);
    }
    section.with_preserved_keys(&["cool_s"]).with_header_comment(section_comment(report))
}
