//! The forms that a smooth error may have over the position of an axis.
//!
//! A cubic B-spline in even knots is split into forms by its roughness ∫ f″²: f is constant, straight, bow, S, and so on, each of
//! mean square 1 over the travel and orthogonal to all others there. They solve
//!
//! ```text
//! R·v = λ·M·v        M = mean of B·Bᵀ, R = L⁴·mean of B″·B″ᵀ over the length L
//! ```
//!
//! Constant and straight line have λ = 0 and are no forms: a constant is the zero of the set-up, the line is a scale, a squareness
//! or the slope of an angle. A form is expected to be smaller the rougher it is, with a variance in proportion to 1/λ: with one
//! unknown size for each error this is the smoothing spline, and its size is found by the marginal likelihood.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use trueup_machine::machine_file::BSpline;

use crate::bspline::{self, evaluate_with_derivatives};

/// Pieces of the spline over the travel.
const SPLINE_SPANS: usize = 8;
/// Points of a piece in the integrals.
const QUADRATURE_POINTS_PER_SPAN: usize = 16;
const SPLINE_ORDER: usize = 4;

/// The forms over the travel of an axis.
#[derive(Clone, Debug)]
pub struct SplineModes {
    /// The ends of the travel that was measured.
    pub ends_mm: [f64; 2],
    knots_mm: Vec<f64>,
    /// Control points of each form.
    shapes: Vec<DVector<f64>>,
    /// The share of each form in the expected mean square; 1 together.
    pub shares: Vec<f64>,
}

impl SplineModes {
    /// Returns the forms between two positions.
    ///
    /// # Panics
    /// The ends do not rise.
    #[must_use]
    pub fn new(ends_mm: [f64; 2]) -> Self {
        let [first, last] = ends_mm;
        assert!(last > first, "a travel");
        let piece = (last - first) / SPLINE_SPANS as f64;
        let inner: Vec<f64> = (1..SPLINE_SPANS).map(|n| first + piece * n as f64).collect();
        let knots_mm = bspline::clamped_knots(SPLINE_ORDER, first, &inner, last);
        let count = knots_mm.len() - SPLINE_ORDER;
        let basis: Vec<BSpline> = (0..count)
            .map(|own| {
                let control_um = (0..count).map(|n| f64::from(u8::from(n == own))).collect();
                BSpline { order: SPLINE_ORDER, knots_mm: knots_mm.clone(), control_um }
            })
            .collect();
        let (mut mass, mut rough) = (DMatrix::zeros(count, count), DMatrix::zeros(count, count));
        let points = SPLINE_SPANS * QUADRATURE_POINTS_PER_SPAN;
        for point in 0..points {
            let mm = first + (last - first) * (point as f64 + 0.5) / points as f64;
            let at =
                basis.iter().map(|mode| evaluate_with_derivatives(mode, mm)).collect::<Vec<_>>();
            let value = DVector::from_iterator(count, at.iter().map(|mode| mode[0]));
            let length = last - first;
            let bend =
                DVector::from_iterator(count, at.iter().map(|mode| mode[2] * length * length));
            mass += &value * value.transpose() / points as f64;
            rough += &bend * bend.transpose() / points as f64;
        }
        let root = mass.cholesky().expect("B-splines are independent").l();
        let back = root.clone().try_inverse().expect("a triangle with a diagonal above 0");
        let eigen = SymmetricEigen::new(&back * rough * back.transpose());
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        let forms = &order[2..];
        let shapes =
            forms.iter().map(|n| back.transpose() * eigen.eigenvectors.column(*n)).collect();
        let whole: f64 = forms.iter().map(|n| eigen.eigenvalues[*n].recip()).sum();
        let shares = forms.iter().map(|n| eigen.eigenvalues[*n].recip() / whole).collect();
        Self { ends_mm, knots_mm, shapes, shares }
    }

