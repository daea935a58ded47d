//! Whether the calibration still fits: a cumulative sum (CUSUM, Page 1954) of what is measured against what the
//! model says, that bad readings do not alarm, with a false alarm rate that follows from the statistic.
//!
//! ```text
//! d   measured − predicted, less its mean in a record from when the calibration was right
//! e   (d − ρᵍ·d₋₁)/(σ·√(1 − ρ²ᵍ))            noise with a memory made white; g rows since the last sound reading
//! S⁺ ← max(0, S⁺ + ψ(e) − k), S⁻ ← max(0, S⁻ − ψ(e) − k)      alarm where one of them is above h
//! ```
//!
//! A change of [`TARGET_SHIFT_SIGMAS`]·σ moves e by δ = CHANGE·√((1 − ρ)/(1 + ρ)); k = δ/2 finds it soonest. ψ holds a reading to a bound, and one
//! beyond `GROSS_ERROR_THRESHOLD_SIGMAS` standard deviations counts only with the next one; h is above what any two can bring. A gross reading does not become d₋₁. Mean
//! and σ are those of the readings within `GROSS_ERROR_THRESHOLD_SIGMAS`, so bad ones in the record of the calibration do not count either.

mod cusum_design;
mod recommended_measurement;

use serde::Serialize;
use trueup_machine::{
    InputFileError, Machine, RunFile,
    machine_file::{ElongationSource, Quantity},
    predict::RunPredictor,
};
use trueup_numerics::robust::median;

use crate::learnable_constants::resolve_quantity;
use cusum_design::{BaselineUncertainty, CusumDesign};
use recommended_measurement::ComparisonKind;

/// The change that is to be found, in standard deviations of what is measured less what is predicted.
pub const TARGET_SHIFT_SIGMAS: f64 = 3.0;
/// Fewer readings do not say what the noise is: with 40 σ is known to an eighth, and h has room for that.
const MIN_BASELINE_READINGS: usize = 40;
/// A memory beyond this cannot be distinguished from a drift: 50 rows.
const MAX_AUTOCORRELATION: f64 = 0.98;
/// A reading beyond this many standard deviations is bad, or the machine has changed: one good one in 16 000.
const GROSS_ERROR_THRESHOLD_SIGMAS: f64 = 4.0;
/// Standard errors of a bound that holds nineteen times of twenty.
const NORMAL_QUANTILE_95: f64 = 1.645;
/// Readings are in a row where they are no farther apart than this many steps of the clock.
const MAX_CONSECUTIVE_GAP_STEPS: f64 = 1.5;
/// No alarm is falsely raised oftener than once in this many readings, however far apart these are: a machine that is probed twice
/// a day has few in 1,000 hours.
const MIN_READINGS_PER_FALSE_ALARM: f64 = 1000.0;

/// The noise when the calibration was right.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BaselineNoise {
    /// The mean of measured less predicted, in µm: the reference may be arbitrary.
    pub mean_um: f64,
    /// Its standard deviation, in µm; above 0.
    pub sigma_um: f64,
    /// Its correlation from row to row and what the record leaves open of it, 0…0.98.
    pub memory: f64,
    /// From row to row, in s.
    pub row_s: f64,
    /// Readings that it is known from.
    pub readings: usize,
}

/// The sums, and when they are an alarm.
#[derive(Clone, Copy, Debug)]
pub struct CusumMonitor {
    noise: BaselineNoise,
    k: f64,
    plan: CusumDesign,
    before_um: Option<f64>,
    /// Rows since the last sound reading.
    gap: f64,
    sums: [f64; 2],
    /// Rows so far, and the row in which each sum began.
    row: usize,
    began: [usize; 2],
    /// The side of a gross reading in this row, and in the one measured before it; else 0.
    gross: [f64; 2],
}

/// An alarm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CalibrationAlarm {
    /// The row, from 1, without the header.
    pub row: usize,
    /// The record's clock in s, where it has one.
    pub time_s: Option<f64>,
    /// By how much the mean has moved since the sum began to rise, in µm.
    pub moved_um: f64,
    /// The measurement to take.
    pub next: String,
}

