//! Straightness: the error of one axis while another moves, as a B-spline with few coefficients.
//!
//! ```text
//! readings ─► sites: mean and scatter at each position ─► less the reference line ─► spline
//! ```
//!
//! Two methods. [`Method::Paper`] takes data points as control points, as `physics.md` section 4
//! tells it. [`Method::LeastSquares`] fits by least squares, with knots placed where they are
//! needed, and takes one more as long as it has reason to:
//!
//! - it stops at the fewest coefficients with which every residual is within the tolerance; where
//!   the least sum of squares misses that by little, knots that flatten the largest residual are
//!   tried (the values stay those of plain least squares);
//! - and it stops where a further knot would follow noise: at the minimum of the generalised
//!   cross-validation S/N/(1 − p/N)² (Craven and Wahba), with S the sum of squares of all N readings
//!   (the scatter at equal positions included, so that repeats count) and p the coefficients and the
//!   free knots together. The minimum counts as found when [`PATIENCE`] further knots have not
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
//! Which straight line is the reference of a straightness measurement is the user's to say
//! ([`Reference`]): a line that is taken away is named in the result, with its two constants.
//! Outside the measured range the end values are held, by board and model alike.

mod compare;
mod knots;
mod paper;
mod run;
mod sites;

use std::{error::Error, fmt};

use statrs::distribution::{ContinuousCDF as _, FisherSnedecor};
use trueup_machine::machine_file::BSpline;

pub use compare::{Compared, Residual};
pub use run::{Curve, fit_run};
pub use sites::Line;

use crate::bspline::{clamped, least_squares};
use knots::{ORDER, Search, Support};
use sites::Sites;

/// How many further knots may fail to gain before the search ends.
pub const PATIENCE: usize = 2;

/// More coefficients are no table for a board, and no fit but a filter.
pub const MOST_COEFFICIENTS: usize = 128;

/// Knots are looked for over at most so many sites; of more, neighbours are joined. The fit itself,
/// its residuals and the criterion take all of them.
const MOST_CELLS: usize = 600;

/// What is asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// The largest residual allowed, in µm, above 0. `None`: down to the noise.
    pub tolerance_um: Option<f64>,
    /// How the curve is found.
    pub method: Method,
    /// The straight line from which the error counts.
    pub reference: Reference,
    /// At most so many coefficients; at least 2 and at most [`MOST_COEFFICIENTS`] are used.
    pub most_coefficients: usize,
}

impl Default for Options {
    /// Least squares down to the noise, of the readings as they are.
    fn default() -> Self {
        Self {
            tolerance_um: None,
            method: Method::LeastSquares,
            reference: Reference::AsMeasured,
            most_coefficients: MOST_COEFFICIENTS,
        }
    }
}

/// How a curve is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Data points as control points, the worst residual joins (seed 003). Without a tolerance it
    /// takes the largest residual that least squares leaves.
    Paper,
    /// Least squares, knots where they are needed.
    LeastSquares,
}

/// The straight line from which a straightness error counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reference {
    /// None is taken away: the readings are errors already, a slope among them is squareness or
    /// alignment.
    AsMeasured,
    /// Through the means at the two end positions.
    EndPoints,
    /// The least squares line through all readings.
    LeastSquares,
}

impl fmt::Display for Reference {
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
pub enum Stop {
    /// Every residual is within the tolerance.
    Tolerance,
    /// A further knot would follow noise.
    Noise,
    /// There are no points left to place a further knot by.
    Points,
    /// [`Options::most_coefficients`] is reached.
    Coefficients,
}

impl fmt::Display for Stop {
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
pub struct Noise {
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
pub struct Fit {
    /// In the machine file's terms: µm over mm, less the reference line.
    pub spline: BSpline,
    /// How it was found.
    pub method: Method,
    /// The reference that was asked for, and the line that was therefore taken away.
    pub reference: Reference,
    /// The line itself, zero for [`Reference::AsMeasured`].
    pub line: Line,
    /// The least squares line that is left in the readings: for [`Reference::AsMeasured`] the slope
    /// that may be alignment.
    pub line_left: Line,
    /// Why there are not more coefficients.
    pub stopped: Stop,
    /// The tolerance that was asked for, in µm.
    pub tolerance_um: Option<f64>,
    /// Whether every residual is within it; true where none was asked for.
    pub is_within_tolerance: bool,
    /// What is left at the sites.
    pub residual: Residual,
    /// The noise of one reading; `None` where as many coefficients as readings leave nothing.
    pub noise: Option<Noise>,
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
    /// What the user should know, a sentence each.
    pub warnings: Vec<String>,
    /// The limit that was asked for.
    most_coefficients: usize,
    /// The readings by position, for the comparison.
    sites: Sites,
}

/// Why there is no fit.
#[derive(Clone, Debug, PartialEq)]
pub enum FitError {
    /// There are not as many errors as positions.
    LengthsDiffer {
        /// Positions.
        positions: usize,
        /// Errors.
        errors: usize,
    },
    /// A value is NaN or infinite.
    NotFinite {
        /// Its row, from 0.
        row: usize,
        /// Whether it is the position; else the error.
        is_position: bool,
        /// The value.
        value: f64,
    },
    /// Fewer than 4 different positions: no curve, and no judging it.
    TooFewPositions {
        /// Different positions that are there.
        positions: usize,
    },
    /// All readings stand at one position.
    OnePosition {
        /// Where, in mm.
        position_mm: f64,
    },
    /// The tolerance is not above 0.
    Tolerance {
        /// The tolerance, in µm.
        um: f64,
    },
}

impl fmt::Display for FitError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::LengthsDiffer { positions, errors } => {
                write!(f, "there are {positions} positions but {errors} errors")
            }
            Self::NotFinite { row, is_position, value } => {
                let what = if *is_position { "position" } else { "error" };
                write!(f, "the {what} in row {row} is {value}")
            }
            Self::TooFewPositions { positions } => write!(
                f,
                "has readings at {positions} different positions: a curve needs at least 4"
            ),
            Self::OnePosition { position_mm } => write!(
                f,
                "is {position_mm} in every row: a curve needs at least 4 different positions"
            ),
            Self::Tolerance { um } => write!(f, "the tolerance must be above 0 µm, not {um}"),
        }
    }
}

