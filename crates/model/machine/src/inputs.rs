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

use trueup_core::{
    calibration::MainsFrequency,
    sensor_health::{HIGH_RAIL, LOW_RAIL},
    thermometer::Thermometer,
    units::{AdcCode, READING_UNITS_PER_CODE, SensorReading, Temperature},
};

use crate::keys::table::table;

/// The ADC's reference: its full scale in volts.
pub const ADC_REFERENCE_VOLTS: f64 = 3.3;

/// The board's temperature channels are numbered from 0 to this one.
pub const MAX_TEMPERATURE_CHANNEL: u8 = 7;

/// The inputs connected to the board. Needed to run there, not to predict.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BoardInputs {
    /// The displacement sensor.
    pub sensor: Option<SensorInput>,
    /// The temperature channels by the name of their run-file column, `temp_<name>_c`.
    pub temperatures: BTreeMap<String, TemperatureInput>,
    /// The conditions by the name of their run-file column, which has 0 and 1.
    pub conditions: BTreeMap<String, ConditionInput>,
    /// The board is written to only with its service switch closed.
    pub service_switch: bool,
    /// The mains whose hum the temperature inputs suppress.
    pub mains: MainsFrequency,
}

/// How a condition comes in: as a bit of the CNC's `Conditions`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConditionInput {
    /// 0…15; no two conditions share one.
    pub bit: u8,
    /// Whether it counts as holding while the CNC does not send it.
    pub default: bool,
}

/// How a temperature comes in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TemperatureInput {
    /// The converter's number on the board, 0…[`MAX_TEMPERATURE_CHANNEL`]; no two temperatures share one.
    pub channel: u8,
    /// The meaning of its counts.
    pub kind: TemperatureInputKind,
    /// How fast it may change in K/min, within `RATE_LIMIT_RANGE_C_PER_MIN`; `None`: the board's default where a law uses it.
    pub max_c_per_min: Option<f64>,
}

/// Lowest and highest limit that may be stated for a thermometer's rate of change, by what its mass can do, in K/min.
pub(crate) const RATE_LIMIT_RANGE_C_PER_MIN: [f64; 2] = [0.1, 600.0];

/// The meaning of the counts of a temperature channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TemperatureInputKind {
    /// A PT100 by IEC 60751.
    Pt100,
    /// A line.
    Linear(LinearInput),
}

/// A linear temperature input: T in °C = (counts − `zero_counts`) / `counts_per_c`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearInput {
    /// The counts at 0 °C.
    pub zero_counts: f64,
    /// Counts for one °C; not 0.
    pub counts_per_c: f64,
    /// The meaning of a count.
    pub scale: CountScale,
}

/// The meaning of a count of a linear temperature input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CountScale {
    /// A code of the board's converter: [`AdcCode::FULL_SCALE`] at [`ADC_REFERENCE_VOLTS`] on its pin.
    Code,
    /// A volt at the input, up to `full_scale_v`; at the pin `divider` of it.
    Volt {
        /// The largest voltage of the transmitter.
        full_scale_v: f64,
        /// Volts at the board's converter for one volt of the input.
        divider: f64,
    },
    /// A count of another converter, which gives `counts_full_scale` at `full_scale_v`.
    Count {
        /// The counts at `full_scale_v`.
        counts_full_scale: f64,
        /// The voltage of the input at `counts_full_scale`.
        full_scale_v: f64,
        /// Volts at the board's converter for one volt of the input.
        divider: f64,
    },
}

impl CountScale {
    /// Returns the codes of the board's converter for one count.
    #[must_use]
    pub(crate) fn codes_per_count(self) -> f64 {
        let codes_per_v = f64::from(AdcCode::FULL_SCALE) / ADC_REFERENCE_VOLTS;
        match self {
            Self::Code => 1.0,
            Self::Volt { divider, .. } => divider * codes_per_v,
            Self::Count { counts_full_scale, full_scale_v, divider } => {
                full_scale_v / counts_full_scale * divider * codes_per_v
            }
        }
    }

    /// Returns the largest count that the transmitter gives.
    #[must_use]
    pub(crate) fn max_count(self) -> f64 {
        match self {
            Self::Code => f64::from(AdcCode::FULL_SCALE),
            Self::Volt { full_scale_v, .. } => full_scale_v,
            Self::Count { counts_full_scale, .. } => counts_full_scale,
        }
    }
}

impl LinearInput {
    /// Returns the same line in codes of the board's converter: the code at 0 °C, and codes for one °C.
    #[must_use]
    pub fn linear_coefficients_in_codes(&self) -> (f64, f64) {
        let codes = self.scale.codes_per_count();
        (self.zero_counts * codes, self.counts_per_c * codes)
    }

    /// Returns the temperature in °C of a code of the board's converter.
    ///
    /// ```
    /// use trueup_machine::inputs::{CountScale, LinearInput};
    /// // The paper's T = (counts − 4000)/16, with 32768 counts at 10 V: 1520 codes of 0.328 · 10 V / 3.3 V
    /// // · 4096 = 4071.2 are 12 234 counts, or 514.6 °C.
    /// let scale = CountScale::Count { counts_full_scale: 32_768.0, full_scale_v: 10.0, divider: 0.328 };
    /// let paper = LinearInput { zero_counts: 4_000.0, counts_per_c: 16.0, scale };
    /// assert!((paper.celsius_from_code(1_520.0) - 514.63).abs() < 0.01);
    /// ```
    #[must_use]
    pub fn celsius_from_code(&self, code: f64) -> f64 {
        let (zero, per_c) = self.linear_coefficients_in_codes();
        (code - zero) / per_c
    }

