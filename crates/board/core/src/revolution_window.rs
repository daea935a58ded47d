//! How long a revolution is, in samples of the 5 kHz stream, ready to average over.
//!
//! W = 60 s/min · 5000 Hz / n samples, Q16, with its reciprocal 2⁴⁹/W next to it, so that the
//! averages need no division. W lies between 4.58 samples (65 535 r/min) and 1000 samples
//! (300 r/min); slower spindles, a standing one and an unknown speed use the 200 ms of 300 r/min.
//! Rounding W to 2⁻¹⁶ of a sample and the reciprocal to an integer costs at most 1.1·10⁻⁷ and
//! 6·10⁻⁸ of the value.

use crate::{fixed_point::rounding_shift_right_unsigned, units::Rpm};

/// Samples a second of the stream that is averaged.
pub const RUN_OUT_SAMPLE_RATE_HZ: u32 = 5_000;

/// The slowest speed at which a revolution is averaged; below it the window is 200 ms.
pub const MIN_SPEED_FOR_REVOLUTION_MEAN: Rpm = Rpm(300);

/// One revolution in samples, and its reciprocal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RevolutionWindow {
    /// Samples, Q16.
    width: u32,
    /// 2⁴⁹ divided by `width`.
    reciprocal: u32,
}

impl RevolutionWindow {
    /// The fixed window of 200 ms, for a standing spindle or an unknown speed.
    pub const STANDSTILL: Self = Self::from_speed(MIN_SPEED_FOR_REVOLUTION_MEAN);

    /// Returns one revolution at this speed; 200 ms where the speed is unknown or below 300 r/min.
    ///
    /// ```
    /// use trueup_core::{units::Rpm, revolution_window::RevolutionWindow};
    /// // 24 000 r/min are 400 Hz: 12.5 samples of 0.2 ms.
    /// assert_eq!(RevolutionWindow::for_speed(Some(Rpm(24_000))).samples_q16(), 12 * 65_536 + 32_768);
    /// assert_eq!(RevolutionWindow::for_speed(Some(Rpm(0))), RevolutionWindow::STANDSTILL);
    /// ```
    #[must_use]
    pub const fn for_speed(speed: Option<Rpm>) -> Self {
        match speed {
            Some(speed) if speed.0 > MIN_SPEED_FOR_REVOLUTION_MEAN.0 => Self::from_speed(speed),
            _ => Self::STANDSTILL,
        }
    }

    /// Divided by words, six or more places at a time, for which the processor has an instruction:
    /// a speed that changes costs 49 (`cargo measure`). It has none for a division of 64 bits.
    const fn from_speed(speed: Rpm) -> Self {
        const SAMPLES_PER_MINUTE: u32 = 60 * RUN_OUT_SAMPLE_RATE_HZ;
        /// Any width is shorter than a word by this many places.
        const SPARE_BITS: u32 = 6;
        // Widening; `From` is not const.
        let speed = speed.0 as u32;
        let (whole, rest) = div_rem(SAMPLES_PER_MINUTE, speed);
        // The rest is below 2¹⁶.
        let (part, _) = div_rem((rest << 16).wrapping_add(speed >> 1), speed);
        let width = (whole << 16).wrapping_add(part);
        // 2³¹ first, then 18 places more, and the rest rounds.
        let (mut reciprocal, mut rest) = div_rem(1 << 31, width);
        let mut places = 0;
        while places < 49 - 31 {
            let (digit, left) = div_rem(rest << SPARE_BITS, width);
            reciprocal = (reciprocal << SPARE_BITS) | digit;
            rest = left;
            places = SPARE_BITS.wrapping_add(places);
        }
        let up = rest.wrapping_add(width >> 1) >= width;
        Self { width, reciprocal: reciprocal.wrapping_add(up as u32) }
    }

    /// Length in samples, Q16.
    #[must_use]
    pub const fn samples_q16(self) -> u32 {
        self.width
    }

    /// Returns the mean of a stream over it: `inside` is the sum of the last [`Self::whole_samples`] values,
    /// below 2³², and `end` the value before them, at most 22 bits.
    #[must_use]
    #[inline]
    #[allow(clippy::cast_possible_truncation, reason = "a mean of 22 bits")]
    pub fn mean(self, inside: u32, end: u32) -> u32 {
        let fraction = self.width & 0xFFFF;
        // The area under the stream has 48 places; eight are given back before the product, which
        // then is the mean times 2⁴¹: at most 63 bits.
        let area = (u64::from(inside) << 8)
            .wrapping_add(u64::from(end).wrapping_mul(u64::from(fraction)) >> 8);
        rounding_shift_right_unsigned(area.wrapping_mul(u64::from(self.reciprocal)), 41) as u32
    }

    /// Returns the whole samples in it.
    #[must_use]
    pub const fn whole_samples(self) -> u32 {
        self.width >> 16
    }

    /// Returns how many samples it takes to cover it.
    #[must_use]
    pub const fn covering_sample_count(self) -> u32 {
        self.width.wrapping_add(0xFFFF) >> 16
    }

    /// 2⁴⁹ divided by the length in Q16 samples.
    #[must_use]
    pub const fn reciprocal_q49(self) -> u32 {
        self.reciprocal
    }
}

/// Quotient and rest; of a divisor of 0, which no speed gives, 0 and the dividend.
const fn div_rem(dividend: u32, divisor: u32) -> (u32, u32) {
    match dividend.checked_div(divisor) {
        Some(quotient) => (quotient, dividend.wrapping_sub(quotient.wrapping_mul(divisor))),
        None => (0, dividend),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_speed_has_its_revolution_and_reciprocal() {
        let mut worst_width: f64 = 0.0;
        let mut worst_reciprocal: f64 = 0.0;
        for rpm in 300..=u16::MAX {
            let window = RevolutionWindow::for_speed(Some(Rpm(rpm)));
            let exact = 300_000.0 * 65_536.0 / f64::from(rpm);
            let width = f64::from(window.samples_q16());
            worst_width = worst_width.max((width / exact - 1.0).abs());
            let product = width * f64::from(window.reciprocal_q49()) / 2f64.powi(49);
            worst_reciprocal = worst_reciprocal.max((product - 1.0).abs());
        }
        assert!(worst_width <= 1.7e-6, "{worst_width:e}");
        assert!(worst_reciprocal <= 6e-8, "{worst_reciprocal:e}");
    }

    #[test]
    fn a_window_is_what_a_division_of_64_bits_gives() {
        for rpm in 300..=u64::from(u16::MAX) {
            let width = (300_000 * 65_536 + rpm / 2) / rpm;
            let window = RevolutionWindow::from_speed(Rpm(rpm as u16));
            assert_eq!(u64::from(window.samples_q16()), width);
            assert_eq!(u64::from(window.reciprocal_q49()), ((1 << 49) + width / 2) / width);
        }
    }

    #[test]
    fn slow_and_unknown_speeds_use_200_ms() {
        assert_eq!(RevolutionWindow::STANDSTILL.samples_q16(), 1000 * 65_536);
        for speed in [None, Some(Rpm(0)), Some(Rpm(299)), Some(Rpm(300))] {
            assert_eq!(RevolutionWindow::for_speed(speed), RevolutionWindow::STANDSTILL);
        }
    }
}
