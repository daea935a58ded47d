//! Has a thermometer stopped? Equal readings prove nothing of a part at rest, but the end of its noise does.
//!
//! Noise takes a reading back and forth; growth that is rounded to steps goes one way, and a quiet reading next to an edge passes
//! just that one. So what counts are swings: a change of two of the converter's steps or more, against the direction
//! of the change before. They are weighed against the readings without one: noise of half a step RMS has more than
//! one in 24 wherever it lies between two steps, 0.4 steps have one in 45 at the most and are not judged. A thermometer is lively
//! once its swings have outweighed the rest by `MIN_LIVELY_WEIGHT`; if it then gives the same reading [`FROZEN_AFTER_READINGS`] times in a
//! row (by noise of half a step alone 0.52⁴⁰⁰), it is still.
//!
//! Noise that comes from outside, a drive's, ends with the drive, and for all thermometers at once. So one that is
//! still counts as stuck only next to another that is lively and has changed of late ([`crate::temperature_channels::TemperatureChannels::receive`]);
//! a board with one thermometer never says so.

use crate::units::Temperature;

/// This many equal readings in a row, 40 s: no noise that was seen does that.
pub const FROZEN_AFTER_READINGS: u16 = 400;
/// A swing outweighs this many readings without one.
const SWING_WEIGHT: u16 = 23;
/// As far as the weight goes: a minute of noise of one step RMS brings it there.
const MAX_LIVELINESS_WEIGHT: u16 = 1_000;
/// Lively up to here: above what is left of the largest weight when a stop has been counted to its end.
const MIN_LIVELY_WEIGHT: u16 = MAX_LIVELINESS_WEIGHT - FROZEN_AFTER_READINGS - 100;
/// One that has changed within 2 s is going.
const INACTIVE_AFTER_READINGS: u16 = 20;

/// The state of the check for a frozen thermometer.
#[derive(Clone, Copy, Debug, Default)]
pub struct FreezeDetector {
    last: Option<Temperature>,
    is_rising: bool,
    /// The smallest change that was seen: a step of the converter.
    step: u32,
    /// How often in a row the last reading has come again.
    equal: u16,
    /// Swings, [`SWING_WEIGHT`] each, less the readings without one.
    weight: u16,
    /// It was lively, and gives the same reading now for longer than noise would.
    is_still: bool,
}

impl FreezeDetector {
    /// Takes a reading; one that failed says nothing.
    // Once in the image.
    #[inline(never)]
    pub fn receive(&mut self, reading: Option<Temperature>) {
        let Some(now) = reading else { return };
        let last = self.last.replace(now).unwrap_or(now);
        self.equal = if now == last { self.equal.saturating_add(1) } else { 0 };
        let change = now.0.abs_diff(last.0);
        let mut swings = false;
        if change > 0 {
            let is_rising = now > last;
            self.step = if self.step == 0 { change } else { self.step.min(change) };
            // Steps of a PT100 differ a little.
            swings = is_rising != self.is_rising && change / 3 >= self.step / 2;
            self.is_rising = is_rising;
        }
        self.weight = if swings {
            self.weight.saturating_add(SWING_WEIGHT).min(MAX_LIVELINESS_WEIGHT)
        } else {
            self.weight.saturating_sub(1)
        };
        // By then a steady one has lost as much.
        self.is_still = match self.equal {
            0..FROZEN_AFTER_READINGS => false,
            FROZEN_AFTER_READINGS => self.weight >= MIN_LIVELY_WEIGHT,
            _ => self.is_still,
        };
    }

    /// Returns whether it was lively, and gives the same reading now for longer than noise would.
    #[must_use]
    pub const fn is_frozen(&self) -> bool {
        self.is_still
    }

    /// Returns whether it is lively, and has changed of late.
    #[must_use]
    pub const fn is_active(&self) -> bool {
        self.equal < INACTIVE_AFTER_READINGS && self.weight >= MIN_LIVELY_WEIGHT
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::temperature_channels::TemperatureChannels;
    extern crate std;

    /// Readings in steps of a converter: one in this many is two steps off, after one that is one.
    fn noisy(n: u32, one_in: u32) -> Option<Temperature> {
        let steps = if n.is_multiple_of(one_in) { 2 } else { i32::from(n % one_in == 1) };
        Some(Temperature(20_000 + 100 * steps))
    }

    fn faulty(channels: &TemperatureChannels) -> [bool; 3] {
        [0, 1, 2].map(|number| channels.is_faulty(number))
    }

    #[test]
    fn a_lively_thermometer_that_stops_is_given_up_after_40_s_where_another_goes_on_and_only_there()
    {
        for others_go_on in [true, false] {
            let mut channels = TemperatureChannels::default();
            for n in 0..3_000 {
                channels.receive(0, noisy(n, 5));
                channels.receive(1, noisy(n, 6));
                channels.receive(2, noisy(n, 1_000));
            }
            assert_eq!(faulty(&channels), [false; 3]);
            let stops = |channels: &mut TemperatureChannels, n: u32| {
                channels.receive(0, Some(Temperature(20_000)));
                channels
                    .receive(1, if others_go_on { noisy(n, 6) } else { Some(Temperature(20_000)) });
                channels.receive(2, Some(Temperature(20_000)));
                faulty(channels)
            };
            let reported = (1..10_000).find(|n| stops(&mut channels, *n)[0]);
            assert_eq!(reported.is_some(), others_go_on);
            if let Some(readings) = reported {
                assert!((400..=404).contains(&readings), "{readings}");
                assert_eq!(faulty(&channels), [true, false, false], "a quiet one is not judged");
                for n in 0..100 {
                    channels.receive(1, noisy(n, 6));
                    channels.receive(0, Some(Temperature(20_000)));
                }
                assert!(channels.is_faulty(0), "for as long as it stands");
                for n in 1..5 {
                    channels.receive(0, Some(Temperature(20_000 + 100 * n)));
                }
                assert!(!channels.is_faulty(0), "and is believed again with its fourth");
            }
        }
    }

    #[test]
    fn what_warms_up_in_steps_or_lies_at_an_edge_is_not_lively_and_its_rest_proves_nothing() {
        let edge = |n: i32| 20_000 + 100 * (n % 2);
        let steps = |n: i32| n / 2 * 100;
        let both = |n: i32| n / 40 * 200 + 100 * (n % 2);
        let seldom =
            |n: i32| if n % 30 == 0 { 20_200 } else { 20_000 + 100 * i32::from(n % 30 == 1) };
        let quick = |n: i32| if n < 2 { 100 * n } else { 200 * n };
        for reading in [edge, steps, both, seldom, quick] {
            let mut it = FreezeDetector::default();
            (0..20_000).for_each(|n| it.receive(Some(Temperature(reading(n)))));
            assert!(!it.is_active());
            (0..1_000).for_each(|_| it.receive(Some(Temperature(5_000_000))));
            assert!(!it.is_frozen());
        }
    }
}
