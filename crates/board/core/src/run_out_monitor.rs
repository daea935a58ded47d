//! Run-out out of family: how much of what the filter takes out there is, against what it was since this speed was reached.
//!
//! ```text
//! d = code − reading                 of one code of each millisecond, drawn: a fixed pattern would be in step with some speed
//! v = Σ d²/1024                      over 1.024 s: half the square of the amplitude, and the noise
//! family = the least of the first 16 v at a speed
//! odd: v < family/4, or v > 16·family and the amplitude is above 5 µm; twice in a row
//! ```
//!
//! Run-out is the ring's and the bearing's, and at one speed it does not change. It vanishes only if the sensor no longer sees
//! its ring (a gain that is lost, a ring under chips, a broken wire that brings in noise), and grows fourfold where a
//! bearing breaks up or the sensor has come loose; cutting adds a micrometre or two. From speed to speed, or after a
//! stop with another tool, it may be anything, and is not compared.
//!
//! Not judged: a spindle that stands or turns at up to 300 r/min, the first 16 s at a speed, and run-out that does not
//! stand out of the noise. The mean of 1,024 squares of a sine is 2.2 % off (RMS); a quarter is 34 such
//! deviations away.

use crate::{
    design_parameters::CODES_PER_TICK,
    units::{AdcCode, READING_UNITS_PER_CODE, Rpm, SensorReading},
};

#[allow(clippy::cast_possible_truncation, reason = "20")]
const CODES_PER_TICK_U32: u32 = CODES_PER_TICK as u32;
const RUN_OUT_WINDOW_MS_LOG2: u32 = 10;
/// Milliseconds of a mean.
pub const RUN_OUT_WINDOW_MS: u16 = 1 << RUN_OUT_WINDOW_MS_LOG2;
/// Minimum number of means: a spindle may need as long to reach its speed.
pub const MIN_BASELINE_WINDOWS: u8 = 16;
/// An amplitude of half the family's or less is a quarter of its square.
const LOW_POWER_DIVISOR: u32 = 4;
/// One of four times the family's is 16 times its square.
const HIGH_POWER_FACTOR: u32 = 16;
/// Half the square of an amplitude of 41 codes (5 µm), in 1/256 codes².
const CUTTING_THRESHOLD: u32 = 41 * 41 / 2 * 256;
/// This many means in a row have to be odd.
const MIN_ANOMALOUS_WINDOWS: u8 = 2;

/// The run-out seen at the present speed.
#[derive(Clone, Debug, Default)]
pub struct RunOutMonitor {
    /// 0: it does not turn.
    speed: Rpm,
    /// The random number that selects the code looked at, drawn anew each time.
    drawn: u32,
    /// Of d in 1/16 codes.
    squares: u64,
    count: u16,
    /// Means at this speed.
    windows: u8,
    /// The least of the first ones, in 1/256 codes².
    family: u32,
    odd: u8,
}

impl RunOutMonitor {
    /// The spindle does not turn.
    #[inline]
    pub fn record_standstill(&mut self) {
        self.speed = Rpm(0);
    }

    /// Takes a millisecond of codes of a spindle that turns, and the reading at its end.
    #[inline]
    pub fn receive(
        &mut self,
        codes: &[AdcCode; CODES_PER_TICK],
        reading: SensorReading,
        speed: Rpm,
    ) {
        if speed != self.speed {
            self.restart_baseline(speed);
        }
        // Knuth's constants; the upper half is the random one.
        self.drawn = self.drawn.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let number = (self.drawn >> 16).wrapping_mul(CODES_PER_TICK_U32) >> 16;
        let Some(code) = codes.get(number as usize) else { return };
        let level = i32::from(code.0).wrapping_mul(READING_UNITS_PER_CODE);
        // In 1/16 codes: below 2¹⁶.
        let deviation = level.wrapping_sub(reading.0).unsigned_abs() >> 6;
        let square = u64::from(deviation).wrapping_mul(u64::from(deviation));
        self.squares = self.squares.wrapping_add(square);
        self.count = self.count.wrapping_add(1);
        if self.count >= RUN_OUT_WINDOW_MS {
            self.evaluate_window();
        }
    }

    /// Returns whether it is another one than it was.
    #[must_use]
    pub fn is_anomalous(&self) -> bool {
        self.speed != Rpm(0) && self.odd >= MIN_ANOMALOUS_WINDOWS
    }

    #[cold]
    #[inline(never)]
    fn restart_baseline(&mut self, speed: Rpm) {
        *self = Self { speed, ..Self::default() };
    }

