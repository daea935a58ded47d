//! The paper's Table 1 for the user's own data: five ways to a curve side by side.
//!
//! A line through every point leaves nothing at the points, whatever lies between them. Therefore
//! each way is also fitted to every second position and judged at the others.

use std::fmt;

use trueup_machine::{file::BSpline, model::spline_um};
use trueup_numerics::least_squares::Triangle;

use super::{
    Fit, Method, Options, paper,
    path::{Found, MOST_CELLS},
    residual::Residual,
    sites::Sites,
};

/// The feed of the paper's cut, at which corners are printed, in mm/min.
const FEED_MM_PER_MIN: f64 = 1000.0;

/// A way to a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// A B-spline through points that the paper's rule chooses, with the paper's coefficients.
    Paper,
    /// A B-spline in the paper's knots, its coefficients by least squares.
    PapersPoints,
    /// A B-spline, knots and coefficients by least squares.
    LeastSquares,
    /// A polynomial of degree 7.
    Polynomial,
    /// Straight lines from reading to reading.
    Lines,
}

impl Way {
    const ALL: [Self; 5] =
        [Self::Paper, Self::PapersPoints, Self::LeastSquares, Self::Polynomial, Self::Lines];

    /// The way of a fit by `method`.
    #[must_use]
    pub fn of(method: Method) -> Self {
        match method {
            Method::Paper => Self::Paper,
            Method::LeastSquares => Self::LeastSquares,
        }
    }
}

impl fmt::Display for Way {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Paper => "paper's way",
            Self::PapersPoints => "paper's points, least squares",
            Self::LeastSquares => "least squares",
            Self::Polynomial => "polynomial of degree 7",
            Self::Lines => "straight lines",
        })
    }
}

/// One way to a curve, and how it does.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// Which it is.
    pub way: Way,
    /// Coefficients that describe the curve.
    pub coefficients: usize,
    /// At the positions it was fitted to.
    pub residual: Residual,
    /// Fitted to every second position, at the others; `None` where these are fewer than 8.
    pub left_out: Option<Residual>,
    /// Largest absolute slope in µm/mm: speed of the correction for a feed of 1 mm/s.
    pub slope_um_per_mm: f64,
    /// Largest absolute curvature in µm/mm². For straight lines a bend over half the distance to
    /// both neighbours, which is as sharp as the data can say.
    pub curvature_um_per_mm2: f64,
    /// Largest jump of the slope at a corner, in µm/mm: at a feed of 1 mm/s the correction's speed jumps by as
    /// many µm/s. 0 for what has no corners.
    pub corner_um_per_mm: f64,
}

impl fmt::Display for Compared {
    /// One line that begins with the way's name, ASCII alone: terminals and TOML comments take it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Residual { range_um, mean_um, mean_square_um2, largest_um, .. } = self.residual;
        write!(
            f,
            "{}: {} coefficients; residual: range {range_um:.2} um, mean {:.2} um, mean square \
             {mean_square_um2:.3} um2, largest {largest_um:.2} um",
            self.way,
            self.coefficients,
            // + 0.0 turns -0 into 0.
            (mean_um * 100.0).round() / 100.0 + 0.0
        )?;
        if let Some(left) = &self.left_out {
            write!(f, "; at positions left out {:.2} um RMS", left.rms_um)?;
        }
        write!(
            f,
            "; slope up to {:.4} um/mm, curvature up to {:.2e} um/mm2",
            self.slope_um_per_mm, self.curvature_um_per_mm2
        )?;
        if self.corner_um_per_mm > 0.0 {
            let um_per_s = self.corner_um_per_mm * FEED_MM_PER_MIN / 60.0;
            write!(f, "; corners of {um_per_s:.2} um/s at {FEED_MM_PER_MIN} mm/min")?;
        }
        Ok(())
    }
}

/// A curve of any of the ways.
enum Model {
    Spline(BSpline),
    Polynomial(Polynomial),
    Lines { x: Vec<f64>, y: Vec<f64> },
}

impl Model {
    fn at(&self, x_mm: f64) -> f64 {
        match self {
            Self::Spline(spline) => spline_um(spline, x_mm),
            Self::Polynomial(polynomial) => polynomial.derivatives(x_mm)[0],
            Self::Lines { x, y } => {
                let n = x.partition_point(|&at| at <= x_mm).clamp(1, x.len() - 1);
                let share = (x_mm - x[n - 1]) / (x[n] - x[n - 1]);
                y[n - 1] + share * (y[n] - y[n - 1])
            }
        }
    }

    fn coefficients(&self) -> usize {
        match self {
            Self::Spline(spline) => spline.control_um.len(),
            Self::Polynomial(polynomial) => polynomial.chebyshev.len(),
            Self::Lines { x, .. } => x.len(),
        }
    }

