//! Pitch error: an equidistant table by position, linear between its points.
//!
//! ```text
//! n = ⌊(p − start)/step⌋     w = ((p − start) mod step)/step     e = e[n] + w·(e[n+1] − e[n])
//! ```
//!
//! The number comes from one 32-bit division, w (Q31) from the step's kept reciprocal. Before the
//! first and after the last point the end value is held. A table for each direction of motion is
//! blended by β of [`crate::reversal`], and the two drives of a gantry by where across the beam the
//! point is.
//!
//! Values are 1/256 nm, steps 10 nm…42 m, any number of points. Worst error against `f64`,
//! measured by the test below over steps from 0.01 mm to 15 m and points up to ±5 mm: 0.011 nm.

use crate::{
    reversal::{Fraction, Interval},
    units::{FineNanometres, Position},
};

/// Where a position lies in a table.
struct TablePosition {
    /// The last point at or before it.
    number: usize,
    /// How far from there to the next.
    fraction: Fraction,
    /// Whether it lies before the first or after the last point.
    outside: bool,
}

impl TablePosition {
    /// Returns the place of `p` among `count` points, or `None` where there is none: no step, no points.
    #[inline]
    fn locate(p: Position, start: Position, step: Interval, count: usize) -> Option<Self> {
        let last = count.checked_sub(1)?;
        let from_start = p.0.wrapping_sub(start.0).cast_unsigned();
        let steps = from_start.checked_div(step.length())?;
        if p < start {
            return Some(Self { number: 0, fraction: Fraction::ZERO, outside: true });
        }
        let rest = from_start.wrapping_sub(steps.wrapping_mul(step.length()));
        let number = usize::try_from(steps).ok()?;
        if number >= last {
            let outside = number > last || rest > 0;
            return Some(Self { number: last, fraction: Fraction::ZERO, outside });
        }
        Some(Self { number, fraction: step.fraction(rest), outside: false })
    }

    /// Returns the value of a table here.
    #[inline]
    fn interpolate(&self, points: &[[u8; 4]]) -> Option<FineNanometres> {
        let value = |bytes: &[u8; 4]| FineNanometres(i32::from_le_bytes(*bytes));
        let here = value(points.get(self.number)?);
        let next = points.get(self.number.wrapping_add(1)).map_or(here, value);
        Some(self.fraction.interpolate(here, next))
    }
}

/// A table of errors, actual minus commanded, at equidistant positions.
///
/// The empty table (`Default`) is 0 everywhere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorTable<'a> {
    /// The position of the first point.
    pub start: Position,
    /// The distance of the points, more than 0.
    pub step: Interval,
    /// Errors in 1/256 nm, little-endian.
    pub points: &'a [[u8; 4]],
}

impl ErrorTable<'_> {
    /// Returns the error at `p`, and whether `p` lies outside, where the end value is held. A single point
    /// is a constant, outside everywhere but at its position. A step of 0 gives 0, outside.
    ///
    /// ```
    /// use trueup_core::{pitch_table::ErrorTable, reversal::Interval, units::{FineNanometres, Position}};
    /// // 10 mm commanded, 9 mm moved: the error is 0 at 0, and −1 mm at 10 mm.
    /// let points = [0, -1_000_000].map(|nm: i32| (nm * 256).to_le_bytes());
    /// let table = ErrorTable { start: Position(0), step: Interval::new(1_000_000), points: &points };
    /// let at = |mm: i32| table.error_at(Position(mm * Position::PER_MILLIMETRE));
    /// assert_eq!((at(5).0.rounded().0, at(5).1), (-500_000, false));
    /// // The offset is its opposite: 1 mm is added to the command.
    /// assert_eq!(at(10).0.rounded().saturating_neg().0, 1_000_000);
    /// assert_eq!(at(11), (at(10).0, true));
    /// ```
    #[must_use]
    #[inline]
    pub fn error_at(&self, p: Position) -> (FineNanometres, bool) {
        if self.points.is_empty() {
            return (FineNanometres::ZERO, false);
        }
        let found = TablePosition::locate(p, self.start, self.step, self.points.len())
            .and_then(|place| Some((place.interpolate(self.points)?, place.outside)));
        found.unwrap_or((FineNanometres::ZERO, true))
    }
}

/// The pitch error of an axis, with a table for each direction of motion or one for both.
///
/// With two tables the backlash is in them. `Default` is 0 everywhere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PitchErrorTable<'a> {
    /// The position of the first point.
    pub start: Position,
    /// The distance of the points, more than 0.
    pub step: Interval,
    /// Errors when approached in the positive direction, in 1/256 nm, little-endian.
    pub forward: &'a [[u8; 4]],
    /// Errors when approached in the negative direction, as many; `None`: the same.
    pub reverse: Option<&'a [[u8; 4]]>,
}

