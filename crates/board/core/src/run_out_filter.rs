//! From 20 000 codes a second to 1000 readings a second, free of run-out.
//!
//! ```text
//! 20 kS/s codes → sums of 4 → 5 kHz → mean over a revolution → mean over a revolution → 1 kHz
//! ```
//!
//! Run-out is periodic in a revolution and much larger than the growth to be measured; a mean over
//! a whole revolution takes it out, harmonics and all. Two means in a row make the zeros double,
//! so that a speed that is 1 % wrong still leaves 0.0001 of it. They come *before* the rate falls
//! to 1 kHz, because there the harmonics have already folded onto low frequencies.
//!
//! A step arrives after two revolutions; the delay is one revolution and half a tick. Below 300 r/min it is 200 ms: in the
//! millisecond of a stop the reading goes back to what it was 100 ms before, and 200 ms later it is 200 ms behind. A spindle
//! that loses 5.8 µm of centrifugal growth in its last second is reported 0.6 µm too long, for 0.4 s. A
//! shorter window would not see a whole revolution of a spindle that still turns, and let its run-out through. No
//! digital filter can distinguish from growth what is above 10 kHz at the ADC's pin: that is the task of the
//! two-pole analogue filter before it.

use crate::{
    design_parameters::CODES_PER_TICK,
    revolution_mean::RevolutionMean,
    revolution_window::RevolutionWindow,
    units::{AdcCode, Rpm, SensorReading},
};

/// Codes that are added up to one sample of the 5 kHz stream.
const CODES_PER_SAMPLE: usize = 4;
const SAMPLES_PER_TICK: usize = CODES_PER_TICK / CODES_PER_SAMPLE;
/// The largest sum of this many codes; more count as that.
const FULL_SCALE_SUM: u32 = 4 * AdcCode::MAX.0 as u32;

/// The filter and all that it remembers.
#[derive(Clone, Debug)]
pub struct RunOutFilter {
    first: RevolutionMean,
    second: RevolutionMean,
    speed: Option<Rpm>,
    window: RevolutionWindow,
}

impl RunOutFilter {
    /// Returns a filter that has seen nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            first: RevolutionMean::new(),
            second: RevolutionMean::new(),
            speed: None,
            window: RevolutionWindow::STANDSTILL,
        }
    }

    /// Forgets everything: after a fault nothing of it may reach the next reading.
    pub fn clear(&mut self) {
        self.first.clear();
        self.second.clear();
    }

    /// Takes one tick of codes and gives the reading at its end, or `None` while the two means
    /// have not yet seen a whole revolution each. Nothing is made up for the time before the
    /// first code, so there is no ramp from zero.
    pub fn tick(
        &mut self,
        codes: &[AdcCode; CODES_PER_TICK],
        speed: Option<Rpm>,
    ) -> Option<SensorReading> {
        if speed != self.speed {
            self.speed = speed;
            self.window = RevolutionWindow::for_speed(speed);
        }
        let samples = sum_codes_to_samples(codes);
        if self.first.has_full_revolution(self.window) {
            self.second.push_all(self.first.push_and_average(samples, self.window));
        } else {
            self.fill_first_mean(samples);
        }
        let mean = self.second.mean(self.window)?;
        Some(SensorReading(i32::try_from(mean).unwrap_or(i32::MAX)))
    }

    /// Sample by sample, while the first mean comes to its first revolution.
    #[cold]
    #[inline(never)]
    fn fill_first_mean(&mut self, samples: [u32; SAMPLES_PER_TICK]) {
        for sample in samples {
            self.first.push(sample);
            if let Some(mean) = self.first.mean(self.window) {
                self.second.push(mean);
            }
        }
    }
}

/// Four codes each, added up: a sum is Q2, and 256 makes it Q10.
#[inline]
fn sum_codes_to_samples(codes: &[AdcCode; CODES_PER_TICK]) -> [u32; SAMPLES_PER_TICK] {
    let mut samples = [0; SAMPLES_PER_TICK];
    for (sample, four) in samples.iter_mut().zip(codes.as_chunks::<CODES_PER_SAMPLE>().0) {
        let sum = four.iter().fold(0_u32, |sum, code| sum.wrapping_add(code.0.into()));
        *sample = sum.min(FULL_SCALE_SUM) << 8;
    }
    samples
}

impl Default for RunOutFilter {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::READING_UNITS_PER_CODE;
    extern crate std;

    #[test]
    fn the_first_reading_is_the_input_and_not_a_ramp_from_zero() {
        for (speed, ticks_until_first) in [(Some(Rpm(24_000)), 5), (None, 400)] {
            let mut filter = RunOutFilter::new();
            let first = (1..).find_map(|tick| {
                filter.tick(&[AdcCode(631); CODES_PER_TICK], speed).map(|reading| (tick, reading))
            });
            assert_eq!(
                first,
                Some((ticks_until_first, SensorReading(631 * READING_UNITS_PER_CODE)))
            );
        }
    }

    #[test]
    fn every_constant_code_comes_out_exactly() {
        for code in 0..=AdcCode::MAX.0 {
            let mut filter = RunOutFilter::new();
            let mut last = None;
            for _ in 0..7 {
                last = filter.tick(&[AdcCode(code); CODES_PER_TICK], Some(Rpm(24_000)));
            }
            assert_eq!(last, Some(SensorReading(i32::from(code) * READING_UNITS_PER_CODE)));
        }
    }

    #[test]
    fn a_change_of_speed_leaves_a_constant_input_constant() {
        let mut filter = RunOutFilter::new();
        for tick in 0..3000_u32 {
            let speed = Rpm(u16::try_from(300 + tick * 7919 % 60_000).unwrap());
            let reading = filter.tick(&[AdcCode(2000); CODES_PER_TICK], Some(speed));
            if tick > 450 {
                assert_eq!(
                    reading,
                    Some(SensorReading(2000 * READING_UNITS_PER_CODE)),
                    "at tick {tick}"
                );
            }
        }
    }

    #[test]
    fn a_reading_is_a_revolution_old_in_the_millisecond_of_a_stop_100_ms_and_then_200() {
        let mut filter = RunOutFilter::new();
        // Four codes in a millisecond, and this many milliseconds behind.
        let mut behind_ms = |tick: u32, speed: u16| {
            let codes = core::array::from_fn(|n| AdcCode((4 * tick + n as u32 / 5) as u16));
            let reading = filter.tick(&codes, Some(Rpm(speed)));
            reading.map(|reading| {
                f64::from(tick) - f64::from(reading.0) / f64::from(4 * READING_UNITS_PER_CODE)
            })
        };
        let before = (1..600).filter_map(|tick| behind_ms(tick, 12_000)).last();
        let after = (600..900).map(|tick| behind_ms(tick, 0).expect("it goes on"));
        let is_near = |ms: f64, expected: f64| (ms - expected).abs() < 1.0;
        assert!(before.is_some_and(|ms| is_near(ms, 5.0)), "{before:?}");
        let after: std::vec::Vec<_> = after.collect();
        assert!((after[0] - 100.0).abs() < 5.0, "{}", after[0]);
        assert!(is_near(after[299], 200.0), "{}", after[299]);
    }
}
