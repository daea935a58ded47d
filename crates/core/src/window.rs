//! How long a revolution is, in samples of the 5 kHz stream, ready to average over.
//!
//! W = 60 s/min · 5000 Hz / n samples, Q16, with its reciprocal 2⁴⁹/W beside it, so that the
//! averages need no division. W lies between 4.58 samples (65 535 r/min) and 1000 samples
//! (300 r/min); slower spindles, a standing one and an unknown speed use the 200 ms of 300 r/min.
//! Rounding W to 2⁻¹⁶ of a sample and the reciprocal to an integer costs at most 1.1·10⁻⁷ and
//! 6·10⁻⁸ of the value.

use crate::units::Rpm;

/// Samples a second of the stream that is averaged.
pub const AVERAGED_HZ: u32 = 5_000;

/// The slowest speed at which a revolution is averaged; below it the window is 200 ms.
pub const SLOWEST: Rpm = Rpm(300);

/// One revolution in samples, and its reciprocal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Samples, Q16.
    width: u32,
    /// 2⁴⁹ divided by `width`.
    reciprocal: u32,
}

impl Window {
    /// The fixed window of 200 ms, for a standing spindle or an unknown speed.
    pub const STANDSTILL: Self = Self::of(SLOWEST);

    /// One revolution at this speed; 200 ms where the speed is unknown or below 300 r/min.
    ///
    /// ```
    /// use trueup_core::{units::Rpm, window::Window};
    /// // 24 000 r/min are 400 Hz: 12.5 samples of 0.2 ms.
    /// assert_eq!(Window::for_speed(Some(Rpm(24_000))).samples_q16(), 12 * 65_536 + 32_768);
    /// assert_eq!(Window::for_speed(Some(Rpm(0))), Window::STANDSTILL);
    /// ```
    #[must_use]
    pub const fn for_speed(speed: Option<Rpm>) -> Self {
        match speed {
            Some(speed) if speed.0 > SLOWEST.0 => Self::of(speed),
            _ => Self::STANDSTILL,
        }
    }

    #[allow(
        clippy::arithmetic_side_effects,
        clippy::cast_possible_truncation,
        reason = "speed is 300…65535: 2⁴⁹/W is below 2³¹, W below 2²⁶"
    )]
    const fn of(speed: Rpm) -> Self {
        const SAMPLES_PER_MINUTE_Q16: u64 = 60 * AVERAGED_HZ as u64 * 65_536;
        let speed = speed.0 as u64;
        let width = (SAMPLES_PER_MINUTE_Q16 + speed / 2) / speed;
        Self { width: width as u32, reciprocal: (((1 << 49) + width / 2) / width) as u32 }
    }

    /// Length in samples, Q16.
    #[must_use]
    pub const fn samples_q16(self) -> u32 {
        self.width
    }

    /// 2⁴⁹ divided by the length in Q16 samples.
    #[must_use]
    pub const fn reciprocal_q49(self) -> u32 {
        self.reciprocal
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
            let window = Window::for_speed(Some(Rpm(rpm)));
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
    fn slow_and_unknown_speeds_use_200_ms() {
        assert_eq!(Window::STANDSTILL.samples_q16(), 1000 * 65_536);
        for speed in [None, Some(Rpm(0)), Some(Rpm(299)), Some(Rpm(300))] {
            assert_eq!(Window::for_speed(speed), Window::STANDSTILL);
        }
    }
}