impl PitchErrorTable<'_> {
    /// Returns the error at `p` when approached as `reversal` says, and whether `p` lies outside, as
    /// [`ErrorTable::error_at`]. Where the reverse table is too short this says 0 and outside.
    ///
    /// ```
    /// use trueup_core::{pitch_table::PitchErrorTable, reversal::{Fraction, Interval}, units::{FineNanometres, Position}};
    /// let (forward, reverse) = ([0, 1_500], [500, 2_000]);
    /// let bytes = |table: [i32; 2]| table.map(|nm| (nm * 256).to_le_bytes());
    /// let pitch = PitchErrorTable {
    ///     start: Position(0),
    ///     step: Interval::new(100_000),
    ///     forward: &bytes(forward),
    ///     reverse: Some(&bytes(reverse)),
    /// };
    /// let at = |reversal| pitch.error_at(Position(100_000), reversal).0.rounded().0;
    /// assert_eq!([at(Fraction::ZERO), at(Fraction(1 << 30)), at(Fraction::ONE)], [1_500, 1_750, 2_000]);
    /// ```
    #[must_use]
    #[inline]
    pub fn error_at(&self, p: Position, reversal: Fraction) -> (FineNanometres, bool) {
        if self.forward.is_empty() {
            return (FineNanometres::ZERO, false);
        }
        self.interpolate(p, reversal).unwrap_or((FineNanometres::ZERO, true))
    }

    #[inline]
    fn interpolate(&self, p: Position, reversal: Fraction) -> Option<(FineNanometres, bool)> {
        let place = TablePosition::locate(p, self.start, self.step, self.forward.len())?;
        let forward = place.interpolate(self.forward)?;
        let error = match self.reverse {
            Some(points) => reversal.interpolate(forward, place.interpolate(points)?),
            None => forward,
        };
        Some((error, place.outside))
    }

    /// Returns whether the table can be used: a step, and as many points both ways. Called once, when it is
    /// loaded.
    #[must_use]
    pub fn is_consistent(&self) -> bool {
        let alike = self.reverse.is_none_or(|reverse| reverse.len() == self.forward.len());
        let step = self.step == Interval::new(self.step.length()) && self.step.length() > 0;
        alike && (step || self.forward.is_empty())
    }
}

/// The beam of a gantry with two drives on one axis: where on the cross axis the drives are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GantryBeam {
    first: Position,
    second: Position,
    /// Whether the second drive lies in the negative direction from the first.
    backwards: bool,
    distance: Interval,
}

impl GantryBeam {
    /// Drives at `first` and `second`; at one place there is only the first.
    ///
    /// Costs some hundred instructions: meant for loading, not for every tick.
    #[must_use]
    pub const fn new(first: Position, second: Position) -> Self {
        Self {
            first,
            second,
            backwards: second.0 < first.0,
            distance: Interval::new(first.0.abs_diff(second.0)),
        }
    }

    /// Where the first and the second drive are.
    #[must_use]
    pub const fn drive_positions(&self) -> [Position; 2] {
        [self.first, self.second]
    }

    /// w = (y − y₁)/(y₂ − y₁), held to 0…1.
    #[must_use]
    #[inline]
    pub fn interpolation_weight(&self, y: Position) -> Fraction {
        let before = if self.backwards { y >= self.first } else { y <= self.first };
        if before || self.distance.length() == 0 {
            return Fraction::ZERO;
        }
        self.distance.fraction(y.0.abs_diff(self.first.0))
    }