/// The result of a watch over a record.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CalibrationMonitoringReport {
    /// The noise when the calibration was right.
    pub noise: BaselineNoise,
    /// The rows that were looked at.
    pub rows: usize,
    /// This many hours pass on average between two false alarms.
    pub false_alarm_h: f64,
    /// Rows, from 1, of readings that stand alone and did not count in full.
    pub outliers: Vec<usize>,
    /// The first alarm; `None`: the calibration fits.
    pub alarm: Option<CalibrationAlarm>,
}

impl BaselineNoise {
    /// Of a record from when the calibration was right: measured less predicted by row, in µm, NaN where one
    /// is missing; `sampling_interval_s` from row to row.
    ///
    /// # Errors
    /// There are too few rows, or they do not scatter at all; the rule.
    pub fn from_residuals(apart_um: &[f64], row_s: f64) -> Result<Self, String> {
        Self::from_gapped_residuals(
            &apart_um.iter().map(|um| (1.0, *um)).collect::<Vec<_>>(),
            row_s,
        )
    }

    /// Returns the same where each reading is this many rows after the one before it.
    fn from_gapped_residuals(rows: &[(f64, f64)], row_s: f64) -> Result<Self, String> {
        let there: Vec<f64> = rows.iter().map(|row| row.1).filter(|um| um.is_finite()).collect();
        let count = there.len();
        if count < MIN_BASELINE_READINGS {
            return Err(format!(
                "has {count} rows that are measured and predicted; at least {MIN_BASELINE_READINGS} are needed"
            ));
        }
        let mut mean_um = median(&mut there.clone());
        let mut off: Vec<f64> = there.iter().map(|um| (um - mean_um).abs()).collect();
        // The median of the magnitude of normal noise is 1/1.4826 of its standard deviation.
        let mut sigma_um = 1.4826 * median(&mut off);
        const TRIMMING_ITERATIONS: usize = 10;
        for _ in 0..TRIMMING_ITERATIONS {
            // Readings that are written in steps may agree in more than half.
            let within = if sigma_um > 0.0 {
                GROSS_ERROR_THRESHOLD_SIGMAS * sigma_um
            } else {
                f64::INFINITY
            };
            let sound = there.iter().filter(|um| (*um - mean_um).abs() <= within);
            let sound: Vec<f64> = sound.copied().collect();
            mean_um = sound.iter().sum::<f64>() / sound.len() as f64;
            let squares: f64 = sound.iter().map(|um| (um - mean_um).powi(2)).sum();
            sigma_um = (squares / (sound.len().max(2) - 1) as f64).sqrt();
        }
        if sigma_um < 1e-9 {
            return Err("does not scatter at all: is it a simulation?".into());
        }
        let is_sound = |um: f64| (um - mean_um).abs() <= GROSS_ERROR_THRESHOLD_SIGMAS * sigma_um;
        let pairs = rows.windows(2).filter(|pair| {
            pair[1].0 <= MAX_CONSECUTIVE_GAP_STEPS
                && pair.iter().all(|reading| reading.1.is_finite() && is_sound(reading.1))
        });
        let (mut products, mut squares, mut in_a_row) = (0.0, 0.0, 0.0);
        for pair in pairs {
            let [a, b] = [pair[0].1 - mean_um, pair[1].1 - mean_um];
            products += a * b;
            squares += (a * a + b * b) / 2.0;
            in_a_row += 1.0;
        }
        let memory: f64 = if squares > 0.0 { products / squares } else { 0.0 };
        let error = if in_a_row > 0.0 { ((1.0 - memory * memory) / in_a_row).sqrt() } else { 0.0 };
        let memory = (memory.max(0.0) + error).clamp(0.0, MAX_AUTOCORRELATION);
        Ok(Self { mean_um, sigma_um, memory, row_s, readings: count })
    }
}

impl CusumMonitor {
    /// With a false alarm in this many hours on average, above 0, and in no fewer than 1,000 readings.
    #[must_use]
    pub fn new(noise: BaselineNoise, false_alarm_h: f64) -> Self {
        let rho = noise.memory;
        let k = TARGET_SHIFT_SIGMAS * ((1.0 - rho) / (1.0 + rho)).sqrt() / 2.0;
        let rows = (false_alarm_h * 3600.0 / noise.row_s).max(MIN_READINGS_PER_FALSE_ALARM);
        let count = noise.readings as f64;
        let open = BaselineUncertainty {
            mean: NORMAL_QUANTILE_95 / count.sqrt(),
            scatter: 1.0 + NORMAL_QUANTILE_95 / (2.0 * count).sqrt(),
        };
        let first = TARGET_SHIFT_SIGMAS / (1.0 - rho.powi(4)).sqrt();
        let plan = cusum_design::design_cusum(k, first, rows, open);
        Self {
            noise,
            k,
            plan,
            before_um: None,
            gap: 0.0,
            sums: [0.0; 2],
            row: 0,
            began: [0; 2],
            gross: [0.0; 2],
        }
    }