    /// Largest jump of the slope in µm/mm: lines alone have any.
    fn corner(&self) -> f64 {
        let Self::Lines { x, y } = self else { return 0.0 };
        let slopes: Vec<f64> =
            (1..x.len()).map(|n| (y[n] - y[n - 1]) / (x[n] - x[n - 1])).collect();
        slopes.windows(2).fold(0.0, |most, pair| f64::max(most, (pair[1] - pair[0]).abs()))
    }

    /// Largest absolute slope and curvature.
    fn steepest(&self) -> (f64, f64) {
        match self {
            Self::Spline(spline) => crate::bspline::steepest(spline, 9),
            Self::Polynomial(polynomial) => polynomial.steepest(),
            Self::Lines { x, y } => {
                let slopes: Vec<f64> =
                    (1..x.len()).map(|n| (y[n] - y[n - 1]) / (x[n] - x[n - 1])).collect();
                let bend = |n: usize| (slopes[n] - slopes[n - 1]) / (0.5 * (x[n + 1] - x[n - 1]));
                let largest = |values: &mut dyn Iterator<Item = f64>| {
                    values.fold(0.0, |largest: f64, value| largest.max(value.abs()))
                };
                (largest(&mut slopes.iter().copied()), largest(&mut (1..slopes.len()).map(bend)))
            }
        }
    }

    fn residual(&self, sites: &Sites) -> Residual {
        let left: Vec<f64> = sites.points().map(|(x, y, _)| y - self.at(x)).collect();
        Residual::of(&left)
    }
}

/// A polynomial in Chebyshev's form over the measured range.
struct Polynomial {
    ends: [f64; 2],
    chebyshev: Vec<f64>,
}

impl Polynomial {
    /// The least squares polynomial of `degree`, or of the highest below it that the sites allow.
    fn fit(sites: &Sites, degree: usize) -> Self {
        let ends = sites.ends();
        let count = (degree + 1).min(sites.len() - 1);
        let mut row = vec![0.0; count];
        for count in (1..=count).rev() {
            let mut triangle = Triangle::new(count);
            for (x, y, weight) in sites.points() {
                let root = weight.sqrt();
                let values = chebyshev(local(ends, x)).map(|[t, ..]| root * t);
                row.iter_mut().zip(values).for_each(|(row, value)| *row = value);
                triangle.add(&row[..count], root * y);
            }
            if let Ok(solution) = triangle.solve() {
                return Self { ends, chebyshev: solution.coefficients };
            }
        }
        Self { ends, chebyshev: vec![0.0] }
    }

    /// Value, slope and curvature.
    fn derivatives(&self, x_mm: f64) -> [f64; 3] {
        let scale = 2.0 / (self.ends[1] - self.ends[0]);
        let mut sum = [0.0; 3];
        for (c, t) in self.chebyshev.iter().zip(chebyshev(local(self.ends, x_mm))) {
            for (sum, t) in sum.iter_mut().zip(t) {
                *sum += c * t;
            }
        }
        [sum[0], sum[1] * scale, sum[2] * scale * scale]
    }

    fn steepest(&self) -> (f64, f64) {
        const PLACES: u32 = 500;
        (0..=PLACES).fold((0.0_f64, 0.0_f64), |(slope, curvature), n| {
            let share = f64::from(n) / f64::from(PLACES);
            let at = self.ends[0] + share * (self.ends[1] - self.ends[0]);
            let [_, first, second] = self.derivatives(at);
            (slope.max(first.abs()), curvature.max(second.abs()))
        })
    }
}

/// A position as −1…1.
fn local([first, last]: [f64; 2], x: f64) -> f64 {
    2.0 * (x - first) / (last - first) - 1.0
}

