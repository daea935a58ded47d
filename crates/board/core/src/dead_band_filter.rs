//! The temperature of a thermometer without the jitter of its converter: what the laws follow.
//!
//! The step of a MAX31865, 1/32 K, is 0.36 µm for each metre of a steel screw, and a thermometer at the edge of a step
//! reads now one, now the other. An offset that followed it would turn the axis round ten times a second, and an axis
//! with backlash does not follow what turns round within it: the tool stays where the farthest of the offsets put it.
//!
//! Two measures, each for what the other leaves. A time constant of 1 s leaves a ninth of a step of it (standard
//! deviation, a reading at the edge), and a [dead band](crate::thermometer::Thermometer::dead_band) of a quarter of a step
//! each way holds the temperature while what is smoothed stays within it. They cost 8 mK where the temperature turns round (0.09 µm/m of steel) and 1 s of its change
//! (0.2 µm/m where a screw warms by 1 K/min).

use crate::{
    lag::{Lag, SmoothingFactor},
    units::Temperature,
};

/// Largest difference from the smoothed value that counts as jitter; more is followed at once. Half a kelvin, as in
/// [`temperature_rate`](crate::temperature_rate). So the first result of a converter, which may be far off, does not linger.
const MAX_TEMPERATURE_JITTER: u32 = Temperature::PER_KELVIN.unsigned_abs() / 2;

/// A temperature that stands while its readings change by no more than the jitter of their converter.
#[derive(Clone, Copy, Debug, Default)]
pub struct DeadBandFilter {
    known: Option<FilterState>,
}

#[derive(Clone, Copy, Debug)]
struct FilterState {
    smoothed: Lag,
    held: Temperature,
}

impl DeadBandFilter {
    /// Follows a reading, one in 100 ms, to within `dead_band` of what is smoothed. `None`: the thermometer is lost, and the
    /// next reading is the first one.
    pub fn update(&mut self, reading: Option<Temperature>, dead_band: Temperature) {
        let Some(now) = reading else {
            self.known = None;
            return;
        };
        match &mut self.known {
            Some(FilterState { smoothed, held })
                if smoothed.value().abs_diff(now.0) <= MAX_TEMPERATURE_JITTER =>
            {
                smoothed.step(now.0, SmoothingFactor::TIME_CONSTANT_1_S);
                let (value, within) = (smoothed.value(), dead_band.0);
                let [least, most] = [value.saturating_sub(within), value.saturating_add(within)];
                held.0 = held.0.max(least).min(most);
            }
            known => *known = Some(FilterState { smoothed: Lag::settled_at(now.0), held: now }),
        }
    }

    /// Returns the temperature; `None` before the first reading and while the thermometer is lost.
    #[must_use]
    pub fn temperature(&self) -> Option<Temperature> {
        self.known.map(|state| state.held)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;
    use std::vec::Vec;

    /// 1/32 K, as of a MAX31865.
    const STEP: Temperature = Temperature(Temperature::PER_KELVIN / 32);
    const DEAD_BAND: Temperature = Temperature(STEP.0 / 4);

    fn followed(readings: impl Iterator<Item = i32>) -> Vec<i32> {
        let mut steady = DeadBandFilter::default();
        let mut follow = |reading| {
            steady.update(Some(Temperature(reading)), DEAD_BAND);
            steady.temperature().unwrap().0
        };
        readings.map(&mut follow).collect()
    }

    #[test]
    fn a_reading_at_the_edge_of_a_step_comes_to_rest_between_the_two() {
        // Now one, now the other, in no order: bits of a shift register of 16.
        let mut register = 0xACE1_u32;
        let readings = (0..6_000).map(|_| {
            let bit = (register ^ register >> 2 ^ register >> 3 ^ register >> 5) & 1;
            register = register >> 1 | bit << 15;
            (register & 1).cast_signed() * STEP.0
        });
        let all = followed(readings);
        let settled = &all[500..];
        let (least, most) = (settled.iter().min().unwrap(), settled.iter().max().unwrap());
        assert!(most - least < STEP.0 / 3, "{least} to {most} of {}", STEP.0);
        let turns = settled.windows(2).filter(|pair| pair[0] != pair[1]).count();
        assert!(turns < settled.len() / 50, "{turns} changes in {} readings", settled.len());
        assert!((STEP.0 / 4..=3 * STEP.0 / 4).contains(settled.last().unwrap()));
    }

    #[test]
    fn what_stays_is_followed_to_a_quarter_of_a_step() {
        // A step up and down again: e⁻¹⁰ of it is left after ten seconds.
        let all = followed((0..400).map(|n| if n < 200 { STEP.0 } else { 0 }));
        let near = |value: i32, requested: i32| {
            value.abs_diff(requested) <= 1 + STEP.0.unsigned_abs() / 10_000
        };
        assert!(near(all[399], STEP.0 / 4), "{}", all[399]);
        // 1 K/min: a second of it, and a quarter of a step.
        let per_reading = Temperature::PER_KELVIN / 600;
        let rising = followed((0..3_000).map(|n| n * per_reading));
        let behind = 2_999 * per_reading - rising[2_999];
        assert!((behind - 10 * per_reading - STEP.0 / 4).abs() <= per_reading, "{behind}");
    }

    #[test]
    fn what_is_far_off_is_followed_at_once_and_what_is_lost_begins_anew() {
        let mut steady = DeadBandFilter::default();
        let warm = Temperature(20 * Temperature::PER_KELVIN);
        steady.update(Some(Temperature(-100 * Temperature::PER_KELVIN)), DEAD_BAND);
        steady.update(Some(warm), DEAD_BAND);
        assert_eq!(steady.temperature(), Some(warm));
        steady.update(None, DEAD_BAND);
        assert_eq!(steady.temperature(), None);
        let near = Temperature(warm.0 + STEP.0);
        steady.update(Some(near), DEAD_BAND);
        assert_eq!(steady.temperature(), Some(near));
    }
}