    /// Returns the error at `y` between errors `first` and `second` of the drives: (1 − w)·e₁ + w·e₂.
    ///
    /// ```
    /// use trueup_core::{pitch_table::GantryBeam, units::{FineNanometres, Position}};
    /// let beam = GantryBeam::new(Position(0), Position(300_000_000)); // 3 m
    /// let error = beam.interpolate(FineNanometres(256_000), FineNanometres(768_000), Position(75_000_000));
    /// assert_eq!(error.rounded().0, 1_500); // a quarter of the way from 1 µm to 3 µm
    /// ```
    #[must_use]
    #[inline]
    pub fn interpolate(
        &self,
        first: FineNanometres,
        second: FineNanometres,
        y: Position,
    ) -> FineNanometres {
        self.interpolation_weight(y).interpolate(first, second)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::next_random;
    extern crate std;
    use std::vec::Vec;

    const MM: i32 = Position::PER_MILLIMETRE;

    /// Up to ±5 mm.
    fn steep(seed: &mut u64) -> i32 {
        const MAX: i64 = 5_000_000 * 256;
        let value = i64::from(next_random(seed)) % (2 * MAX + 1) - MAX;
        match next_random(seed) % 4 {
            0 => MAX as i32,
            1 => -MAX as i32,
            _ => value as i32,
        }
    }

    fn exact(points: &[i32], start: i32, step: u32, p: i32) -> (f64, bool) {
        let along = (f64::from(p) - f64::from(start)) / f64::from(step);
        let last = (points.len() - 1) as f64;
        let held = along.clamp(0.0, last);
        let n = (held as usize).min(points.len() - 1);
        let (a, b) = (f64::from(points[n]), f64::from(points[(n + 1).min(points.len() - 1)]));
        (a + (b - a) * (held - n as f64), held != along)
    }

    #[test]
    fn the_table_is_f64_over_all_steps_and_sizes() {
        let (mut worst, mut seed) = (0.0_f64, 1);
        for round in 0..3_000_u32 {
            let step = match round {
                0 => 1_000,
                1 => 1_500_000_000,
                _ => (1_000 << (next_random(&mut seed) % 21)) + next_random(&mut seed) % 1_000,
            };
            let count = if round == 2 { 4_096 } else { 1 << (next_random(&mut seed) % 13) };
            let start =
                (next_random(&mut seed) as i32 / 10 * 7).clamp(-1_500_000_000, 1_500_000_000);
            let values: Vec<i32> = (0..count).map(|_| steep(&mut seed)).collect();
            let points: Vec<_> = values.iter().map(|value| value.to_le_bytes()).collect();
            let table =
                ErrorTable { start: Position(start), step: Interval::new(step), points: &points };
            let span = step.saturating_mul(count as u32).max(1);
            for kind in 0..1_000 {
                let p = match kind {
                    0 => i32::MIN,
                    1 => i32::MAX,
                    2 => start,
                    3..500 => start.wrapping_add_unsigned(next_random(&mut seed) % span),
                    500..750 => {
                        let point = next_random(&mut seed) % count as u32;
                        start
                            .wrapping_add_unsigned(point.wrapping_mul(step))
                            .wrapping_add(kind % 3 - 1)
                    }
                    _ => next_random(&mut seed) as i32,
                };
                let (value, outside) = table.error_at(Position(p));
                let (requested, beyond) = exact(&values, start, step, p);
                assert_eq!(outside, beyond, "{p} in {start} + {count} times {step}");
                worst = worst.max((f64::from(value.0) - requested).abs() / 256.0);
            }
        }
        std::println!("largest error of a table: {worst:.4} nm");
        assert!(worst <= 0.05);
    }

    #[test]
    fn a_table_is_exact_at_its_points_and_holds_its_ends() {
        let values = [7, -1_280_000_000, 1_280_000_000, 3];
        let points = values.map(i32::to_le_bytes);
        let table = ErrorTable { start: Position(-MM), step: Interval::new(77), points: &points };
        for (n, value) in (0..).zip(values) {
            assert_eq!(table.error_at(Position(-MM + n * 77)), (FineNanometres(value), false));
        }
        assert_eq!(table.error_at(Position(-MM - 1)), (FineNanometres(7), true));
        assert_eq!(table.error_at(Position(-MM + 3 * 77 + 1)), (FineNanometres(3), true));
        assert_eq!(table.error_at(Position(i32::MIN)), (FineNanometres(7), true));
        assert_eq!(table.error_at(Position(i32::MAX)), (FineNanometres(3), true));
    }

    #[test]
    fn moving_too_little_is_compensated_upwards_and_too_much_downwards() {
        // 10 mm commanded: 9 mm moved, and 11 mm moved.
        for (moved, compensation) in [(9, 1_000_000), (11, -1_000_000)] {
            let error = (moved - 10) * 1_000_000 * FineNanometres::PER_NANOMETRE;
            let points = [[0; 4], error.to_le_bytes()];
            let step = Interval::new(10 * MM.unsigned_abs());
            let table = ErrorTable { start: Position(0), step, points: &points };
            let (error, outside) = table.error_at(Position(10 * MM));
            assert_eq!((error.rounded().saturating_neg().0, outside), (compensation, false));
        }
    }

    #[test]
    fn one_point_is_a_constant() {
        let points = [256_i32.to_le_bytes()];
        let table =
            ErrorTable { start: Position(5), step: Interval::new(MM as u32), points: &points };
        assert_eq!([4, 5, 6].map(|p| table.error_at(Position(p)).1), [true, false, true]);
        assert_eq!([4, 5, 6].map(|p| table.error_at(Position(p)).0), [FineNanometres(256); 3]);
    }

    #[test]
    fn no_points_are_nought_and_no_step_is_outside() {
        assert_eq!(ErrorTable::default().error_at(Position(1)), (FineNanometres::ZERO, false));
        assert_eq!(
            PitchErrorTable::default().error_at(Position(1), Fraction::ONE),
            (FineNanometres::ZERO, false)
        );
        assert!(PitchErrorTable::default().is_consistent());
        let points = [[1; 4]; 3];
        let stuck = PitchErrorTable { forward: &points, ..PitchErrorTable::default() };
        assert_eq!(stuck.error_at(Position(0), Fraction::ONE), (FineNanometres::ZERO, true));
        assert!(!stuck.is_consistent());
        let short = PitchErrorTable {
            step: Interval::new(10),
            reverse: Some(points.get(..1).unwrap()),
            ..stuck
        };
        assert_eq!(short.error_at(Position(20), Fraction::ONE), (FineNanometres::ZERO, true));
        assert!(!short.is_consistent());
        assert!(PitchErrorTable { reverse: Some(&points), ..short }.is_consistent());
        let other = Interval::from_parts(10, 1 << 31);
        assert!(!PitchErrorTable { step: other, reverse: Some(&points), ..short }.is_consistent());
    }

    #[test]
    fn both_directions_are_f64_for_every_blend() {
        let (mut worst, mut seed) = (0.0_f64, 5);
        for _ in 0..200 {
            let step = 1_000 << (next_random(&mut seed) % 12);
            let tables = [(); 2].map(|()| (0..40).map(|_| steep(&mut seed)).collect::<Vec<_>>());
            let bytes = tables
                .each_ref()
                .map(|table| table.iter().map(|value| value.to_le_bytes()).collect::<Vec<_>>());
            let pitch = PitchErrorTable {
                start: Position(-MM),
                step: Interval::new(step),
                forward: &bytes[0],
                reverse: Some(&bytes[1]),
            };
            for _ in 0..2_000 {
                let p = -MM + (next_random(&mut seed) % (41 * step)) as i32;
                let reversal = Fraction(next_random(&mut seed) >> 1);
                let [(forward, _), (reverse, beyond)] =
                    tables.each_ref().map(|table| exact(table, -MM, step, p));
                let requested =
                    forward + (reverse - forward) * f64::from(reversal.0) / 2f64.powi(31);
                let (error, outside) = pitch.error_at(Position(p), reversal);
                assert_eq!(outside, beyond);
                worst = worst.max((f64::from(error.0) - requested).abs() / 256.0);
            }
        }
        std::println!("largest error of two tables: {worst:.4} nm");
        assert!(worst <= 0.05);
    }

    #[test]
    fn across_the_beam_the_error_goes_from_one_drive_to_the_other() {
        for (first, second) in [(0, 3_000), (3_000, 0), (-1_000, 2_000), (-15_000, 15_000)] {
            let beam = GantryBeam::new(Position(first * MM), Position(second * MM));
            for y in (-16_000..16_000).step_by(250) {
                let w = f64::from(y - first) / f64::from(second - first);
                let requested = 2_000.0 + 4_000.0 * w.clamp(0.0, 1.0);
                let error = beam.interpolate(
                    FineNanometres(2_000),
                    FineNanometres(6_000),
                    Position(y * MM),
                );
                assert!(
                    (f64::from(error.0) - requested).abs() <= 1.0,
                    "{y}: {error:?} {requested}"
                );
            }
        }
        let nowhere = GantryBeam::new(Position(5), Position(5));
        for y in [i32::MIN, 4, 5, 6, i32::MAX] {
            assert_eq!(
                nowhere.interpolate(FineNanometres(1), FineNanometres(3), Position(y)),
                FineNanometres(1)
            );
        }
        let widest = GantryBeam::new(Position(i32::MAX), Position(i32::MIN));
        assert_eq!(widest.interpolation_weight(Position(i32::MIN)), Fraction::ONE);
        assert_eq!(widest.interpolation_weight(Position(i32::MAX)), Fraction::ZERO);
    }

    #[test]
    fn any_table_may_come() {
        let mut seed = 9;
        let points = [[0xff, 0xff, 0xff, 0x7f], [0, 0, 0, 0x80], [1, 2, 3, 4]];
        let edges = [i32::MIN, -1, 0, 1, i32::MAX];
        for _ in 0..300_000 {
            let mut any = || next_random(&mut seed);
            let step = Interval::from_parts(any() >> (any() % 33).min(31), any());
            let forward = &points[..any() as usize % 4];
            let reverse = (any() % 2 == 0).then_some(&points[..any() as usize % 4]);
            let position = |n: u32| edges.get(n as usize % 8).copied().unwrap_or(n as i32);
            let pitch =
                PitchErrorTable { start: Position(position(any())), step, forward, reverse };
            let _ = pitch.error_at(Position(position(any())), Fraction(any()));
            let beam = GantryBeam::new(Position(position(any())), Position(position(any())));
            let _ = beam.interpolate(
                FineNanometres(any() as i32),
                FineNanometres(any() as i32),
                Position(position(any())),
            );
        }
    }
}