    /// The next row; whether it is an alarm. A missing one ends nothing.
    pub fn update(&mut self, apart_um: f64) -> bool {
        self.update_after_gap(1.0, apart_um).is_some()
    }

    /// Takes the row `gap` steps of the clock after the one before it. Returns the row, from 0, in which the sum
    /// began that is an alarm.
    fn update_after_gap(&mut self, gap: f64, apart_um: f64) -> Option<usize> {
        self.row += 1;
        self.gap += gap;
        self.gross[0] = 0.0;
        if !apart_um.is_finite() {
            return None;
        }
        let BaselineNoise { mean_um, sigma_um, memory, .. } = self.noise;
        let off_um = apart_um - mean_um;
        // Of the first nothing is known before it.
        let left = self.before_um.map_or(0.0, |_| memory.powf(self.gap.max(0.0)));
        let expected_um = left * self.before_um.unwrap_or(0.0);
        let white = (off_um - expected_um) / (sigma_um * (1.0 - left * left).max(1e-6).sqrt());
        let bound = self.plan.bound;
        let before = self.gross[1];
        let held = if white.abs() > GROSS_ERROR_THRESHOLD_SIGMAS {
            self.gross = [white.signum(); 2];
            if before == white.signum() { bound * before } else { 0.0 }
        } else {
            (self.before_um, self.gap, self.gross) = (Some(off_um), 0.0, [0.0; 2]);
            white.clamp(-bound, bound)
        };
        for (side, sign) in [1.0, -1.0].into_iter().enumerate() {
            if self.sums[side] == 0.0 {
                self.began[side] = self.row - 1;
            }
            self.sums[side] = (self.sums[side] + sign * held - self.k).max(0.0);
        }
        (0..2).find(|side| self.sums[*side] > self.plan.height).map(|side| self.began[side])
    }
}

/// Watches `run` by `machine`, with the noise of a record from when the calibration was right.
///
/// # Errors
/// A record measures nothing that the machine file predicts; the one from then is too short.
pub fn monitor_calibration(
    machine: &Machine,
    calibrated: &RunFile,
    run: &RunFile,
    quantity: Option<Quantity>,
    false_alarm_h: f64,
) -> Result<CalibrationMonitoringReport, InputFileError> {
    let then = compute_monitoring_residuals(machine, calibrated, quantity)?;
    let now = compute_monitoring_residuals(machine, run, quantity)?;
    let bad = |rule: String| calibrated.value_error(0, &then.column, rule);
    let row_s = sampling_interval_s(calibrated, &then.apart_um);
    let noise = BaselineNoise::from_gapped_residuals(
        &rows_with_gaps(calibrated, &then.apart_um, row_s),
        row_s,
    )
    .map_err(bad)?;
    let mut watch = CusumMonitor::new(noise, false_alarm_h);
    let (mut outliers, mut alarm) = (Vec::new(), None);
    for (row, (gap, um)) in rows_with_gaps(run, &now.apart_um, row_s).into_iter().enumerate() {
        let since = watch.update_after_gap(gap, um);
        if watch.gross[0] != 0.0 {
            outliers.push(row + 1);
        }
        if let Some(since) = since {
            let mut there: Vec<f64> =
                now.apart_um[since..=row].iter().copied().filter(|um| um.is_finite()).collect();
            alarm = Some(CalibrationAlarm {
                row: row + 1,
                time_s: run.column("time_s").map(|times| times[row]),
                moved_um: median(&mut there) - noise.mean_um,
                next: recommended_measurement::recommend_next_measurement(
                    &now,
                    machine,
                    run,
                    since,
                    noise.sigma_um,
                ),
            });
            // What has changed stands alone no longer.
            outliers.retain(|outlier| *outlier <= since);
            break;
        }
    }
    let rows = now.apart_um.iter().filter(|um| um.is_finite()).count();
    Ok(CalibrationMonitoringReport { noise, rows, false_alarm_h, outliers, alarm })
}

