//! The inputs of the board, as the user describes them, and the sensor's way from counts to codes.
//!
//! A count is the unit in which the run file states the sensor: the PLC's, `counts_full_scale` of
//! them for `volts_full_scale`. On the board the same signal passes a divider into a 12-bit ADC:
//!
//! ```text
//! V = counts · volts_full_scale / counts_full_scale
//! codes = V · divider / 3.3 V · 4096
//! reading = 1024 · codes
//! ```
//!
//! With the paper's sensor (10 V at 32768 counts) and the divider of the wiring, 0.328, one code is 8.05 counts;
//! with one that takes 10 V to the whole 3.3 V it would be 8.

use std::collections::BTreeMap;

use trueup_core::units::{Code, READINGS_PER_CODE, Reading};

/// The ADC's reference: its full scale in volts.
pub const REFERENCE_VOLTS: f64 = 3.3;

/// The board's temperature channels are numbered from 0 to this one.
pub const LAST_CHANNEL: u8 = 7;

/// What is connected to the board. Needed to run there, not to predict.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Inputs {
    /// The displacement sensor.
    pub sensor: Option<SensorInput>,
    /// The temperature channels by the name of their run-file column, `temp_<name>_c`.
    pub temperatures: BTreeMap<String, TemperatureInput>,
    /// The board is written to only with its service switch closed.
    pub service_switch: bool,
}

/// How a temperature comes in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TemperatureInput {
    /// The converter's number on the board, 0…[`LAST_CHANNEL`]; no two temperatures share one.
    pub channel: u8,
    /// What its counts mean.
    pub kind: TemperatureKind,
    /// How fast it may change in K/min, within [`RATES_C_PER_MIN`]; `None`: the board's default where a law uses it.
    pub max_c_per_min: Option<f64>,
}

/// What a thermometer's mass can do, from the slowest to the fastest limit that may be stated, in K/min.
pub const RATES_C_PER_MIN: [f64; 2] = [0.1, 600.0];

/// What the counts of a temperature channel mean.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TemperatureKind {
    /// A PT100 by IEC 60751.
    Pt100,
    /// T in °C = (counts − `zero_counts`) / `counts_per_c`.
    Linear {
        /// The counts at 0 °C.
        zero_counts: f64,
        /// Counts for one °C; not 0.
        counts_per_c: f64,
    },
}

/// The chain from the displacement sensor's counts to the ADC.
///
/// What the machine file gives is positive, and its full scale after the divider is within
/// [`REFERENCE_VOLTS`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorInput {
    /// The sensor's voltage at `counts_full_scale`, in volts.
    pub volts_full_scale: f64,
    /// The largest count; the smallest is 0.
    pub counts_full_scale: f64,
    /// Volts at the ADC for one volt of the sensor.
    pub divider: f64,
}

impl SensorInput {
    /// The sensor's voltage.
    #[must_use]
    pub fn volts_from_counts(&self, counts: f64) -> f64 {
        counts * (self.volts_full_scale / self.counts_full_scale)
    }

    /// ADC codes at full resolution: neither rounded nor held to 0…4095.
    #[must_use]
    pub fn codes_from_counts(&self, counts: f64) -> f64 {
        counts * self.codes_per_count()
    }

    /// The counts that give `codes`, the inverse of [`Self::codes_from_counts`].
    #[must_use]
    pub fn counts_from_codes(&self, codes: f64) -> f64 {
        codes / self.codes_per_count()
    }

    /// Reading units at full resolution: not rounded.
    #[must_use]
    pub fn exact_reading_from_counts(&self, counts: f64) -> f64 {
        self.codes_from_counts(counts) * f64::from(READINGS_PER_CODE)
    }

    /// The nearest reading, at most half a unit (1/2048 code) off; saturates at the ends of `i32`,
    /// and a missing count (NaN) reads 0.
    #[must_use]
    pub fn reading_from_counts(&self, counts: f64) -> Reading {
        // A cast from f64 saturates and takes NaN to 0.
        Reading(self.exact_reading_from_counts(counts).round() as i32)
    }

    /// Whether the sensor can give these counts: 0…`counts_full_scale`. NaN cannot be given.
    #[must_use]
    pub fn is_in_range(&self, counts: f64) -> bool {
        (0.0..=self.counts_full_scale).contains(&counts)
    }

    fn codes_per_count(&self) -> f64 {
        // In this order the paper's chain comes out at exactly 1/8.
        let adc_scale = self.volts_full_scale / REFERENCE_VOLTS * self.divider;
        adc_scale / self.counts_full_scale * f64::from(Code::FULL_SCALE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's sensor and the divider of this project's board.
    const PAPER: SensorInput =
        SensorInput { volts_full_scale: 10.0, counts_full_scale: 32768.0, divider: 0.33 };

    #[test]
    fn one_code_is_eight_of_the_papers_counts() {
        assert_eq!(PAPER.codes_from_counts(8.0), 1.0);
        assert_eq!(PAPER.counts_from_codes(1.0), 8.0);
        assert_eq!(PAPER.codes_from_counts(32768.0), 4096.0);
    }

    #[test]
    fn one_code_of_the_papers_sensor_is_122_nm() {
        let um_per_count = 500.0 / 32768.0;
        assert_eq!(PAPER.counts_from_codes(1.0) * um_per_count, 0.122_070_312_5);
    }

    #[test]
    fn one_count_of_the_papers_sensor_is_128_readings() {
        assert_eq!(PAPER.reading_from_counts(1.0), Reading(128));
        assert_eq!(PAPER.reading_from_counts(5048.0), Reading(5048 * 128));
        assert_eq!(PAPER.reading_from_counts(0.0), Reading(0));
    }

    #[test]
    fn full_scale_is_the_stated_voltage() {
        assert_eq!(PAPER.volts_from_counts(32768.0), 10.0);
        assert_eq!(PAPER.volts_from_counts(16384.0), 5.0);
    }

    #[test]
    fn an_s7_input_reaches_ten_volts_at_27648_counts() {
        let s7 = SensorInput { counts_full_scale: 27648.0, ..PAPER };
        assert_eq!(s7.volts_from_counts(27648.0), 10.0);
        assert!((s7.codes_from_counts(27648.0) - 4096.0).abs() < 1e-9);
    }

    #[test]
    fn codes_and_counts_are_inverse_over_the_whole_range() {
        let odd = SensorInput { volts_full_scale: 5.0, counts_full_scale: 27648.0, divider: 0.61 };
        for counts in 0..=27648 {
            let counts = f64::from(counts);
            let back = odd.counts_from_codes(odd.codes_from_counts(counts));
            assert!((back - counts).abs() <= 1e-10, "{counts} came back as {back}");
        }
    }

    #[test]
    fn readings_saturate_and_a_missing_count_reads_zero() {
        assert_eq!(PAPER.reading_from_counts(1e12), Reading(i32::MAX));
        assert_eq!(PAPER.reading_from_counts(-1e12), Reading(i32::MIN));
        assert_eq!(PAPER.reading_from_counts(f64::NAN), Reading(0));
    }

    #[test]
    fn the_range_ends_are_in_range_and_a_missing_count_is_not() {
        assert!(PAPER.is_in_range(0.0) && PAPER.is_in_range(32768.0));
        assert!(!PAPER.is_in_range(-1.0) && !PAPER.is_in_range(32769.0));
        assert!(!PAPER.is_in_range(f64::NAN));
    }
}
