//! Can the mass that a thermometer measures have changed so fast?
//!
//! A mass follows what heats it with a rate of its own, so a reading is believed only within the reach of those before:
//! a tracked value follows the readings by at most the limit, and a reading that is farther from it than a tolerance
//! came too fast. That catches steps and ramps alike: what rises by e K/min more than the limit leaves the tolerance
//! after 60·tolerance/e seconds. The tolerance is half a kelvin and two steps of the converter: noise of three steps of a
//! MAX31865 (0.09 K RMS) leaves it once in 10⁷ readings, and in four in a row never.
//!
//! | a reading that came too fast | becomes |
//! |---|---|
//! | one to three, then as before | a spark: they are ignored |
//! | four in a row | a doubt: reported, the last believed value is held |
//! | it stays within the limit for [`RATE_RECOVERY_READINGS`] (60 s) | believed |
//! | it jumps back to where the mass can be by now | believed |
//! | a thermometer of the same law agrees within 3 K, four times in a row | believed |
//! | none of these within [`RATE_FAULT_READINGS`] (5 min) | no thermometer: it is given up |

use crate::{index_set::IndexSet, thermometer::FAULT_AFTER_READINGS, units::Temperature};

/// The limit of a thermometer that a law uses, where the calibration states none: 10 K/min. A spindle of 24,000 r/min
/// warms its front bearing by 6 K/min at the most, the parts of a machine are slower.
pub const DEFAULT_RATE_DECIKELVIN_PER_MIN: u16 = 100;
/// The largest limit, in tenths of a kelvin a minute: 600 K/min, a bare element in flowing coolant.
pub const MAX_RATE_DECIKELVIN_PER_MIN: u16 = 6_000;
/// After this many readings within the limit a value that came too fast is believed: 60 s.
pub const RATE_RECOVERY_READINGS: u16 = 600;
/// A doubt that has lasted for this many readings is a broken thermometer: 5 min.
pub const RATE_FAULT_READINGS: u16 = 3_000;
/// Thermometers of one law agree within this.
pub const MAX_TEMPERATURE_DISAGREEMENT: Temperature = Temperature(3 * Temperature::PER_KELVIN);

/// Readings in ten minutes: a tenth of a kelvin a minute is one kelvin in this many.
const READINGS_PER_TEN_MINUTES: i32 = 6_000;

/// How fast a channel may change.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TemperatureRateLimit {
    /// From one reading to the next, in temperature units; 0: not judged.
    per_reading: i32,
    /// How far a reading may be from the tracked value, in temperature units.
    tolerance: i32,
    /// Channels that the same law uses.
    pub partners: IndexSet,
}

impl TemperatureRateLimit {
    /// Returns the limit of a channel that changes by up to `tenths` of a kelvin a minute (0: not judged) and whose
    /// converter has steps of `step`.
    #[must_use]
    pub fn new(tenths: u16, step: Temperature, partners: IndexSet) -> Self {
        let tenths = i32::from(tenths.min(MAX_RATE_DECIKELVIN_PER_MIN));
        // 14 bits by 22: below 2⁶³.
        let units = i64::from(tenths).wrapping_mul(Temperature::PER_KELVIN.into());
        let per_reading = units.checked_div(READINGS_PER_TEN_MINUTES.into()).unwrap_or(0);
        let tolerance = (Temperature::PER_KELVIN / 2).saturating_add(step.0.saturating_mul(2));
        Self { per_reading: i32::try_from(per_reading).unwrap_or(i32::MAX), tolerance, partners }
    }

    /// Returns whether the channel is judged.
    #[must_use]
    pub const fn is_enabled(&self) -> bool {
        self.per_reading != 0
    }

    /// Returns how far a reading may be from a value that was tracked this many readings ago.
    fn allowed_deviation(&self, readings: u16) -> u32 {
        let moved = self.per_reading.saturating_mul(readings.min(RATE_RECOVERY_READINGS).into());
        self.tolerance.saturating_add(moved).unsigned_abs()
    }
}

