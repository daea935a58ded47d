//! The raw reading of a temperature channel, and the temperature it means.
//!
//! A PT100 delivers micro-ohms ([`pt100`]), a linear chain 1/256 counts (Q8):
//!
//! T = (raw − zero)·slope/2^shift.
//!
//! The slope is in temperature units per 1/256 count, 16 000/(counts per °C), with as many binary
//! places (`shift`, at most 31) as 31 bits hold, because it reaches from 1.6 (10 000 counts/K) to
//! 160 000 (0.1 counts/K). Paper 2's chain, 16 counts/K, has the slope 1000 exactly. Measured
//! worst error of a linear chain against `f64` over ±500 °C: 0.0003 mK, with 0.1…10 000 counts/K.

use crate::{
    fixed_point::rounding_shift_right,
    pt100,
    sensor_health::{HIGH_RAIL, LOW_RAIL},
    supply_monitor::SupplyScale,
    units::{MicroOhms, Temperature},
};

/// A channel is given up after this many bad readings in a row, 100 ms apart.
pub const FAULT_AFTER_READINGS: u8 = 4;

/// A raw reading of a temperature channel: micro-ohms of a PT100, 1/256 counts of a linear chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawTemperatureReading(pub i32);

impl Default for RawTemperatureReading {
    fn default() -> Self {
        Self::NONE
    }
}

impl RawTemperatureReading {
    /// The channel has nothing to deliver: no converter, no answer, not yet measured.
    pub const NONE: Self = Self(i32::MIN);
}

/// Why a channel has no temperature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ThermometerFault {
    /// Nothing came: [`RawTemperatureReading::NONE`].
    Missing,
    /// The resistance is above that of any temperature in range: a broken wire.
    Open,
    /// The resistance is below that of any temperature in range: a short circuit.
    Short,
    /// A linear chain is beyond ±500 °C.
    OutOfRange,
    /// The converter of a linear chain reads at an end of its range: a broken wire or a short circuit.
    AtRail,
    /// The supply that a linear chain is measured by is not believed.
    NoSupply,
}

impl From<pt100::ResistanceFault> for ThermometerFault {
    fn from(fault: pt100::ResistanceFault) -> Self {
        match fault {
            pt100::ResistanceFault::Open => Self::Open,
            pt100::ResistanceFault::Short => Self::Short,
        }
    }
}

/// How a channel's delivery becomes a temperature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Thermometer {
    /// A platinum resistance after IEC 60751.
    Pt100,
    /// A chain of which the counts are proportional to the temperature.
    Linear {
        /// The delivery at 0 °C, in 1/256 counts.
        zero: i32,
        /// Temperature units per 1/256 count, times 2^`shift`; negative where counts fall as it
        /// grows warmer.
        slope: i32,
        /// Binary places of `slope`, at most [`Thermometer::MAX_SLOPE_SHIFT`]; more count as that many.
        shift: u8,
    },
}

impl Thermometer {
    /// A linear chain beyond this, either way, is a fault.
    pub const MAX_ABS_TEMPERATURE: Temperature = Temperature(500 * Temperature::PER_KELVIN);
    /// The most binary places of a slope.
    pub const MAX_SLOPE_SHIFT: u8 = 31;

    /// Returns the temperature that a delivery of the board means. A linear chain is measured by the supply of the converter
    /// (`None`: it is not believed), a PT100's resistance is not; and at an end of the converter's range, where
    /// [`sensor_health`](crate::sensor_health) has its rails, it measures nothing.
    ///
    /// # Errors
    /// As [`Self::convert`], and [`ThermometerFault::AtRail`] and [`ThermometerFault::NoSupply`].
    pub fn convert_with_supply(
        &self,
        raw: RawTemperatureReading,
        supply: Option<SupplyScale>,
    ) -> Result<Temperature, ThermometerFault> {
        match self {
            Self::Linear { .. } if raw != RawTemperatureReading::NONE => {
                if is_at_rail(raw) {
                    return Err(ThermometerFault::AtRail);
                }
                let supply = supply.ok_or(ThermometerFault::NoSupply)?;
                self.convert(RawTemperatureReading(supply.scale_raw(raw.0)))
            }
            _ => self.convert(raw),
        }
    }

    /// Returns a step of its converter, as a temperature: 1/32 K of a MAX31865, a count of a linear chain.
    #[must_use]
    pub fn resolution(&self) -> Temperature {
        match *self {
            Self::Pt100 => Temperature(Temperature::PER_KELVIN / 32),
            Self::Linear { slope, shift, .. } => {
                let count =
                    i64::from(slope.unsigned_abs()).wrapping_mul(SUBCOUNTS_PER_COUNT.into());
                let step = rounding_shift_right(count, shift.min(Self::MAX_SLOPE_SHIFT).into());
                Temperature(i32::try_from(step).unwrap_or(i32::MAX))
            }
        }
    }

