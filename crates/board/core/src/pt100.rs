//! Platinum resistance thermometers of 100 Ω after IEC 60751 (Callendar–Van Dusen).
//!
//! R = 100 Ω·(1 + A·t + B·t²) for t ≥ 0, and below zero + C·(t − 100 °C)·t³ more. Measuring needs
//! the inverse, which has no closed form below zero and a square root above. So it is a table of
//! cubics over pieces of 2²³ µΩ (22 K). Two of them meet at 100 Ω, where the equation changes:
//!
//! t = c₀ + x·(c₁ + x·(c₂ + x·c₃)), x = (R − 100 Ω) mod 2²³ µΩ in Q31.
//!
//! Each cubic goes through the equation at both ends of its piece, so the pieces join, and at a
//! quarter and three quarters. The compiler computes the table from A, B and C; the board does
//! three multiplications (`smmul`) and no division.
//!
//! Range −60…+400 °C. Measured worst error over it: 0.0036 mK from resistance to temperature,
//! 0.63 µΩ (0.0018 mK) from temperature to resistance.

use crate::{
    fixed_point::{mul_high, rounding_shift_right_i32},
    units::{MicroOhms, Temperature},
};

/// Why a resistance is not a temperature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResistanceFault {
    /// Above [`OPEN_THRESHOLD`]: a wire is broken, or far too hot.
    Open,
    /// Below [`SHORT_THRESHOLD`]: a short circuit, or far too cold.
    Short,
}

/// The resistance at 0 °C.
pub const R0: MicroOhms = MicroOhms(100_000_000);
/// Below this a thermometer counts as shorted: 74 Ω are −65.8 °C, a margin of 5.8 K.
pub const SHORT_THRESHOLD: MicroOhms = MicroOhms(74_000_000);
/// Above this a thermometer counts as open: 249 Ω are +405.3 °C, a margin of 5.3 K.
pub const OPEN_THRESHOLD: MicroOhms = MicroOhms(249_000_000);

/// A, per kelvin.
const A: f64 = 3.9083e-3;
/// B, per kelvin².
const B: f64 = -5.775e-7;
/// C, per kelvin⁴; only below 0 °C.
const C: f64 = -4.183e-12;

/// Binary places of a piece's width in micro-ohms.
const PIECE_WIDTH_BITS: u32 = 23;
/// Pieces below 100 Ω.
const PIECES_BELOW_R0: i32 = 4;
/// Pieces from 66.4 Ω to 251 Ω: 352 bytes of table.
const PIECE_COUNT: usize = 22;

/// c₀, 2·c₁, 4·c₂ and 8·c₃ in temperature units: x in Q31 and a product shifted by 32 halve.
type CubicCoefficients = [i32; 4];

static CUBICS: [CubicCoefficients; PIECE_COUNT] = build_cubics();

/// Returns the temperature in °C at which the equation gives `ratio`·100 Ω, by Newton's method.
const fn solve_temperature(ratio: f64) -> f64 {
    let mut t = (ratio - 1.0) / A;
    let mut steps = 0_u32;
    while steps < 12 {
        let mut value = 1.0 + t * (A + t * B);
        let mut slope = A + 2.0 * B * t;
        if ratio < 1.0 {
            value += C * (t - 100.0) * t * t * t;
            slope += C * (4.0 * t - 300.0) * t * t;
        }
        t -= (value - ratio) / slope;
        steps = steps.saturating_add(1);
    }
    t
}

/// Returns the nearest integer; for the tables that the compiler makes.
#[allow(clippy::cast_possible_truncation, reason = "saturates, and a test checks the result")]
const fn round_to_nearest(value: f64) -> i32 {
    if value < 0.0 { (value - 0.5) as i32 } else { (value + 0.5) as i32 }
}