    /// Returns the lowest and the highest temperature in °C that the input can give: between the codes at which the
    /// board takes it for a broken wire or a short circuit, up to the transmitter's full scale, and within ±500 °C.
    /// `None` where nothing is left.
    #[must_use]
    pub(crate) fn temperature_range_c(&self) -> Option<[f64; 2]> {
        let last = self.scale.max_count() * self.scale.codes_per_count();
        let lowest = f64::from(LOW_RAIL.0) + 1.0;
        let highest = last.min(f64::from(HIGH_RAIL.0) - 1.0);
        let ends = [self.celsius_from_code(lowest), self.celsius_from_code(highest)];
        let limit =
            f64::from(Thermometer::MAX_ABS_TEMPERATURE.0) / f64::from(Temperature::PER_KELVIN);
        let [low, high] = [ends[0].min(ends[1]).max(-limit), ends[0].max(ends[1]).min(limit)];
        (lowest < highest && low < high).then_some([low, high])
    }
}

table! {
    /// The chain from the displacement sensor's counts to the ADC.
    ///
    /// The values of the machine file are positive, and its full scale after the divider is within
    /// [`ADC_REFERENCE_VOLTS`].
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct SensorInput {
        volts_full_scale: f64 = key(Positive, "V", "what the sensor gives at `counts_full_scale`").required().with_example_value("10.0").with_range(range([0.0, 1e4], [0.1, 100.0], [1.0, 10.0], "data sheets of sensors").with_hint_above("probably in mV instead of V"));
        /// The largest count; the smallest is 0.
        counts_full_scale: f64 = key(Positive, "counts", "what a run file states at `volts_full_scale`: 27648 for a SIMATIC S7 input, 32768 for the paper's").required().with_example_value("32768");
        divider: f64 = key(Positive, "", "volts at the board's converter for one volt of the sensor; `volts_full_scale` · `divider` must not be above 3.3 V").required().with_example_value("0.328").with_range(range([0.0, 1e3], [1e-3, 10.0], [0.1, 1.0], USER_SETTING_SOURCE));
    }
}

impl SensorInput {
    /// Returns the sensor's voltage.
    #[must_use]
    pub fn volts_from_counts(&self, counts: f64) -> f64 {
        counts * (self.volts_full_scale / self.counts_full_scale)
    }

    /// ADC codes at full resolution: neither rounded nor held to 0…4095.
    #[must_use]
    pub fn codes_from_counts(&self, counts: f64) -> f64 {
        counts * self.codes_per_count()
    }

    /// Returns the counts that give `codes`, the inverse of [`Self::codes_from_counts`].
    #[must_use]
    pub(crate) fn counts_from_codes(&self, codes: f64) -> f64 {
        codes / self.codes_per_count()
    }

    /// Reading units at full resolution: not rounded.
    #[must_use]
    pub(crate) fn exact_reading_from_counts(&self, counts: f64) -> f64 {
        self.codes_from_counts(counts) * f64::from(READING_UNITS_PER_CODE)
    }

    /// Returns the nearest reading, at most half a unit (1/2048 code) off; saturates at the ends of `i32`,
    /// and a missing count (NaN) reads 0.
    #[must_use]
    pub(crate) fn reading_from_counts(&self, counts: f64) -> SensorReading {
        // A cast from f64 saturates and takes NaN to 0.
        SensorReading(self.exact_reading_from_counts(counts).round() as i32)
    }

    /// Returns whether the sensor can give these counts: 0…`counts_full_scale`. NaN cannot be given.
    #[must_use]
    pub fn is_in_range(&self, counts: f64) -> bool {
        (0.0..=self.counts_full_scale).contains(&counts)
    }

    fn codes_per_count(&self) -> f64 {
        // In this order the paper's chain comes out at exactly 1/8.
        let adc_scale = self.volts_full_scale / ADC_REFERENCE_VOLTS * self.divider;
        adc_scale / self.counts_full_scale * f64::from(AdcCode::FULL_SCALE)
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
        assert_eq!(PAPER.reading_from_counts(1.0), SensorReading(128));
        assert_eq!(PAPER.reading_from_counts(5048.0), SensorReading(5048 * 128));
        assert_eq!(PAPER.reading_from_counts(0.0), SensorReading(0));
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
        assert_eq!(PAPER.reading_from_counts(1e12), SensorReading(i32::MAX));
        assert_eq!(PAPER.reading_from_counts(-1e12), SensorReading(i32::MIN));
        assert_eq!(PAPER.reading_from_counts(f64::NAN), SensorReading(0));
    }

    #[test]
    fn the_range_ends_are_in_range_and_a_missing_count_is_not() {
        assert!(PAPER.is_in_range(0.0) && PAPER.is_in_range(32768.0));
        assert!(!PAPER.is_in_range(-1.0) && !PAPER.is_in_range(32769.0));
        assert!(!PAPER.is_in_range(f64::NAN));
    }
}