impl Error for FitError {}

/// The curve through readings of `error_um` at positions `along_mm`, in any order; readings at
/// equal positions are repeats.
///
/// # Errors
/// See [`FitError`].
pub fn fit(along_mm: &[f64], error_um: &[f64], options: &Options) -> Result<Fit, FitError> {
    if let Some(um) = options.tolerance_um
        && !(um > 0.0 && um.is_finite())
    {
        return Err(FitError::Tolerance { um });
    }
    let mut sites = Sites::of(along_mm, error_um)?;
    let line = sites.subtract(options.reference);
    let found = Found::of(&sites, options);
    let residual = Residual::of(&sites.residuals(&found.spline));
    let (noise, standard_error_um) = noise_of(&sites, &found);
    let tolerance_um = options.tolerance_um;
    let (slope_um_per_mm, curvature_um_per_mm2) = crate::bspline::steepest(&found.spline, 9);
    let mut fit = Fit {
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
    fit.warn();
    Ok(fit)
}

impl Fit {
    /// The same data by the paper's way, by least squares, by a polynomial of degree 7 and by
    /// straight lines, each also on positions that it has not seen.
    #[must_use]
    pub fn compare(&self) -> Vec<Compared> {
        compare::table(self)
    }

    fn warn(&mut self) {
        /// A linear axis shorter than that is rather one whose positions are in metres.
        const SHORT_MM: f64 = 20.0;
        let [first, last] = self.sites.ends();
        let travel = last - first;
        if travel < SHORT_MM {
            self.warnings.push(format!(
                "the positions span {travel} mm: if they are metres, multiply them by 1000"
            ));
        }
        let limit = trueup_machine::compile::STEEPEST_UM_PER_MM;
        if self.slope_um_per_mm > limit {
            self.warnings.push(format!(
                "the curve is as steep as {:.1} µm/mm, and a board takes at most {limit}",
                self.slope_um_per_mm
            ));
        }
        if let Some(tolerance) = self.tolerance_um
            && !self.is_within_tolerance
        {
            let mut warning = format!(
                "the largest residual is {:.2} µm, the tolerance {tolerance} µm: {}",
                self.residual.largest_um, self.stopped
            );
            if let (Stop::Noise, Some(noise)) = (self.stopped, self.noise) {
                warning += &format!(" (one reading scatters by {:.2} µm)", noise.um);
            }
            self.warnings.push(warning);
        }
    }
}

/// A spline, and why it has no more coefficients.
struct Found {
    spline: BSpline,
    stopped: Stop,
}

impl Found {
    fn of(sites: &Sites, options: &Options) -> Self {
        match options.method {
            Method::LeastSquares => Self::least_squares(sites, options),
            Method::Paper => {
                let tolerance = options.tolerance_um.unwrap_or_else(|| {
                    let best = Self::least_squares(sites, options);
                    Residual::of(&sites.residuals(&best.spline)).largest_um
                });
                let (spline, is_within) = paper::fit(sites, tolerance, paper::Control::Readings);
                Self { spline, stopped: if is_within { Stop::Tolerance } else { Stop::Points } }
            }
        }
    }

    fn least_squares(sites: &Sites, options: &Options) -> Self {
        let cells = sites.thinned(MOST_CELLS);
        let found = Self::with_support(sites, &cells, options, Support::EverySecond);
        let is_short_of_points = found.stopped == Stop::Points && options.tolerance_um.is_some();
        if !is_short_of_points {
            return found;
        }
        let second = Self::with_support(sites, &cells, options, Support::All);
        if second.stopped == Stop::Tolerance { second } else { found }
    }

    fn with_support(sites: &Sites, cells: &Sites, options: &Options, support: Support) -> Self {
        let mut path = Path::new(sites, cells, options);
        for order in 2..ORDER {
            path.take(&[], order);
        }
        let search = Search::new(cells, support);
        let mut placed = search.place(Vec::new());
        loop {
            let Some(at) = placed else { return path.end(Stop::Points) };
            path.take(&at.inner, ORDER);
            if path.is_near_tolerance() {
                for inner in search.flattened(&at) {
                    path.try_within(&inner);
                }
            }
            if path.is_settled() {
                return path.end(Stop::Noise);
            }
            let coefficients = ORDER + at.inner.len() + 1;
            if coefficients > options.most_coefficients.min(MOST_COEFFICIENTS) {
                return path.end(Stop::Coefficients);
            }
            // A knot counts for its place and for its coefficient, and something has to be left.
            if coefficients + at.inner.len() + 1 >= cells.len() {
                return path.end(Stop::Points);
            }
            placed = search.one_more(&at);
        }
    }
}

/// Fits with more and more coefficients: the best of them by cross-validation, and the first
/// that is within the tolerance.
struct Path<'s> {
    sites: &'s Sites,
    cells: &'s Sites,
    options: &'s Options,
    /// The straight line's sum of squares.
    line: Option<(f64, BSpline)>,
    best: Option<Best>,
    /// Fits since the best.
    since: usize,
    /// The largest residual of the newest fit.
    largest: f64,
    within: Option<BSpline>,
    /// The best came with the fit that is within the tolerance, or after it: that one follows no
    /// noise.
    is_within_sound: bool,
    /// Nothing is left but the arithmetic's own rounding.
    is_exact: bool,
}