/// The state of the check of a channel's rate of change.
#[derive(Clone, Copy, Debug, Default)]
pub struct TemperatureRateMonitor {
    /// Where the mass was when it was last believed.
    tracked: i32,
    /// Readings since then.
    age: u16,
    /// The value in doubt, and for how many readings it has been within the limit; 0: there is none.
    candidate: i32,
    steady: u16,
    /// Readings in a row that came too fast, and that a partner agrees with, up to [`FAULT_AFTER_READINGS`].
    doubtful: u8,
    agreed: u8,
}

impl TemperatureRateMonitor {
    /// Believes a reading without a look at those before.
    pub fn restart(&mut self, now: Temperature) {
        *self = Self { tracked: now.0, ..Self::default() };
    }

    /// Takes the time of a reading that failed.
    pub fn record_missed_reading(&mut self) {
        self.age = self.age.saturating_add(1);
        (self.steady, self.agreed) = (0, 0);
    }

    /// Judges a reading; `agrees`: a thermometer of the same law does. Returns whether it is believed.
    pub fn check_reading(
        &mut self,
        now: Temperature,
        limit: &TemperatureRateLimit,
        agrees: bool,
    ) -> bool {
        self.age = self.age.saturating_add(1);
        self.agreed = if agrees { self.agreed.saturating_add(1) } else { 0 };
        let off = |from: i32| from.abs_diff(now.0);
        let is_steady = self.steady > 0 && off(self.candidate) <= limit.allowed_deviation(1);
        // What stays at the value in doubt has to stay for its time; what leaves it may be back where the mass is by now.
        let reach = if is_steady {
            limit.tolerance.unsigned_abs()
        } else {
            limit.allowed_deviation(self.age)
        };
        if off(self.tracked) <= reach {
            self.tracked =
                step_towards(self.tracked, now, limit.per_reading.saturating_mul(self.age.into()));
            *self = Self { tracked: self.tracked, ..Self::default() };
            return true;
        }
        if is_steady {
            self.candidate = step_towards(self.candidate, now, limit.per_reading);
            self.steady = self.steady.saturating_add(1);
        } else {
            (self.candidate, self.steady) = (now.0, 1);
        }
        if self.steady > RATE_RECOVERY_READINGS || self.agreed >= FAULT_AFTER_READINGS {
            self.restart(now);
            return true;
        }
        self.doubtful = self.doubtful.saturating_add(1).min(FAULT_AFTER_READINGS);
        false
    }

    /// Returns whether the value is in doubt: more than a spark.
    #[must_use]
    pub const fn is_uncertain(&self) -> bool {
        self.doubtful >= FAULT_AFTER_READINGS
    }

    /// Returns whether the doubt has lasted too long for a thermometer.
    #[must_use]
    pub const fn has_timed_out(&self) -> bool {
        self.is_uncertain() && self.age >= RATE_FAULT_READINGS
    }
}

