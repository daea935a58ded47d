//! The machine's own sensors: their readings of the truth.
//!
//! A displacement sensor, in this order:
//!
//! ```text
//! u = growth, late by delay_s, then behind by a lag
//! v = gain·u + curvature·u² + drift·(T_coil − T₀) + run-out + noise        µm
//! counts = nearest whole number of zero_counts + v/um_per_count, held to 0…full_scale_counts
//! ```
//!
//! The run-out that is left after averaging over turns has another phase in each row. A thermometer has
//! a lag, an offset, noise and a last digit. Any cell may be missing.

use std::collections::VecDeque;

use schemars::JsonSchema;
use serde::Deserialize;

use crate::{
    noise::{CorrelatedNoise, RandomStream},
    scenario_error::{RuleViolation, keys},
};

/// The displacement sensor in the spindle nose; without faults by default.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DisplacementConfig {
    /// The counts of a cold spindle.
    pub zero_counts: f64,
    /// µm for one count, not 0.
    pub um_per_count: f64,
    /// The largest count; the smallest is 0.
    pub full_scale_counts: f64,
    /// Gain: its reading of 1 µm.
    pub gain: f64,
    /// The quadratic term of its reading, in µm per µm².
    pub curvature_per_um: f64,
    /// Drift with the temperature of its coil, in µm/K.
    pub coil_um_per_c: f64,
    /// The coil temperature at which it is right, in °C.
    pub coil_reference_c: f64,
    /// How late its values are, in s; at least 0.
    pub delay_s: f64,
    /// Time constant of its filter in s; at least 0.
    pub lag_s: f64,
    /// Amplitude of the run-out that is left, in µm.
    pub runout_um: f64,
    /// White noise in µm, standard deviation.
    pub noise_um: f64,
    /// Correlated noise in µm, standard deviation.
    pub correlated_um: f64,
    /// Its time constant in s.
    pub correlated_s: f64,
    /// The share of rows in which it is missing, 0…1.
    pub dropout: f64,
}

impl Default for DisplacementConfig {
    fn default() -> Self {
        Self {
            zero_counts: 5048.0,
            um_per_count: 500.0 / 32768.0,
            full_scale_counts: 32768.0,
            gain: 1.0,
            curvature_per_um: 0.0,
            coil_um_per_c: 0.0,
            coil_reference_c: 20.0,
            delay_s: 0.0,
            lag_s: 0.0,
            runout_um: 0.0,
            noise_um: 0.0,
            correlated_um: 0.0,
            correlated_s: 600.0,
            dropout: 0.0,
        }
    }
}

impl DisplacementConfig {
    /// The first rule that is broken.
    pub(crate) fn check(&self) -> Result<(), RuleViolation> {
        if self.um_per_count == 0.0 {
            return Err(RuleViolation::new("um_per_count", "must not be 0".into()));
        }
        RuleViolation::require_fractions(&keys!(self: dropout))?;
        RuleViolation::require_non_negative(
            &keys!(self: full_scale_counts, delay_s, lag_s, runout_um, noise_um, correlated_um, correlated_s),
        )
    }
}

/// A displacement sensor on its way through a run.
#[derive(Clone, Debug)]
pub(crate) struct DisplacementSensor {
    config: DisplacementConfig,
    /// Times and growths that have not come out of the delay yet, the oldest first.
    waiting: VecDeque<(f64, f64)>,
    time_s: f64,
    delayed_um: f64,
    lagged_um: Option<f64>,
    chance: RandomStream,
    correlated: CorrelatedNoise,
    read_s: f64,
}

impl DisplacementSensor {
    /// Returns a sensor with chance of its own under `seed`.
    #[must_use]
    pub fn new(config: &DisplacementConfig, seed: u64) -> Self {
        let correlated = RandomStream::new(seed, "sensor, correlated");
        Self {
            correlated: CorrelatedNoise::new(correlated, config.correlated_um, 0.0),
            config: config.clone(),
            waiting: VecDeque::new(),
            time_s: 0.0,
            delayed_um: f64::NAN,
            lagged_um: None,
            chance: RandomStream::new(seed, "sensor"),
            read_s: 0.0,
        }
    }

    /// Returns the counts of its full scale.
    #[must_use]
    pub fn full_scale_counts(&self) -> f64 {
        self.config.full_scale_counts
    }

    /// Sees `growth_um`, `dt_s` after the last time; 0 at first.
    pub fn step(&mut self, dt_s: f64, growth_um: f64) {
        self.time_s += dt_s;
        self.waiting.push_back((self.time_s, growth_um));
        let out_s = self.time_s - self.config.delay_s;
        // What is as old as the delay comes out, straight between the two around it. Before there is
        // any such, the machine has always stood as it did at first.
        while self.waiting.get(1).is_some_and(|&(time_s, _)| time_s <= out_s) {
            self.waiting.pop_front();
        }
        self.delayed_um = match (self.waiting.front(), self.waiting.get(1)) {
            (Some(&(t0, u0)), Some(&(t1, u1))) if t0 <= out_s => {
                u0 + (u1 - u0) * (out_s - t0) / (t1 - t0)
            }
            (Some(&(_, u0)), _) => u0,
            (None, _) => growth_um,
        };
        let before = self.lagged_um.unwrap_or(self.delayed_um);
        let left = if self.config.lag_s > 0.0 { (-dt_s / self.config.lag_s).exp() } else { 0.0 };
        self.lagged_um = Some(self.delayed_um + (before - self.delayed_um) * left);
    }

