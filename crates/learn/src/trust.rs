//! Whether the calibration still fits: a cumulative sum (CUSUM, Page 1954) of what is measured against what the
//! model says, with a false alarm rate that follows from the statistic.
//!
//! ```text
//! d   measured − predicted, less its mean in a record from when the calibration was right
//! e   (d − ρ·d₋₁)/(σ·√(1 − ρ²))              noise with a memory made white; σ and ρ from that record
//! S⁺ ← max(0, S⁺ + e − k), S⁻ ← max(0, S⁻ − e − k)        alarm where one of them is above h
//! ```
//!
//! A change of [`CHANGE`]·σ moves e by δ = CHANGE·√((1 − ρ)/(1 + ρ)); k = δ/2 finds it soonest. h follows from
//! how long the two sums may run without a change until one of them is above it (Siegmund 1985):
//!
//! ```text
//! ARL = (eˣ − x − 1)/(4·k²),   x = 2·k·(h + 1.166)
//! ```

use serde::Serialize;
use trueup_machine::{
    BadInput, Machine, RunFile,
    file::{ElongationSource, Quantity},
    predict::Predictor,
};

use crate::constants::measured;

/// The change that is to be found, in standard deviations of what is measured less what is predicted.
pub const CHANGE: f64 = 3.0;
/// Fewer rows do not say what the noise is: with 200 σ is known to 5 % where there is no memory.
const FEWEST: usize = 200;
/// A memory beyond this cannot be told from a drift: 50 rows.
const MOST_MEMORY: f64 = 0.98;

/// What the noise was when the calibration was right.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Noise {
    /// The mean of measured less predicted, in µm: the reference may be arbitrary.
    pub mean_um: f64,
    /// Its standard deviation, in µm; above 0.
    pub sigma_um: f64,
    /// Its correlation from row to row, 0…0.98.
    pub memory: f64,
    /// From row to row, in s.
    pub row_s: f64,
}

/// The sums, and when they are an alarm.
#[derive(Clone, Copy, Debug)]
pub struct Watch {
    noise: Noise,
    k: f64,
    h: f64,
    before_um: Option<f64>,
    sums: [f64; 2],
}

/// An alarm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Alarm {
    /// The row, from 1, without the header.
    pub row: usize,
    /// The record's clock in s, where it has one.
    pub time_s: Option<f64>,
    /// By how much the mean has moved since the sum began to rise, in µm.
    pub moved_um: f64,
    /// The measurement to take.
    pub next: &'static str,
}

/// What is said of a record.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trust {
    /// What the noise was when the calibration was right.
    pub noise: Noise,
    /// The rows that were looked at.
    pub rows: usize,
    /// So many hours pass on average between two false alarms.
    pub false_alarm_h: f64,
    /// The first alarm; `None`: the calibration fits.
    pub alarm: Option<Alarm>,
}

impl Noise {
    /// Of a record from when the calibration was right: measured less predicted by row, in µm, NaN where one
    /// is missing; `row_s` from row to row.
    ///
    /// # Errors
    /// There are too few rows, or they do not scatter at all; the rule.
    pub fn of(apart_um: &[f64], row_s: f64) -> Result<Self, String> {
        let there: Vec<f64> = apart_um.iter().copied().filter(|um| um.is_finite()).collect();
        let count = there.len();
        if count < FEWEST {
            return Err(format!(
                "has {count} rows that are measured and predicted; at least {FEWEST} are needed"
            ));
        }
        let mean_um = there.iter().sum::<f64>() / count as f64;
        let off: Vec<f64> = there.iter().map(|um| um - mean_um).collect();
        let squares: f64 = off.iter().map(|um| um * um).sum();
        let sigma_um = (squares / (count - 1) as f64).sqrt();
        if sigma_um < 1e-9 {
            return Err("does not scatter at all: is it a simulation?".into());
        }
        let products: f64 = off.windows(2).map(|pair| pair[0] * pair[1]).sum();
        Ok(Self { mean_um, sigma_um, memory: (products / squares).clamp(0.0, MOST_MEMORY), row_s })
    }
}

