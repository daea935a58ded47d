//! The converter's supply, by which it measures, and what its drift does to a reading.
//!
//! A code is 4096·V/VDDA: a supply that falls by 1 % makes every reading 1 % larger, 2.5 µm in the middle
//! of a sensor's 500 µm. The chip's internal reference does not follow the supply, so its own code r
//! shows it:
//!
//! level: l += (r − l)/min(n, 32), n the number of readings, one in 10 ms; scale = basis/l,
//! reading at the basis = reading·scale.
//!
//! The basis is the level from which readings count: that of the first 1.28 s, until one is taken up
//! that was stored. The mean of 32 leaves of a noise of 2 codes RMS 0.25 codes, 0.017 %: 0.04 µm in the
//! middle. Beyond ±3 % a supply is broken, and what is measured by it is not believed.

use crate::{
    fixed_point::rounding_shift_right,
    units::{AdcCode, SensorReading},
};

/// Readings of the internal reference that are averaged: 0.32 s at 10 ms each.
const AVERAGED_READINGS: u32 = 32;
/// Readings after which a basis is taken: what the first one has left in the mean is 2 %.
const MIN_BASELINE_READINGS: u32 = 4 * AVERAGED_READINGS;
/// Thousandths of the basis by which the level may differ. The 3.3 V of a board come from a regulator that
/// is good for 1 to 2 % over temperature and load; 3 % are beyond every one that works.
const MAX_DEVIATION_PER_MILLE: u32 = 30;
/// It is believed again within this: ten times the noise of a level nearer.
const RECOVERY_DEVIATION_PER_MILLE: u32 = 28;

/// A level of the internal reference in 1/16 of a code; 0: not known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InternalReferenceLevel(pub u16);

/// By what readings are multiplied, Q24: 1 where nothing is known of the supply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SupplyScale(u32);

impl Default for SupplyScale {
    fn default() -> Self {
        Self::ONE
    }
}

impl SupplyScale {
    const FRACTION_BITS: u32 = 24;
    /// The supply is as it was.
    pub const ONE: Self = Self(1 << Self::FRACTION_BITS);

    /// Returns a reading as the converter would have given it at the basis; worst error half a unit.
    ///
    /// ```
    /// use trueup_core::{supply_monitor::SupplyMonitor, units::{AdcCode, SensorReading}};
    /// let mut supply = SupplyMonitor::default();
    /// supply.set_baseline_level(trueup_core::supply_monitor::InternalReferenceLevel(1500 * 16));
    /// // The supply has fallen by 1 %: all codes are 1.01 times as large.
    /// (0..1000).for_each(|_| supply.receive(AdcCode(1515)));
    /// let reading = supply.scale().scale_reading(SensorReading(1_010_000));
    /// assert!((reading.0 - 1_000_000).abs() <= 1);
    /// ```
    #[must_use]
    pub fn scale_reading(self, reading: SensorReading) -> SensorReading {
        SensorReading(self.scale_raw(reading.0))
    }

    /// Returns the same for any number that is proportional to a code; saturates.
    #[must_use]
    pub fn scale_raw(self, raw: i32) -> i32 {
        // 32 bits by 32 signed: below 2⁶³.
        let scaled = i64::from(raw).wrapping_mul(i64::from(self.0));
        let limits = (i64::from(i32::MIN), i64::from(i32::MAX));
        let bounded = rounding_shift_right(scaled, Self::FRACTION_BITS).clamp(limits.0, limits.1);
        i32::try_from(bounded).unwrap_or(i32::MAX)
    }
}

/// The level of the supply, and its basis.
#[derive(Clone, Copy, Debug, Default)]
pub struct SupplyMonitor {
    /// The mean in 1/65536 codes.
    level: u32,
    received: u32,
    /// In 1/65536 codes; 0: none yet.
    basis: u32,
    is_off: bool,
}

impl SupplyMonitor {
    const FRACTION_BITS: u32 = 16;
    const LEVEL_SHIFT: u32 = Self::FRACTION_BITS - 4;

    /// Takes a code of the internal reference, one in 10 ms.
    pub fn receive(&mut self, code: AdcCode) {
        let code = i64::from(code.0.min(AdcCode::MAX.0)) << Self::FRACTION_BITS;
        self.received = self.received.saturating_add(1);
        let share = i64::from(self.received.min(AVERAGED_READINGS));
        let from_level = code.wrapping_sub(i64::from(self.level));
        // Between the two: never negative, never above the largest code.
        let level = i64::from(self.level).wrapping_add(from_level.checked_div(share).unwrap_or(0));
        self.level = u32::try_from(level).unwrap_or(0);
        if self.basis == 0 && self.received >= MIN_BASELINE_READINGS {
            self.basis = self.level;
        }
        let limit =
            if self.is_off { RECOVERY_DEVIATION_PER_MILLE } else { MAX_DEVIATION_PER_MILLE };
        let off_by = u64::from(self.level.abs_diff(self.basis)).wrapping_mul(1_000);
        self.is_off = self.basis != 0 && off_by > u64::from(self.basis).wrapping_mul(limit.into());
    }

    /// Readings count from this level; an unknown one counts as none.
    pub fn set_baseline_level(&mut self, basis: InternalReferenceLevel) {
        self.basis = u32::from(basis.0) << Self::LEVEL_SHIFT;
        self.is_off = false;
    }

    /// Returns the level from which readings count.
    #[must_use]
    pub fn baseline_level(&self) -> InternalReferenceLevel {
        InternalReferenceLevel(u16::try_from(self.basis >> Self::LEVEL_SHIFT).unwrap_or(0))
    }

