//! A curve as each of the [ways](super::CurveMethod) has it: value, slope, curvature, and the corners of lines.

use trueup_machine::{machine_file::BSpline, model::spline_value_um};
use trueup_numerics::least_squares::GivensQr;

use super::{residual::ResidualSummary, sites::Sites};
use crate::bspline::{evaluate_with_derivatives, max_slope_and_curvature};

/// A curve of any of the ways.
#[derive(Clone, Debug)]
pub(super) enum CurveModel {
    /// A B-spline.
    Spline(BSpline),
    /// A polynomial.
    Polynomial(ChebyshevSeries),
    /// Straight lines through these points.
    Lines {
        /// Positions in mm, rising.
        x: Vec<f64>,
        /// Values in µm.
        y: Vec<f64>,
    },
}

impl CurveModel {
    /// Its value in µm.
    pub(super) fn evaluate(&self, x_mm: f64) -> f64 {
        match self {
            Self::Spline(spline) => spline_value_um(spline, x_mm),
            Self::Polynomial(polynomial) => polynomial.value_and_derivatives(x_mm)[0],
            Self::Lines { x, y } => {
                let n = segment_index(x, x_mm);
                y[n - 1] + segment_slope(x, y, n) * (x_mm - x[n - 1])
            }
        }
    }

    /// Its slope in µm/mm and its curvature in µm/mm²; at a corner the slope of the piece that begins there.
    pub(super) fn slope_and_curvature(&self, x_mm: f64) -> [f64; 2] {
        match self {
            Self::Spline(spline) => {
                let [_, slope, curvature] = evaluate_with_derivatives(spline, x_mm);
                [slope, curvature]
            }
            Self::Polynomial(polynomial) => {
                let [_, slope, curvature] = polynomial.value_and_derivatives(x_mm);
                [slope, curvature]
            }
            Self::Lines { x, y } => [segment_slope(x, y, segment_index(x, x_mm)), 0.0],
        }
    }

    pub(super) fn coefficient_count(&self) -> usize {
        match self {
            Self::Spline(spline) => spline.control_um.len(),
            Self::Polynomial(polynomial) => polynomial.chebyshev.len(),
            Self::Lines { x, .. } => x.len(),
        }
    }

    /// Where its slope jumps, in mm, and by how much, in µm/mm: lines alone have such corners.
    pub(super) fn slope_jumps(&self) -> Vec<[f64; 2]> {
        let Self::Lines { x, y } = self else { return Vec::new() };
        (1..x.len() - 1)
            .map(|n| [x[n], segment_slope(x, y, n + 1) - segment_slope(x, y, n)])
            .collect()
    }

    /// Largest jump of the slope in µm/mm.
    pub(super) fn max_slope_jump(&self) -> f64 {
        self.slope_jumps().iter().fold(0.0, |most, [_, jump]| f64::max(most, jump.abs()))
    }

    /// Largest absolute slope and curvature.
    pub(super) fn max_slope_and_curvature(&self) -> (f64, f64) {
        match self {
            Self::Spline(spline) => max_slope_and_curvature(spline, 9),
            Self::Polynomial(polynomial) => polynomial.max_slope_and_curvature(),
            Self::Lines { x, y } => {
                let slopes: Vec<f64> = (1..x.len()).map(|n| segment_slope(x, y, n)).collect();
                let bend = |n: usize| (slopes[n] - slopes[n - 1]) / (0.5 * (x[n + 1] - x[n - 1]));
                let largest = |values: &mut dyn Iterator<Item = f64>| {
                    values.fold(0.0, |largest: f64, value| largest.max(value.abs()))
                };
                (largest(&mut slopes.iter().copied()), largest(&mut (1..slopes.len()).map(bend)))
            }
        }
    }

    pub(super) fn residual_summary(&self, sites: &Sites) -> ResidualSummary {
        let left: Vec<f64> = sites.points().map(|(x, y, _)| y - self.evaluate(x)).collect();
        ResidualSummary::from_residuals(&left)
    }
}

/// Returns which piece of lines through `x` a position is on: that which ends with this number.
fn segment_index(x: &[f64], x_mm: f64) -> usize {
    x.partition_point(|&at| at <= x_mm).clamp(1, x.len() - 1)
}

/// Returns the slope of the piece that ends with the number `n`, in µm/mm.
fn segment_slope(x: &[f64], y: &[f64], n: usize) -> f64 {
    (y[n] - y[n - 1]) / (x[n] - x[n - 1])
}

/// A polynomial in Chebyshev's form over the measured range.
#[derive(Clone, Debug)]
pub(super) struct ChebyshevSeries {
    ends: [f64; 2],
    chebyshev: Vec<f64>,
}

