//! Straightness: the error of one axis while another moves, as a B-spline with few coefficients.
//!
//! ```text
//! readings ─► sites: mean and scatter at each position ─► less the reference line ─► spline
//! ```
//!
//! Two methods. [`FitMethod::Paper`] takes data points as control points, as in section 4 of
//! `docs/physics.md`. [`FitMethod::LeastSquares`] fits by least squares, with knots placed where they are
//! needed, and takes one more as long as it has reason to:
//!
//! - it stops at the fewest coefficients with which every residual is within the tolerance; where
//!   the least sum of squares misses that by little, knots that flatten the largest residual are
//!   tried (the values stay those of plain least squares);
//! - and it stops where a further knot would follow noise: at the minimum of the generalised
//!   cross-validation S/N/(1 − p/N)² (Craven and Wahba), with S the sum of squares of all N readings
//!   (the scatter at equal positions included, so that repeats count) and p the coefficients and the
//!   free knots together. The minimum counts as found when `MAX_KNOTS_WITHOUT_GAIN` further knots have not
//!   lowered it and what is left has no pattern along the axis (von Neumann's ratio of successive
//!   differences, at 1 %): a wave of many periods needs many knots before the first gains anything.
//!
//! Polynomials of degree 1 to 3 come first, as splines of order 2 to 4 without inner knots. Unless
//! the curve is better than the straight line by Fisher's test at 0.1 %, the line is the answer: so
//! noise alone gives no curve.
//!
//! A knot stands only where the points around it would suffice if every second one were missing.
//! If the tolerance is not met so, for want of points and not for noise, each coefficient may rest
//! on a single point.
//!
//! Measured: for one tolerance on 60 seeded guideways the median number of coefficients is 0.85 of
//! what FITPACK's `splrep` needs, and never more (`host-tests/tests/scipy_splines.rs`); fewer than
//! the paper's way in all of 48 curves with the paper's travels and amplitudes, each within its
//! residual (`tests/fit/straightness_paper.rs`); a real bed's profile predicted at points not used
//! within 0.60 µm RMS by 10 coefficients (`tests/fit/straightness_bed.rs`).
//!
//! Which straight line is the reference of a straightness measurement is the user's to say
//! ([`ReferenceLine`]): a line that is taken away is named in the result, with its two constants.
//! Outside the measured range the end values are held, by board and model alike.

mod knot_placement;
mod knot_selection;
mod method_comparison;
pub mod method_table;
mod model;
mod paper_method;
mod residual;
mod run_fit;
mod sites;

use std::fmt;

use trueup_machine::machine_file::BSpline;

pub use method_comparison::{CurveMethod, MethodPerformance};
pub use residual::ResidualSummary;
pub use run_fit::{StraightnessCurve, fit_straightness_run};
pub use sites::StraightLine;

use crate::bspline::fit_least_squares_spline;
use knot_selection::SelectedSpline;
use sites::Sites;

/// How many further knots may fail to gain before the search ends.
pub(crate) const MAX_KNOTS_WITHOUT_GAIN: usize = 2;

/// With more coefficients a curve is too large for a board, and follows the noise.
pub(crate) const MAX_COEFFICIENTS: usize = 128;

/// Tolerance, method and limits of the fit.
#[derive(Clone, Debug, PartialEq)]
pub struct StraightnessFitOptions {
    /// The largest residual allowed, in µm, above 0. `None`: down to the noise.
    pub tolerance_um: Option<f64>,
    /// How the curve is found.
    pub method: FitMethod,
    /// The straight line from which the error counts.
    pub reference: ReferenceLine,
    /// At most this many coefficients; at least 2 and at most `MAX_COEFFICIENTS` are used.
    pub most_coefficients: usize,
}

impl Default for StraightnessFitOptions {
    /// Least squares down to the noise, of the readings as they are.
    fn default() -> Self {
        Self {
            tolerance_um: None,
            method: FitMethod::LeastSquares,
            reference: ReferenceLine::AsMeasured,
            most_coefficients: MAX_COEFFICIENTS,
        }
    }
}

/// How a curve is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FitMethod {
    /// Data points as control points, the worst residual joins (the paper's way). Without a tolerance it
    /// takes the largest residual that least squares leaves.
    Paper,
    /// Least squares, knots where they are needed.
    LeastSquares,
}

/// The straight line from which a straightness error counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReferenceLine {
    /// None is taken away: the readings are errors already, a slope among them is squareness or
    /// alignment.
    AsMeasured,
    /// Through the means at the two end positions.
    EndPoints,
    /// The least squares line through all readings.
    LeastSquares,
}

