//! One knot after the other, until the tolerance or the noise says enough: the rules that the
//! [module](super) states.

use trueup_machine::machine_file::BSpline;

use super::{
    FitMethod, MAX_COEFFICIENTS, MAX_KNOTS_WITHOUT_GAIN, ResidualSummary, StopReason,
    StraightnessFitOptions,
    knot_placement::{CUBIC_ORDER, KnotSearch, RequiredSites},
    paper_method,
    sites::Sites,
};
use crate::{
    bspline::{clamped_knots, fit_least_squares_spline},
    pooled_rows::f_test_p_value,
};

/// Knots are looked for over at most this many sites; of more, neighbours are joined. The fit itself,
/// its residuals and the criterion take all of them.
pub(super) const MAX_KNOT_SEARCH_SITES: usize = 600;

/// A spline, and why it has no more coefficients.
pub(super) struct SelectedSpline {
    pub(super) spline: BSpline,
    pub(super) stopped: StopReason,
}

impl SelectedSpline {
    pub(super) fn select(sites: &Sites, options: &StraightnessFitOptions) -> Self {
        match options.method {
            FitMethod::LeastSquares => Self::select_by_least_squares(sites, options),
            FitMethod::Paper => {
                let tolerance = options.tolerance_um.unwrap_or_else(|| {
                    let best = Self::select_by_least_squares(sites, options);
                    ResidualSummary::from_residuals(&sites.residuals(&best.spline)).largest_um
                });
                let paper_method::PaperFit { spline, is_within, .. } =
                    paper_method::fit(sites, tolerance, paper_method::ControlValueRule::Readings);
                Self {
                    spline,
                    stopped: if is_within { StopReason::Tolerance } else { StopReason::Points },
                }
            }
        }
    }

    fn select_by_least_squares(sites: &Sites, options: &StraightnessFitOptions) -> Self {
        let cells = sites.merge_neighbours(MAX_KNOT_SEARCH_SITES);
        let found =
            Self::select_with_required_sites(sites, &cells, options, RequiredSites::EverySecond);
        let is_short_of_points =
            found.stopped == StopReason::Points && options.tolerance_um.is_some();
        if !is_short_of_points {
            return found;
        }
        let second = Self::select_with_required_sites(sites, &cells, options, RequiredSites::All);
        if second.stopped == StopReason::Tolerance { second } else { found }
    }

    fn select_with_required_sites(
        sites: &Sites,
        cells: &Sites,
        options: &StraightnessFitOptions,
        support: RequiredSites,
    ) -> Self {
        let mut path = SelectionPath::new(sites, cells, options);
        for order in 2..CUBIC_ORDER {
            path.try_knots(&[], order);
        }
        let search = KnotSearch::new(cells, support);
        let mut placed = search.evaluate(Vec::new());
        loop {
            let Some(at) = placed else { return path.finish(StopReason::Points) };
            path.try_knots(&at.inner, CUBIC_ORDER);
            if path.is_near_tolerance() {
                for inner in search.minimax_candidates(&at) {
                    path.try_knots_within_tolerance(&inner);
                }
            }
            if path.is_converged() {
                return path.finish(StopReason::Noise);
            }
            let coefficients = CUBIC_ORDER + at.inner.len() + 1;
            if coefficients > options.most_coefficients.min(MAX_COEFFICIENTS) {
                return path.finish(StopReason::Coefficients);
            }
            // A knot counts for its place and for its coefficient, and something has to be left.
            if coefficients + at.inner.len() + 1 >= cells.len() {
                return path.finish(StopReason::Points);
            }
            placed = search.add_knot(&at);
        }
    }
}

/// Fits with more and more coefficients: the best of them by cross-validation, and the first
/// that is within the tolerance.
struct SelectionPath<'s> {
    sites: &'s Sites,
    cells: &'s Sites,
    options: &'s StraightnessFitOptions,
    /// The straight line's sum of squares.
    line: Option<(f64, BSpline)>,
    best: Option<BestFit>,
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
struct BestFit {
    criterion: f64,
    sum_of_squares: f64,
    /// Coefficients and free knots.
    free: usize,
    spline: BSpline,
}