impl ChebyshevSeries {
    /// Returns the least squares polynomial of `degree`, or of the highest below it that the sites allow.
    pub(super) fn fit(sites: &Sites, degree: usize) -> Self {
        let ends = sites.end_positions_mm();
        let count = (degree + 1).min(sites.len() - 1);
        let mut row = vec![0.0; count];
        for count in (1..=count).rev() {
            let mut triangle = GivensQr::new(count);
            for (x, y, weight) in sites.points() {
                let root = weight.sqrt();
                let values =
                    chebyshev_polynomials(normalise_position(ends, x)).map(|[t, ..]| root * t);
                row.iter_mut().zip(values).for_each(|(row, value)| *row = value);
                triangle.add_row(&row[..count], root * y);
            }
            if let Ok(solution) = triangle.solve() {
                return Self { ends, chebyshev: solution.coefficients };
            }
        }
        Self { ends, chebyshev: vec![0.0] }
    }

    /// Value, slope and curvature.
    fn value_and_derivatives(&self, x_mm: f64) -> [f64; 3] {
        let scale = 2.0 / (self.ends[1] - self.ends[0]);
        let mut sum = [0.0; 3];
        for (c, t) in
            self.chebyshev.iter().zip(chebyshev_polynomials(normalise_position(self.ends, x_mm)))
        {
            for (sum, t) in sum.iter_mut().zip(t) {
                *sum += c * t;
            }
        }
        [sum[0], sum[1] * scale, sum[2] * scale * scale]
    }

    fn max_slope_and_curvature(&self) -> (f64, f64) {
        const EVALUATION_INTERVALS: u32 = 500;
        (0..=EVALUATION_INTERVALS).fold((0.0_f64, 0.0_f64), |(slope, curvature), n| {
            let share = f64::from(n) / f64::from(EVALUATION_INTERVALS);
            let at = self.ends[0] + share * (self.ends[1] - self.ends[0]);
            let [_, first, second] = self.value_and_derivatives(at);
            (slope.max(first.abs()), curvature.max(second.abs()))
        })
    }
}

/// Returns a position as −1…1.
fn normalise_position([first, last]: [f64; 2], x: f64) -> f64 {
    2.0 * (x - first) / (last - first) - 1.0
}

/// Chebyshev's polynomials T₀, T₁, … at u with their first and second derivatives.
fn chebyshev_polynomials(u: f64) -> impl Iterator<Item = [f64; 3]> {
    let mut pair = ([1.0, 0.0, 0.0], [u, 1.0, 0.0]);
    std::iter::from_fn(move || {
        let (now, next) = pair;
        // T_{n+1} = 2u·T_n − T_{n−1}, differentiated once and twice.
        let after = [
            2.0 * u * next[0] - now[0],
            2.0 * (next[0] + u * next[1]) - now[1],
            2.0 * (2.0 * next[1] + u * next[2]) - now[2],
        ];
        pair = (next, after);
        Some(now)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::straightness::sites::every_10_mm;

    #[test]
    fn a_polynomial_of_degree_7_is_found_with_its_derivatives() {
        let seventh = |x: f64| (x / 100.0 - 1.0).powi(7);
        let polynomial = ChebyshevSeries::fit(&every_10_mm(21, seventh), 7);
        for x in [0.0, 13.0, 100.0, 200.0] {
            let u: f64 = x / 100.0 - 1.0;
            let expected = [u.powi(7), 7.0 * u.powi(6) / 100.0, 42.0 * u.powi(5) / 1e4];
            for (found, expected) in polynomial.value_and_derivatives(x).iter().zip(expected) {
                assert!((found - expected).abs() < 1e-12, "{found} {expected}");
            }
        }
        let (slope, curvature) = polynomial.max_slope_and_curvature();
        assert!((slope - 0.07).abs() < 1e-12 && (curvature - 0.0042).abs() < 1e-12);
    }

    #[test]
    fn few_sites_lower_the_degree() {
        assert_eq!(ChebyshevSeries::fit(&every_10_mm(5, |x| x), 7).chebyshev.len(), 4);
    }

    #[test]
    fn straight_lines_pass_through_every_point_and_bend_there() {
        let sites = every_10_mm(4, |x| if x == 10.0 { 5.0 } else { 0.0 });
        let lines = CurveModel::Lines { x: sites.x.clone(), y: sites.y.clone() };
        assert_eq!(lines.residual_summary(&sites).range_um, 0.0);
        assert_eq!(lines.evaluate(5.0), 2.5);
        assert_eq!(lines.max_slope_and_curvature(), (0.5, 0.1));
    }
}