/// Returns the cubic through the equation at 0, ¼, ¾ and 1 of the piece that begins at `start` µΩ.
const fn interpolate_cubic(start: f64) -> CubicCoefficients {
    const UNITS_PER_KELVIN: f64 = Temperature::PER_KELVIN as f64;
    const PIECE_WIDTH_MICRO_OHMS: f64 = (1 << PIECE_WIDTH_BITS) as f64;
    const R0_MICRO_OHMS: f64 = R0.0 as f64;
    let y0 = solve_temperature(start / R0_MICRO_OHMS) * UNITS_PER_KELVIN;
    let y1 = solve_temperature((start + 0.25 * PIECE_WIDTH_MICRO_OHMS) / R0_MICRO_OHMS)
        * UNITS_PER_KELVIN;
    let y2 = solve_temperature((start + 0.75 * PIECE_WIDTH_MICRO_OHMS) / R0_MICRO_OHMS)
        * UNITS_PER_KELVIN;
    let y3 = solve_temperature((start + PIECE_WIDTH_MICRO_OHMS) / R0_MICRO_OHMS) * UNITS_PER_KELVIN;
    // Newton's divided differences on 0, ¼, ¾, 1 …
    let (d01, d12, d23) = ((y1 - y0) / 0.25, (y2 - y1) / 0.5, (y3 - y2) / 0.25);
    let (d012, d123) = ((d12 - d01) / 0.75, (d23 - d12) / 0.75);
    let d = d123 - d012;
    // … multiplied out: y0 + d01·x + d012·x(x − ¼) + d·x(x − ¼)(x − ¾).
    let c1 = d01 - 0.25 * d012 + 0.1875 * d;
    let c2 = d012 - d;
    [
        round_to_nearest(y0),
        round_to_nearest(2.0 * c1),
        round_to_nearest(4.0 * c2),
        round_to_nearest(8.0 * d),
    ]
}

#[allow(
    clippy::arithmetic_side_effects,
    reason = "run by the compiler, which refuses to build what overflows"
)]
const fn build_cubics() -> [CubicCoefficients; PIECE_COUNT] {
    let mut table = [[0; 4]; PIECE_COUNT];
    let mut start = R0.0 - (PIECES_BELOW_R0 << PIECE_WIDTH_BITS);
    let mut piece = 0;
    while piece < PIECE_COUNT {
        table[piece] = interpolate_cubic(start as f64);
        start += 1 << PIECE_WIDTH_BITS;
        piece += 1;
    }
    table
}

/// Returns the temperature of a thermometer of this resistance.
///
/// ```
/// use trueup_core::{pt100::{ResistanceFault, temperature_from_resistance}, units::{MicroOhms, Temperature}};
/// assert_eq!(temperature_from_resistance(MicroOhms(100_000_000)), Ok(Temperature(0)));
/// // 100 Ω·(1 + 3.9083e-3·100 − 5.775e-7·100²) = 138.5055 Ω at 100 °C, right to 0.01 mK.
/// let boiling = temperature_from_resistance(MicroOhms(138_505_500)).unwrap();
/// assert!((boiling.0 - 100 * Temperature::PER_KELVIN).abs() < Temperature::PER_MILLIKELVIN / 100);
/// assert_eq!(temperature_from_resistance(MicroOhms(i32::MAX)), Err(ResistanceFault::Open));
/// assert_eq!(temperature_from_resistance(MicroOhms(0)), Err(ResistanceFault::Short));
/// ```
///
/// # Errors
/// [`ResistanceFault`] when the resistance is not one of a thermometer in its range.
pub fn temperature_from_resistance(r: MicroOhms) -> Result<Temperature, ResistanceFault> {
    const PIECE_OFFSET_MASK: i32 = (1 << PIECE_WIDTH_BITS) - 1;
    if r < SHORT_THRESHOLD {
        return Err(ResistanceFault::Short);
    }
    let from_zero = r.0.wrapping_sub(R0.0);
    let piece = (from_zero >> PIECE_WIDTH_BITS).wrapping_add(PIECES_BELOW_R0);
    let Some([c0, c1, c2, c3]) = usize::try_from(piece).ok().and_then(|piece| CUBICS.get(piece))
    else {
        return Err(ResistanceFault::Open);
    };
    if r > OPEN_THRESHOLD {
        return Err(ResistanceFault::Open);
    }
    let x = (from_zero & PIECE_OFFSET_MASK).wrapping_shl(31 - PIECE_WIDTH_BITS);
    let inner = c2.wrapping_add(mul_high(*c3, x));
    let slope = c1.wrapping_add(mul_high(inner, x));
    Ok(Temperature(c0.wrapping_add(mul_high(slope, x))))
}

