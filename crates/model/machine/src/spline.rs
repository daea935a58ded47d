//! A clamped B-spline over the position of an axis, and its value in `f64` (`docs/physics.md` section 4).
//!
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
//! Outside the knots the end values are held.

/// A clamped B-spline: µm over mm.
///
/// Whatever is read from a machine file passes [`Self::validate`].
#[derive(Clone, Debug, PartialEq)]
pub struct BSpline {
    /// The degree plus one: 2, 3 or 4.
    pub order: usize,
    /// As many as control points and order together, not falling; the first and the last one each
    /// stand there `order` times, the ones between at most `order − 1` times.
    pub knots_mm: Vec<f64>,
    /// The control points, at least `order` of them.
    pub control_um: Vec<f64>,
}

/// A rule that a spline breaks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SplineError {
    /// The field at fault, with the index of the element where one is: `knots_mm[3]`.
    pub key: String,
    /// The rule that is broken; it goes on after the key.
    pub rule: String,
}

impl BSpline {
    /// Returns where the curve begins and ends, in mm; `None` where it has no knots.
    pub(crate) fn range_mm(&self) -> Option<[f64; 2]> {
        Some([*self.knots_mm.first()?, *self.knots_mm.last()?])
    }

    /// Whether it is a clamped, continuous spline of an order that the board runs.
    ///
    /// # Errors
    /// The first rule that is broken, of those that the fields state.
    pub fn validate(&self) -> Result<(), SplineError> {
        let fault = |key: &str, rule: String| SplineError { key: key.to_string(), rule };
        let Self { order, knots_mm: knots, control_um: control } = self;
        let order = *order;
        if !(2..=4).contains(&order) {
            let rule = format!("must be 2, 3 or 4, not {order}: the board runs cubics, of order 4");
            return Err(fault("order", rule));
        }
        if control.len() < order {
            let rule = format!(
                "has {} elements, but a spline of order {order} needs at least {order}",
                control.len()
            );
            return Err(fault("control_um", rule));
        }
        if knots.len() != control.len() + order {
            let rule = format!(
                "must have {} elements, {} of control_um and {order} of the order, not {}",
                control.len() + order,
                control.len(),
                knots.len()
            );
            return Err(fault("knots_mm", rule));
        }
        let at = |index: usize| format!("knots_mm[{index}]");
        if let Some(index) = (1..knots.len()).find(|&index| knots[index] < knots[index - 1]) {
            let rule = format!("{} is below {} before it", knots[index], knots[index - 1]);
            return Err(fault(&at(index), format!("{rule}: knots must not fall")));
        }
        // The lengths are checked: there are at least 2·order knots.
        let inner = order..knots.len() - order;
        let (first, last) = (knots[0], knots[knots.len() - 1]);
        if first == last {
            return Err(fault("knots_mm", format!("must not all be {first}: there is no length")));
        }
        let repeated = |end: &str, value: f64| {
            format!("must be {value} as well: the {end} knot stands there exactly {order} times")
        };
        for (end, value, mut range) in
            [("first", first, 1..order), ("last", last, inner.end..knots.len())]
        {
            if let Some(index) = range.find(|&index| knots[index] != value) {
                return Err(fault(&at(index), repeated(end, value)));
            }
        }
        for index in inner {
            let value = knots[index];
            if value == first || value == last {
                let rule = format!("{value} repeats the end more than {order} times");
                return Err(fault(&at(index), rule));
            }
            if knots[index + 1 - order] == value {
                let rule = format!(
                    "{value} stands there more than {} times: the curve would jump",
                    order - 1
                );
                return Err(fault(&at(index), rule));
            }
        }
        Ok(())
    }
}

/// Returns the spline at `position_mm`, in µm; NaN for a missing position, and for a spline that breaks
/// the rules of [`BSpline::validate`].
///
/// ```
/// use trueup_machine::{machine_file::BSpline, model::spline_value_um};
/// // One cubic segment: half way it is (1·0 + 3·8 + 3·8 + 1·0)/8.
/// let hump = BSpline {
///     order: 4,
///     knots_mm: vec![0.0, 0.0, 0.0, 0.0, 10.0, 10.0, 10.0, 10.0],
///     control_um: vec![0.0, 8.0, 8.0, 0.0],
/// };
/// assert_eq!(spline_value_um(&hump, 5.0), 6.0);
/// assert_eq!(spline_value_um(&hump, -1.0), 0.0);
/// ```
#[must_use]
pub fn spline_value_um(spline: &BSpline, position_mm: f64) -> f64 {
    let Some(at) = KnotSpan::find(spline, position_mm) else { return f64::NAN };
    let mut d = [0.0; 4];
    d[..spline.order].copy_from_slice(&spline.control_um[at.first..at.first + spline.order]);
    at.de_boor(spline, d)
}

/// Returns how much each control point weighs at `position_mm`: the number of the first of as many as the
/// order says, and their weights, which add up to 1. All NaN where [`spline_value_um`] is.
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
                worst = worst.max((spline_value_um(&spline, t) - sum).abs());
            }
        }
        println!("de Boor against the basis: {worst:e} µm");
        assert!(worst < 1e-12, "{worst:e} µm");
    }

    #[test]
    fn the_examples_middle_is_what_the_hand_finds() {
        // At the knot 500 the three control points around it weigh 1/4, 1/2, 1/4.
        assert!((spline_value_um(&example(), 500.0) - (3.0 - 2.0 * 2.0 + 4.0) / 4.0).abs() < 1e-12);
    }

    #[test]
    fn a_clamped_spline_begins_and_ends_at_its_end_points_and_is_held_outside() {
        let spline = BSpline { control_um: vec![1.5, 3.0, -2.0, 4.0, -7.0], ..example() };
        for position_mm in [f64::NEG_INFINITY, -1.0, 0.0] {
            assert_eq!(spline_value_um(&spline, position_mm), 1.5);
        }
        for position_mm in [1000.0, 1000.1, f64::INFINITY] {
            assert_eq!(spline_value_um(&spline, position_mm), -7.0);
        }
        assert!(spline_value_um(&spline, f64::NAN).is_nan());
    }

    #[test]
    fn order_2_is_a_polyline_through_its_control_points() {
        let line = BSpline {
            order: 2,
            knots_mm: vec![0.0, 0.0, 10.0, 30.0, 30.0],
            control_um: vec![1.0, 5.0, -5.0],
        };
        for (position_mm, um) in [(0.0, 1.0), (5.0, 3.0), (10.0, 5.0), (20.0, 0.0), (30.0, -5.0)] {
            assert_eq!(spline_value_um(&line, position_mm), um);
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
            assert!(
                (spline_value_um(&line, position_mm) - (0.02 * position_mm - 4.0)).abs() < 1e-12
            );
        }
    }

    #[test]
    fn an_unsound_spline_is_no_number() {
        let short = BSpline { knots_mm: vec![0.0, 1.0], ..example() };
        let empty = BSpline { knots_mm: vec![], control_um: vec![], order: 0 };
        let falling = BSpline { knots_mm: (0..9).rev().map(f64::from).collect(), ..example() };
        for spline in [short, empty, falling] {
            assert!(spline_value_um(&spline, 0.5).is_nan());
            assert!(spline.validate().is_err());
        }
    }
}
