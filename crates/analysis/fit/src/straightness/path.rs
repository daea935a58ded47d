//! One knot after the other, until the tolerance or the noise says enough: the rules that the
//! [module](super) states.

use statrs::distribution::{ContinuousCDF as _, FisherSnedecor};
use trueup_machine::file::BSpline;

use super::{
    MAX_COEFFICIENTS, Method, Options, PATIENCE, Residual, Stop,
    knots::{ORDER, Search, Support},
    paper,
    sites::Sites,
};
use crate::bspline::{clamped, least_squares};

/// Knots are looked for over at most this many sites; of more, neighbours are joined. The fit itself,
/// its residuals and the criterion take all of them.
pub(super) const MAX_CELLS: usize = 600;

/// A spline, and why it has no more coefficients.
pub(super) struct Found {
    pub(super) spline: BSpline,
    pub(super) stopped: Stop,
}

impl Found {
    pub(super) fn of(sites: &Sites, options: &Options) -> Self {
        match options.method {
            Method::LeastSquares => Self::least_squares(sites, options),
            Method::Paper => {
                let tolerance = options.tolerance_um.unwrap_or_else(|| {
                    let best = Self::least_squares(sites, options);
                    Residual::of(&sites.residuals(&best.spline)).largest_um
                });
                let paper::Chosen { spline, is_within, .. } =
                    paper::fit(sites, tolerance, paper::Control::Readings);
                Self { spline, stopped: if is_within { Stop::Tolerance } else { Stop::Points } }
            }
        }
    }

    fn least_squares(sites: &Sites, options: &Options) -> Self {
        let cells = sites.thinned(MAX_CELLS);
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
            if coefficients > options.most_coefficients.min(MAX_COEFFICIENTS) {
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

    /// Returns whether the newest fit, the best so far, misses the tolerance by little.
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

    /// Returns whether further knots are of no use.
    fn is_settled(&self) -> bool {
        let is_noise = || self.best.as_ref().is_some_and(|best| !self.has_pattern(&best.spline));
        self.is_within_sound || self.is_exact || (self.since >= PATIENCE && is_noise())
    }

    /// Returns whether what a curve leaves goes on from one site to the next: von Neumann's ratio of the
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

    /// Returns whether the best is better than a straight line by more than its coefficients explain.
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

    /// Returns the result, given why the search has ended.
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

/// Inner knots to a micrometre where that leaves them apart: no knot is placed better than that,
/// and a machine file is read by people.
fn rounded(inner: &[f64], first: f64, last: f64) -> Vec<f64> {
    let before = std::iter::once(first).chain(inner.iter().copied());
    let after = inner.iter().copied().chain(std::iter::once(last));
    let are_apart = before.zip(after).all(|(low, high)| high - low > 0.1);
    inner.iter().map(|&knot| if are_apart { (knot * 1e3).round() / 1e3 } else { knot }).collect()
}