    /// The basis is taken anew.
    pub fn reset_baseline_level(&mut self) {
        *self = Self::default();
    }

    /// By what readings are to be multiplied.
    #[must_use]
    pub fn scale(&self) -> SupplyScale {
        let basis = u64::from(self.basis) << SupplyScale::FRACTION_BITS;
        let scale = basis.checked_div(self.level.into()).filter(|scale| *scale > 0);
        SupplyScale(scale.and_then(|scale| u32::try_from(scale).ok()).unwrap_or(SupplyScale::ONE.0))
    }

    /// Returns whether it is more than 3 % away from its basis.
    #[must_use]
    pub fn is_out_of_tolerance(&self) -> bool {
        self.is_off
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settled(basis: u16, code: u16) -> SupplyMonitor {
        let mut supply = SupplyMonitor::default();
        supply.set_baseline_level(InternalReferenceLevel(basis * 16));
        (0..2_000).for_each(|_| supply.receive(AdcCode(code)));
        supply
    }

    #[test]
    fn a_reading_is_as_at_the_basis_whatever_the_supply_within_3_percent() {
        for code in 1456..=1545_u16 {
            let supply = settled(1500, code);
            assert!(!supply.is_out_of_tolerance(), "{code}");
            for at_basis in [1_u32, 1000, 2_048 << 10, 4_000 << 10] {
                let exact = f64::from(at_basis) * f64::from(code) / 1500.0;
                let reading = supply.scale().scale_reading(SensorReading(exact.round() as i32));
                let off = f64::from(reading.0) - f64::from(at_basis);
                // Half a unit of the reading that went in, half of the result, and the scale's 2⁻²⁴.
                assert!(off.abs() <= 1.8, "{code}: {off}");
            }
        }
    }

    #[test]
    fn beyond_3_percent_either_way_it_is_off_and_within_2_8_it_is_not_any_more() {
        for (code, off) in [(1454, true), (1456, false), (1544, false), (1546, true)] {
            assert_eq!(settled(1500, code).is_out_of_tolerance(), off, "{code}");
        }
        let mut supply = settled(1500, 1400);
        assert!(supply.is_out_of_tolerance());
        (0..2_000).for_each(|_| supply.receive(AdcCode(1457)));
        assert!(supply.is_out_of_tolerance(), "2.87 % are still too much");
        (0..2_000).for_each(|_| supply.receive(AdcCode(1459)));
        assert!(!supply.is_out_of_tolerance());
    }

    #[test]
    fn without_a_stored_basis_the_first_one_and_a_quarter_second_is_it() {
        let mut supply = SupplyMonitor::default();
        for n in 0..MIN_BASELINE_READINGS {
            assert_eq!(
                (supply.baseline_level(), supply.scale()),
                (InternalReferenceLevel(0), SupplyScale::ONE),
                "{n}"
            );
            supply.receive(AdcCode(1500));
        }
        assert_eq!(supply.baseline_level(), InternalReferenceLevel(1500 * 16));
        assert_eq!(supply.scale(), SupplyScale::ONE);
    }

    #[test]
    fn a_first_basis_is_a_mean_and_not_one_reading() {
        let mut supply = SupplyMonitor::default();
        let mut seed = 5;
        // ±4 codes, evenly: 2.3 codes RMS.
        for _ in 0..MIN_BASELINE_READINGS {
            supply.receive(AdcCode(1496 + (crate::testing::next_random(&mut seed) % 9) as u16));
        }
        // Of 2.6 codes RMS the mean leaves 0.33: within four of them.
        assert!((i32::from(supply.baseline_level().0) - 1500 * 16).abs() < 4 * 16 * 33 / 100 + 1);
    }

    #[test]
    fn a_step_of_the_supply_is_followed_within_a_second_and_a_half() {
        let mut supply = settled(1500, 1500);
        (0..150).for_each(|_| supply.receive(AdcCode(1530)));
        let reading = supply.scale().scale_reading(SensorReading(1_020_000));
        // e^(−150/32) of 2 % is left.
        assert!((reading.0 - 1_000_000).abs() < 20_000 / 100, "{reading:?}");
    }

    #[test]
    fn no_code_and_no_basis_panics_or_wraps() {
        for basis in [0, 1, u16::MAX] {
            for code in [0, 1, 4095, u16::MAX] {
                let mut supply = SupplyMonitor::default();
                supply.set_baseline_level(InternalReferenceLevel(basis));
                (0..300).for_each(|_| supply.receive(AdcCode(code)));
                for raw in [i32::MIN, -1, 0, 1, i32::MAX] {
                    let scaled = supply.scale().scale_raw(raw);
                    assert!(scaled.signum() * raw.signum() >= 0, "{basis}, {code}: {scaled}");
                }
            }
        }
    }

    #[test]
    fn a_basis_that_is_forgotten_is_taken_anew() {
        let mut supply = settled(1500, 1400);
        supply.reset_baseline_level();
        assert_eq!(
            (supply.baseline_level(), supply.scale(), supply.is_out_of_tolerance()),
            (InternalReferenceLevel(0), SupplyScale::ONE, false)
        );
        (0..MIN_BASELINE_READINGS).for_each(|_| supply.receive(AdcCode(1400)));
        assert_eq!(
            (supply.baseline_level(), supply.is_out_of_tolerance()),
            (InternalReferenceLevel(1400 * 16), false)
        );
    }
}
