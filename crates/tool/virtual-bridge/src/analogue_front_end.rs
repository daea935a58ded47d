//! From the sensor's volts to the ADC's codes, as the board's analogue front end does it: a
//! divider, two poles at 2 kHz, noise, 12 bits.
//!
//! The noise is always there, 1 LSB RMS from a seed: without it a code would be a stair, and no
//! average could see between two of its steps.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use trueup_core::units::AdcCode;

/// Conversions a second.
pub const SAMPLE_RATE_HZ: f64 = 20_000.0;
/// Both poles of the low-pass before the ADC.
pub(crate) const LOW_PASS_POLE_HZ: f64 = 2_000.0;
/// The ADC's full scale.
pub const ADC_REFERENCE_VOLTS: f64 = 3.3;
/// RMS of the noise, in codes.
pub const NOISE_CODES_RMS: f64 = 1.0;
/// The signal is followed in steps of 1/320 kHz, so that a carrier at 40 kHz is one.
pub(crate) const STEPS_PER_SAMPLE: u32 = 16;

/// The analogue front end of one board.
#[derive(Clone, Debug)]
pub struct AnalogueFrontEnd {
    divider: f64,
    low_pass: Option<LowPass>,
    random: ChaCha8Rng,
    samples: u64,
}

/// Two first-order poles in a row, in volts; empty before the first voltage.
#[derive(Clone, Debug, Default)]
struct LowPass(Option<[f64; 2]>);

impl LowPass {
    /// Returns the voltage after the low-pass at the end of a step in which the input was `volts`. It
    /// starts settled.
    fn step(&mut self, volts: f64, share: f64) -> f64 {
        let [first, second] = self.0.get_or_insert([volts; 2]);
        *first += (volts - *first) * share;
        *second += (*first - *second) * share;
        *second
    }
}

impl AnalogueFrontEnd {
    /// Returns a front end that takes the sensor's volts times `divider` to the ADC.
    #[must_use]
    pub fn new(divider: f64, seed: u64) -> Self {
        Self {
            divider,
            low_pass: Some(LowPass::default()),
            random: ChaCha8Rng::seed_from_u64(seed),
            samples: 0,
        }
    }

    /// Returns the same without its analogue low-pass: to show what that is for.
    #[must_use]
    pub fn without_low_pass(mut self) -> Self {
        self.low_pass = None;
        self
    }

    /// Returns the time of the next conversion in seconds from the start.
    #[must_use]
    #[allow(clippy::cast_precision_loss, reason = "14 000 years of samples fit")]
    pub fn time_s(&self) -> f64 {
        self.samples as f64 / SAMPLE_RATE_HZ
    }

    /// Returns the next conversion. `volts_at` is the sensor's voltage at a time in seconds from the start.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the 12 bits of the converter"
    )]
    pub(crate) fn convert(&mut self, volts_at: impl Fn(f64) -> f64) -> AdcCode {
        let now = self.time_s();
        let pin = match &mut self.low_pass {
            None => volts_at(now),
            Some(low_pass) => {
                let step_s = 1.0 / SAMPLE_RATE_HZ / f64::from(STEPS_PER_SAMPLE);
                let share = 1.0 - (-std::f64::consts::TAU * LOW_PASS_POLE_HZ * step_s).exp();
                (0..STEPS_PER_SAMPLE).rev().fold(0.0, |_, steps_left| {
                    low_pass.step(volts_at(now - f64::from(steps_left) * step_s), share)
                })
            }
        };
        self.samples += 1;
        let noise: f64 = StandardNormal.sample(&mut self.random);
        let code = pin * self.divider / ADC_REFERENCE_VOLTS * f64::from(AdcCode::FULL_SCALE)
            + noise * NOISE_CODES_RMS;
        AdcCode(code.round().clamp(0.0, f64::from(AdcCode::MAX.0)) as u16)
    }

    /// Returns a millisecond of conversions.
    pub fn convert_block(&mut self, volts_at: impl Fn(f64) -> f64) -> [AdcCode; 20] {
        std::array::from_fn(|_| self.convert(&volts_at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean(codes: impl Iterator<Item = AdcCode>) -> f64 {
        let codes: Vec<f64> = codes.map(|code| f64::from(code.0)).collect();
        codes.iter().sum::<f64>() / codes.len() as f64
    }

    #[test]
    fn ten_volts_through_the_divider_are_the_full_scale() {
        let mut front_end = AnalogueFrontEnd::new(0.33, 1);
        // 5 V are half of 4096 codes.
        let level = mean((0..20_000).map(|_| front_end.convert(|_| 5.0)));
        assert!((level - 2048.0).abs() < 0.05, "{level}");
    }

    #[test]
    fn the_noise_is_one_code_rms_and_comes_from_the_seed() {
        let run = |seed| -> Vec<AdcCode> {
            let mut front_end = AnalogueFrontEnd::new(0.33, seed);
            (0..50_000).map(|_| front_end.convert(|_| 5.0)).collect()
        };
        let codes = run(7);
        let level = mean(codes.iter().copied());
        let variance = mean(codes.iter().copied())
            .mul_add(-level, codes.iter().map(|c| f64::from(c.0).powi(2)).sum::<f64>() / 50_000.0);
        // White noise of one code, and the 1/12 of rounding.
        assert!((variance - (1.0 + 1.0 / 12.0)).abs() < 0.03, "{variance}");
        assert_eq!(codes, run(7));
        assert_ne!(codes, run(8));
    }

    #[test]
    fn the_low_pass_takes_a_20_khz_carrier_down_by_40_db() {
        let carrier = |t: f64| 5.0 + 1.0 * (std::f64::consts::TAU * 20_000.0 * t).cos();
        let shift = |mut front_end: AnalogueFrontEnd| {
            (0..2_000).for_each(|_| {
                front_end.convert(carrier);
            });
            mean((0..50_000).map(|_| front_end.convert(carrier))) - 2048.0
        };
        let open = shift(AnalogueFrontEnd::new(0.33, 1).without_low_pass());
        let filtered = shift(AnalogueFrontEnd::new(0.33, 1));
        assert!((open - 409.6).abs() < 0.1, "sampled at its crest it reads as 1 V: {open}");
        // |H| = 1/(1 + (20/2)²) = 1/101.
        assert!(filtered.abs() < 409.6 / 95.0, "{filtered}");
    }
}