/// The best fit so far.
struct Best {
    criterion: f64,
    sum_of_squares: f64,
    /// Coefficients and free knots.
    free: usize,
    spline: BSpline,
}

impl<'s> Path<'s> {
    fn new(sites: &'s Sites, cells: &'s Sites, options: &'s Options) -> Self {
        Self {
            sites,
            cells,
            options,
            line: None,
            best: None,
            since: 0,
            largest: f64::INFINITY,
            within: None,
            is_within_sound: false,
            is_exact: false,
        }
    }

    /// The least squares fit in these knots joins.
    fn take(&mut self, inner: &[f64], order: usize) {
        let count = inner.len() + order;
        if count > self.options.most_coefficients.max(2) {
            return;
        }
        let [first, last] = self.sites.ends();
        let knots = clamped(order, first, &rounded(inner, first, last), last);
        let Some(fit) = least_squares(knots, order, self.sites.points()) else {
            self.since += 1;
            return;
        };
        let rows = self.sites.rows as f64;
        // Readings of nothing but a spline leave rounding: no criterion is asked about that.
        let scale = self.sites.y.iter().map(|y| y.abs()).fold(0.0, f64::max);
        let floor = rows * (1e-9 * scale).powi(2) + f64::MIN_POSITIVE;
        self.is_exact = fit.sum_of_squares <= floor;
        let sum_of_squares = fit.sum_of_squares + self.sites.within;
        let free = count + inner.len();
        let share = 1.0 - free as f64 / rows;
        let criterion = sum_of_squares.max(floor) / (share * share);
        let is_best = share > 0.0 && self.best.as_ref().is_none_or(|it| criterion < it.criterion);

        if order == 2 {
            self.line = Some((sum_of_squares, fit.spline.clone()));
        }
        if let Some(tolerance) = self.options.tolerance_um
            && self.within.is_none()
        {
            self.largest = Residual::of(&self.sites.residuals(&fit.spline)).largest_um;
            if self.largest <= tolerance {
                self.within = Some(fit.spline.clone());
            }
        }
        if is_best {
            self.is_within_sound = self.within.is_some();
            self.best = Some(Best { criterion, sum_of_squares, free, spline: fit.spline });
            self.since = 0;
        } else {
            self.since += 1;
        }
    }

    /// Whether the newest fit, the best so far, misses the tolerance by little.
    fn is_near_tolerance(&self) -> bool {
        const LITTLE: f64 = 2.0;
        let limit = self.options.tolerance_um.map_or(0.0, |tolerance| LITTLE * tolerance);
        self.within.is_none() && self.since == 0 && self.largest <= limit
    }

