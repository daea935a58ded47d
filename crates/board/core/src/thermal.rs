//! A law over temperature: growth that does not depend on the position, and growth that does.
//!
//! ΔK(T) = K₀(T) + tanβ(T)·(P − P₀). K₀ and tanβ are straight lines in pieces:
//!
//! K₀ = constant + (T − start)·constant_slope, tanβ = gradient + (T − start)·gradient_slope,
//!
//! of the last piece that starts at or below T; below all, of the first. A positive ΔK is actual
//! minus commanded: the axis has gone too far, and the offset is its opposite. Of the three kinds,
//! "constant" has no gradient, "position" no constant, "both" has both; a spindle whose growth is
//! k·(T − T_ref) uses K₀ alone. A last piece without slopes holds the end of a table.
//!
//! Slopes are Q4 per 2²² temperature units (1.024 K): K₀ up to 512 µm/K, tanβ up to 190 µm/m per K.
//! Pieces are read where they lie, 20 bytes each, little-endian. Measured worst error against
//! `f64`: 0.5 units of K₀ (0.002 nm) and 0.5 of the gradient (0.011 nm on 15 m); with the rounding
//! of the slope too, 14.21 µm/m per K over 40 K and 15 m is within 0.03 nm.

use crate::{
    fixed_point::{rounding_shift_right, saturate_to_i32},
    gradient::Gradient,
    units::{FineNanometres, Temperature},
};

/// Bytes of a piece.
pub const THERMAL_LAW_SEGMENT_SIZE: usize = 20;
/// Binary places of the temperature unit in which slopes are given: 2²² units are 1.024 K.
pub const SLOPE_UNIT_BITS: u32 = 22;
/// Binary places of a slope.
pub const SLOPE_FRACTION_BITS: u32 = 4;

/// Two straight lines over temperature, from `start` to the next piece's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ThermalLawSegment {
    /// Where the piece begins and the two values below hold.
    pub start: Temperature,
    /// K₀ at `start`.
    pub constant: FineNanometres,
    /// Growth of K₀: 1/16 [`FineNanometres`] units per 1.024 K.
    pub constant_slope: i32,
    /// tanβ at `start`.
    pub gradient: Gradient,
    /// Growth of tanβ: 1/16 [`Gradient`] units per 1.024 K.
    pub gradient_slope: i32,
}

impl ThermalLawSegment {
    /// As it lies in a calibration.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; THERMAL_LAW_SEGMENT_SIZE] {
        let words = [
            self.start.0,
            self.constant.0,
            self.constant_slope,
            self.gradient.0,
            self.gradient_slope,
        ];
        let mut bytes = [0; THERMAL_LAW_SEGMENT_SIZE];
        for (four, word) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(words) {
            *four = word.to_le_bytes();
        }
        bytes
    }

    /// Out of a calibration; any bytes are a piece.
    #[must_use]
    pub fn from_bytes(bytes: &[u8; THERMAL_LAW_SEGMENT_SIZE]) -> Self {
        Self {
            start: Temperature(read_word(bytes, 0)),
            constant: FineNanometres(read_word(bytes, 1)),
            constant_slope: read_word(bytes, 2),
            gradient: Gradient(read_word(bytes, 3)),
            gradient_slope: read_word(bytes, 4),
        }
    }

    fn evaluate(&self, t: Temperature) -> (FineNanometres, Gradient) {
        let warmer = i64::from(t.0).wrapping_sub(i64::from(self.start.0));
        let constant = evaluate_line(self.constant.0, self.constant_slope, warmer);
        let gradient = evaluate_line(self.gradient.0, self.gradient_slope, warmer);
        (FineNanometres(constant), Gradient(gradient))
    }
}

/// Returns the number `index` (0…4) of a piece.
fn read_word(bytes: &[u8; THERMAL_LAW_SEGMENT_SIZE], index: usize) -> i32 {
    bytes.as_chunks::<4>().0.get(index).map_or(0, |four| i32::from_le_bytes(*four))
}

/// value + slope·warmer, saturating.
fn evaluate_line(value: i32, slope: i32, warmer: i64) -> i32 {
    const SLOPE_SHIFT: u32 = SLOPE_UNIT_BITS + SLOPE_FRACTION_BITS;
    // 33 bits by 32 and a half: below 2⁶³, so neither step can wrap.
    let growth = rounding_shift_right(warmer.wrapping_mul(i64::from(slope)), SLOPE_SHIFT);
    saturate_to_i32(growth.saturating_add(i64::from(value)))
}

