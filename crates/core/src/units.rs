//! The quantities of the bridge, each in the one integer unit in which the board computes it.
//!
//! Lengths are nanometres, time is milliseconds of the sample clock, a sensor reading is a
//! 1/1024 of an ADC code. The user's units (µm, °C, counts) exist on the host alone.

/// An error, an elongation or an offset in nanometres: ±2.147 m.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Nanometres(pub i32);

/// Nanometres in one micrometre.
pub const NANOMETRES_PER_MICROMETRE: i32 = 1_000;

impl Nanometres {
    /// No length.
    pub const ZERO: Self = Self(0);

    /// The nearest representable length: saturates, never wraps.
    #[must_use]
    pub fn saturating(value: i64) -> Self {
        let held = value.clamp(i64::from(i32::MIN), i64::from(i32::MAX));
        Self(i32::try_from(held).expect("clamped to the range of i32 above"))
    }

    /// The same length the other way; −2.147 483 648 m gives +2.147 483 647 m.
    #[must_use]
    pub const fn opposite(self) -> Self {
        Self(self.0.saturating_neg())
    }
}

/// One raw conversion of the 12-bit ADC, 0…4095.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Code(pub u16);

impl Code {
    /// The largest code of the 12-bit converter.
    pub const MAX: Self = Self(4095);
    /// Codes from 0 V to the reference voltage.
    pub const FULL_SCALE: i32 = 4096;
}

/// A sensor reading in 1/1024 ADC code (Q10): 0.119 nm where 4096 codes are 500 µm.
///
/// The filter's output lies in 0…4095·1024; a zero reading in a calibration may lie anywhere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Reading(pub i32);

/// Reading units in one ADC code.
pub const READINGS_PER_CODE: i32 = 1024;

/// Spindle speed in revolutions per minute; the direction of rotation does not matter here.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Rpm(pub u16);

/// A moment of the sample clock, in milliseconds since the start. It wraps after 49.7 days.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Millis(pub u32);

impl Millis {
    /// Milliseconds since `earlier`, right across the wrap, for intervals below 49.7 days.
    #[must_use]
    pub fn since(self, earlier: Self) -> u32 {
        self.0.wrapping_sub(earlier.0)
    }

    /// The moment `ms` milliseconds later.
    #[must_use]
    pub fn after(self, ms: u32) -> Self {
        Self(self.0.wrapping_add(ms))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_is_right_across_its_wrap() {
        let before = Millis(u32::MAX - 4);
        assert_eq!(before.after(10).since(before), 10);
        assert_eq!(before.after(10), Millis(5));
    }

    #[test]
    fn lengths_saturate_at_both_ends() {
        assert_eq!(Nanometres::saturating(i64::MAX).0, i32::MAX);
        assert_eq!(Nanometres::saturating(i64::MIN).0, i32::MIN);
        assert_eq!(Nanometres(i32::MIN).opposite(), Nanometres(i32::MAX));
    }
}
