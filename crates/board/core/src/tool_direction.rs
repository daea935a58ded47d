//! The tool direction V: from the spindle nose to the tool tip, in machine coordinates.

use crate::{
    fixed_point::{rounding_shift_right, widening_mul},
    units::{FineNanometres, Nanometres},
};

/// A unit vector in Q30: 2³⁰ is 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ToolDirection(pub [i32; 3]);

impl ToolDirection {
    /// 1 in this format.
    pub const ONE: i32 = 1 << Self::FRACTION_BITS;
    /// Binary places of a component.
    pub const FRACTION_BITS: u32 = 30;
    /// Straight down, the tool of a vertical spindle: (0, 0, −1).
    pub const DOWN: Self = Self([0, 0, -Self::ONE]);
}

impl ToolDirection {
    /// Lays an elongation s along the tool: the error s·V of the tool tip on X, Y and Z.
    ///
    /// Each component is rounded to the nearest nanometre.
    ///
    /// ```
    /// use trueup_core::{tool_direction::ToolDirection, units::Nanometres};
    /// // A spindle that has grown by 62.8 µm has its tip 62.8 µm too low.
    /// let error = ToolDirection::DOWN.project_elongation(Nanometres(62_800));
    /// assert_eq!(error, [Nanometres(0), Nanometres(0), Nanometres(-62_800)]);
    /// ```
    #[must_use]
    pub fn project_elongation(self, elongation: Nanometres) -> [Nanometres; 3] {
        self.0.map(|component| {
            // At most 2⁶², so that nothing wraps.
            let along = widening_mul(component, elongation.0);
            Nanometres::saturating_from(rounding_shift_right(along, Self::FRACTION_BITS))
        })
    }

    /// As [`project_elongation`](Self::project_elongation), in 1/256 nm, to be added to other parts and rounded with them.
    ///
    /// Each component is rounded to the nearest 1/256 nm and saturates at ±8.388 mm. Worst error
    /// against `f64`: 0.5/256 nm, the rounding.
    ///
    /// ```
    /// use trueup_core::{tool_direction::ToolDirection, units::{FineNanometres, Nanometres}};
    /// // 3 nm along a tool that points to −X by 1/1024: 3·256/1024 of a fine unit, so 1.
    /// let leaning = ToolDirection([-ToolDirection::ONE / 1024, 0, -ToolDirection::ONE]);
    /// assert_eq!(leaning.project_elongation_fine(Nanometres(3)), [FineNanometres(-1), FineNanometres(0), FineNanometres(-768)]);
    /// ```
    #[must_use]
    pub fn project_elongation_fine(self, elongation: Nanometres) -> [FineNanometres; 3] {
        const EXCESS_FRACTION_BITS: u32 =
            ToolDirection::FRACTION_BITS - FineNanometres::FRACTION_BITS;
        self.0.map(|component| {
            let along = widening_mul(component, elongation.0);
            FineNanometres::saturating_from(rounding_shift_right(along, EXCESS_FRACTION_BITS))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;

    #[test]
    fn half_a_millimetre_at_30_degrees_is_a_quarter_and_0_433() {
        // A = +30° about +X turns (0, 0, −1) into (0, sin 30°, −cos 30°).
        let one = f64::from(ToolDirection::ONE);
        let tilted =
            ToolDirection([0, (0.5 * one) as i32, (-(0.75_f64.sqrt()) * one).round() as i32]);
        let error = tilted.project_elongation(Nanometres(500_000));
        assert_eq!(error, [Nanometres(0), Nanometres(250_000), Nanometres(-433_013)]);
    }

    #[test]
    fn the_extremes_neither_wrap_nor_panic() {
        let error = ToolDirection([i32::MIN, i32::MAX, 0]).project_elongation(Nanometres(i32::MIN));
        assert_eq!(error, [Nanometres(i32::MAX), Nanometres(i32::MIN), Nanometres(0)]);
    }

    #[test]
    fn a_fine_error_is_f64_rounded_to_a_256th_of_a_nanometre() {
        let mut worst: f64 = 0.0;
        for component in (-ToolDirection::ONE..=ToolDirection::ONE).step_by(1_234_567) {
            for elongation in (-8_388_607..=8_388_607).step_by(9_973) {
                let exact = f64::from(component) * f64::from(elongation) / 2f64.powi(22);
                let [x, y, z] = ToolDirection([component, 0, -component])
                    .project_elongation_fine(Nanometres(elongation));
                assert_eq!(y, FineNanometres::ZERO);
                worst = worst.max((f64::from(x.0) - exact).abs());
                worst = worst.max((f64::from(z.0) + exact).abs());
            }
        }
        std::println!("largest error of a fine error: {worst:.4}/256 nm");
        assert!(worst <= 0.5);
    }

    #[test]
    fn a_fine_error_rounds_to_the_error() {
        let tilted = ToolDirection([-123_456_789, 536_870_912, -919_000_000]);
        for elongation in (-8_388_607..=8_388_607).step_by(997) {
            let error = tilted.project_elongation(Nanometres(elongation));
            let fine =
                tilted.project_elongation_fine(Nanometres(elongation)).map(FineNanometres::rounded);
            for (whole, rounded) in error.into_iter().zip(fine) {
                assert!((whole.0 - rounded.0).abs() <= 1);
            }
        }
    }

    #[test]
    fn a_fine_error_beyond_8_mm_saturates() {
        for elongation in [8_388_608, i32::MAX] {
            let error = ToolDirection([ToolDirection::ONE, i32::MIN, 0])
                .project_elongation_fine(Nanometres(elongation));
            assert_eq!(
                error,
                [FineNanometres(i32::MAX), FineNanometres(i32::MIN), FineNanometres(0)]
            );
        }
        let error =
            ToolDirection([i32::MIN, i32::MAX, 0]).project_elongation_fine(Nanometres(i32::MIN));
        assert_eq!(error, [FineNanometres(i32::MAX), FineNanometres(i32::MIN), FineNanometres(0)]);
    }
}
