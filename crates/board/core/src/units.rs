//! The quantities of the bridge, each in the one integer unit in which the board computes it.
//!
//! Lengths are nanometres, and 1/256 nm while parts of an error are added up; positions are 10 nm,
//! temperatures 1/4096 mK above 0 °C, angles micro-degrees, resistances micro-ohms; time is
//! milliseconds of the sample clock, a sensor reading is a 1/1024 of an ADC code. The user's units
//! (µm, °C, counts) exist on the host alone.

use crate::fixed_point::{rounding_shift_right_i32, saturate_to_i32};

/// An error, an elongation or an offset in nanometres: ±2.147 m.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Nanometres(pub i32);

/// Nanometres in one micrometre.
pub const NANOMETRES_PER_MICROMETRE: i32 = 1_000;

impl Nanometres {
    /// No length.
    pub const ZERO: Self = Self(0);

    /// Returns the nearest representable length: saturates, never wraps.
    #[must_use]
    #[inline]
    pub const fn saturating_from(value: i64) -> Self {
        Self(saturate_to_i32(value))
    }

    /// Returns the length clamped to ±`largest`, which counts as 0 below 0; and whether it had to be.
    ///
    /// Both ends are tested by one comparison, because nearly every length lies between them.
    #[must_use]
    #[inline]
    pub fn clamped(self, largest: Self) -> (Self, bool) {
        let largest = Self(largest.0.max(0));
        if self.is_within(largest) { (self, false) } else { (self.nearest_bound(largest.0), true) }
    }

    /// Returns whether the length is at most `largest` either way, which must not be below 0.
    #[inline]
    const fn is_within(self, largest: Self) -> bool {
        let from_lowest = self.0.wrapping_add(largest.0).cast_unsigned();
        // At most 2³² − 2.
        from_lowest <= largest.0.cast_unsigned().wrapping_mul(2)
    }

    #[cold]
    fn nearest_bound(self, largest: i32) -> Self {
        Self(if self.0 < 0 { largest.saturating_neg() } else { largest })
    }

    /// Returns the same length in 1/256 nm; saturates at ±8.388 mm.
    #[must_use]
    pub const fn to_fine(self) -> FineNanometres {
        FineNanometres(self.0.saturating_mul(FineNanometres::PER_NANOMETRE))
    }

    /// Returns the same length the other way; −2.147 483 648 m gives +2.147 483 647 m.
    #[must_use]
    pub const fn saturating_neg(self) -> Self {
        Self(self.0.saturating_neg())
    }
}

/// A part of an error in 1/256 nm (Q8): ±8.388 mm. Parts are added in this unit and rounded once,
/// so that the rounding of many parts does not add up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct FineNanometres(pub i32);

impl FineNanometres {
    /// Nothing.
    pub const ZERO: Self = Self(0);
    /// Binary places of a nanometre.
    pub const FRACTION_BITS: u32 = 8;
    /// Fine units in one nanometre.
    pub const PER_NANOMETRE: i32 = 1 << Self::FRACTION_BITS;

    /// Returns the nearest representable value: saturates, never wraps.
    #[must_use]
    #[inline]
    pub const fn saturating_from(value: i64) -> Self {
        Self(saturate_to_i32(value))
    }

    /// Returns the sum; saturates.
    #[must_use]
    pub const fn saturating_add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }

    /// Returns the value clamped to ±`largest`, which counts as 0 below 0; and whether it had to be.
    #[must_use]
    #[inline]
    pub fn clamped(self, largest: Self) -> (Self, bool) {
        let (value, was_clamped) = Nanometres(self.0).clamped(Nanometres(largest.0));
        (Self(value.0), was_clamped)
    }

    /// Returns whether the value is at most `largest` either way, which must not be below 0.
    #[inline]
    pub(crate) const fn is_within(self, largest: Self) -> bool {
        Nanometres(self.0).is_within(Nanometres(largest.0))
    }

    /// Returns the nearest nanometre, halves upwards.
    #[must_use]
    pub const fn rounded(self) -> Nanometres {
        Nanometres(rounding_shift_right_i32(self.0, Self::FRACTION_BITS))
    }
}

