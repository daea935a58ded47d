//! The reference model in `f64`: what the board's integers are measured against.
//!
//! Elongation by the displacement sensor (Shi, Gao and Mao, section 2.2.2):
//!
//! ```text
//! ΔK = K₀ + (V − V₀)·tanβ
//! ```
//!
//! It is positive when the tool grows out of the spindle, and an error of ΔK·V̂ in machine
//! coordinates, V̂ the tool direction. The CNC adds the offset, the opposite of the error: with the
//! tool pointing down, growth of +60 µm is an error of −60 µm in Z, and the offset lifts by +60 µm.

use crate::machine_file::{Machine, SensorModel, Source};

/// The elongation in µm that the sensor's law gives for `sensor_counts`; NaN for a missing count.
///
/// ```
/// use trueup_machine::{machine_file::SensorModel, model::elongation_um};
/// let paper = SensorModel {
///     k0_um: 0.0, zero_counts: 5048.0, um_per_count: 500.0 / 32768.0, temperature: None,
/// };
/// // (9164 − 5048) · 500/32768 = 4116 · 0.0152587890625
/// assert_eq!(elongation_um(&paper, 9164.0), 62.80517578125);
/// ```
#[must_use]
pub fn elongation_um(sensor: &SensorModel, sensor_counts: f64) -> f64 {
    sensor.k0_um + (sensor_counts - sensor.zero_counts) * sensor.um_per_count
}

/// The error on X, Y and Z in µm of a tool that has grown by `elongation_um` along the unit vector
/// `tool_direction`.
#[must_use]
pub fn error_um(elongation_um: f64, tool_direction: [f64; 3]) -> [f64; 3] {
    // + 0.0 turns the −0 of a zero component into 0, which is what a table should show.
    tool_direction.map(|component| elongation_um * component + 0.0)
}

/// What the CNC must add to its command on X, Y and Z, in µm: the opposite of [`error_um`].
#[must_use]
pub fn offset_um(elongation_um: f64, tool_direction: [f64; 3]) -> [f64; 3] {
    error_um(-elongation_um, tool_direction)
}

impl Machine {
    /// The elongation in µm from the configured source: 0 where there is none, NaN for a missing
    /// count.
    #[must_use]
    pub fn elongation_um(&self, sensor_counts: f64) -> f64 {
        match (self.spindle.source, &self.spindle.sensor) {
            (Some(Source::Sensor), Some(sensor)) => elongation_um(sensor, sensor_counts),
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DOWN: [f64; 3] = [0.0, 0.0, -1.0];

    fn paper() -> SensorModel {
        SensorModel {
            k0_um: 0.0,
            zero_counts: 5048.0,
            um_per_count: 500.0 / 32768.0,
            temperature: None,
        }
    }

    #[test]
    fn the_papers_readings_give_the_papers_micrometres() {
        // Counts are whole, so a value printed to 0.1 µm comes back within half a count.
        for (counts, um) in
            [(5048.0, 0.0), (5376.0, 5.0), (6359.0, 20.0), (8194.0, 48.0), (9164.0, 62.8)]
        {
            assert!((elongation_um(&paper(), counts) - um).abs() < 0.0077, "{counts} counts");
        }
        assert_eq!(elongation_um(&paper(), 9164.0), 62.805_175_781_25);
    }

    #[test]
    fn k0_is_the_elongation_at_the_zero_reading() {
        let shifted = SensorModel { k0_um: 3.25, ..paper() };
        assert_eq!(elongation_um(&shifted, 5048.0), 3.25);
    }

    #[test]
    fn a_reading_below_zero_is_a_spindle_that_has_shrunk() {
        assert_eq!(elongation_um(&paper(), 5048.0 - 64.0), -0.976_562_5);
    }

    #[test]
    fn growth_lifts_the_tool() {
        assert_eq!(error_um(62.8, DOWN), [0.0, 0.0, -62.8]);
        assert_eq!(offset_um(62.8, DOWN), [0.0, 0.0, 62.8]);
    }

    #[test]
    fn shrinking_lowers_the_tool() {
        assert_eq!(offset_um(-5.0, DOWN), [0.0, 0.0, -5.0]);
    }

    #[test]
    fn a_tool_swung_by_a_30_degrees_takes_the_papers_shares() {
        // A = +30° turns (0, 0, −1) to (0, sin 30°, −cos 30°).
        let swung = [0.0, 0.5, -(0.75_f64.sqrt())];
        let error = error_um(500.0, swung);
        assert_eq!(error[1], 250.0);
        assert!((error[2] + 433.0).abs() < 0.02);
        let offset = offset_um(500.0, swung);
        assert_eq!(offset, error.map(|component| -component + 0.0));
    }

    #[test]
    fn no_component_is_minus_zero() {
        for component in offset_um(1.0, DOWN).into_iter().chain(error_um(1.0, DOWN)) {
            assert!(component != 0.0 || component.is_sign_positive());
        }
    }
}