impl<'s> SelectionPath<'s> {
    fn new(sites: &'s Sites, cells: &'s Sites, options: &'s StraightnessFitOptions) -> Self {
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
    fn try_knots(&mut self, inner: &[f64], order: usize) {
        let count = inner.len() + order;
        if count > self.options.most_coefficients.max(2) {
            return;
        }
        let [first, last] = self.sites.end_positions_mm();
        let knots = clamped_knots(order, first, &round_knots(inner, first, last), last);
        let Some(fit) = fit_least_squares_spline(knots, order, self.sites.points()) else {
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
        let is_best =
            share > 0.0 && self.best.as_ref().is_none_or(|best| criterion < best.criterion);

        if order == 2 {
            self.line = Some((sum_of_squares, fit.spline.clone()));
        }
        if let Some(tolerance) = self.options.tolerance_um
            && self.within.is_none()
        {
            self.largest =
                ResidualSummary::from_residuals(&self.sites.residuals(&fit.spline)).largest_um;
            if self.largest <= tolerance {
                self.within = Some(fit.spline.clone());
            }
        }
        if is_best {
            self.is_within_sound = self.within.is_some();
            self.best = Some(BestFit { criterion, sum_of_squares, free, spline: fit.spline });
            self.since = 0;
        } else {
            self.since += 1;
        }
    }

    /// Returns whether the newest fit, the best so far, misses the tolerance by little.
    fn is_near_tolerance(&self) -> bool {
        const NEAR_TOLERANCE_RATIO: f64 = 2.0;
        let limit =
            self.options.tolerance_um.map_or(0.0, |tolerance| NEAR_TOLERANCE_RATIO * tolerance);
        self.within.is_none() && self.since == 0 && self.largest <= limit
    }

    /// As many knots as the newest fit has, elsewhere: is it within the tolerance with them?
    fn try_knots_within_tolerance(&mut self, inner: &[f64]) {
        let [first, last] = self.sites.end_positions_mm();
        let knots = clamped_knots(CUBIC_ORDER, first, &round_knots(inner, first, last), last);
        let fit = fit_least_squares_spline(knots, CUBIC_ORDER, self.sites.points());
        let (Some(fit), Some(tolerance), None) = (fit, self.options.tolerance_um, &self.within)
        else {
            return;
        };
        if ResidualSummary::from_residuals(&self.sites.residuals(&fit.spline)).largest_um
            <= tolerance
        {
            self.within = Some(fit.spline);
            self.is_within_sound = true;
        }
    }

    /// Returns whether further knots are of no use.
    fn is_converged(&self) -> bool {
        let is_noise = || {
            self.best.as_ref().is_some_and(|best| !self.has_autocorrelated_residuals(&best.spline))
        };
        self.is_within_sound
            || self.is_exact
            || (self.since >= MAX_KNOTS_WITHOUT_GAIN && is_noise())
    }

    /// Returns whether what a curve leaves goes on from one site to the next: von Neumann's ratio of the
    /// mean square of successive differences to the variance is 2 for noise, and smaller then.
    fn has_autocorrelated_residuals(&self, spline: &BSpline) -> bool {
        /// The 1 % point of the normal distribution.
        const NORMAL_QUANTILE_99: f64 = 2.326;
        let left = self.cells.residuals(spline);
        let count = left.len() as f64;
        let squares: f64 = left.iter().map(|r| r * r).sum();
        let successive: f64 = left.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum();
        let deviation = (1.0 / count).sqrt();
        1.0 - 0.5 * successive / squares > NORMAL_QUANTILE_99 * deviation
    }

    /// Returns whether the best is better than a straight line by more than its coefficients explain.
    fn is_better_than_line(&self, best: &BestFit) -> bool {
        const SIGNIFICANCE_LEVEL: f64 = 1e-3;
        let (Some((line, _)), freedom) = (&self.line, self.sites.rows.saturating_sub(best.free))
        else {
            return true;
        };
        let (more, freedom) = ((best.free - 2) as f64, freedom as f64);
        let gained = line - best.sum_of_squares;
        f_test_p_value((gained, more), (best.sum_of_squares, freedom))
            .is_none_or(|p| p < SIGNIFICANCE_LEVEL)
    }

    /// Returns the result, given why the search has ended.
    fn finish(self, stopped: StopReason) -> SelectedSpline {
        if let Some(spline) = self.within.clone().filter(|_| self.is_within_sound) {
            return SelectedSpline { spline, stopped: StopReason::Tolerance };
        }
        let best = self.best.as_ref().expect("a line fits any 4 positions");
        match &self.line {
            Some((_, line)) if best.free > 2 && !self.is_better_than_line(best) => {
                SelectedSpline { spline: line.clone(), stopped: StopReason::Noise }
            }
            _ => SelectedSpline { spline: best.spline.clone(), stopped },
        }
    }
}

/// Inner knots to a micrometre where that leaves them apart: no knot is placed better than that,
/// and a machine file is read by people.
fn round_knots(inner: &[f64], first: f64, last: f64) -> Vec<f64> {
    let before = std::iter::once(first).chain(inner.iter().copied());
    let after = inner.iter().copied().chain(std::iter::once(last));
    let are_apart = before.zip(after).all(|(low, high)| high - low > 0.1);
    inner.iter().map(|&knot| if are_apart { (knot * 1e3).round() / 1e3 } else { knot }).collect()
}
