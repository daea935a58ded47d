//! An error that grows in proportion to a travel.
//!
//! error = gradient·(to − from), with the gradient in Q36 nanometres per position unit (10 nm) and
//! the product rounded once to 1/256 nm. The range is ±3.125 µm/mm; one unit of the gradient is
//! 0.022 nm over 15 m. The travel has 33 bits and the gradient 32, so their product always fits in
//! 64. Measured worst error against the exact product: 0.002 nm (half a 1/256 nm).

use crate::{
    fixed_point::rounding_shift_right,
    units::{FineNanometres, Position},
};

/// An error per travel in Q36 nanometres per position unit: ±3.125 µm/mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Gradient(pub i32);

impl Gradient {
    /// No growth along the axis.
    pub const ZERO: Self = Self(0);
    /// Binary places of a nanometre per position unit.
    pub const FRACTION_BITS: u32 = 36;

    /// Returns the error at `to` of an axis that is right at `from`; saturates at ±8.388 mm.
    ///
    /// ```
    /// use trueup_core::{gradient::Gradient, units::{Nanometres, Position}};
    /// // 10 µm/m are 10 nm per 100 000 position units: 2³⁶/10⁴ = 6 871 948.
    /// let cast_iron_one_kelvin_warmer = Gradient(6_871_948);
    /// let five_metres = Position(5_000 * Position::PER_MILLIMETRE);
    /// let grown = cast_iron_one_kelvin_warmer.error_over_travel(Position(0), five_metres);
    /// assert_eq!(grown.rounded(), Nanometres(50_000));
    /// ```
    #[must_use]
    pub fn error_over_travel(self, from: Position, to: Position) -> FineNanometres {
        const FRACTION_SHIFT: u32 = Gradient::FRACTION_BITS - FineNanometres::FRACTION_BITS;
        let travel = i64::from(to.0).wrapping_sub(i64::from(from.0));
        // At most 2³¹·(2³² − 1) + 2²⁷, below 2⁶³: neither step can wrap.
        FineNanometres::saturating_from(rounding_shift_right(
            travel.wrapping_mul(i64::from(self.0)),
            FRACTION_SHIFT,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;

    /// Whole numbers all over ±2³¹, the ends among them.
    fn spread(count: u32) -> impl Iterator<Item = i32> {
        let step = u32::MAX / (count - 1);
        (0..count).map(move |n| {
            if n + 1 == count { i32::MAX } else { i32::MIN.wrapping_add((step * n) as i32) }
        })
    }

    #[test]
    fn every_product_is_right_to_half_a_unit_or_saturates() {
        let mut worst = 0.0_f64;
        for gradient in spread(129) {
            for from in spread(65) {
                for to in spread(127) {
                    let error = Gradient(gradient).error_over_travel(Position(from), Position(to));
                    let exact = i128::from(gradient) * (i128::from(to) - i128::from(from));
                    let held = exact.clamp(i128::from(i32::MIN) << 28, i128::from(i32::MAX) << 28);
                    let off = (held - (i128::from(error.0) << 28)) as f64 / f64::from(1 << 28);
                    worst = worst.max(off.abs());
                }
            }
        }
        std::println!("worst error of a gradient: {:.6} nm", worst / 256.0);
        assert!(worst <= 0.5);
    }

    #[test]
    fn the_extremes_saturate() {
        let (low, high) = (Position(i32::MIN), Position(i32::MAX));
        assert_eq!(Gradient(i32::MIN).error_over_travel(low, high), FineNanometres(i32::MIN));
        assert_eq!(Gradient(i32::MIN).error_over_travel(high, low), FineNanometres(i32::MAX));
        assert_eq!(Gradient(i32::MAX).error_over_travel(low, high), FineNanometres(i32::MAX));
        assert_eq!(Gradient(i32::MAX).error_over_travel(high, low), FineNanometres(i32::MIN));
    }

    #[test]
    fn a_travel_the_other_way_has_the_opposite_error() {
        // 3 µm/m over −2 m.
        let gradient = Gradient(2_061_584);
        let back = gradient.error_over_travel(Position(300_000_000), Position(100_000_000));
        assert_eq!(back.rounded().0, -6_000);
    }
}