    /// Returns the number of forms.
    #[must_use]
    pub fn count(&self) -> usize {
        self.shapes.len()
    }

    /// Returns the middle of the travel.
    #[must_use]
    pub(crate) fn middle_mm(&self) -> f64 {
        0.5 * (self.ends_mm[0] + self.ends_mm[1])
    }

    /// Returns `mm`, or the end of the travel that is beyond it.
    #[must_use]
    pub(crate) fn clamp_to_travel(&self, mm: f64) -> f64 {
        mm.clamp(self.ends_mm[0], self.ends_mm[1])
    }

    /// Returns the value of each form; beyond the travel that of its end.
    #[must_use]
    pub fn evaluate(&self, mm: f64) -> Vec<f64> {
        let (first, weights) =
            bspline::evaluate_basis(&self.knots_mm, SPLINE_ORDER, self.clamp_to_travel(mm));
        let of = |shape: &DVector<f64>| -> f64 {
            weights.iter().enumerate().map(|(n, weight)| weight * shape[first + n]).sum()
        };
        self.shapes.iter().map(of).collect()
    }

    /// Returns the spline that is the sum of these amounts of the forms and a line about the middle of the travel, in units
    /// for a metre.
    #[must_use]
    pub(crate) fn to_spline(&self, amounts: &[f64], per_m: f64) -> BSpline {
        let sum = |n: usize| -> f64 {
            self.shapes.iter().zip(amounts).map(|(shape, amount)| shape[n] * amount).sum()
        };
        // A line has its control points at the means of the inner knots (Greville).
        let greville =
            |n: usize| (1..SPLINE_ORDER).map(|k| self.knots_mm[n + k]).sum::<f64>() / 3.0;
        let count = self.knots_mm.len() - SPLINE_ORDER;
        let control_um = (0..count)
            .map(|n| sum(n) + per_m * (greville(n) - self.middle_mm()) / 1000.0)
            .collect();
        BSpline { order: SPLINE_ORDER, knots_mm: self.knots_mm.clone(), control_um }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trueup_machine::model::spline_value_um;

    #[test]
    fn forms_have_mean_square_one_and_no_line() {
        let modes = SplineModes::new([-100.0, 500.0]);
        assert_eq!(modes.count(), 9);
        let mean = |of: &dyn Fn(f64, &[f64]) -> f64| -> f64 {
            let each = (0..2400).map(|n| {
                let share = (f64::from(n) + 0.5) / 2400.0;
                of(share - 0.5, &modes.evaluate(600.0 * share - 100.0))
            });
            each.sum::<f64>() / 2400.0
        };
        for one in 0..9 {
            assert!(mean(&|_, at| at[one]).abs() < 1e-2, "a constant in {one}");
            assert!(mean(&|s, at| s * at[one]).abs() < 1e-2, "a line in {one}");
            for other in 0..=one {
                let expected = f64::from(u8::from(one == other));
                assert!((mean(&|_, at| at[one] * at[other]) - expected).abs() < 2e-2);
            }
        }
        assert!((modes.shares.iter().sum::<f64>() - 1.0).abs() < 1e-9);
        assert!(modes.shares.windows(2).all(|pair| pair[1] < pair[0]));
    }

    #[test]
    fn a_spline_is_the_sum_of_its_forms_and_its_line() {
        let modes = SplineModes::new([0.0, 400.0]);
        let amounts: Vec<f64> = (0..9_u8).map(|n| 3.0 - f64::from(n)).collect();
        let spline = modes.to_spline(&amounts, 20.0);
        for mm in [0.0, 13.0, 200.0, 371.0, 400.0] {
            let forms: f64 =
                modes.evaluate(mm).iter().zip(&amounts).map(|(at, amount)| at * amount).sum();
            let expected = forms + 20.0 * (mm - 200.0) / 1000.0;
            assert!((spline_value_um(&spline, mm) - expected).abs() < 1e-9, "at {mm}");
        }
    }
}