impl fmt::Display for ReferenceLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::AsMeasured => "none, as measured",
            Self::EndPoints => "through the end points",
            Self::LeastSquares => "least squares",
        })
    }
}

/// Why no further coefficient was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopReason {
    /// Every residual is within the tolerance.
    Tolerance,
    /// A further knot would follow noise.
    Noise,
    /// There are no points left to place a further knot by.
    Points,
    /// [`StraightnessFitOptions::most_coefficients`] is reached.
    Coefficients,
}

impl fmt::Display for StopReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Tolerance => "every residual is within the tolerance",
            Self::Noise => "a further knot would follow noise",
            Self::Points => "too few positions for a further knot",
            Self::Coefficients => "no further coefficient is allowed",
        })
    }
}

/// How large the noise of one reading is, and how that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseEstimate {
    /// Standard deviation of one reading, in µm.
    pub um: f64,
    /// Degrees of freedom of the estimate.
    pub freedom: usize,
    /// From readings at equal positions; else from what the curve leaves, which is too much where
    /// the tolerance stopped it before the noise.
    pub from_repeats: bool,
}

/// A fitted curve.
#[derive(Clone, Debug)]
pub struct StraightnessFit {
    /// In the machine file's terms: µm over mm, less the reference line.
    pub spline: BSpline,
    /// How it was found.
    pub method: FitMethod,
    /// The reference that was requested, and the line that was therefore taken away.
    pub reference: ReferenceLine,
    /// The line itself, zero for [`ReferenceLine::AsMeasured`].
    pub line: StraightLine,
    /// The least squares line that is left in the readings: for [`ReferenceLine::AsMeasured`] the slope
    /// that may be alignment.
    pub line_left: StraightLine,
    /// Why there are not more coefficients.
    pub stopped: StopReason,
    /// The tolerance that was requested, in µm.
    pub tolerance_um: Option<f64>,
    /// Whether every residual is within it; true where none was requested.
    pub is_within_tolerance: bool,
    /// The residuals at the sites.
    pub residual: ResidualSummary,
    /// The noise of one reading; `None` where as many coefficients as readings leave nothing.
    pub noise: Option<NoiseEstimate>,
    /// Largest standard error of the curve within the measured range, in µm, from `noise`: how well
    /// the curve itself is known.
    pub standard_error_um: Option<f64>,
    /// Readings that were used.
    pub rows: usize,
    /// Different positions among them.
    pub positions: usize,
    /// Largest absolute slope in µm/mm.
    pub slope_um_per_mm: f64,
    /// Largest absolute curvature in µm/mm².
    pub curvature_um_per_mm2: f64,
    /// Warnings for the user, a sentence each.
    pub warnings: Vec<String>,
    /// The limit that was requested.
    most_coefficients: usize,
    /// The readings by position, for the comparison.
    sites: Sites,
}

/// Why there is no fit.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StraightnessFitError {
    /// There are not as many errors as positions.
    #[error("there are {positions} positions but {errors} errors")]
    LengthsDiffer {
        /// Number of positions.
        positions: usize,
        /// Number of errors.
        errors: usize,
    },
    /// A value is NaN or infinite.
    #[error("the {} in row {row} is {value}", if *.is_position { "position" } else { "error" })]
    NotFinite {
        /// Its row, from 0.
        row: usize,
        /// Whether it is the position; else the error.
        is_position: bool,
        /// The value that is not finite, in mm (a position) or µm (an error).
        value: f64,
    },
    /// Fewer than 4 different positions: no curve, and no judging it.
    #[error("has readings at {positions} different positions: a curve needs at least 4")]
    TooFewPositions {
        /// Different positions that are there.
        positions: usize,
    },
    /// All readings stand at one position.
    #[error("is {position_mm} in every row: a curve needs at least 4 different positions")]
    OnePosition {
        /// Where, in mm.
        position_mm: f64,
    },
    /// The tolerance is not above 0.
    #[error("the tolerance must be above 0 µm, not {um}")]
    Tolerance {
        /// The tolerance, in µm.
        um: f64,
    },
}