/// Returns the resistance of a thermometer at this temperature; below −200 °C, where the equation ends,
/// that of −200 °C.
///
/// ```
/// use trueup_core::{pt100::resistance_from_temperature, units::{MicroOhms, Temperature}};
/// assert_eq!(resistance_from_temperature(Temperature(0)), MicroOhms(100_000_000));
/// // 100 Ω·(1 + 3.9083e-3·20 − 5.775e-7·20²) = 107.7935 Ω at 20 °C.
/// assert_eq!(resistance_from_temperature(Temperature(20 * Temperature::PER_KELVIN)), MicroOhms(107_793_500));
/// ```
#[must_use]
pub const fn resistance_from_temperature(t: Temperature) -> MicroOhms {
    // w = t/2³¹ units in Q31. The coefficients are in ¼ µΩ, doubled once for every w.
    const FULL_SCALE_KELVIN: f64 = 2_147_483_648.0 / Temperature::PER_KELVIN as f64;
    const R0_IN_QUARTER_MICRO_OHMS: f64 = 4.0 * R0.0 as f64;
    const C1: i32 = round_to_nearest(R0_IN_QUARTER_MICRO_OHMS * A * FULL_SCALE_KELVIN * 2.0);
    const C2: i32 = round_to_nearest(
        R0_IN_QUARTER_MICRO_OHMS * B * FULL_SCALE_KELVIN * FULL_SCALE_KELVIN * 4.0,
    );
    const C3: i32 = round_to_nearest(
        R0_IN_QUARTER_MICRO_OHMS
            * C
            * -100.0
            * FULL_SCALE_KELVIN
            * FULL_SCALE_KELVIN
            * FULL_SCALE_KELVIN
            * 8.0,
    );
    const C4: i32 = round_to_nearest(
        R0_IN_QUARTER_MICRO_OHMS
            * C
            * FULL_SCALE_KELVIN
            * FULL_SCALE_KELVIN
            * FULL_SCALE_KELVIN
            * FULL_SCALE_KELVIN
            * 16.0,
    );
    const MIN_TEMPERATURE_UNITS: i32 = -200 * Temperature::PER_KELVIN;
    let w = if t.0 < MIN_TEMPERATURE_UNITS { MIN_TEMPERATURE_UNITS } else { t.0 };
    // None of the sums reaches 2³¹: |C1| < 1.7·10⁹, and each product is at most half its factor.
    let mut inner = C2;
    if w < 0 {
        inner = inner.wrapping_add(mul_high(C3.wrapping_add(mul_high(C4, w)), w));
    }
    let slope = C1.wrapping_add(mul_high(inner, w));
    let from_zero = rounding_shift_right_i32(mul_high(slope, w), 2);
    MicroOhms(R0.0.wrapping_add(from_zero))
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;

    const PER_KELVIN: f64 = Temperature::PER_KELVIN as f64;

    /// Returns the equation, in micro-ohms.
    fn equation(t: f64) -> f64 {
        let below = if t < 0.0 { C * (t - 100.0) * t.powi(3) } else { 0.0 };
        1e8 * (1.0 + A * t + B * t * t + below)
    }

    /// Its inverse above zero, by the square root.
    fn hot(micro_ohms: f64) -> f64 {
        ((A * A - 4.0 * B * (1.0 - micro_ohms / 1e8)).sqrt() - A) / (2.0 * B)
    }

    #[test]
    fn every_resistance_in_range_is_within_a_hundredth_of_a_millikelvin() {
        let (low, high) = (equation(-60.0) as i32, equation(400.0) as i32);
        let mut worst = 0.0_f64;
        for r in (low..=high).step_by(61) {
            let t = f64::from(temperature_from_resistance(MicroOhms(r)).unwrap().0) / PER_KELVIN;
            let exact = solve_temperature(f64::from(r) / 1e8);
            if r >= R0.0 {
                assert!((exact - hot(f64::from(r))).abs() < 1e-9, "the table's own source");
            } else {
                assert!((equation(exact) - f64::from(r)).abs() < 1e-5, "the table's own source");
            }
            worst = worst.max((t - exact).abs());
        }
        std::println!("worst error from resistance to temperature: {:.5} mK", worst * 1e3);
        assert!(worst < 1e-5);
    }

    #[test]
    fn every_temperature_in_range_has_its_resistance_to_a_micro_ohm() {
        let (mut worst, mut worst_kelvin) = (0.0_f64, 0.0_f64);
        let range = -60 * Temperature::PER_KELVIN..=400 * Temperature::PER_KELVIN;
        for t in range.step_by(613) {
            let celsius = f64::from(t) / PER_KELVIN;
            let off = (f64::from(resistance_from_temperature(Temperature(t)).0)
                - equation(celsius))
            .abs();
            worst = worst.max(off);
            worst_kelvin = worst_kelvin.max(off / 1e8 / (A + 2.0 * B * celsius));
        }
        let millikelvin = worst_kelvin * 1e3;
        std::println!("worst error of a resistance: {worst:.3} µΩ, {millikelvin:.5} mK");
        assert!(worst < 1.0 && millikelvin < 0.01);
    }

    #[test]
    fn there_and_back_is_the_same_temperature() {
        let mut worst = 0;
        for t in (-60 * Temperature::PER_KELVIN..=400 * Temperature::PER_KELVIN).step_by(9_973) {
            let back =
                temperature_from_resistance(resistance_from_temperature(Temperature(t))).unwrap();
            worst = worst.max(back.0.abs_diff(t));
        }
        std::println!("worst error there and back: {:.5} mK", f64::from(worst) / 4096.0);
        assert!(worst < 4096 / 100);
    }

    #[test]
    fn a_higher_resistance_is_never_colder() {
        let mut last = Temperature(i32::MIN);
        for r in (SHORT_THRESHOLD.0..=OPEN_THRESHOLD.0).step_by(7) {
            let now = temperature_from_resistance(MicroOhms(r)).unwrap();
            assert!(now >= last, "at {r} µΩ");
            last = now;
        }
        // Where the pieces join, to the micro-ohm: 1 µΩ is 2.6 µK, 11 units.
        for piece in -3..=17 {
            let join = R0.0 + (piece << PIECE_WIDTH_BITS);
            let [before, at] =
                [join - 1, join].map(|r| temperature_from_resistance(MicroOhms(r)).unwrap().0);
            assert!((0..=16).contains(&(at - before)), "{before} then {at} at {join} µΩ");
        }
    }

    #[test]
    fn a_broken_wire_and_a_short_circuit_are_distinguished() {
        assert_eq!(temperature_from_resistance(MicroOhms(i32::MIN)), Err(ResistanceFault::Short));
        assert_eq!(temperature_from_resistance(MicroOhms(0)), Err(ResistanceFault::Short));
        assert_eq!(
            temperature_from_resistance(MicroOhms(SHORT_THRESHOLD.0 - 1)),
            Err(ResistanceFault::Short)
        );
        assert!(
            temperature_from_resistance(SHORT_THRESHOLD).unwrap().0 < -65 * Temperature::PER_KELVIN
        );
        assert!(
            temperature_from_resistance(OPEN_THRESHOLD).unwrap().0 > 405 * Temperature::PER_KELVIN
        );
        assert_eq!(
            temperature_from_resistance(MicroOhms(OPEN_THRESHOLD.0 + 1)),
            Err(ResistanceFault::Open)
        );
        assert_eq!(temperature_from_resistance(MicroOhms(i32::MAX)), Err(ResistanceFault::Open));
    }

    #[test]
    fn the_extremes_have_a_resistance() {
        assert_eq!(
            resistance_from_temperature(Temperature(i32::MIN)).0,
            equation(-200.0).round() as i32
        );
        let hottest = equation(f64::from(i32::MAX) / PER_KELVIN);
        assert!(
            (f64::from(resistance_from_temperature(Temperature(i32::MAX)).0) - hottest).abs() < 1.0
        );
    }

    #[test]
    fn the_papers_four_tenths_of_an_ohm_a_kelvin_is_a_slope_of_39_hundredths() {
        let one = resistance_from_temperature(Temperature(Temperature::PER_KELVIN)).0 - R0.0;
        assert_eq!(one, 390_772);
    }

    #[test]
    fn the_tables_are_rounded_alike_on_either_side_of_zero() {
        for (value, integer) in [(2.4, 2), (2.6, 3), (0.4, 0)] {
            assert_eq!((round_to_nearest(value), round_to_nearest(-value)), (integer, -integer));
        }
    }
}