    #[cold]
    #[inline(never)]
    fn evaluate_window(&mut self) {
        let mean = u32::try_from(self.squares >> RUN_OUT_WINDOW_MS_LOG2).unwrap_or(u32::MAX);
        (self.squares, self.count) = (0, 0);
        if self.windows < MIN_BASELINE_WINDOWS {
            self.windows = self.windows.saturating_add(1);
            self.family = if self.windows == 1 { mean } else { self.family.min(mean) };
            return;
        }
        let is_less = mean < self.family / LOW_POWER_DIVISOR;
        let is_more = mean > CUTTING_THRESHOLD && mean / HIGH_POWER_FACTOR > self.family;
        self.odd = if is_less || is_more { self.odd.saturating_add(1) } else { 0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;

    const SPEED: Rpm = Rpm(12_000);

    /// Seconds of a spindle with this run-out, in codes.
    fn turn(it: &mut RunOutMonitor, seconds: u32, amplitude: f64, hz: f64, speed: Rpm) -> bool {
        for ms in 0..seconds * 1_024 {
            let codes = core::array::from_fn(|n| {
                let s = (f64::from(ms) + n as f64 / 20.0) / 1e3;
                let run_out = amplitude * (hz * s * core::f64::consts::TAU).sin();
                AdcCode((700.0 + run_out).round() as u16)
            });
            if speed == Rpm(0) {
                it.record_standstill();
            } else {
                it.receive(&codes, SensorReading(700 * READING_UNITS_PER_CODE), speed);
            }
        }
        it.is_anomalous()
    }

    #[test]
    fn run_out_that_vanishes_or_grows_fourfold_is_reported_in_the_third_second_and_what_cutting_adds_is_not()
     {
        // Whole multiples of the tick among them.
        for hz in [200.0, 325.0, 370.37, 500.0, 740.74, 1_000.0] {
            for (then, is_odd) in [
                (4.0, true),
                (5.5, false),
                (10.0, false),
                (26.0, false),
                (39.0, false),
                (44.0, true),
            ] {
                let mut it = RunOutMonitor::default();
                assert!(!turn(&mut it, 20, 10.0, hz, SPEED));
                assert!(!turn(&mut it, 1, then, hz, SPEED), "not by one mean");
                assert_eq!(
                    turn(&mut it, 1, then, hz, SPEED),
                    is_odd,
                    "10 codes, then {then}; {hz} Hz"
                );
                turn(&mut it, 1, 10.0, hz, SPEED);
                assert!(!it.is_anomalous(), "what has come back is reported no more");
            }
        }
    }

    #[test]
    fn what_cutting_adds_to_a_small_run_out_is_not_reported() {
        let mut it = RunOutMonitor::default();
        turn(&mut it, 20, 3.0, 200.0, SPEED);
        assert!(!turn(&mut it, 5, 38.0, 200.0, SPEED), "4.6 µm");
        assert!(turn(&mut it, 2, 44.0, 200.0, SPEED), "5.4 µm");
    }

    #[test]
    fn no_speed_is_in_step_with_what_is_looked_at() {
        // Every seventh code of each millisecond is, at 325 Hz; and a beat in five minutes shows it at its most and at its least.
        for hz in [163.934, 200.0, 325.0, 400.0].map(|hz| hz + 1.0 / 600.0) {
            for eighth in 0..8 {
                let mut it = RunOutMonitor::default();
                for ms in 0..200 * u32::from(RUN_OUT_WINDOW_MS) {
                    let at = |n: usize| hz * (f64::from(ms) + n as f64 / 20.0) / 1e3;
                    let turns = |n| at(n) + f64::from(eighth) / 16.0;
                    let codes = core::array::from_fn(|n| {
                        AdcCode((700.0 + 10.0 * (turns(n) * core::f64::consts::TAU).sin()) as u16)
                    });
                    it.receive(&codes, SensorReading(700 * READING_UNITS_PER_CODE), SPEED);
                    assert!(!it.is_anomalous(), "{hz} Hz, {eighth}/8, {ms} ms");
                }
            }
        }
    }

    #[test]
    fn another_speed_or_a_stop_has_another_run_out() {
        for next in [Rpm(12_001), Rpm(0)] {
            let mut it = RunOutMonitor::default();
            turn(&mut it, 20, 10.0, 200.0, SPEED);
            turn(&mut it, 3, 1.0, 200.0, SPEED);
            assert!(it.is_anomalous());
            assert!(!turn(&mut it, 5, 1.0, 200.0, next));
            assert!(!turn(&mut it, 20, 80.0, 200.0, SPEED), "after it");
        }
    }

    #[test]
    fn a_spindle_that_passes_a_resonance_on_its_way_up_has_the_run_out_of_its_end() {
        let mut it = RunOutMonitor::default();
        turn(&mut it, 12, 30.0, 200.0, SPEED);
        assert!(!turn(&mut it, 60, 10.0, 200.0, SPEED));
        assert!(turn(&mut it, 2, 4.0, 200.0, SPEED), "and 30 codes do not count");
    }

    #[test]
    fn the_whole_range_of_codes_does_not_wrap() {
        let mut it = RunOutMonitor::default();
        turn(&mut it, 20, 10.0, 200.0, SPEED);
        for _ in 0..2 * RUN_OUT_WINDOW_MS {
            it.receive(&[AdcCode(4095); CODES_PER_TICK], SensorReading(0), SPEED);
        }
        assert!(it.is_anomalous());
    }
}