    /// Its counts now, with the coil at `coil_c` and the spindle turning or not; NaN where missing.
    pub fn read(&mut self, coil_c: f64, turns: bool) -> f64 {
        let config = &self.config;
        let u = self.lagged_um.unwrap_or(0.0);
        let phase = self.chance.uniform(0.0, std::f64::consts::TAU);
        let white = self.chance.standard_normal();
        let is_missing = self.chance.bernoulli(config.dropout);
        let rho = autocorrelation(self.time_s - self.read_s, config.correlated_s);
        self.read_s = self.time_s;
        let v = config.gain * u
            + config.curvature_per_um * u * u
            + config.coil_um_per_c * (coil_c - config.coil_reference_c)
            + if turns { config.runout_um * phase.sin() } else { 0.0 }
            + config.noise_um * white
            + self.correlated.draw_correlated(rho);
        if is_missing {
            return f64::NAN;
        }
        (config.zero_counts + v / config.um_per_count).round().clamp(0.0, config.full_scale_counts)
    }
}

/// Returns the correlation over `dt_s` of noise with the time constant `constant_s`.
pub(crate) fn autocorrelation(dt_s: f64, constant_s: f64) -> f64 {
    if constant_s > 0.0 { (-dt_s / constant_s).exp() } else { 0.0 }
}

/// Where a thermometer may be put.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Spot {
    /// The air around the machine.
    Ambient,
    /// The coolant on its way to the spindle.
    Coolant,
    /// The shaft at the front bearing.
    Front,
    /// The shaft at the rear bearing.
    Rear,
    /// The shaft in the motor.
    Motor,
    /// The shaft at the nose.
    Nose,
    /// The spindle's housing.
    Housing,
    /// Tool and holder.
    Holder,
    /// The coil of the displacement sensor.
    Coil,
    /// The screw of X.
    ScrewX,
    /// The screw of Y.
    ScrewY,
    /// The screw of Z.
    ScrewZ,
    /// The scale of X.
    ScaleX,
    /// The scale of Y.
    ScaleY,
    /// The scale of Z.
    ScaleZ,
}

impl Spot {
    /// Returns whether it is on the spindle.
    #[must_use]
    pub(crate) fn is_on_spindle(self) -> bool {
        matches!(
            self,
            Self::Front
                | Self::Rear
                | Self::Motor
                | Self::Nose
                | Self::Housing
                | Self::Holder
                | Self::Coil
        )
    }
}

/// A thermometer, where it is and how it errs.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ThermometerConfig {
    /// Where it is.
    pub at: Spot,
    /// How far it shows too much, in K.
    #[serde(default)]
    pub offset_c: f64,
    /// Its time constant in s.
    #[serde(default)]
    pub lag_s: f64,
    /// Its noise in K, standard deviation.
    #[serde(default)]
    pub noise_c: f64,
    /// Its last digit in K; 0: a thousandth.
    #[serde(default = "default_resolution_c")]
    pub quantum_c: f64,
    /// The share of rows in which it is missing, 0…1.
    #[serde(default)]
    pub dropout: f64,
}

fn default_resolution_c() -> f64 {
    1.0 / 16.0
}

impl ThermometerConfig {
    /// The first rule that is broken.
    pub(crate) fn check(&self) -> Result<(), RuleViolation> {
        RuleViolation::require_fractions(&keys!(self: dropout))?;
        RuleViolation::require_non_negative(&keys!(self: lag_s, noise_c, quantum_c))
    }
}

/// A thermometer on its way through a run.
#[derive(Clone, Debug)]
pub struct Thermometer {
    config: ThermometerConfig,
    shown_c: Option<f64>,
    chance: RandomStream,
}

impl Thermometer {
    /// Returns the thermometer `name`, with chance of its own under `seed`.
    #[must_use]
    pub fn new(config: &ThermometerConfig, name: &str, seed: u64) -> Self {
        let chance = RandomStream::new(seed, &format!("thermometer {name}"));
        Self { config: config.clone(), shown_c: None, chance }
    }

    /// Where it is.
    #[must_use]
    pub(crate) fn spot(&self) -> Spot {
        self.config.at
    }

    /// Feels `temperature_c` for `dt_s`.
    pub fn step(&mut self, dt_s: f64, temperature_c: f64) {
        let before_c = self.shown_c.unwrap_or(temperature_c);
        let left = if self.config.lag_s > 0.0 { (-dt_s / self.config.lag_s).exp() } else { 0.0 };
        self.shown_c = Some(temperature_c + (before_c - temperature_c) * left);
    }

    /// Returns what it shows now, in °C; NaN where missing.
    pub fn read(&mut self) -> f64 {
        let shown_c = self.shown_c.unwrap_or(f64::NAN) + self.config.offset_c;
        let noisy_c = shown_c + self.config.noise_c * self.chance.standard_normal();
        if self.chance.bernoulli(self.config.dropout) {
            return f64::NAN;
        }
        let quantum_c = self.config.quantum_c;
        if quantum_c > 0.0 { (noisy_c / quantum_c).round() * quantum_c } else { noisy_c }
    }
}
