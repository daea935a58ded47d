//! The sensor's volts, sampled once a servo period, as the codes of the board's converter.
//!
//! A tick of the node takes 20 codes. Their sum is round(20 · volts · codes per volt), and they rise by one code at most
//! within a sample: so a value lies between two codes by a twentieth, and the smallest steps look like one slow step a
//! block and not like noise. A sample that does not differ from the one before by half a step of its source is a
//! repeated one: its codes are all equal, at the nearest code. A stuck source then looks to the node's checks as a stuck
//! converter does, and a quiet source at rest as a quiet sensor.
//!
//! | volts | codes |
//! |---|---|
//! | not a number | none: samples are missing |
//! | beyond the converter's range | its ends, which are rails |
//!
//! A signal that turns with the spindle faster than half the rate of samples looks like a slow one: a spindle speed
//! close to a whole number of servo periods a revolution needs a low-pass filter before the input.

use trueup_core::{design_parameters::CODES_PER_TICK, units::AdcCode};

/// The largest code of the converter.
const MAX_ADC_CODE: f64 = 4_095.0;

/// The input of the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SensorScale {
    /// Codes of the board's converter for a volt of the sensor: divider / 3.3 V · 4096.
    pub codes_per_v: f64,
    /// Smallest step of the source, in volts.
    pub resolution_v: f64,
}

/// Samples of a tick: one, or two where a servo period is half a tick.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TickSamples {
    volts: Option<f64>,
    codes: [AdcCode; CODES_PER_TICK],
    is_known: bool,
}

impl TickSamples {
    /// Takes a sample, for the `part` of `parts` of the coming tick.
    pub(crate) fn add_sample(
        &mut self,
        volts: f64,
        scale: &SensorScale,
        part: usize,
        parts: usize,
    ) {
        if part == 0 {
            self.is_known = true;
        }
        if !volts.is_finite() {
            self.is_known = false;
            self.volts = None;
            return;
        }
        let is_repeated = self.volts.is_some_and(|before| {
            (volts - before).abs() < 0.5 * scale.resolution_v || volts == before
        });
        self.volts = Some(volts);
        let codes = (volts * scale.codes_per_v).clamp(0.0, MAX_ADC_CODE);
        let length = CODES_PER_TICK / parts.max(1);
        let places = self.codes.iter_mut().skip(part.saturating_mul(length)).take(length);
        if is_repeated {
            let nearest = clamp_code((codes + 0.5) as u16);
            places.for_each(|place| *place = nearest);
            return;
        }
        let whole = codes as u16;
        let share = length as f64;
        // This number of the part's codes is one above.
        let above = ((codes - f64::from(whole)) * share + 0.5) as usize;
        let below = length.saturating_sub(above);
        for (place, code_at) in places.enumerate() {
            *code_at = clamp_code(if place < below { whole } else { whole.saturating_add(1) });
        }
    }

    /// Returns the codes of the tick; `None`: a sample is missing.
    #[must_use]
    pub fn codes(&self) -> Option<&[AdcCode; CODES_PER_TICK]> {
        self.is_known.then_some(&self.codes)
    }
}

fn clamp_code(number: u16) -> AdcCode {
    AdcCode(number.min(MAX_ADC_CODE as u16))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCALE: SensorScale = SensorScale { codes_per_v: 407.0, resolution_v: 0.0003 };

    fn sum(samples: &TickSamples) -> u32 {
        samples.codes().expect("known").iter().map(|code| u32::from(code.0)).sum()
    }

    #[test]
    fn the_mean_of_a_tick_is_the_sample_to_a_twentieth_of_a_code_and_rises_once() {
        let mut samples = TickSamples::default();
        for step in 0..20_000 {
            let volts = f64::from(step) * 0.0005;
            samples.add_sample(volts, &SCALE, 0, 1);
            let mean = f64::from(sum(&samples)) / CODES_PER_TICK as f64;
            let exact = (volts * SCALE.codes_per_v).min(MAX_ADC_CODE);
            assert!((mean - exact).abs() <= 0.0251, "{volts} V: {mean}, not {exact}");
            let codes = samples.codes().expect("known");
            let steps = codes.windows(2).filter(|two| two[0] != two[1]);
            assert!(steps.clone().count() <= 1);
            assert!(codes.windows(2).all(|two| two[1].0 == two[0].0 || two[1].0 == two[0].0 + 1));
        }
    }

    #[test]
    fn a_repeated_sample_is_one_code_and_a_new_one_is_not() {
        let mut samples = TickSamples::default();
        let equal = |samples: &TickSamples| {
            let codes = samples.codes().expect("known");
            codes.iter().all(|code| *code == codes[0])
        };
        samples.add_sample(1.0013, &SCALE, 0, 1);
        assert!(!equal(&samples));
        for volts in [1.0013, 1.001_4, 1.001_3] {
            samples.add_sample(volts, &SCALE, 0, 1);
            assert!(equal(&samples), "{volts} is within half a step");
            assert_eq!(sum(&samples), 20 * 408, "407.5 is nearest to 408 or 407");
        }
        samples.add_sample(1.001_7, &SCALE, 0, 1);
        assert!(!equal(&samples));
    }

    #[test]
    fn two_samples_of_a_tick_are_its_halves_and_a_missing_one_makes_none() {
        let mut samples = TickSamples::default();
        samples.add_sample(1.0, &SCALE, 0, 2);
        samples.add_sample(2.0, &SCALE, 1, 2);
        assert_eq!(sum(&samples), 10 * 407 + 10 * 814);
        samples.add_sample(f64::NAN, &SCALE, 0, 2);
        samples.add_sample(2.0, &SCALE, 1, 2);
        assert_eq!(samples.codes(), None);
        samples.add_sample(1.0, &SCALE, 0, 2);
        samples.add_sample(f64::INFINITY, &SCALE, 1, 2);
        assert_eq!(samples.codes(), None);
    }

    #[test]
    fn beyond_the_converter_are_its_rails() {
        let mut samples = TickSamples::default();
        for (volts, code) in [(-3.0, 0), (11.0, 4_095), (1e300, 4_095)] {
            samples.add_sample(volts, &SCALE, 0, 1);
            assert_eq!(samples.codes().expect("known"), &[AdcCode(code); CODES_PER_TICK]);
        }
    }
}