/// Measured less predicted by row.
struct MonitoringResiduals {
    compared: ComparisonKind,
    /// The column of what is compared with the model.
    column: String,
    apart_um: Vec<f64>,
    predicted_um: Vec<f64>,
}

/// Returns measured less predicted, and predicted, by row. Without a measurement the sensor is compared with the model of
/// temperature or time that the file has, whichever of them is the source.
fn compute_monitoring_residuals(
    machine: &Machine,
    run: &RunFile,
    requested: Option<Quantity>,
) -> Result<MonitoringResiduals, InputFileError> {
    let by = |source: Option<ElongationSource>, quantity: Quantity| {
        let mut machine = machine.clone();
        machine.spindle.source = source;
        let index = Quantity::ALL.iter().position(|candidate| *candidate == quantity).unwrap_or(0);
        let rows = RunPredictor::new(&machine, run)?;
        let um: Vec<f64> = rows.model_values().map(|values| values.to_array()[index]).collect();
        Ok::<_, InputFileError>(um)
    };
    let spindle = &machine.spindle;
    let is_measured = Quantity::ALL
        .iter()
        .any(|quantity| run.column(&format!("measured_{}_um", quantity.name())).is_some());
    let model = match spindle.source {
        Some(ElongationSource::Sensor) | None => {
            let by_temperature =
                spindle.temperature.as_ref().map(|_| ElongationSource::Temperature);
            by_temperature.or(spindle.warmup.as_ref().map(|_| ElongationSource::Warmup))
        }
        other => other,
    };
    let can_compare = spindle.sensor.is_some() && !is_measured;
    let (compared, column, measured_um, predicted_um) = if let Some(model) =
        model.filter(|_| can_compare)
    {
        let quantity = Quantity::Elongation;
        let sensor_um = by(Some(ElongationSource::Sensor), quantity)?;
        (
            ComparisonKind::Sensor(model),
            "sensor_counts".into(),
            sensor_um,
            by(Some(model), quantity)?,
        )
    } else {
        let quantity = resolve_quantity(run, requested)?;
        let name = format!("measured_{}_um", quantity.name());
        let compared =
            quantity.axis().map_or(ComparisonKind::Growth(spindle.source), ComparisonKind::Axis);
        let measured_um = run.require_column(&name)?.to_vec();
        (compared, name, measured_um, by(spindle.source, quantity)?)
    };
    let apart_um = measured_um
        .iter()
        .zip(&predicted_um)
        .map(|(measured, predicted)| measured - predicted)
        .collect();
    Ok(MonitoringResiduals { compared, column, apart_um, predicted_um })
}

/// Returns the most common step of the clock between readings, in s; a minute where there is none.
fn sampling_interval_s(run: &RunFile, apart_um: &[f64]) -> f64 {
    let times = run.column("time_s").unwrap_or_default().iter().zip(apart_um);
    let times: Vec<f64> = times.filter(|(_, um)| um.is_finite()).map(|(s, _)| *s).collect();
    let steps = times.windows(2).map(|pair| pair[1] - pair[0]);
    let mut steps: Vec<f64> = steps.filter(|step| *step > 0.0).collect();
    if steps.is_empty() { 60.0 } else { median(&mut steps) }
}

/// Returns each row with the steps of the clock since the one before it: 1 where there is no clock.
fn rows_with_gaps(run: &RunFile, apart_um: &[f64], row_s: f64) -> Vec<(f64, f64)> {
    let times = run.column("time_s");
    let mut before_s: Option<f64> = None;
    let rows = apart_um.iter().enumerate().map(|(row, um)| {
        let now_s = times.map(|times| times[row]);
        let gap = match (before_s, now_s) {
            (Some(before_s), Some(now_s)) => ((now_s - before_s) / row_s).max(0.0),
            _ => 1.0,
        };
        before_s = now_s;
        (if gap.is_finite() { gap } else { 1.0 }, *um)
    });
    // What is not measured in between is no row: the gaps add up.
    let mut waiting = 0.0;
    rows.map(|(gap, um)| {
        waiting += gap;
        let all = waiting;
        if um.is_finite() {
            waiting = 0.0;
            (all, um)
        } else {
            (0.0, um)
        }
    })
    .collect()
}
