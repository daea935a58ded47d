//! B-splines in `f64`: the basis, its derivatives, and least squares in it.
//!
//! The basis functions that are not zero at x follow from Cox and de Boor's recurrence, all at once
//! and without a division by zero:
//!
//! ```text
//! N_{j,1} = 1 in [t_j, t_{j+1})
//! N_{j,k} = (x − t_j)/(t_{j+k−1} − t_j)·N_{j,k−1} + (t_{j+k} − x)/(t_{j+k} − t_{j+1})·N_{j+1,k−1}
//! ```
//!
//! Least squares is solved row by row: Givens rotations turn each observation into the triangle R
//! of the design matrix, of which `order` numbers a coefficient are kept. A million rows therefore
//! need no more memory than ten, and the condition of the problem is not squared as by normal
//! equations. The remainder of a row after the rotations is its share of the residual, so the sum of
//! squares costs nothing.
//!
//! Measured against SciPy on random knots (`host-tests/tests/scipy_splines.rs`): values, slopes and
//! fits are the same to 1e-9 of the largest value.

use trueup_machine::machine_file::BSpline;

/// The largest order: the board runs cubics.
pub(crate) const MAX_SPLINE_ORDER: usize = 4;

/// The values of `order` basis functions.
pub type BasisValues = [f64; MAX_SPLINE_ORDER];

/// Below this [sine](BandedLeastSquares::min_column_angle_sine) the coefficients are noise of the arithmetic.
const SINGULARITY_TOLERANCE: f64 = 1e-10;

/// Returns the knots of a clamped spline from `first` to `last` with `inner` (rising) between them.
#[must_use]
pub fn clamped_knots(order: usize, first: f64, inner: &[f64], last: f64) -> Vec<f64> {
    let mut knots = vec![first; order];
    knots.extend_from_slice(inner);
    knots.resize(knots.len() + order, last);
    knots
}

/// Returns the knot span that holds `x`: the largest s of order−1…n−1 with `knots[s] <= x`.
fn find_knot_span(knots: &[f64], order: usize, x: f64) -> usize {
    let count = knots.len() - order;
    knots.partition_point(|&knot| knot <= x).saturating_sub(1).clamp(order - 1, count - 1)
}

/// Returns the first basis function that is not zero at `x`, and the values of it and the `order − 1`
/// after it. Outside the knots the functions of the end span are continued.
///
/// # Panics
/// `order` is not 1…4, or there are fewer than 2·`order` knots.
#[must_use]
pub(crate) fn evaluate_basis(knots: &[f64], order: usize, x: f64) -> (usize, BasisValues) {
    assert!((1..=MAX_SPLINE_ORDER).contains(&order) && knots.len() >= 2 * order, "no spline");
    evaluate_basis_in_span(knots, order, find_knot_span(knots, order, x), x)
}

/// [`evaluate_basis`] in a span that is known.
fn evaluate_basis_in_span(
    knots: &[f64],
    order: usize,
    span: usize,
    x: f64,
) -> (usize, BasisValues) {
    let mut weights = [0.0; MAX_SPLINE_ORDER];
    weights[0] = 1.0;
    for level in 1..order {
        let mut carried = 0.0;
        for j in 0..level {
            let (left, right) = (knots[span + 1 + j - level], knots[span + 1 + j]);
            let share = weights[j] / (right - left);
            weights[j] = carried + (right - x) * share;
            carried = (x - left) * share;
        }
        weights[level] = carried;
    }
    (span + 1 - order, weights)
}

/// Returns the value of a spline and of its first two derivatives at `x`: µm, µm/mm, µm/mm².
///
/// # Panics
/// The spline breaks the rules of [`BSpline::validate`].
#[must_use]
pub fn evaluate_with_derivatives(spline: &BSpline, x: f64) -> [f64; 3] {
    let BSpline { order, knots_mm: knots, control_um } = spline;
    let order = *order;
    let span = find_knot_span(knots, order, x);
    let mut points = [0.0; MAX_SPLINE_ORDER];
    points[..order].copy_from_slice(&control_um[span + 1 - order..=span]);
    let mut result = [0.0; 3];
    for (derivative, slot) in result.iter_mut().enumerate() {
        if derivative >= order {
            break;
        }
        let left = order - derivative;
        let (_, weights) = evaluate_basis_in_span(knots, left, span, x);
        *slot = weights.iter().zip(&points).take(left).map(|(w, p)| w * p).sum();
        // The control points of the next derivative.
        for j in 0..left - 1 {
            let low = span + 2 + j - left;
            let width = knots[low + left - 1] - knots[low];
            points[j] = (points[j + 1] - points[j]) * (left - 1) as f64 / width;
        }
    }
    result
}