/// Returns `from`, moved by at most `most` toward a temperature.
fn step_towards(from: i32, to: Temperature, most: i32) -> i32 {
    let most = most.max(0);
    // `clamp` would check the order of its bounds, with a panic.
    to.0.max(from.saturating_sub(most)).min(from.saturating_add(most))
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;

    const STEP: Temperature = Temperature(Temperature::PER_KELVIN / 32);

    fn limit(kelvin_per_min: f64) -> TemperatureRateLimit {
        TemperatureRateLimit::new((kelvin_per_min * 10.0) as u16, STEP, IndexSet::default())
    }

    fn celsius(celsius: f64) -> Temperature {
        Temperature((celsius * f64::from(Temperature::PER_KELVIN)) as i32)
    }

    /// For how many readings it is not believed, of those that `celsius` gives from the first to the last.
    fn doubted(per_min: f64, readings: u32, of: impl Fn(f64) -> f64) -> (u32, Option<u32>) {
        let (mut monitor, limit) = (TemperatureRateMonitor::default(), limit(per_min));
        monitor.restart(celsius(of(0.0)));
        let (mut count, mut first) = (0, None);
        for n in 1..=readings {
            if !monitor.check_reading(celsius(of(f64::from(n) / 10.0)), &limit, false) {
                count += 1;
                first.get_or_insert(n);
            }
        }
        (count, first)
    }

    #[test]
    fn a_step_is_believed_after_60_s_and_not_before_whatever_its_size() {
        for (from, to) in [(30.0, 85.0), (21.0, 23.0), (60.0, 20.0), (20.0, 20.8)] {
            let step = |t_s: f64| if t_s < 5.0 { from } else { to };
            assert_eq!(doubted(10.0, 2_000, step), (600, Some(50)), "{from} to {to} °C");
        }
    }

    #[test]
    fn a_ramp_above_the_limit_is_found_within_the_time_of_the_tolerance_and_one_below_never() {
        for limit in [0.1, 1.0, 10.0, 100.0, 600.0] {
            let below = |t_s: f64| 20.0 + 0.99 * limit / 60.0 * t_s;
            assert_eq!(doubted(limit, 20_000, below).0, 0, "{limit} K/min");
            let above = |t_s: f64| 20.0 - 1.2 * limit / 60.0 * t_s;
            let (_, first) = doubted(limit, 60_000, above);
            let within = 10.0 * 60.0 * (0.5 + 2.0 / 32.0) / (0.2 * limit) + 2.0;
            assert!(first.is_some_and(|n| f64::from(n) <= within), "{limit} K/min: {first:?}");
        }
    }

    #[test]
    fn one_that_goes_back_to_where_the_mass_is_by_now_is_believed_at_once() {
        // The mass warms by 6 K/min meanwhile; a contact adds 21 Ω for four seconds, and for three readings.
        for lasts_s in [0.3, 4.0, 40.0] {
            let fault = |t_s: f64| {
                let is_off = (10.0..10.0 + lasts_s - 0.05).contains(&t_s);
                20.0 + 0.1 * t_s + if is_off { 54.0 } else { 0.0 }
            };
            let readings = (10.0 * lasts_s) as u32;
            assert_eq!(doubted(10.0, 2_000, fault).0, readings, "{lasts_s} s");
        }
    }

    #[test]
    fn one_that_is_never_steady_is_given_up_after_five_minutes() {
        let (mut monitor, limit) = (TemperatureRateMonitor::default(), limit(10.0));
        monitor.restart(celsius(20.0));
        let wild = |n: u16| celsius(60.0 + f64::from(n % 40));
        let given_up = (1..=u16::MAX).find(|n| {
            assert!(!monitor.check_reading(wild(*n), &limit, false));
            assert_eq!(monitor.is_uncertain(), *n >= 4);
            monitor.has_timed_out()
        });
        assert_eq!(given_up, Some(RATE_FAULT_READINGS));
    }

    #[test]
    fn a_partner_that_agrees_four_times_in_a_row_ends_a_doubt() {
        let (mut monitor, limit) = (TemperatureRateMonitor::default(), limit(10.0));
        monitor.restart(celsius(20.0));
        for n in 1..=40 {
            let agrees = n > 30 || n % 4 == 0;
            assert_eq!(monitor.check_reading(celsius(40.0), &limit, agrees), n >= 34, "{n}");
        }
    }

    #[test]
    fn after_a_loss_what_the_mass_can_have_done_meanwhile_is_believed_and_more_is_not() {
        for (lost, to, is_believed) in
            [(100, 21.5, true), (100, 22.5, false), (60_000, 31.0, false)]
        {
            let mut monitor = TemperatureRateMonitor::default();
            monitor.restart(celsius(20.0));
            (0..lost).for_each(|_| monitor.record_missed_reading());
            let is = monitor.check_reading(celsius(to), &limit(10.0), false);
            assert_eq!(is, is_believed, "{to} °C after {lost}");
        }
    }

    #[test]
    fn no_reading_panics_or_wraps() {
        let ends = [i32::MIN, -1, 0, i32::MAX];
        for tenths in [1, MAX_RATE_DECIKELVIN_PER_MIN, u16::MAX] {
            let limit =
                TemperatureRateLimit::new(tenths, Temperature(i32::MAX), IndexSet::default());
            let mut monitor = TemperatureRateMonitor::default();
            for n in 0..40_000 {
                monitor.check_reading(Temperature(ends[n % 4]), &limit, n % 7 == 0);
                monitor.record_missed_reading();
            }
        }
    }
}