impl Watch {
    /// With a false alarm in so many hours on average, above 0.
    #[must_use]
    pub fn new(noise: Noise, false_alarm_h: f64) -> Self {
        let rho = noise.memory;
        let k = CHANGE * ((1.0 - rho) / (1.0 + rho)).sqrt() / 2.0;
        let rows = (false_alarm_h * 3600.0 / noise.row_s).max(2.0);
        Self { noise, k, h: height(k, rows), before_um: None, sums: [0.0; 2] }
    }

    /// The next row; whether it is an alarm. A missing one ends nothing.
    pub fn step(&mut self, apart_um: f64) -> bool {
        if !apart_um.is_finite() {
            self.before_um = None;
            return false;
        }
        let Noise { mean_um, sigma_um, memory, .. } = self.noise;
        let off_um = apart_um - mean_um;
        let white = match self.before_um.replace(off_um) {
            Some(before_um) => {
                (off_um - memory * before_um) / (sigma_um * (1.0 - memory * memory).sqrt())
            }
            // Of the first nothing is foreseen.
            None => off_um / sigma_um,
        };
        self.sums[0] = (self.sums[0] + white - self.k).max(0.0);
        self.sums[1] = (self.sums[1] - white - self.k).max(0.0);
        self.sums.iter().any(|sum| *sum > self.h)
    }

    fn begins(&self) -> bool {
        self.sums == [0.0; 2]
    }
}

/// h of two sums with the reference value `k` that run for so many rows on average without a change.
fn height(k: f64, rows: f64) -> f64 {
    let run = |x: f64| (x.exp() - x - 1.0) / (4.0 * k * k);
    let (mut low, mut high) = (0.0, 60.0);
    for _ in 0..80 {
        let x = (low + high) / 2.0;
        if run(x) < rows { low = x } else { high = x }
    }
    (low / (2.0 * k) - 1.166).max(k)
}

/// Watches `run` by `machine`, with the noise of a record from when the calibration was right.
///
/// # Errors
/// A record measures nothing that the machine file predicts; the one from then is too short.
pub fn trust(
    machine: &Machine,
    calibrated: &RunFile,
    run: &RunFile,
    wanted: Option<Quantity>,
    false_alarm_h: f64,
) -> Result<Trust, BadInput> {
    let (then_um, _) = apart(machine, calibrated, wanted)?;
    let (now_um, predicted_um) = apart(machine, run, wanted)?;
    let bad = |rule: String| calibrated.bad(0, "time_s", rule);
    let noise = Noise::of(&then_um, row_s(calibrated)).map_err(bad)?;
    let mut watch = Watch::new(noise, false_alarm_h);
    let (mut since, mut alarm) = (0, None);
    for (row, um) in now_um.iter().enumerate() {
        if watch.begins() {
            since = row;
        }
        if watch.step(*um) {
            let moved = &now_um[since..=row];
            let there: Vec<f64> = moved.iter().copied().filter(|um| um.is_finite()).collect();
            let mean_um = there.iter().sum::<f64>() / there.len() as f64;
            alarm = Some(Alarm {
                row: row + 1,
                time_s: run.column("time_s").map(|times| times[row]),
                moved_um: mean_um - noise.mean_um,
                next: next(&now_um[since..], &predicted_um[since..], run, since),
            });
            break;
        }
    }
    let rows = now_um.iter().filter(|um| um.is_finite()).count();
    Ok(Trust { noise, rows, false_alarm_h, alarm })
}