/// Returns the largest absolute slope in µm/mm and curvature in µm/mm², found at `per_span` places of each
/// knot span with its ends.
#[must_use]
pub(crate) fn max_slope_and_curvature(spline: &BSpline, per_span: usize) -> (f64, f64) {
    let knots = &spline.knots_mm;
    let (mut slope, mut curvature) = (0.0_f64, 0.0_f64);
    for pair in knots.windows(2).filter(|pair| pair[1] > pair[0]) {
        for n in 0..per_span {
            // A curvature jumps at a double knot: both sides are looked at, just inside.
            let share = (n as f64 / (per_span - 1) as f64).clamp(1e-9, 1.0 - 1e-9);
            let [_, first, second] =
                evaluate_with_derivatives(spline, pair[0] + share * (pair[1] - pair[0]));
            slope = slope.max(first.abs());
            curvature = curvature.max(second.abs());
        }
    }
    (slope, curvature)
}

/// Returns whether points at `x` (rising) determine every coefficient: each basis function has a point of
/// its own within its support, in order (Schoenberg and Whitney).
#[must_use]
pub fn satisfies_schoenberg_whitney(
    knots: &[f64],
    order: usize,
    mut x: impl Iterator<Item = f64>,
) -> bool {
    let count = knots.len() - order;
    let [first, last] = [knots[0], knots[knots.len() - 1]];
    (0..count).all(|j| {
        let (low, high) = (knots[j], knots[j + order]);
        // At the ends of all knots the first and the last function are not zero.
        let is_after = |x: f64| x > low || (x == first && low == first && j == 0);
        let found = x.by_ref().find(|&x| is_after(x));
        found.is_some_and(|x| x < high || (x == last && j == count - 1))
    })
}

/// Least squares that takes one observation at a time: R of the design matrix, in `order`
/// diagonals, and Qᵀ times each of the right-hand sides.
#[derive(Clone, Debug)]
pub struct BandedLeastSquares {
    order: usize,
    sides: usize,
    /// Row j holds R_{j,j} … R_{j,j+order−1}.
    r: Vec<BasisValues>,
    /// Row j holds `sides` numbers.
    right: Vec<f64>,
}

impl BandedLeastSquares {
    /// For `count` coefficients and `sides` right-hand sides.
    #[must_use]
    pub fn new(order: usize, count: usize, sides: usize) -> Self {
        Self {
            order,
            sides,
            r: vec![[0.0; MAX_SPLINE_ORDER]; count],
            right: vec![0.0; count * sides],
        }
    }

    /// Takes in the observation whose coefficients from `first` on weigh `weights`, with its
    /// right-hand sides; these are left with what no coefficient can explain.
    pub(crate) fn add_observation(
        &mut self,
        first: usize,
        mut weights: BasisValues,
        values: &mut [f64],
    ) {
        for i in 0..self.order {
            let low = weights[i];
            if low == 0.0 {
                continue;
            }
            let row = &mut self.r[first + i];
            let radius = row[0].hypot(low);
            let (cosine, sine) = (row[0] / radius, low / radius);
            row[0] = radius;
            for (r, w) in row[1..self.order - i].iter_mut().zip(&mut weights[i + 1..self.order]) {
                (*r, *w) = (cosine * *r + sine * *w, cosine * *w - sine * *r);
            }
            let right = &mut self.right[(first + i) * self.sides..][..self.sides];
            for (r, v) in right.iter_mut().zip(values.iter_mut()) {
                (*r, *v) = (cosine * *r + sine * *v, cosine * *v - sine * *r);
            }
        }
    }

    /// Returns how well the observations determine each coefficient, 0 (not at all) to 1: the least sine
    /// of the angle between a column of the design matrix and all columns before it.
    #[must_use]
    pub fn min_column_angle_sine(&self) -> f64 {
        let sine = |j: usize| {
            let above = (1..self.order.min(j + 1)).map(|i| self.r[j - i][i].powi(2));
            let whole = self.r[j][0].powi(2) + above.sum::<f64>();
            if whole > 0.0 { self.r[j][0].abs() / whole.sqrt() } else { 0.0 }
        };
        (0..self.r.len()).map(sine).fold(1.0, f64::min)
    }

