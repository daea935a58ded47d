//! The error of one linear axis along another, in `f64`: straightness and squareness.
//!
//! Straightness (`docs/physics.md` section 4) is a B-spline over the position of the axis that moves,
//! C(t) = Σ N_{j,p}(t)·b_j, evaluated by de Boor's recurrence in the knot span [t_s, t_{s+1}) that
//! holds t, with p the degree:
//!
//! ```text
//! d_j ← b_j                             j = s−p … s
//! d_j ← (1 − α)·d_{j−1} + α·d_j         r = 1 … p, j = s … s−p+r
//!       α = (t − t_j)/(t_{j+p+1−r} − t_j)
//! C = d_s
//! ```
//!
//! Measured against the sum of the basis itself: within 4·10⁻¹⁵ µm for control points up to 12 µm.
//! Outside the knots the end values are held. In space the curves add up: Δx = δx(y) + δx(z),
//! Δy = δy(x) + δy(z), Δz = δz(x) + δz(y).
//!
//! Squareness is a slope: the error of the first axis for one metre of the second.

use crate::file::straightness::{BSpline, Squareness};

/// Returns the spline at `position_mm`, in µm; NaN for a missing position, and for a spline that breaks
/// the rules of [`BSpline::validate`].
///
/// ```
/// use trueup_machine::{file::BSpline, model::spline_um};
/// // One cubic segment: half way it is (1·0 + 3·8 + 3·8 + 1·0)/8.
/// let hump = BSpline {
///     order: 4,
///     knots_mm: vec![0.0, 0.0, 0.0, 0.0, 10.0, 10.0, 10.0, 10.0],
///     control_um: vec![0.0, 8.0, 8.0, 0.0],
/// };
/// assert_eq!(spline_um(&hump, 5.0), 6.0);
/// assert_eq!(spline_um(&hump, -1.0), 0.0);
/// ```
#[must_use]
pub fn spline_um(spline: &BSpline, position_mm: f64) -> f64 {
    let Some(at) = KnotSpan::find(spline, position_mm) else { return f64::NAN };
    let mut d = [0.0; 4];
    d[..spline.order].copy_from_slice(&spline.control_um[at.first..at.first + spline.order]);
    at.de_boor(spline, d)
}

/// Returns how much each control point weighs at `position_mm`: the number of the first of as many as the
/// order says, and their weights, which add up to 1. All NaN where [`spline_um`] is.
#[must_use]
pub(crate) fn spline_basis_values(spline: &BSpline, position_mm: f64) -> (usize, [f64; 4]) {
    let Some(at) = KnotSpan::find(spline, position_mm) else { return (0, [f64::NAN; 4]) };
    let weight = |number: usize| {
        let mut d = [0.0; 4];
        d[number] = 1.0;
        at.de_boor(spline, d)
    };
    let mut weights = [0.0; 4];
    weights.iter_mut().enumerate().take(spline.order).for_each(|(n, value)| *value = weight(n));
    (at.first, weights)
}

/// The knot span that holds a position.
struct KnotSpan {
    /// The position, inside the knots.
    t: f64,
    /// s − p: the first control point that weighs there.
    first: usize,
}

impl KnotSpan {
    fn find(spline: &BSpline, position_mm: f64) -> Option<Self> {
        let BSpline { order, knots_mm: knots, control_um: control } = spline;
        let (order, count) = (*order, control.len());
        let is_sound = (2..=4).contains(&order) && count >= order && knots.len() == count + order;
        let (&first, &last) = (knots.first()?, knots.last()?);
        if !is_sound || position_mm.is_nan() || first.is_nan() || last.is_nan() || first > last {
            return None;
        }
        let t = position_mm.clamp(first, last);
        let degree = order - 1;
        // The last span is closed: its right end is inside.
        let span =
            knots.partition_point(|&knot| knot <= t).saturating_sub(1).clamp(degree, count - 1);
        Some(Self { t, first: span - degree })
    }

    /// Returns the module's recurrence on d_{s−p} … d_s.
    fn de_boor(&self, spline: &BSpline, mut d: [f64; 4]) -> f64 {
        let (order, knots) = (spline.order, &spline.knots_mm);
        for round in 1..order {
            for i in (round..order).rev() {
                let j = self.first + i;
                let (left, right) = (knots[j], knots[j + order - round]);
                let share = (self.t - left) / (right - left);
                d[i] = (1.0 - share) * d[i - 1] + share * d[i];
            }
        }
        d[order - 1]
    }
}