    /// As many knots as the newest fit has, elsewhere: is it within the tolerance with them?
    fn try_within(&mut self, inner: &[f64]) {
        let [first, last] = self.sites.ends();
        let knots = clamped(ORDER, first, &rounded(inner, first, last), last);
        let fit = least_squares(knots, ORDER, self.sites.points());
        let (Some(fit), Some(tolerance), None) = (fit, self.options.tolerance_um, &self.within)
        else {
            return;
        };
        if Residual::of(&self.sites.residuals(&fit.spline)).largest_um <= tolerance {
            self.within = Some(fit.spline);
            self.is_within_sound = true;
        }
    }

    /// Whether further knots are of no use.
    fn is_settled(&self) -> bool {
        let is_noise = || self.best.as_ref().is_some_and(|best| !self.has_pattern(&best.spline));
        self.is_within_sound || self.is_exact || (self.since >= PATIENCE && is_noise())
    }

    /// Whether what a curve leaves goes on from one site to the next: von Neumann's ratio of the
    /// mean square of successive differences to the variance is 2 for noise, and smaller then.
    fn has_pattern(&self, spline: &BSpline) -> bool {
        /// The 1 % point of the normal distribution.
        const SELDOM: f64 = 2.326;
        let left = self.cells.residuals(spline);
        let count = left.len() as f64;
        let squares: f64 = left.iter().map(|r| r * r).sum();
        let successive: f64 = left.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum();
        let deviation = (1.0 / count).sqrt();
        1.0 - 0.5 * successive / squares > SELDOM * deviation
    }

    /// Whether the best is better than a straight line by more than its coefficients explain.
    fn is_curved(&self, best: &Best) -> bool {
        const LEVEL: f64 = 1e-3;
        let (Some((line, _)), freedom) = (&self.line, self.sites.rows.saturating_sub(best.free))
        else {
            return true;
        };
        let (more, freedom) = ((best.free - 2) as f64, freedom as f64);
        let Ok(fisher) = FisherSnedecor::new(more, freedom) else { return true };
        let ratio = (line - best.sum_of_squares) / more / (best.sum_of_squares / freedom);
        !ratio.is_finite() || fisher.sf(ratio.max(0.0)) < LEVEL
    }

    /// The result, given why the search has ended.
    fn end(self, stopped: Stop) -> Found {
        if let Some(spline) = self.within.clone().filter(|_| self.is_within_sound) {
            return Found { spline, stopped: Stop::Tolerance };
        }
        let best = self.best.as_ref().expect("a line fits any 4 positions");
        match &self.line {
            Some((_, line)) if best.free > 2 && !self.is_curved(best) => {
                Found { spline: line.clone(), stopped: Stop::Noise }
            }
            _ => Found { spline: best.spline.clone(), stopped },
        }
    }
}

/// Inner knots to a micrometre where that leaves them apart: nobody places a knot better than that,
/// and a machine file is read by people.
fn rounded(inner: &[f64], first: f64, last: f64) -> Vec<f64> {
    let before = std::iter::once(first).chain(inner.iter().copied());
    let after = inner.iter().copied().chain(std::iter::once(last));
    let are_apart = before.zip(after).all(|(low, high)| high - low > 0.1);
    inner.iter().map(|&knot| if are_apart { (knot * 1e3).round() / 1e3 } else { knot }).collect()
}

/// The noise of one reading, and the largest standard error of the curve.
fn noise_of(sites: &Sites, found: &Found) -> (Option<Noise>, Option<f64>) {
    /// Fewer degrees of freedom than that say little of a standard deviation.
    const ENOUGH: usize = 5;
    let BSpline { order, knots_mm, control_um } = &found.spline;
    let free = 2 * control_um.len() - order;
    let left: f64 =
        sites.residuals(&found.spline).iter().zip(&sites.weight).map(|(r, w)| w * r * r).sum();
    let noise = |squares: f64, freedom: usize, from_repeats| Noise {
        um: (squares / freedom as f64).sqrt(),
        freedom,
        from_repeats,
    };
    let noise = match sites.within_freedom() {
        freedom @ ENOUGH.. => Some(noise(sites.within, freedom, true)),
        _ => sites
            .rows
            .checked_sub(free)
            .filter(|&freedom| freedom > 0)
            .map(|freedom| noise(left + sites.within, freedom, false)),
    };
    let fit = least_squares(knots_mm.clone(), *order, sites.points());
    let error = noise.zip(fit).map(|(noise, fit)| {
        const PLACES: u32 = 400;
        let [first, last] = sites.ends();
        let variance = |n: u32| {
            let x = first + (last - first) * f64::from(n) / f64::from(PLACES);
            let (first, weights) = crate::bspline::basis(knots_mm, *order, x);
            fit.triangle.variance(first, &weights)
        };
        noise.um * (0..=PLACES).map(variance).fold(0.0, f64::max).sqrt()
    });
    (noise, error)
}