    /// Returns the coefficients for right-hand side `side`; `None` where they are not determined.
    #[must_use]
    pub fn solve(&self, side: usize) -> Option<Vec<f64>> {
        if self.min_column_angle_sine() < SINGULARITY_TOLERANCE {
            return None;
        }
        let count = self.r.len();
        let mut solution = vec![0.0; count];
        for j in (0..count).rev() {
            let known: f64 =
                (1..self.order.min(count - j)).map(|i| self.r[j][i] * solution[j + i]).sum();
            solution[j] = (self.right[j * self.sides + side] - known) / self.r[j][0];
        }
        Some(solution)
    }

    /// Returns the variance of the fitted curve where the basis is `weights` from `first` on, for
    /// observations of unit weight and variance: |R⁻ᵀ·w|².
    #[must_use]
    pub fn prediction_variance(&self, first: usize, weights: &BasisValues) -> f64 {
        let count = self.r.len();
        let mut z = vec![0.0; count - first];
        let mut sum = 0.0;
        for j in first..count {
            let own = weights.get(j - first).filter(|_| j - first < self.order).unwrap_or(&0.0);
            let known: f64 = (1..self.order.min(j - first + 1))
                .map(|i| self.r[j - i][i] * z[j - first - i])
                .sum();
            let value = (own - known) / self.r[j][0];
            z[j - first] = value;
            sum += value * value;
            // The influence of a place dies out along the band.
            if j > first + 3 * self.order && value * value < 1e-12 * sum {
                break;
            }
        }
        sum
    }
}

/// A least squares fit in given knots.
#[derive(Clone, Debug)]
pub struct SplineFit {
    /// The spline with the fitted coefficients.
    pub spline: BSpline,
    /// Weighted sum of squares of what is left.
    pub sum_of_squares: f64,
    /// The triangle, to judge what the data say of a place.
    pub triangle: BandedLeastSquares,
}