/// Returns the curve through readings of `error_um` at positions `along_mm`, in any order; readings at
/// equal positions are repeats.
///
/// # Errors
/// See [`StraightnessFitError`].
pub fn fit(
    along_mm: &[f64],
    error_um: &[f64],
    options: &StraightnessFitOptions,
) -> Result<StraightnessFit, StraightnessFitError> {
    if let Some(um) = options.tolerance_um
        && !(um > 0.0 && um.is_finite())
    {
        return Err(StraightnessFitError::Tolerance { um });
    }
    let mut sites = Sites::from_readings(along_mm, error_um)?;
    let line = sites.subtract_reference_line(options.reference);
    let found = SelectedSpline::select(&sites, options);
    let residual = ResidualSummary::from_residuals(&sites.residuals(&found.spline));
    let (noise, standard_error_um) = estimate_noise(&sites, &found);
    let tolerance_um = options.tolerance_um;
    let (slope_um_per_mm, curvature_um_per_mm2) =
        crate::bspline::max_slope_and_curvature(&found.spline, 9);
    let mut fit = StraightnessFit {
        method: options.method,
        reference: options.reference,
        line,
        line_left: sites.least_squares_line(),
        stopped: found.stopped,
        tolerance_um,
        is_within_tolerance: tolerance_um.is_none_or(|um| residual.largest_um <= um),
        residual,
        noise,
        standard_error_um,
        rows: sites.rows,
        positions: sites.len(),
        slope_um_per_mm,
        curvature_um_per_mm2,
        warnings: Vec::new(),
        most_coefficients: options.most_coefficients,
        spline: found.spline,
        sites,
    };
    fit.add_warnings();
    Ok(fit)
}

impl StraightnessFit {
    /// Returns the same data by the paper's way, by least squares, by a polynomial of degree 7 and by
    /// straight lines, each also on positions that it has not seen.
    #[must_use]
    pub fn compare_methods(&self) -> Vec<MethodPerformance> {
        method_comparison::compare_methods(self)
    }

    fn add_warnings(&mut self) {
        /// A linear axis shorter than that is rather one whose positions are in metres.
        const MIN_PLAUSIBLE_TRAVEL_MM: f64 = 20.0;
        let [first, last] = self.sites.end_positions_mm();
        let travel = last - first;
        if travel < MIN_PLAUSIBLE_TRAVEL_MM {
            self.warnings.push(format!(
                "the positions span {travel} mm: if they are metres, multiply them by 1000"
            ));
        }
        if let Some(tolerance) = self.tolerance_um
            && !self.is_within_tolerance
        {
            let mut warning = format!(
                "the largest residual is {:.2} µm, the tolerance {tolerance} µm: {}",
                self.residual.largest_um, self.stopped
            );
            if let (StopReason::Noise, Some(noise)) = (self.stopped, self.noise) {
                warning += &format!(" (one reading scatters by {:.2} µm)", noise.um);
            }
            self.warnings.push(warning);
        }
    }
}

/// Returns the noise of one reading, and the largest standard error of the curve.
fn estimate_noise(sites: &Sites, found: &SelectedSpline) -> (Option<NoiseEstimate>, Option<f64>) {
    /// Fewer degrees of freedom than that say little of a standard deviation.
    const MIN_DEGREES_OF_FREEDOM: usize = 5;
    let BSpline { order, knots_mm, control_um } = &found.spline;
    let free = 2 * control_um.len() - order;
    let left: f64 =
        sites.residuals(&found.spline).iter().zip(&sites.weight).map(|(r, w)| w * r * r).sum();
    let noise = |squares: f64, freedom: usize, from_repeats| NoiseEstimate {
        um: (squares / freedom as f64).sqrt(),
        freedom,
        from_repeats,
    };
    let noise = match sites.within_site_degrees_of_freedom() {
        freedom @ MIN_DEGREES_OF_FREEDOM.. => Some(noise(sites.within, freedom, true)),
        _ => sites
            .rows
            .checked_sub(free)
            .filter(|&freedom| freedom > 0)
            .map(|freedom| noise(left + sites.within, freedom, false)),
    };
    let fit = fit_least_squares_spline(knots_mm.clone(), *order, sites.points());
    let error = noise.zip(fit).map(|(noise, fit)| {
        const EVALUATION_INTERVALS: u32 = 400;
        let [first, last] = sites.end_positions_mm();
        let variance = |n: u32| {
            let x = first + (last - first) * f64::from(n) / f64::from(EVALUATION_INTERVALS);
            let (first, weights) = crate::bspline::evaluate_basis(knots_mm, *order, x);
            fit.triangle.prediction_variance(first, &weights)
        };
        noise.um * (0..=EVALUATION_INTERVALS).map(variance).fold(0.0, f64::max).sqrt()
    });
    (noise, error)
}