    /// Returns by how much its temperature may differ from what is followed, either way: a quarter of a step of a MAX31865,
    /// twice what a time constant of 1 s leaves of it ([`dead_band_filter`](crate::dead_band_filter)). A linear chain delivers the mean of many
    /// conversions, which has no steps.
    #[must_use]
    pub fn dead_band(&self) -> Temperature {
        match *self {
            Self::Pt100 => Temperature(self.resolution().0 / 4),
            Self::Linear { .. } => Temperature(0),
        }
    }

    /// Returns the temperature that a delivery means.
    ///
    /// ```
    /// use trueup_core::{thermometer::{ThermometerFault, RawTemperatureReading, Thermometer}, units::Temperature};
    /// // 4000 counts at 0 °C and 16 counts per kelvin: 4376 counts are 376/16 = 23.5 °C.
    /// let chain = Thermometer::Linear { zero: 4000 * 256, slope: 1000, shift: 0 };
    /// let warm = Temperature(23_500 * Temperature::PER_MILLIKELVIN);
    /// assert_eq!(chain.convert(RawTemperatureReading(4376 * 256)), Ok(warm));
    /// assert_eq!(chain.convert(RawTemperatureReading::NONE), Err(ThermometerFault::Missing));
    /// ```
    ///
    /// # Errors
    /// [`ThermometerFault`] when the channel has delivered nothing, or nothing that is a temperature.
    pub fn convert(&self, raw: RawTemperatureReading) -> Result<Temperature, ThermometerFault> {
        if raw == RawTemperatureReading::NONE {
            return Err(ThermometerFault::Missing);
        }
        match *self {
            Self::Pt100 => Ok(pt100::temperature_from_resistance(MicroOhms(raw.0))?),
            Self::Linear { zero, slope, shift } => {
                let shift = u32::from(shift.min(Self::MAX_SLOPE_SHIFT));
                let from_zero = i64::from(raw.0).wrapping_sub(i64::from(zero));
                // 33 bits by 32, at most 2⁶³ − 2³¹, and half is at most 2³⁰: nothing can wrap.
                let scaled = from_zero.wrapping_mul(i64::from(slope));
                match i32::try_from(rounding_shift_right(scaled, shift)) {
                    Ok(t) if t.unsigned_abs() <= Self::MAX_ABS_TEMPERATURE.0.unsigned_abs() => {
                        Ok(Temperature(t))
                    }
                    _ => Err(ThermometerFault::OutOfRange),
                }
            }
        }
    }
}

/// Parts of a count that a linear chain delivers.
const SUBCOUNTS_PER_COUNT: i32 = 256;

