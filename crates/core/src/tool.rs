//! The tool direction V: from the spindle nose to the tool tip, in machine coordinates.

/// A unit vector in Q30: 2³⁰ is 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Direction(pub [i32; 3]);

impl Direction {
    /// 1 in this format.
    pub const ONE: i32 = 1 << Self::FRACTION_BITS;
    /// Binary places of a component.
    pub const FRACTION_BITS: u32 = 30;
    /// Straight down, the tool of a vertical spindle: (0, 0, −1).
    pub const DOWN: Self = Self([0, 0, -Self::ONE]);
}

use crate::units::Nanometres;

impl Direction {
    /// Lays an elongation s along the tool: the error s·V of the tool tip on X, Y and Z.
    ///
    /// Each component is rounded to the nearest nanometre.
    ///
    /// ```
    /// use trueup_core::{tool::Direction, units::Nanometres};
    /// // A spindle that has grown by 62.8 µm has its tip 62.8 µm too low.
    /// let error = Direction::DOWN.error(Nanometres(62_800));
    /// assert_eq!(error, [Nanometres(0), Nanometres(0), Nanometres(-62_800)]);
    /// ```
    #[must_use]
    pub fn error(self, elongation: Nanometres) -> [Nanometres; 3] {
        const HALF: i64 = 1 << (Direction::FRACTION_BITS - 1);
        self.0.map(|component| {
            let along = i64::from(component).saturating_mul(i64::from(elongation.0));
            Nanometres::saturating(along.saturating_add(HALF) >> Self::FRACTION_BITS)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_a_millimetre_at_30_degrees_is_a_quarter_and_0_433() {
        // A = +30° about +X turns (0, 0, −1) into (0, sin 30°, −cos 30°).
        let one = f64::from(Direction::ONE);
        let tilted = Direction([0, (0.5 * one) as i32, (-(0.75_f64.sqrt()) * one).round() as i32]);
        let error = tilted.error(Nanometres(500_000));
        assert_eq!(error, [Nanometres(0), Nanometres(250_000), Nanometres(-433_013)]);
    }

    #[test]
    fn the_extremes_neither_wrap_nor_panic() {
        let error = Direction([i32::MIN, i32::MAX, 0]).error(Nanometres(i32::MIN));
        assert_eq!(error, [Nanometres(i32::MAX), Nanometres(i32::MIN), Nanometres(0)]);
    }
}
