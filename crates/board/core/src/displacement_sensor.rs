//! Spindle elongation from the displacement sensor (`docs/physics.md` section 1).
//!
//! ΔK = K₀ + (V − V₀)·tanβ, with V and V₀ as [`SensorReading`]s, so that one law serves any divider
//! and any sensor range. The slope is Q28 nanometres per reading unit: 1.6·10⁻⁸ of its value for
//! the paper's sensor, up to ±8 nm a unit (67 times that sensor).

use crate::{
    fixed_point::rounding_shift_right,
    units::{Nanometres, SensorReading},
};

/// tanβ in nanometres per reading unit, Q28: ±8 nm a unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SensorSlope(pub i32);

impl SensorSlope {
    /// Binary places of a slope.
    pub const FRACTION_BITS: u32 = 28;
}

/// The linear law of the sensor. Its output is positive when the tool grows out of the spindle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SensorLaw {
    /// K₀, the elongation at the zero reading.
    pub k0: Nanometres,
    /// V₀, the reading with the machine cold.
    pub zero: SensorReading,
    /// tanβ in Q28 nm per reading; positive where the reading grows with the spindle.
    pub slope: SensorSlope,
}

impl SensorLaw {
    /// Returns the elongation at a reading; saturates at ±2.147 m.
    ///
    /// Worst error against `f64` with the same constants: 0.5 nm, the rounding of the result.
    ///
    /// ```
    /// use trueup_core::{displacement_sensor::{SensorLaw, SensorSlope}, units::{Nanometres, SensorReading}};
    /// // The paper's sensor: 500 µm over 4096 codes of 1024 readings, zero at 5048/8 codes.
    /// let law = SensorLaw {
    ///     k0: Nanometres(0),
    ///     zero: SensorReading(5048 * 128),
    ///     slope: SensorSlope((500_000.0 / 4096.0 / 1024.0 * f64::from(1 << 28)) as i32),
    /// };
    /// // 9164 counts: (9164 − 5048)·500/32768 = 62.805 µm.
    /// assert_eq!(law.elongation(SensorReading(9164 * 128)), Nanometres(62_805));
    /// ```
    #[must_use]
    pub fn elongation(&self, reading: SensorReading) -> Nanometres {
        let from_zero = i64::from(reading.0).wrapping_sub(i64::from(self.zero.0));
        // 33 bits by 32 and a half: below 2⁶³, so that neither step can wrap.
        let grown = from_zero.wrapping_mul(i64::from(self.slope.0));
        let grown = rounding_shift_right(grown, SensorSlope::FRACTION_BITS);
        Nanometres::saturating_from(grown.wrapping_add(i64::from(self.k0.0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;

    #[test]
    fn the_law_is_f64_rounded_to_a_nanometre_over_the_whole_input() {
        let slopes = [1, 31_998_976, -31_998_976, 1 << 30, i32::MAX, i32::MIN];
        let mut worst: f64 = 0.0;
        for slope in slopes {
            let law = SensorLaw {
                k0: Nanometres(-123),
                zero: SensorReading(646_144),
                slope: SensorSlope(slope),
            };
            for reading in (0..=4095 * 1024).step_by(61) {
                let exact =
                    -123.0 + f64::from(reading - 646_144) * f64::from(slope) / 2f64.powi(28);
                worst =
                    worst.max((f64::from(law.elongation(SensorReading(reading)).0) - exact).abs());
            }
        }
        std::println!("largest error of the law: {worst:.3} nm");
        assert!(worst <= 0.5);
    }

    #[test]
    fn extremes_saturate() {
        let steep = |zero| SensorLaw {
            k0: Nanometres(0),
            zero: SensorReading(zero),
            slope: SensorSlope(i32::MAX),
        };
        assert_eq!(steep(i32::MIN).elongation(SensorReading(i32::MAX)).0, i32::MAX);
        assert_eq!(steep(i32::MAX).elongation(SensorReading(i32::MIN)).0, i32::MIN);
    }
}