/// A law in pieces, in ascending order of their starts. Without a piece it is zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ThermalExpansionLaw<'a> {
    /// The pieces as they lie in the calibration.
    pub pieces: &'a [[u8; THERMAL_LAW_SEGMENT_SIZE]],
}

impl ThermalExpansionLaw<'_> {
    /// Returns whether tanβ is anything but 0 at some temperature.
    #[must_use]
    pub fn depends_on_position(&self) -> bool {
        self.pieces
            .iter()
            .map(ThermalLawSegment::from_bytes)
            .any(|piece| piece.gradient != Gradient::ZERO || piece.gradient_slope != 0)
    }

    /// K₀ and tanβ at a temperature; each saturates.
    ///
    /// The paper's axis, tanβ = (T − 23 °C)·14.21 µm/m, at 42 °C and P = 1 m:
    ///
    /// ```
    /// use trueup_core::{
    ///     gradient::Gradient,
    ///     thermal::{ThermalExpansionLaw, ThermalLawSegment},
    ///     units::{FineNanometres, Position, Temperature},
    /// };
    /// let celsius = |t: i32| Temperature(t * Temperature::PER_KELVIN);
    /// // 14.21 µm/m = 1.421e-4 nm per position unit; times 2³⁶·1.024·16: 159 990 376.
    /// let slope = (1.421e-4 * f64::from(1 << 18).powi(2) * 1.024 * 16.0) as i32;
    /// let pieces = [ThermalLawSegment { start: celsius(23), gradient_slope: slope, ..ThermalLawSegment::default() }
    ///     .to_bytes()];
    /// let law = ThermalExpansionLaw { pieces: &pieces };
    ///
    /// let (constant, gradient) = law.evaluate(celsius(42));
    /// assert_eq!(constant, FineNanometres(0));
    /// // 19 K · 14.21 µm/m · 1 m = 269.99 µm too far; the offset is −269.99 µm.
    /// let metre = Position(1_000 * Position::PER_MILLIMETRE);
    /// let error = constant.saturating_add(gradient.error_over_travel(Position(0), metre)).rounded();
    /// assert_eq!(error.0, 269_990);
    /// assert_eq!(error.saturating_neg().0, -269_990);
    /// ```
    #[must_use]
    pub fn evaluate(&self, t: Temperature) -> (FineNanometres, Gradient) {
        let after = self.pieces.partition_point(|piece| read_word(piece, 0) <= t.0);
        match self.pieces.get(after.saturating_sub(1)) {
            Some(piece) => ThermalLawSegment::from_bytes(piece).evaluate(t),
            None => (FineNanometres::ZERO, Gradient::ZERO),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Nanometres;
    extern crate std;
    use crate::units::Position;

    const PER_KELVIN: f64 = Temperature::PER_KELVIN as f64;
    /// Gradient units of 1 µm/m: 10⁻⁵ nm per position unit.
    const PER_UM_PER_M: f64 = 68_719_476_736.0 * 1e-5;

    fn celsius(t: f64) -> Temperature {
        Temperature((t * PER_KELVIN).round() as i32)
    }

    fn gradient_slope(um_per_m_per_c: f64) -> i32 {
        (um_per_m_per_c * PER_UM_PER_M * 1.024 * 16.0).round() as i32
    }

    fn constant_slope(um_per_c: f64) -> i32 {
        (um_per_c * 1e3 * 256.0 * 1.024 * 16.0).round() as i32
    }

    fn metres(m: f64) -> Position {
        Position((m * 1e8).round() as i32)
    }

    #[test]
    fn the_papers_axis_at_42_degrees_goes_270_micrometres_too_far_in_a_metre() {
        let start = celsius(23.0);
        let piece = ThermalLawSegment {
            start,
            gradient_slope: gradient_slope(14.21),
            ..ThermalLawSegment::default()
        };
        let pieces = [piece.to_bytes()];
        let law = ThermalExpansionLaw { pieces: &pieces };
        let error = |t, from, to| {
            let (constant, gradient) = law.evaluate(celsius(t));
            constant
                .saturating_add(gradient.error_over_travel(metres(from), metres(to)))
                .rounded()
                .0
        };
        assert_eq!(error(42.0, 0.0, 1.0), 269_990);
        assert_eq!(error(23.0, 0.0, 1.0), 0);
        // Colder than the reference the axis falls short; one piece reaches below its start.
        assert_eq!(error(22.0, 0.0, 1.0), -14_210);
        // On the other side of the reference position the error is the other way.
        assert_eq!(error(42.0, 1.0, 0.5), -134_995);
    }

    #[test]
    fn forty_kelvin_over_fifteen_metres_is_within_a_tenth_of_a_nanometre() {
        for slope in [10.0, 11.7, 14.21, 33.3, 74.9] {
            let piece = ThermalLawSegment {
                gradient_slope: gradient_slope(slope),
                ..ThermalLawSegment::default()
            };
            let pieces = [piece.to_bytes()];
            let mut worst = 0.0_f64;
            for step in -400..=400 {
                let t = celsius(f64::from(step) / 10.0);
                let gradient = ThermalExpansionLaw { pieces: &pieces }.evaluate(t).1;
                let exact = slope * f64::from(t.0) / PER_KELVIN;
                // µm/m over 15 m, in nanometres.
                let off = (f64::from(gradient.0) / PER_UM_PER_M - exact) * 15.0 * 1e3;
                worst = worst.max(off.abs());
            }
            std::println!("{slope} µm/m per K over ±40 K and 15 m: {worst:.4} nm");
            assert!(worst < 0.1);
        }
    }

    #[test]
    fn a_spindle_that_grows_with_its_temperature_uses_k0_alone() {
        // 2 µm/K from 20 °C.
        let start = celsius(20.0);
        let piece = ThermalLawSegment {
            start,
            constant_slope: constant_slope(2.0),
            ..ThermalLawSegment::default()
        };
        let pieces = [piece.to_bytes()];
        let mut worst = 0.0_f64;
        for step in -600..=4000 {
            let t = celsius(f64::from(step) / 10.0);
            let (growth, gradient) = ThermalExpansionLaw { pieces: &pieces }.evaluate(t);
            assert_eq!(gradient, Gradient::ZERO);
            let exact = 2_000.0 * (f64::from(t.0) / PER_KELVIN - 20.0);
            worst = worst.max((f64::from(growth.0) / 256.0 - exact).abs());
        }
        std::println!("2 µm/K from -60 to 400 °C: {worst:.4} nm");
        assert!(worst < 0.1);
        let growth = ThermalExpansionLaw { pieces: &pieces }.evaluate(celsius(30.5)).0;
        assert_eq!(growth.rounded(), Nanometres(21_000));
    }

    /// Returns a table over 10…40 °C that holds its ends.
    fn table() -> [[u8; THERMAL_LAW_SEGMENT_SIZE]; 4] {
        let um = |um: f64| FineNanometres((um * 256e3).round() as i32);
        let per_m = |um: f64| Gradient((um * PER_UM_PER_M).round() as i32);
        let piece = |start, k0, k0_slope, gradient, slope| ThermalLawSegment {
            start: celsius(start),
            constant: um(k0),
            constant_slope: constant_slope(k0_slope),
            gradient: per_m(gradient),
            gradient_slope: gradient_slope(slope),
        };
        [
            piece(-273.0, -3.0, 0.0, -50.0, 0.0).to_bytes(),
            piece(10.0, -3.0, 0.3, -50.0, 5.0).to_bytes(),
            piece(20.0, 0.0, -0.1, 0.0, 12.0).to_bytes(),
            piece(40.0, -2.0, 0.0, 240.0, 0.0).to_bytes(),
        ]
    }

    #[test]
    fn a_table_is_linear_between_its_points_and_holds_its_ends() {
        let pieces = table();
        let law = ThermalExpansionLaw { pieces: &pieces };
        let (mut worst_constant, mut worst_gradient) = (0.0_f64, 0.0_f64);
        for step in -5200..=5200 {
            let t = celsius(f64::from(step) / 10.0);
            let c = f64::from(t.0) / PER_KELVIN;
            let (k0, gradient) = if c < 10.0 {
                (-3.0, -50.0)
            } else if c < 20.0 {
                (-3.0 + (c - 10.0) * 0.3, -50.0 + (c - 10.0) * 5.0)
            } else if c < 40.0 {
                ((20.0 - c) * 0.1, (c - 20.0) * 12.0)
            } else {
                (-2.0, 240.0)
            };
            let at = law.evaluate(t);
            worst_constant = worst_constant.max((f64::from(at.0.0) / 256.0 - k0 * 1e3).abs());
            let off = f64::from(at.1.0) / PER_UM_PER_M - gradient;
            worst_gradient = worst_gradient.max(off.abs() * 15e3);
        }
        std::println!("table: K0 {worst_constant:.4} nm, gradient {worst_gradient:.4} nm on 15 m");
        assert!(worst_constant < 0.01 && worst_gradient < 0.03);
    }

    #[test]
    fn with_the_slope_as_given_a_line_is_right_to_half_a_unit() {
        let mut worst = 0.0_f64;
        for slope in [-1_738_734_477, -77_777, -1, 0, 1, 163_001, 1_000_000_007] {
            for start in [i32::MIN, -7, 0, 94_208_000, i32::MAX] {
                for t in (i32::MIN..=i32::MAX).step_by(7_654_321) {
                    let piece = ThermalLawSegment {
                        start: Temperature(start),
                        constant_slope: slope,
                        ..ThermalLawSegment::default()
                    };
                    let got = ThermalExpansionLaw { pieces: &[piece.to_bytes()] }
                        .evaluate(Temperature(t))
                        .0;
                    let exact = i128::from(slope) * (i128::from(t) - i128::from(start));
                    let held = exact.clamp(i128::from(i32::MIN) << 26, i128::from(i32::MAX) << 26);
                    let off = held - (i128::from(got.0) << 26);
                    worst = worst.max(off.unsigned_abs() as f64 / f64::from(1 << 26));
                }
            }
        }
        std::println!("a line with its slope as given: {worst:.4} units");
        assert!(worst <= 0.5);
    }

    #[test]
    fn the_slopes_reach_and_the_extremes_saturate() {
        assert!(gradient_slope(190.0) < i32::MAX && gradient_slope(-190.0) > i32::MIN);
        assert!(constant_slope(510.0) < i32::MAX);
        let ends = [i32::MIN, -1, 0, 1, i32::MAX];
        for value in ends {
            for slope in ends {
                for start in ends {
                    for t in ends {
                        let piece = ThermalLawSegment {
                            start: Temperature(start),
                            constant: FineNanometres(value),
                            constant_slope: slope,
                            gradient: Gradient(value),
                            gradient_slope: slope,
                        };
                        let at = ThermalExpansionLaw { pieces: &[piece.to_bytes()] }
                            .evaluate(Temperature(t));
                        let warmer = i128::from(t) - i128::from(start);
                        let growth = (warmer * i128::from(slope) + (1 << 25)) >> 26;
                        let exact = (i128::from(value) + growth)
                            .clamp(i128::from(i32::MIN), i128::from(i32::MAX));
                        assert_eq!(at, (FineNanometres(exact as i32), Gradient(exact as i32)));
                    }
                }
            }
        }
    }

    #[test]
    fn no_piece_is_no_growth_and_any_bytes_are_a_law() {
        assert_eq!(
            ThermalExpansionLaw::default().evaluate(Temperature(i32::MAX)),
            (FineNanometres::ZERO, Gradient::ZERO)
        );
        // Pieces out of order give a wrong law, but a law.
        let mut pieces = table();
        pieces.reverse();
        for t in [i32::MIN, 0, i32::MAX] {
            let _ = ThermalExpansionLaw { pieces: &pieces }.evaluate(Temperature(t));
            let _ = ThermalExpansionLaw {
                pieces: &[[0xff; THERMAL_LAW_SEGMENT_SIZE], [0x80; THERMAL_LAW_SEGMENT_SIZE]],
            }
            .evaluate(Temperature(t));
        }
    }

    #[test]
    fn bytes_are_little_endian_and_come_back() {
        let piece = ThermalLawSegment {
            start: Temperature(0x0403_0201),
            constant: FineNanometres(-2),
            constant_slope: i32::MIN,
            gradient: Gradient(0x0807_0605),
            gradient_slope: i32::MAX,
        };
        let bytes = piece.to_bytes();
        assert_eq!(
            bytes,
            [1, 2, 3, 4, 254, 255, 255, 255, 0, 0, 0, 128, 5, 6, 7, 8, 255, 255, 255, 127]
        );
        assert_eq!(ThermalLawSegment::from_bytes(&bytes), piece);
    }

    #[test]
    fn a_law_depends_on_the_position_where_a_gradient_or_its_slope_is_not_0() {
        for (gradient, gradient_slope, depends) in [(0, 0, false), (1, 0, true), (0, -1, true)] {
            let piece = ThermalLawSegment {
                start: Temperature(0),
                constant: FineNanometres(5),
                constant_slope: 5,
                gradient: Gradient(gradient),
                gradient_slope,
            };
            let pieces =
                [ThermalLawSegment { gradient: Gradient(0), gradient_slope: 0, ..piece }, piece];
            let pieces = pieces.map(|piece| piece.to_bytes());
            assert_eq!(ThermalExpansionLaw { pieces: &pieces }.depends_on_position(), depends);
        }
    }
}