/// Chebyshev's polynomials T₀, T₁, … at u with their first and second derivatives.
fn chebyshev(u: f64) -> impl Iterator<Item = [f64; 3]> {
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

pub(super) fn table(fit: &Fit) -> Vec<Compared> {
    let options = Options {
        tolerance_um: fit.tolerance_um,
        method: Method::LeastSquares,
        reference: fit.reference,
        most_coefficients: fit.most_coefficients,
    };
    let tolerance = fit.tolerance_um.unwrap_or(fit.residual.largest_um);
    let papers = |sites: &Sites, control| {
        Model::Spline(paper::fit(&sites.thinned(MOST_CELLS), tolerance, control).0)
    };
    let model_of = |way, sites: &Sites| match way {
        Way::Paper => papers(sites, paper::Control::Readings),
        Way::PapersPoints => papers(sites, paper::Control::LeastSquares),
        Way::LeastSquares => Model::Spline(Found::of(sites, &options).spline),
        Way::Polynomial => Model::Polynomial(Polynomial::fit(sites, 7)),
        Way::Lines => Model::Lines { x: sites.x.clone(), y: sites.y.clone() },
    };
    const ENOUGH: usize = 8;
    let halves = [0, 1].map(|from| fit.sites.every_second(from));
    let is_own = fit.method == Method::LeastSquares;
    Way::ALL
        .into_iter()
        .map(|way| {
            let model = match way {
                // It is there already.
                Way::LeastSquares if is_own => Model::Spline(fit.spline.clone()),
                _ => model_of(way, &fit.sites),
            };
            let left_out = (halves[1].len() >= ENOUGH).then(|| {
                let [_, last] = halves[0].ends();
                let half = model_of(way, &halves[0]);
                let inside = halves[1].points().filter(|&(x, ..)| x <= last);
                let left: Vec<f64> = inside.map(|(x, y, _)| y - half.at(x)).collect();
                Residual::of(&left)
            });
            let (slope_um_per_mm, curvature_um_per_mm2) = model.steepest();
            Compared {
                way,
                coefficients: model.coefficients(),
                residual: model.residual(&fit.sites),
                left_out,
                slope_um_per_mm,
                curvature_um_per_mm2,
                corner_um_per_mm: model.corner(),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sites(count: usize, error_um: impl Fn(f64) -> f64) -> Sites {
        let x: Vec<f64> = (0..count).map(|n| 10.0 * n as f64).collect();
        let y: Vec<f64> = x.iter().map(|&x| error_um(x)).collect();
        Sites::of(&x, &y).expect("sound")
    }

    #[test]
    fn a_polynomial_of_degree_7_is_found_with_its_derivatives() {
        let seventh = |x: f64| (x / 100.0 - 1.0).powi(7);
        let polynomial = Polynomial::fit(&sites(21, seventh), 7);
        for x in [0.0, 13.0, 100.0, 200.0] {
            let u: f64 = x / 100.0 - 1.0;
            let expected = [u.powi(7), 7.0 * u.powi(6) / 100.0, 42.0 * u.powi(5) / 1e4];
            for (found, expected) in polynomial.derivatives(x).iter().zip(expected) {
                assert!((found - expected).abs() < 1e-12, "{found} {expected}");
            }
        }
        let (slope, curvature) = polynomial.steepest();
        assert!((slope - 0.07).abs() < 1e-12 && (curvature - 0.0042).abs() < 1e-12);
    }

    #[test]
    fn few_sites_lower_the_degree() {
        assert_eq!(Polynomial::fit(&sites(5, |x| x), 7).chebyshev.len(), 4);
    }

    #[test]
    fn straight_lines_pass_through_every_point_and_bend_there() {
        let sites = sites(4, |x| if x == 10.0 { 5.0 } else { 0.0 });
        let lines = Model::Lines { x: sites.x.clone(), y: sites.y.clone() };
        assert_eq!(lines.residual(&sites).range_um, 0.0);
        assert_eq!(lines.at(5.0), 2.5);
        assert_eq!(lines.steepest(), (0.5, 0.1));
    }

    #[test]
    fn lines_jump_in_speed_at_their_corners_and_nothing_else_does() {
        // A roof of 1 µm in 100 mm up and down: the slope goes from 0.01 to −0.01 µm/mm, so at 1 mm/s the
        // speed jumps by 0.02 µm/s; of an axis that follows in a millisecond that asks 20 µm/s².
        let lines = Model::Lines { x: vec![0.0, 100.0, 200.0], y: vec![0.0, 1.0, 0.0] };
        assert!((lines.corner() - 0.02).abs() < 1e-12);
        let x: Vec<f64> = (0..60).map(|k| 10.0 * f64::from(k)).collect();
        let y: Vec<f64> = x.iter().map(|x| 5.0 * (x / 40.0).sin()).collect();
        let fit = super::super::fit(&x, &y, &Options::default()).expect("sound data");
        for row in fit.compare() {
            assert_eq!(row.corner_um_per_mm > 0.0, row.way == Way::Lines, "{row}");
        }
    }

    #[test]
    fn a_row_of_the_comparison_is_one_line_with_all_its_figures() {
        let residual = Residual::of(&[1.0, -1.0]);
        let row = Compared {
            way: Way::Lines,
            coefficients: 9,
            residual,
            left_out: Some(residual),
            slope_um_per_mm: 0.5,
            curvature_um_per_mm2: 0.00123,
            corner_um_per_mm: 0.06,
        };
        assert_eq!(
            row.to_string(),
            "straight lines: 9 coefficients; residual: range 2.00 um, mean 0.00 um, mean square 1.000 um2, \
             largest 1.00 um; at positions left out 1.00 um RMS; slope up to 0.5000 um/mm, \
             curvature up to 1.23e-3 um/mm2; corners of 1.00 um/s at 1000 mm/min"
        );
    }

    #[test]
    fn a_residuals_figures_are_what_the_hand_finds() {
        let residual = Residual::of(&[1.0, 3.0, -2.0, 2.0]);
        assert_eq!((residual.range_um, residual.mean_um, residual.largest_um), (5.0, 1.0, 3.0));
        assert_eq!((residual.mean_square_um2, residual.rms_um), (3.5, 4.5_f64.sqrt()));
    }
}
