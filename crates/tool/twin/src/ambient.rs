//! The air of the shop over the day.
//!
//! ```text
//! T = mean + amplitude·cos(2π·(t − t_warmest)/24 h) + trend·t + wander
//! ```
//!
//! The wander is people, doors and sun: a random walk that is drawn back to 0 with a time constant,
//! of a given standard deviation.

use schemars::JsonSchema;
use serde::Deserialize;

use crate::noise::RandomStream;

const SECONDS_PER_DAY: f64 = 86_400.0;

/// The air as a scenario describes it.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AmbientConfig {
    /// Mean of the day in °C.
    pub mean_c: f64,
    /// Half the difference of the warmest and the coldest hour, in K.
    pub amplitude_c: f64,
    /// When it is warmest, in hours after the start of the run.
    pub warmest_h: f64,
    /// Trend in K/h.
    pub trend_c_per_h: f64,
    /// Standard deviation of the wander in K.
    pub wander_c: f64,
    /// Time constant of the wander in s, above 0.
    pub wander_s: f64,
}

impl Default for AmbientConfig {
    fn default() -> Self {
        Self {
            mean_c: 20.0,
            amplitude_c: 0.0,
            warmest_h: 6.0,
            trend_c_per_h: 0.0,
            wander_c: 0.0,
            wander_s: 1800.0,
        }
    }
}

/// The air on its way through a run.
#[derive(Clone, Debug)]
pub struct AmbientAir {
    config: AmbientConfig,
    stream: RandomStream,
    time_s: f64,
    wander_c: f64,
}

impl AmbientAir {
    /// At the start of the run.
    #[must_use]
    pub fn new(config: &AmbientConfig, mut stream: RandomStream) -> Self {
        let wander_c = config.wander_c * stream.standard_normal();
        Self { config: config.clone(), stream, time_s: 0.0, wander_c }
    }

    /// Returns the current temperature in °C.
    #[must_use]
    pub fn temperature_c(&self) -> f64 {
        let config = &self.config;
        let phase =
            std::f64::consts::TAU * (self.time_s - config.warmest_h * 3600.0) / SECONDS_PER_DAY;
        config.mean_c
            + config.amplitude_c * phase.cos()
            + config.trend_c_per_h * self.time_s / 3600.0
            + self.wander_c
    }

    /// Steps on by `dt_s`. Returns the temperature in °C.
    pub fn step(&mut self, dt_s: f64) -> f64 {
        self.time_s += dt_s;
        // The exact step of an Ornstein–Uhlenbeck process: its size does not depend on dt_s.
        let left = (-dt_s / self.config.wander_s.max(1e-9)).exp();
        let fresh =
            (1.0 - left * left).sqrt() * self.config.wander_c * self.stream.standard_normal();
        self.wander_c = left * self.wander_c + fresh;
        self.temperature_c()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_day_is_warmest_at_its_hour_and_coldest_half_a_day_later() {
        let config = AmbientConfig { amplitude_c: 3.0, warmest_h: 5.0, ..Default::default() };
        let mut ambient = AmbientAir::new(&config, RandomStream::new(1, "ambient"));
        assert!((ambient.step(5.0 * 3600.0) - 23.0).abs() < 1e-9);
        assert!((ambient.step(12.0 * 3600.0) - 17.0).abs() < 1e-9);
    }

    #[test]
    fn the_wander_has_its_size_at_every_step_length() {
        for dt_s in [10.0, 600.0] {
            let config = AmbientConfig { wander_c: 0.5, wander_s: 300.0, ..Default::default() };
            let mut ambient = AmbientAir::new(&config, RandomStream::new(3, "ambient"));
            let apart: Vec<f64> = (0..40_000).map(|_| ambient.step(dt_s) - 20.0).collect();
            assert!((crate::noise::rms(&apart) / 0.5 - 1.0).abs() < 0.06, "{dt_s} s");
        }
    }
}