/// Returns whether a linear chain's delivery is at an end of the 12-bit converter, or beyond it.
fn is_at_rail(RawTemperatureReading(raw): RawTemperatureReading) -> bool {
    const LOW_RAIL_SUBCOUNTS: i32 = LOW_RAIL.0 as i32 * SUBCOUNTS_PER_COUNT;
    const HIGH_RAIL_SUBCOUNTS: i32 = HIGH_RAIL.0 as i32 * SUBCOUNTS_PER_COUNT;
    raw <= LOW_RAIL_SUBCOUNTS || raw >= HIGH_RAIL_SUBCOUNTS
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        supply_monitor::{InternalReferenceLevel, SupplyMonitor},
        units::AdcCode,
    };
    extern crate std;

    /// Paper 2: 4000 counts at 0 °C, 16 counts per kelvin.
    const PAPER: Thermometer = Thermometer::Linear { zero: 4000 * 256, slope: 1000, shift: 0 };

    /// As the host fills it in: the largest shift with which the slope fits.
    fn linear(zero_counts: f64, counts_per_c: f64) -> Thermometer {
        let units = 16_000.0 / counts_per_c;
        let fits = |shift: &u8| (units * 2.0_f64.powi(i32::from(*shift))).abs() < 2_147_483_647.0;
        let shift = (0..=Thermometer::MAX_SLOPE_SHIFT).rev().find(fits).unwrap();
        let slope = (units * 2.0_f64.powi(i32::from(shift))).round() as i32;
        Thermometer::Linear { zero: (zero_counts * 256.0).round() as i32, slope, shift }
    }

    #[test]
    fn the_papers_chain_steps_by_a_sixteenth_of_a_kelvin_exactly() {
        for counts in 0..=12_000 {
            // (counts − 4000)/16 K: 62.5 mK are 256 000 units.
            let expected = Temperature((counts - 4000) * 256_000);
            assert_eq!(PAPER.convert(RawTemperatureReading(counts * 256)), Ok(expected));
            assert_eq!(
                linear(4000.0, 16.0).convert(RawTemperatureReading(counts * 256)),
                Ok(expected)
            );
        }
        assert_eq!(256_000, Temperature::PER_KELVIN / 16);
    }

    #[test]
    fn the_papers_listing_computes_another_temperature_than_the_paper() {
        // 23.5 °C: 4376 counts, 376 above zero, 23 whole degrees and a remainder of 8.
        let from_zero = 4376 - 4000;
        let (whole, remainder) = (from_zero / 16, from_zero % 16);
        assert_eq!((whole, remainder), (23, 8));

        // "L B#16#10", commented "the remainder times ten", loads 16. The digit of tenths is then
        // the remainder itself, here 8 and up to 15, where 8/16 of a degree are 5 tenths.
        let loaded = 0x10;
        assert_eq!(remainder * loaded / 16, 8);
        assert_eq!(remainder * 10 / 16, 5);
        // The whole degrees are multiplied by the same constant. Instead of 235 tenths there are
        // 376, the counts unchanged, which read as tenths are 37.6 °C: 14.1 K or 200 µm/m too many.
        assert_eq!(whole * loaded + remainder * loaded / 16, from_zero);
        assert_eq!(whole * 10 + remainder * 10 / 16, 235);

        // "L IW200, L IW252, -I": neither is MW200 or MW252, where the reading and the zero were put. And the sum of "L MW160,
        // L MW200, +I" is lost: "L MW200, T DB103.DBD220" hands over MW200, into which nothing but the counts was put.
        let memory = |word: usize| {
            [(200, 4376), (250, 16), (252, 0x4000)].iter().find(|pair| pair.0 == word)
        };
        assert_eq!(memory(200).map(|word| word.1), Some(4376), "437.6 °C for 23.5 °C");

        // "L B#16#4000", commented "zero = 4000", loads 16384: 774 K too cold, and a fault here.
        let listing = Thermometer::Linear { zero: 0x4000 * 256, slope: 1000, shift: 0 };
        assert_eq!(0x4000 - 4000, 774 * 16);
        assert_eq!(
            listing.convert(RawTemperatureReading(4376 * 256)),
            Err(ThermometerFault::OutOfRange)
        );

        // Right is the formula in the text.
        let right = Temperature(23_500 * Temperature::PER_MILLIKELVIN);
        assert_eq!(PAPER.convert(RawTemperatureReading(4376 * 256)), Ok(right));
    }

    #[test]
    fn the_papers_current_heats_its_own_thermometer_above_the_chains_resolution() {
        // A PT100 at 0 °C becomes warmer by 0.02 K for each mW where it is well coupled to moving
        // oil, by 0.4 K in still air.
        let coupling_k_per_mw = [0.02, 0.4];
        let heats = |milliamperes: f64| {
            let milliwatts = milliamperes * milliamperes * 100.0 / 1_000.0;
            coupling_k_per_mw.map(|per_mw| per_mw * milliwatts)
        };
        // The listing's 5 mV/K come from 12.5 mA, which are 15.6 mW: 0.3 to 6 K too warm, and a
        // step of the chain is 1/16 K.
        let [well, badly] = heats(12.5);
        assert!((well - 0.3125).abs() < 1e-12 && (badly - 6.25).abs() < 1e-12);
        assert!(well > 1.0 / 16.0);
        // Right is at most 1 mA, whose error stays below a step even in air.
        assert!(heats(1.0)[1] < 1.0 / 16.0);
    }

    #[test]
    fn linear_chains_of_any_gain_and_either_sign_are_right_all_over() {
        let mut worst = 0.0_f64;
        for counts_per_c in [0.1, 0.37, 1.0, 9.99, 16.0, 27.648, 100.0, 1234.5, 10_000.0] {
            for signed in [counts_per_c, -counts_per_c] {
                for zero in [-1000.0, 0.0, 4000.0] {
                    let chain = linear(zero, signed);
                    for step in -3_000..=3_000 {
                        let celsius = f64::from(step) / 6.0001;
                        let raw = ((zero + celsius * signed) * 256.0).round();
                        let exact = (raw / 256.0 - zero) / signed;
                        let t = chain.convert(RawTemperatureReading(raw as i32));
                        if exact.abs() > 499.9999 {
                            continue;
                        }
                        let t = f64::from(t.unwrap().0) / f64::from(Temperature::PER_KELVIN);
                        worst = worst.max((t - exact).abs());
                    }
                }
            }
        }
        std::println!("worst error of a linear chain: {:.6} mK", worst * 1e3);
        assert!(worst < 1e-6);
    }

    #[test]
    fn beyond_500_degrees_either_way_is_a_fault() {
        let at = |counts: i32| PAPER.convert(RawTemperatureReading(counts * 256));
        assert_eq!(at(4000 + 8000), Ok(Thermometer::MAX_ABS_TEMPERATURE));
        assert_eq!(at(4000 - 8000), Ok(Temperature(-Thermometer::MAX_ABS_TEMPERATURE.0)));
        assert_eq!(
            PAPER.convert(RawTemperatureReading(12_000 * 256 + 1)),
            Err(ThermometerFault::OutOfRange)
        );
        assert_eq!(
            PAPER.convert(RawTemperatureReading(-4_000 * 256 - 1)),
            Err(ThermometerFault::OutOfRange)
        );
    }

    #[test]
    fn no_delivery_and_no_slope_panics_or_wraps() {
        let ends = [i32::MIN, i32::MIN + 1, -1, 0, 1, i32::MAX];
        for zero in ends {
            for slope in ends {
                for shift in [0, 1, 30, 31, 32, 63, 64, 255] {
                    for raw in ends {
                        let got = Thermometer::Linear { zero, slope, shift }
                            .convert(RawTemperatureReading(raw));
                        let exact = (i128::from(raw) - i128::from(zero)) * i128::from(slope);
                        let half = (1_i128 << shift.min(31)) >> 1;
                        let exact = (exact + half) >> shift.min(31);
                        let expected = if raw == i32::MIN {
                            Err(ThermometerFault::Missing)
                        } else if exact.abs() > i128::from(Thermometer::MAX_ABS_TEMPERATURE.0) {
                            Err(ThermometerFault::OutOfRange)
                        } else {
                            Ok(Temperature(exact as i32))
                        };
                        assert_eq!(got, expected);
                    }
                }
            }
        }
    }

    #[test]
    fn a_linear_chain_is_measured_by_the_supply_and_a_pt100_is_not() {
        let mut supply = SupplyMonitor::default();
        supply.set_baseline_level(InternalReferenceLevel(1_500 * 16));
        (0..500).for_each(|_| supply.receive(AdcCode(1_515)));
        let scale = Some(supply.scale());
        let at = |raw: i32, scale| PAPER.convert_with_supply(RawTemperatureReading(raw), scale);
        assert_eq!(at(1_010_000, scale), PAPER.convert(RawTemperatureReading(1_000_000)));
        assert_eq!(at(1_010_000, None), Err(ThermometerFault::NoSupply));
        assert_eq!(
            PAPER.convert_with_supply(RawTemperatureReading::NONE, None),
            Err(ThermometerFault::Missing)
        );
        let pt100 = Thermometer::Pt100;
        assert_eq!(
            pt100.convert_with_supply(RawTemperatureReading(110_000_000), None),
            pt100.convert(RawTemperatureReading(110_000_000))
        );
    }

    #[test]
    fn a_linear_chain_at_an_end_of_the_converter_measures_nothing() {
        // The wiring page's sensor: 0 °C is 0 V, which a broken wire reads as well.
        let wiring = linear(0.0, 4.07);
        let scale = Some(SupplyScale::default());
        for (counts, is_rail) in [(0, true), (8, true), (9, false), (2_000, false)] {
            let got = wiring.convert_with_supply(RawTemperatureReading(counts * 256), scale);
            assert_eq!(got == Err(ThermometerFault::AtRail), is_rail, "{counts}");
            let got = PAPER.convert_with_supply(RawTemperatureReading(counts * 256), scale);
            assert_eq!(got == Err(ThermometerFault::AtRail), is_rail, "{counts}: {got:?}");
        }
        for (raw, is_rail) in [(4_086, false), (4_087, true), (4_095, true), (4_376, true)] {
            let got = PAPER.convert_with_supply(RawTemperatureReading(raw * 256), scale);
            assert_eq!(got == Err(ThermometerFault::AtRail), is_rail, "{raw}: {got:?}");
        }
    }

    #[test]
    fn the_step_of_a_chain_is_its_count() {
        assert_eq!(PAPER.resolution(), Temperature(Temperature::PER_KELVIN / 16));
        assert_eq!(linear(0.0, -4.0).resolution(), Temperature(Temperature::PER_KELVIN / 4));
        let steepest = Thermometer::Linear { zero: 0, slope: i32::MIN, shift: 0 };
        assert_eq!(steepest.resolution(), Temperature(i32::MAX));
    }

    #[test]
    fn a_pt100_passes_its_faults_on() {
        assert_eq!(
            Thermometer::Pt100.convert(RawTemperatureReading(100_000_000)),
            Ok(Temperature(0))
        );
        assert_eq!(
            Thermometer::Pt100.convert(RawTemperatureReading(i32::MAX)),
            Err(ThermometerFault::Open)
        );
        assert_eq!(
            Thermometer::Pt100.convert(RawTemperatureReading(i32::MIN + 1)),
            Err(ThermometerFault::Short)
        );
        assert_eq!(
            Thermometer::Pt100.convert(RawTemperatureReading::NONE),
            Err(ThermometerFault::Missing)
        );
    }
}