/// Returns the error in µm of an angle between two axes, at `along_mm` on the second one.
///
/// ```
/// use trueup_machine::{file::{LinearAxis, Squareness}, model::squareness_um};
/// let angle = Squareness { error: LinearAxis::X, along: LinearAxis::Y, um_per_m: 12.0 };
/// assert_eq!(squareness_um(&angle, -500.0), -6.0);
/// ```
#[must_use]
pub fn squareness_um(squareness: &Squareness, along_mm: f64) -> f64 {
    squareness.um_per_m * along_mm / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the example of the format's description.
    fn example() -> BSpline {
        BSpline {
            order: 4,
            knots_mm: vec![0.0, 0.0, 0.0, 0.0, 500.0, 1000.0, 1000.0, 1000.0, 1000.0],
            control_um: vec![0.0, 3.0, -2.0, 4.0, 0.0],
        }
    }

    /// Cox and de Boor's definition of the basis: another way to the same curve.
    fn basis(knots: &[f64], j: usize, order: usize, t: f64) -> f64 {
        if order == 1 {
            return if knots[j] <= t && t < knots[j + 1] { 1.0 } else { 0.0 };
        }
        let part = |from: f64, to: f64, numerator: f64, lower: usize| {
            if to > from {
                numerator / (to - from) * basis(knots, lower, order - 1, t)
            } else {
                0.0
            }
        };
        part(knots[j], knots[j + order - 1], t - knots[j], j)
            + part(knots[j + 1], knots[j + order], knots[j + order] - t, j + 1)
    }

    #[test]
    fn it_is_the_sum_of_the_basis_times_the_control_points() {
        let uneven = BSpline {
            order: 4,
            knots_mm: vec![
                -40.0, -40.0, -40.0, -40.0, -13.0, 2.0, 2.0, 30.0, 31.0, 90.0, 90.0, 90.0, 90.0,
            ],
            control_um: vec![1.0, -7.0, 3.5, 12.0, 0.25, -4.0, 8.0, 8.5, -1.0],
        };
        let quadratic = BSpline {
            order: 3,
            knots_mm: vec![0.0, 0.0, 0.0, 10.0, 10.0, 25.0, 40.0, 40.0, 40.0],
            control_um: vec![1.0, -2.0, 6.0, 3.0, 3.0, -9.0],
        };
        let mut worst: f64 = 0.0;
        for spline in [example(), uneven, quadratic] {
            assert_eq!(spline.validate(), Ok(()));
            let knots = &spline.knots_mm;
            let (first, last) = (knots[0], knots[knots.len() - 1]);
            for step in 0..1000 {
                let t = first + (last - first) * f64::from(step) / 1000.0;
                let sum: f64 = (0..spline.control_um.len())
                    .map(|j| basis(knots, j, spline.order, t) * spline.control_um[j])
                    .sum();
                worst = worst.max((spline_um(&spline, t) - sum).abs());
            }
        }
        println!("de Boor against the basis: {worst:e} µm");
        assert!(worst < 1e-12, "{worst:e} µm");
    }

    #[test]
    fn the_examples_middle_is_what_the_hand_finds() {
        // At the knot 500 the three control points around it weigh 1/4, 1/2, 1/4.
        assert!((spline_um(&example(), 500.0) - (3.0 - 2.0 * 2.0 + 4.0) / 4.0).abs() < 1e-12);
    }

    #[test]
    fn a_clamped_spline_begins_and_ends_at_its_end_points_and_is_held_outside() {
        let spline = BSpline { control_um: vec![1.5, 3.0, -2.0, 4.0, -7.0], ..example() };
        for position_mm in [f64::NEG_INFINITY, -1.0, 0.0] {
            assert_eq!(spline_um(&spline, position_mm), 1.5);
        }
        for position_mm in [1000.0, 1000.1, f64::INFINITY] {
            assert_eq!(spline_um(&spline, position_mm), -7.0);
        }
        assert!(spline_um(&spline, f64::NAN).is_nan());
    }

    #[test]
    fn order_2_is_a_polyline_through_its_control_points() {
        let line = BSpline {
            order: 2,
            knots_mm: vec![0.0, 0.0, 10.0, 30.0, 30.0],
            control_um: vec![1.0, 5.0, -5.0],
        };
        for (position_mm, um) in [(0.0, 1.0), (5.0, 3.0), (10.0, 5.0), (20.0, 0.0), (30.0, -5.0)] {
            assert_eq!(spline_um(&line, position_mm), um);
        }
    }

    #[test]
    fn control_points_on_a_line_give_the_line() {
        // At the knots' running means (Greville's points) a spline repeats a straight line.
        let knots_mm = example().knots_mm;
        let mean = |j: usize| (knots_mm[j + 1] + knots_mm[j + 2] + knots_mm[j + 3]) / 3.0;
        let control_um = (0..5).map(|j| 0.02 * mean(j) - 4.0).collect();
        let line = BSpline { control_um, ..example() };
        for step in 0..=100 {
            let position_mm = f64::from(step) * 10.0;
            assert!((spline_um(&line, position_mm) - (0.02 * position_mm - 4.0)).abs() < 1e-12);
        }
    }

    #[test]
    fn an_unsound_spline_is_no_number() {
        let short = BSpline { knots_mm: vec![0.0, 1.0], ..example() };
        let empty = BSpline { knots_mm: vec![], control_um: vec![], order: 0 };
        let falling = BSpline { knots_mm: (0..9).rev().map(f64::from).collect(), ..example() };
        for spline in [short, empty, falling] {
            assert!(spline_um(&spline, 0.5).is_nan());
            assert!(spline.validate().is_err());
        }
    }
}
