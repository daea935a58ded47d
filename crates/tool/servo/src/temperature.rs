//! Temperatures in °C, as the deliveries of the thermometers that the calibration knows.
//!
//! LinuxCNC's inputs give degrees, whatever measures them; the calibration has a law for what the board's channels
//! deliver. So a temperature goes backwards through that law: R(t) of IEC 60751 for a PT100, t·(counts per kelvin) +
//! zero for a linear chain. The node's law then gives the temperature again, to 0.005 mK for a PT100 and to a
//! 512th of a count for a chain.

use trueup_core::{
    thermometer::{RawTemperatureReading, Thermometer},
    units::Temperature,
};

/// IEC 60751: A per kelvin, B per kelvin², C per kelvin⁴ (below 0 °C).
const CALLENDAR_VAN_DUSEN_A: f64 = 3.9083e-3;
const CALLENDAR_VAN_DUSEN_B: f64 = -5.775e-7;
const CALLENDAR_VAN_DUSEN_C: f64 = -4.183e-12;
const PT100_R0_MICROOHMS: f64 = 1e8;
/// Beyond this either way a thermometer has failed, and no polynomial of it means anything.
const MAX_ABS_TEMPERATURE_C: f64 = 1_000.0;

/// How a channel is made of degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ChannelConversion {
    /// No thermometer of the calibration.
    Unused,
    /// A platinum resistance.
    Pt100,
    /// A linear chain: its delivery at 0 °C, and for a kelvin.
    Linear {
        /// In 1/256 counts.
        zero: f64,
        /// In 1/256 counts a kelvin.
        per_kelvin: f64,
    },
}

impl ChannelConversion {
    /// Returns how this thermometer is made of degrees.
    #[must_use]
    pub(crate) fn from_thermometer(thermometer: Option<&Thermometer>) -> Self {
        match thermometer {
            None => Self::Unused,
            Some(Thermometer::Pt100) => Self::Pt100,
            Some(Thermometer::Linear { slope: 0, .. }) => Self::Unused,
            Some(Thermometer::Linear { zero, slope, shift }) => {
                let scale = f64::from(
                    1_u32.wrapping_shl((*shift).min(Thermometer::MAX_SLOPE_SHIFT).into()),
                );
                let per_kelvin = f64::from(Temperature::PER_KELVIN) * scale / f64::from(*slope);
                Self::Linear { zero: f64::from(*zero), per_kelvin }
            }
        }
    }

    /// Returns what the thermometer delivers at a temperature; nothing where that is not a number.
    #[must_use]
    pub(crate) fn raw_reading_from_celsius(&self, celsius: f64) -> RawTemperatureReading {
        if !celsius.is_finite() || celsius.abs() > MAX_ABS_TEMPERATURE_C {
            return RawTemperatureReading::NONE;
        }
        let exact = match *self {
            Self::Unused => return RawTemperatureReading::NONE,
            Self::Linear { zero, per_kelvin } => zero + celsius * per_kelvin,
            Self::Pt100 => {
                let t = celsius;
                let below =
                    if t < 0.0 { CALLENDAR_VAN_DUSEN_C * (t - 100.0) * t * t * t } else { 0.0 };
                PT100_R0_MICROOHMS
                    * (1.0 + CALLENDAR_VAN_DUSEN_A * t + CALLENDAR_VAN_DUSEN_B * t * t + below)
            }
        };
        let half = 0.5_f64.copysign(exact);
        // The smallest number is that of no delivery.
        #[allow(clippy::cast_possible_truncation, reason = "a cast of a float saturates")]
        RawTemperatureReading(((exact + half) as i32).max(i32::MIN.saturating_add(1)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nodes_law_gives_the_temperature_back() {
        let chains = [
            (Thermometer::Pt100, -59.0, 399.0, 0.005),
            (Thermometer::Linear { zero: 4000 * 256, slope: 1000, shift: 0 }, 0.0, 450.0, 0.13),
            (Thermometer::Linear { zero: 90_000, slope: -32_768_000, shift: 12 }, -40.0, 40.0, 1.1),
        ];
        for (thermometer, from, to, within_mk) in chains {
            let channel = ChannelConversion::from_thermometer(Some(&thermometer));
            for step in 0..10_000 {
                let celsius = from + (to - from) * f64::from(step) / 10_000.0;
                let read = thermometer
                    .convert(channel.raw_reading_from_celsius(celsius))
                    .expect("a temperature");
                let mk = f64::from(read.0) / f64::from(Temperature::PER_MILLIKELVIN);
                assert!(
                    (mk - celsius * 1e3).abs() <= within_mk,
                    "{thermometer:?}: {celsius} °C, {mk} mK"
                );
            }
        }
    }

    #[test]
    fn what_is_no_temperature_delivers_nothing() {
        for channel in
            [ChannelConversion::Pt100, ChannelConversion::Linear { zero: 0.0, per_kelvin: 1.0 }]
        {
            for celsius in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e9, -1e9] {
                assert_eq!(channel.raw_reading_from_celsius(celsius), RawTemperatureReading::NONE);
            }
        }
        assert_eq!(
            ChannelConversion::from_thermometer(None).raw_reading_from_celsius(20.0),
            RawTemperatureReading::NONE
        );
        assert_eq!(
            ChannelConversion::Linear { zero: 0.0, per_kelvin: -1e9 }
                .raw_reading_from_celsius(999.0),
            RawTemperatureReading(i32::MIN + 1)
        );
    }
}
