//! The reference instrument, which has an error of its own.
//!
//! ```text
//! shown = gain·value + drift·t + jumps so far + a·sin(2π·reading/period) + noise, to its last digit
//! ```
//!
//! The reading is what the instrument stands at: the elongation itself, or on an axis its position.
//! Jumps come by chance, as of a foot that slips, and stay.

use schemars::JsonSchema;
use serde::Deserialize;

use crate::{
    noise::{CorrelatedNoise, RandomStream},
    scenario_error::{RuleViolation, keys},
    sensors::autocorrelation,
};

/// The instrument as a scenario describes it; without faults by default.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct InstrumentConfig {
    /// Gain: its reading of 1 µm.
    pub gain: f64,
    /// Its last digit in µm; 0: a tenth of a nanometre.
    pub quantum_um: f64,
    /// White noise in µm, standard deviation.
    pub noise_um: f64,
    /// Correlated noise in µm, standard deviation.
    pub correlated_um: f64,
    /// Its time constant in s.
    pub correlated_s: f64,
    /// Its drift in µm/h.
    pub drift_um_per_h: f64,
    /// How many jumps there are in an hour, on the average.
    pub jumps_per_h: f64,
    /// Their size in µm, standard deviation.
    pub jump_um: f64,
    /// Amplitude of its periodic error in µm.
    pub periodic_um: f64,
    /// The period of that in µm of its reading, above 0.
    pub period_um: f64,
    /// The share of rows in which it is missing, 0…1.
    pub dropout: f64,
    /// The share of rows in which it is grossly wrong, 0…1.
    pub outliers: f64,
    /// How wrong, in µm, standard deviation.
    pub outlier_um: f64,
}

impl Default for InstrumentConfig {
    fn default() -> Self {
        Self {
            gain: 1.0,
            quantum_um: 0.01,
            noise_um: 0.0,
            correlated_um: 0.0,
            correlated_s: 600.0,
            drift_um_per_h: 0.0,
            jumps_per_h: 0.0,
            jump_um: 0.0,
            periodic_um: 0.0,
            period_um: 1000.0,
            dropout: 0.0,
            outliers: 0.0,
            outlier_um: 100.0,
        }
    }
}

impl InstrumentConfig {
    /// The first rule that is broken.
    pub(crate) fn check(&self) -> Result<(), RuleViolation> {
        if self.period_um <= 0.0 {
            return Err(RuleViolation::new(
                "period_um",
                format!("must be above 0, not {}", self.period_um),
            ));
        }
        RuleViolation::require_fractions(&keys!(self: dropout, outliers))?;
        RuleViolation::require_non_negative(
            &keys!(self: quantum_um, noise_um, correlated_um, correlated_s, jumps_per_h, jump_um, outlier_um),
        )
    }
}

/// An instrument on its way through a run.
#[derive(Clone, Debug)]
pub struct Instrument {
    config: InstrumentConfig,
    chance: RandomStream,
    jumps: RandomStream,
    correlated: CorrelatedNoise,
    jumped_um: f64,
    time_s: f64,
}

impl Instrument {
    /// Returns the instrument for `quantity`, with chance of its own under `seed`.
    #[must_use]
    pub fn new(config: &InstrumentConfig, quantity: &str, seed: u64) -> Self {
        let stream = |what: &str| RandomStream::new(seed, &format!("instrument {quantity} {what}"));
        Self {
            correlated: CorrelatedNoise::new(stream("correlated"), config.correlated_um, 0.0),
            config: config.clone(),
            chance: stream("noise"),
            jumps: stream("jumps"),
            jumped_um: 0.0,
            time_s: 0.0,
        }
    }

    /// Returns what it shows at `time_s` of `value_um`, standing at `reading_um`; NaN where missing.
    pub fn read(&mut self, time_s: f64, value_um: f64, reading_um: f64) -> f64 {
        let config = &self.config;
        let passed_s = time_s - self.time_s;
        self.time_s = time_s;
        let jump_um = config.jump_um * self.jumps.standard_normal();
        // The chance that one falls into this interval; two of them are one larger one.
        if self.jumps.bernoulli(1.0 - (-config.jumps_per_h * passed_s / 3600.0).exp()) {
            self.jumped_um += jump_um;
        }
        let turns = reading_um / config.period_um;
        let white = config.noise_um * self.chance.standard_normal();
        let gross = config.outlier_um * self.chance.standard_normal();
        let is_gross = self.chance.bernoulli(config.outliers);
        let is_missing = self.chance.bernoulli(config.dropout);
        let shown_um = config.gain * value_um
            + config.drift_um_per_h * time_s / 3600.0
            + self.jumped_um
            + config.periodic_um * (std::f64::consts::TAU * turns).sin()
            + white
            + if is_gross { gross } else { 0.0 }
            + self.correlated.draw_correlated(autocorrelation(passed_s, config.correlated_s));
        match config.quantum_um {
            _ if is_missing => f64::NAN,
            quantum_um if quantum_um > 0.0 => (shown_um / quantum_um).round() * quantum_um,
            _ => shown_um,
        }
    }
}