/// Measured less predicted, and predicted, by row. Without a measurement the sensor is held against the model of
/// temperature or time that the file has beside it.
fn apart(
    machine: &Machine,
    run: &RunFile,
    wanted: Option<Quantity>,
) -> Result<(Vec<f64>, Vec<f64>), BadInput> {
    let by = |source: Option<ElongationSource>, quantity: Quantity| {
        let mut machine = machine.clone();
        machine.spindle.source = source;
        let index = Quantity::ALL.iter().position(|it| *it == quantity).unwrap_or(0);
        let rows = Predictor::new(&machine, run)?;
        let um: Vec<f64> = rows.model().map(|values| values.all()[index]).collect();
        Ok::<_, BadInput>(um)
    };
    let spindle = &machine.spindle;
    let is_measured =
        Quantity::ALL.iter().any(|it| run.column(&format!("measured_{}_um", it.name())).is_some());
    let beside = if spindle.temperature.is_some() {
        Some(ElongationSource::Temperature)
    } else {
        spindle.warmup.as_ref().map(|_| ElongationSource::Warmup)
    };
    let can_watch = spindle.source == Some(ElongationSource::Sensor) && !is_measured;
    let (measured_um, predicted_um) = if let Some(model) = beside.filter(|_| can_watch) {
        let quantity = Quantity::Elongation;
        (by(Some(ElongationSource::Sensor), quantity)?, by(Some(model), quantity)?)
    } else {
        let quantity = measured(run, wanted)?;
        let name = format!("measured_{}_um", quantity.name());
        (run.require(&name)?.to_vec(), by(spindle.source, quantity)?)
    };
    let apart_um = measured_um.iter().zip(&predicted_um).map(|(it, said)| it - said).collect();
    Ok((apart_um, predicted_um))
}

/// The most common step of the clock, in s; a minute where there is none.
fn row_s(run: &RunFile) -> f64 {
    let steps = run.column("time_s").unwrap_or_default().windows(2).map(|pair| pair[1] - pair[0]);
    let mut steps: Vec<f64> = steps.filter(|step| *step > 0.0).collect();
    if steps.is_empty() { 60.0 } else { trueup_numerics::robust::median(&mut steps) }
}

/// The measurement to take, by what the difference goes with since it began.
fn next(apart_um: &[f64], predicted_um: &[f64], run: &RunFile, since: usize) -> &'static str {
    let speed = run.column("spindle_rpm").map(|rpm| &rpm[since..]);
    let squared: Vec<f64> =
        speed.map(|rpm| rpm.iter().map(|rpm| rpm * rpm).collect()).unwrap_or_default();
    let with = |column: &[f64]| correlation(apart_um, column).abs();
    let (by_growth, by_speed) = (with(predicted_um), with(&squared));
    // Half of the squares go with it.
    const GOES_WITH: f64 = 0.7;
    if by_growth.max(by_speed) < GOES_WITH {
        "It is the same whatever the machine does: read the sensor and touch off the tool after a night at \
         standstill, then trueup fit elongation."
    } else if by_speed > by_growth {
        "It goes with the speed: run several speeds and read the growth at each (trueup program warmup), \
         then trueup diagnose."
    } else {
        "It goes with the growth: record a warm-up from cold (trueup program warmup), then trueup fit or \
         trueup diagnose."
    }
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let pairs: Vec<(f64, f64)> =
        a.iter().copied().zip(b.iter().copied()).filter(|(a, b)| (a + b).is_finite()).collect();
    let count = pairs.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / count;
    let (mean_a, mean_b) = (mean(|it| it.0), mean(|it| it.1));
    let sum = |of: &dyn Fn(f64, f64) -> f64| {
        pairs.iter().map(|(a, b)| of(a - mean_a, b - mean_b)).sum::<f64>()
    };
    let size = (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt();
    if size > 0.0 { sum(&|a, b| a * b) / size } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tables of the CUSUM: k = 0.5, h = 4 runs 168 rows with two sums, h = 5 465 (Montgomery, chapter 9).
    #[test]
    fn the_height_is_that_of_the_tables() {
        for (rows, h) in [(168.0, 4.0), (465.0, 5.0)] {
            let found = height(0.5, rows);
            assert!((found - h).abs() < 0.06, "{found} is not {h}");
        }
    }
}