/// A position of an axis in machine coordinates, in units of 10 nm: ±21.47 m.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Position(pub i32);

impl Position {
    /// Position units in one millimetre.
    pub const PER_MILLIMETRE: i32 = 100_000;
}

/// A temperature in 1/4096 mK above 0 °C (Q12 of a millikelvin): −524.288…+524.287 °C.
///
/// Finer than a millikelvin, because an axis of 15 m grows by 200 nm in one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Temperature(pub i32);

impl Temperature {
    /// Temperature units in one millikelvin.
    pub const PER_MILLIKELVIN: i32 = 4_096;
    /// Temperature units in one kelvin.
    pub const PER_KELVIN: i32 = 1_000 * Self::PER_MILLIKELVIN;
}

/// An electrical resistance in micro-ohms: up to 2147 Ω.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct MicroOhms(pub i32);

/// The angle of a rotary axis in micro-degrees, right-handed: ±2147°.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct MicroDegrees(pub i32);

impl MicroDegrees {
    /// Micro-degrees in one degree.
    pub const PER_DEGREE: i32 = 1_000_000;
}

/// One raw conversion of the 12-bit ADC, 0…4095.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct AdcCode(pub u16);

impl AdcCode {
    /// The largest code of the 12-bit converter.
    pub const MAX: Self = Self(4095);
    /// Codes from 0 V to the reference voltage.
    pub const FULL_SCALE: i32 = 4096;
}

/// A sensor reading in 1/1024 ADC code (Q10): 0.119 nm where 4096 codes are 500 µm.
///
/// The filter's output lies in 0…4095·1024; a zero reading in a calibration may lie anywhere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct SensorReading(pub i32);

/// Reading units in one ADC code.
pub const READING_UNITS_PER_CODE: i32 = 1024;

/// Spindle speed in revolutions per minute; the direction of rotation does not matter here.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Rpm(pub u16);

/// A moment of the sample clock, in milliseconds since the start. It wraps after 49.7 days.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TimestampMs(pub u32);

impl TimestampMs {
    /// Milliseconds since `earlier`, right across the wrap, for intervals below 49.7 days.
    #[must_use]
    pub fn duration_ms_since(self, earlier: Self) -> u32 {
        self.0.wrapping_sub(earlier.0)
    }

    /// Returns the moment `ms` milliseconds later.
    #[must_use]
    pub fn wrapping_add_ms(self, ms: u32) -> Self {
        Self(self.0.wrapping_add(ms))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_is_right_across_its_wrap() {
        let before = TimestampMs(u32::MAX - 4);
        assert_eq!(before.wrapping_add_ms(10).duration_ms_since(before), 10);
        assert_eq!(before.wrapping_add_ms(10), TimestampMs(5));
    }

    #[test]
    fn fine_parts_round_to_the_nearest_nanometre() {
        for (fine, nm) in [(0, 0), (127, 0), (128, 1), (-128, 0), (-129, -1), (256, 1)] {
            assert_eq!(FineNanometres(fine).rounded(), Nanometres(nm), "{fine}");
        }
        assert_eq!(
            FineNanometres(i32::MAX).saturating_add(FineNanometres(1)).rounded(),
            Nanometres(8_388_607)
        );
        assert_eq!(FineNanometres::saturating_from(i64::MIN), FineNanometres(i32::MIN));
    }

    #[test]
    fn lengths_saturate_at_both_ends() {
        assert_eq!(Nanometres::saturating_from(i64::MAX).0, i32::MAX);
        assert_eq!(Nanometres::saturating_from(i64::MIN).0, i32::MIN);
        assert_eq!(Nanometres(i32::MIN).saturating_neg(), Nanometres(i32::MAX));
    }
}
