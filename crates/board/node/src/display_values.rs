//! The live values as a person reads them in the board's log: `f32`, in µm and codes.
//!
//! Corrections and the values that programs read stay integer; `ARCHITECTURE.md` says why. Here a relative error of
//! 3·10⁻⁶ costs nothing, and `micromath` makes the roots cheap: its own root errs by up to 6 %, two of Heron's steps
//! by 2·10⁻⁶.

use micromath::F32;
use trueup_core::{sensor_health::NoiseStatistics, units::Nanometres};

/// The values of the last second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisplayValues {
    /// The offset of X, Y and Z in µm; `None`: not available.
    pub offset_um: Option<[f32; 3]>,
    /// The length of the offset in µm: on a machine without geometric tables the growth along the tool, however that is
    /// tilted.
    pub length_um: f32,
    /// The elongation by the sensor, in µm; `None`: none, or not fresh.
    pub elongation_um: Option<f32>,
    /// RMS noise of the raw codes, in codes; 0 where there was none to measure.
    pub noise_codes: f32,
}

impl DisplayValues {
    /// Returns the values of an offset, an elongation and a noise, rounded to hundredths (the noise to thousandths).
    #[must_use]
    pub fn new(
        offset: Option<[Nanometres; 3]>,
        elongation: Option<Nanometres>,
        noise: NoiseStatistics,
    ) -> Self {
        let offset_um = offset.map(|all| all.map(to_micrometres));
        let [x, y, z] = offset_um.unwrap_or_default();
        // The second differences of codes have six times their variance.
        let variance = noise.squares as f32 / (6.0 * noise.count.max(1) as f32);
        Self {
            offset_um: offset_um.map(|all| all.map(|um| round_to_fraction(um, 100.0))),
            length_um: round_to_fraction(sqrt(x * x + y * y + z * z), 100.0),
            elongation_um: elongation
                .map(|elongation| round_to_fraction(to_micrometres(elongation), 100.0)),
            noise_codes: round_to_fraction(sqrt(variance), 1_000.0),
        }
    }
}

fn to_micrometres(length: Nanometres) -> f32 {
    length.0 as f32 / 1_000.0
}

/// Rounds to one part in `parts`.
fn round_to_fraction(value: f32, parts: f32) -> f32 {
    F32(value * parts).round().0 / parts
}

/// Returns the square root of a number that is not negative, to 2·10⁻⁶ of itself.
fn sqrt(square: f32) -> f32 {
    if square < f32::MIN_POSITIVE {
        return 0.0;
    }
    // By its path: with `std`, `f32` has methods of the same names.
    let first = F32(square).sqrt().0;
    let second = 0.5 * (first + square / first);
    0.5 * (second + square / second)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_root_is_right_to_two_parts_in_a_million_over_all_magnitudes() {
        let (mut worst, mut plain) = (0.0_f64, 0.0_f64);
        for exponent in -100..100 {
            for step in 0..1_000 {
                let square = 2.0_f32.powi(exponent) * (1.0 + step as f32 / 1_000.0);
                let exact = f64::from(square).sqrt();
                worst = worst.max((f64::from(sqrt(square)) / exact - 1.0).abs());
                plain = plain.max((f64::from(F32(square).sqrt().0) / exact - 1.0).abs());
            }
        }
        std::println!("largest error of the root {worst:.1e}, of micromath's own {plain:.1e}");
        assert!(worst < 2e-6 && plain > 0.05);
        assert_eq!([0.0, 1e-45].map(sqrt), [0.0; 2]);
    }

    #[test]
    fn half_a_millimetre_is_as_long_on_a_tilted_tool() {
        // The paper's 30°: 0.250 and 0.433 mm.
        let offset = Some([Nanometres(0), Nanometres(-250_000), Nanometres(433_013)]);
        let noise = NoiseStatistics { squares: 4 * 6 * 1_000, count: 1_000 };
        let shown = DisplayValues::new(offset, Some(Nanometres(-62_804)), noise);
        assert_eq!(shown.offset_um, Some([0.0, -250.0, 433.01]));
        assert_eq!((shown.length_um, shown.elongation_um), (500.0, Some(-62.8)));
        assert_eq!(shown.noise_codes, 2.0);
    }

    #[test]
    fn extremes_are_finite_and_what_is_missing_is_none() {
        let most = NoiseStatistics { squares: u32::MAX, count: 0 };
        let shown = DisplayValues::new(Some([Nanometres(i32::MIN); 3]), None, most);
        assert!(shown.length_um.is_finite() && shown.noise_codes.is_finite());
        let none = DisplayValues::new(None, None, NoiseStatistics::default());
        assert_eq!((none.offset_um, none.elongation_um), (None, None));
        assert_eq!((none.length_um, none.noise_codes), (0.0, 0.0));
    }
}