/// Returns the spline of `order` in `knots` that lies nearest to the points: x rising, weights positive.
///
/// `None` where the points do not determine it (the condition of Schoenberg and Whitney is broken,
/// or nearly).
///
/// # Panics
/// The order is not 1…4, or there are too few knots for it.
#[must_use]
pub fn fit_least_squares_spline(
    knots: Vec<f64>,
    order: usize,
    points: impl Iterator<Item = (f64, f64, f64)>,
) -> Option<SplineFit> {
    assert!((1..=MAX_SPLINE_ORDER).contains(&order) && knots.len() >= 2 * order, "no spline");
    let mut triangle = BandedLeastSquares::new(order, knots.len() - order, 1);
    let mut sum_of_squares = 0.0;
    let mut at = order - 1;
    let last = knots.len() - order - 1;
    for (x, y, weight) in points {
        while at < last && knots[at + 1] <= x {
            at += 1;
        }
        let (first, weights) = evaluate_basis_in_span(&knots, order, at, x);
        let root = weight.sqrt();
        let mut value = [y * root];
        triangle.add_observation(first, weights.map(|w| w * root), &mut value);
        sum_of_squares += value[0] * value[0];
    }
    let control_um = triangle.solve(0)?;
    let spline = BSpline { order, knots_mm: knots, control_um };
    Some(SplineFit { spline, sum_of_squares, triangle })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_way_along_one_cubic_segment_the_four_functions_weigh_an_eighth_and_three_eighths() {
        let knots = clamped_knots(4, 0.0, &[], 10.0);
        assert_eq!(evaluate_basis(&knots, 4, 5.0), (0, [0.125, 0.375, 0.375, 0.125]));
    }
    use trueup_machine::model::spline_value_um;

    fn uneven() -> BSpline {
        BSpline {
            order: 4,
            knots_mm: clamped_knots(4, -40.0, &[-13.0, 2.0, 2.0, 30.0, 31.0], 90.0),
            control_um: vec![1.0, -7.0, 3.5, 12.0, 0.25, -4.0, 8.0, 8.5, -1.0],
        }
    }

    #[test]
    fn the_basis_sums_to_one_and_gives_the_models_value() {
        let spline = uneven();
        for n in 0..=1300 {
            let x = -40.0 + f64::from(n) * 0.1;
            let (first, weights) = evaluate_basis(&spline.knots_mm, 4, x);
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-14);
            let value: f64 = (0..4).map(|j| weights[j] * spline.control_um[first + j]).sum();
            assert!((value - spline_value_um(&spline, x)).abs() < 1e-13, "at {x}");
            assert!((value - evaluate_with_derivatives(&spline, x)[0]).abs() < 1e-13, "at {x}");
        }
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let spline = uneven();
        let step = 1e-3;
        for n in 0..400 {
            let x = -39.9 + f64::from(n) * 0.3217;
            if spline.knots_mm.iter().any(|knot| (knot - x).abs() < 2.0 * step) {
                continue;
            }
            let [_, slope, curvature] = evaluate_with_derivatives(&spline, x);
            let [low, middle, high] = [x - step, x, x + step].map(|x| spline_value_um(&spline, x));
            assert!((slope - (high - low) / (2.0 * step)).abs() < 1e-4 * (1.0 + slope.abs()));
            let second = (high - 2.0 * middle + low) / (step * step);
            assert!((curvature - second).abs() < 1e-3 * (1.0 + curvature.abs()), "at {x}");
        }
    }

    #[test]
    fn the_steepest_place_of_a_parabola_is_its_end() {
        // 10·u² over u = x/10 in 0…1: the slope is 2 µm/mm at the end, the curvature 0.2.
        let parabola = BSpline {
            order: 3,
            knots_mm: clamped_knots(3, 0.0, &[], 10.0),
            control_um: vec![0.0, 0.0, 10.0],
        };
        let (slope, curvature) = max_slope_and_curvature(&parabola, 9);
        assert!((slope - 2.0).abs() < 1e-6 && (curvature - 0.2).abs() < 1e-9);
    }

    #[test]
    fn points_of_a_spline_give_it_back() {
        let spline = uneven();
        let points = (0..=650).map(|n| f64::from(n) * 0.2 - 40.0);
        let points = points.map(|x| (x, spline_value_um(&spline, x), 1.0 + x.sin().abs()));
        let fit = fit_least_squares_spline(spline.knots_mm.clone(), 4, points).expect("unique");
        assert!(fit.sum_of_squares < 1e-22, "{}", fit.sum_of_squares);
        for (found, true_one) in fit.spline.control_um.iter().zip(&spline.control_um) {
            assert!((found - true_one).abs() < 1e-11);
        }
    }

    #[test]
    fn what_is_left_is_the_sum_of_squares() {
        // A line through 0, 1, 0, 1: the slope is 0.2, the sum of squares 0.8.
        let points = [(0.0, 0.0, 1.0), (1.0, 1.0, 1.0), (2.0, 0.0, 1.0), (3.0, 1.0, 1.0)];
        let line = fit_least_squares_spline(clamped_knots(2, 0.0, &[], 3.0), 2, points.into_iter())
            .expect("unique");
        assert!((line.sum_of_squares - 0.8).abs() < 1e-14);
        assert!((line.spline.control_um[0] - 0.2).abs() < 1e-14);
        // The mean of four has a quarter of the variance, at the middle of a line.
        let (first, weights) = evaluate_basis(&line.spline.knots_mm, 2, 1.5);
        assert!((line.triangle.prediction_variance(first, &weights) - 0.25).abs() < 1e-14);
    }

    #[test]
    fn each_function_needs_a_point_of_its_own() {
        let knots = clamped_knots(4, 0.0, &[5.0], 10.0);
        let determined = |x: &[f64]| satisfies_schoenberg_whitney(&knots, 4, x.iter().copied());
        assert!(determined(&[0.0, 1.0, 2.0, 6.0, 10.0]));
        assert!(determined(&[1.0, 2.0, 3.0, 4.0, 6.0]));
        assert!(!determined(&[0.0, 1.0, 2.0, 6.0]), "five functions, four points");
        assert!(!determined(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]), "none beyond 5 for the last");
    }

    #[test]
    fn an_interval_without_enough_points_is_not_unique() {
        let points = || (0..20).map(|n| (f64::from(n), 1.0, 1.0));
        let fits = |inner: &[f64]| {
            fit_least_squares_spline(clamped_knots(4, 0.0, inner, 19.0), 4, points())
        };
        assert!(fits(&[5.0, 10.0]).is_some());
        // Five knots between two points: no point decides between them.
        assert!(fits(&[5.1, 5.2, 5.3, 5.4, 5.5]).is_none());
        assert!(
            fit_least_squares_spline(clamped_knots(4, 0.0, &[], 19.0), 4, points().take(3))
                .is_none()
        );
    }
}
