//! Knots where they are needed: for each number of inner knots the places that leave the least sum
//! of squares.
//!
//! The sum of squares has many valleys over the knots, so they are sought in three ways, of which
//! the best is kept: one more knot where it gains most next to those of the fit before; all knots
//! spread again so that each interval holds an equal share of |f⁗|^¼, which is where the best knots
//! lie as they become many; and the knot that is missed least put where it gains most, again and
//! again. From each start all knots then slide to the bottom of the valley together, by
//! Levenberg and Marquardt's steps on the reduced problem (variable projection after Golub and
//! Pereyra, with Kaufman's simplification): with Q₂ the space that the spline cannot reach,
//!
//! ```text
//! ∂C/∂t_l = −Σ_{i=l−p}^{l} (b_i − b_{i−1})/(t_{i+p} − t_i)·N̂_i     N̂: on the knots with t_l doubled
//! D = Q₂ᵀ·∂C/∂t,   (DᵀD + λ·diag DᵀD)·δ = DᵀQ₂ᵀy
//! ```
//!
//! Both products fall out of the row-wise rotations of [`BandedLeastSquares`].

use nalgebra::{DMatrix, DVector};

use super::sites::Sites;
use crate::bspline::{
    BandedLeastSquares, SplineFit, clamped_knots, evaluate_basis, fit_least_squares_spline,
    satisfies_schoenberg_whitney,
};

/// The order of every curve that has inner knots: cubic.
pub(super) const CUBIC_ORDER: usize = 4;

/// How sure of each coefficient the data must be, as the sine that
/// [`BandedLeastSquares::min_column_angle_sine`] gives: where points are too few, no knot.
const MIN_COLUMN_ANGLE_SINE: f64 = 0.03;

/// Inner knots, and what they leave.
#[derive(Clone, Debug)]
pub(super) struct PlacedKnots {
    pub(super) inner: Vec<f64>,
    pub(super) sum_of_squares: f64,
}

/// Which sites must suffice to determine the coefficients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RequiredSites {
    /// Every second, from the first on or from the second: no coefficient follows a single point.
    EverySecond,
    /// All sites together.
    All,
}

/// Looks for knots over given sites.
pub(super) struct KnotSearch<'s> {
    sites: &'s Sites,
    support: RequiredSites,
    /// Two knots are at least that far apart, in mm.
    least_gap: f64,
}

impl<'s> KnotSearch<'s> {
    pub(super) fn new(sites: &'s Sites, support: RequiredSites) -> Self {
        let [first, last] = sites.end_positions_mm();
        // A quarter of the mean spacing: two knots for one kink are possible, and distinguished.
        let least_gap = 0.25 * (last - first) / (sites.len() - 1) as f64;
        Self { sites, support, least_gap }
    }

    fn knot_vector(&self, inner: &[f64]) -> Vec<f64> {
        let [first, last] = self.sites.end_positions_mm();
        clamped_knots(CUBIC_ORDER, first, inner, last)
    }

    /// Returns the fit in these inner knots; `None` if they may not be.
    fn fit(&self, inner: &[f64]) -> Option<SplineFit> {
        let [first, last] = self.sites.end_positions_mm();
        let before = std::iter::once(first).chain(inner.iter().copied());
        let after = inner.iter().copied().chain(std::iter::once(last));
        if before.zip(after).any(|(low, high)| high - low < self.least_gap) {
            return None;
        }
        let knots = self.knot_vector(inner);
        let is_supported = |(from, step)| {
            satisfies_schoenberg_whitney(
                &knots,
                CUBIC_ORDER,
                self.sites.x.iter().skip(from).step_by(step).copied(),
            )
        };
        let is_supported = match self.support {
            RequiredSites::EverySecond => [(0, 2), (1, 2)].into_iter().all(is_supported),
            RequiredSites::All => is_supported((0, 1)),
        };
        is_supported
            .then(|| fit_least_squares_spline(knots.clone(), CUBIC_ORDER, self.sites.points()))?
            .filter(|fit| fit.triangle.min_column_angle_sine() > MIN_COLUMN_ANGLE_SINE)
    }

    /// These inner knots as they are.
    pub(super) fn evaluate(&self, inner: Vec<f64>) -> Option<PlacedKnots> {
        let sum_of_squares = self.fit(&inner)?.sum_of_squares;
        Some(PlacedKnots { inner, sum_of_squares })
    }

    /// Returns one knot more than `from` has, all at their best; `None` where the sites allow no further.
    pub(super) fn add_knot(&self, from: &PlacedKnots) -> Option<PlacedKnots> {
        /// Of more knots than that, each gains little: one start is enough.
        const MAX_MULTISTART_KNOTS: usize = 32;
        let count = from.inner.len() + 1;
        if count > MAX_MULTISTART_KNOTS {
            return self
                .find_best_insertions(from, 1)
                .pop()
                .map(|start| self.optimise_knots(start));
        }
        let mut starts = self.find_best_insertions(from, 2);
        starts.extend(self.equidistribute_knots(from, count));
        let slid = starts.into_iter().map(|start| self.optimise_knots(start));
        let best = slid.min_by(|a, b| a.sum_of_squares.total_cmp(&b.sum_of_squares))?;
        Some(self.relocate_weakest_knot(best))
    }

    /// Knots that may leave a smaller largest residual than the least sum of squares does: evenly
    /// spaced ones, and those to which the knots slide when large residuals weigh more and more
    /// (Lawson's way to the smallest maximum).
    pub(super) fn minimax_candidates(&self, from: &PlacedKnots) -> Vec<Vec<f64>> {
        const LAWSON_ITERATIONS: usize = 4;
        let [first, last] = self.sites.end_positions_mm();
        let count = from.inner.len();
        let share = |n: usize| n as f64 / (count + 1) as f64;
        let even: Vec<f64> = (1..=count).map(|n| first + share(n) * (last - first)).collect();
        let mut tried: Vec<Vec<f64>> =
            self.evaluate(even).map(|knots| knots.inner).into_iter().collect();
        let mut weighted = self.sites.clone();
        let mut at = from.inner.clone();
        for _ in 0..LAWSON_ITERATIONS {
            let Some(fit) = self.fit(&at) else { break };
            let residuals = self.sites.residuals(&fit.spline);
            let mean = residuals.iter().map(|r| r.abs()).sum::<f64>() / residuals.len() as f64;
            if mean == 0.0 {
                break;
            }
            for (weight, residual) in weighted.weight.iter_mut().zip(&residuals) {
                *weight *= residual.abs() / mean + 0.1;
            }
            let search = KnotSearch { sites: &weighted, ..*self };
            let Some(start) = search.evaluate(at) else { break };
            at = search.optimise_knots(start).inner;
            tried.push(at.clone());
        }
        tried
    }

    /// Returns the `most` best places for one more knot, each with the knots of `from` where they are.
    fn find_best_insertions(&self, from: &PlacedKnots, most: usize) -> Vec<PlacedKnots> {
        let knots = self.knot_vector(&from.inner);
        let mut found: Vec<PlacedKnots> = Vec::new();
        let pairs = knots.windows(2).filter(|pair| pair[1] - pair[0] >= 2.0 * self.least_gap);
        for pair in pairs {
            let tried = [0.25, 0.5, 0.75].into_iter().filter_map(|share| {
                let mut inner = from.inner.clone();
                let place = pair[0] + share * (pair[1] - pair[0]);
                inner.insert(inner.partition_point(|&knot| knot < place), place);
                self.evaluate(inner)
            });
            // One of each interval: the rest of it is for the slide.
            found.extend(tried.min_by(|a, b| a.sum_of_squares.total_cmp(&b.sum_of_squares)));
        }
        found.sort_by(|a, b| a.sum_of_squares.total_cmp(&b.sum_of_squares));
        found.truncate(most);
        found
    }

    /// `count` knots so that each interval holds an equal share of |f⁗|^¼, the fourth derivative
    /// taken from the jumps of the third at the knots of `from` (de Boor's `newknt`).
    fn equidistribute_knots(&self, from: &PlacedKnots, count: usize) -> Option<PlacedKnots> {
        let spline = self.fit(&from.inner)?.spline;
        let knots = &spline.knots_mm;
        // Distinct spans and the third derivative in each, from second derivatives at their ends.
        let mut spans: Vec<(f64, f64, f64)> = Vec::new();
        for pair in knots.windows(2).filter(|pair| pair[1] > pair[0]) {
            let width = pair[1] - pair[0];
            let second = |share: f64| {
                crate::bspline::evaluate_with_derivatives(&spline, pair[0] + share * width)
            };
            let third = (second(0.75)[2] - second(0.25)[2]) / (0.5 * width);
            spans.push((pair[0], pair[1], third));
        }
        if spans.len() < 2 {
            return None;
        }
        let jump = |n: usize| {
            let ((a, _, low), (_, b, high)) = (spans[n], spans[n + 1]);
            (high - low).abs() / (0.5 * (b - a))
        };
        let density: Vec<f64> = (0..spans.len())
            .map(|n| {
                let left = (n > 0).then(|| jump(n - 1));
                let right = (n + 1 < spans.len()).then(|| jump(n));
                let sides = [left, right].into_iter().flatten();
                let (sum, number) = sides.fold((0.0, 0.0), |(s, n), jump| (s + jump, n + 1.0));
                (sum / f64::max(number, 1.0)).powf(0.25)
            })
            .collect();
        let share = |n: usize| density[n] * (spans[n].1 - spans[n].0);
        let whole: f64 = (0..spans.len()).map(share).sum();
        if !(whole > 0.0 && whole.is_finite()) {
            return None;
        }
        let step = whole / (count + 1) as f64;
        let (mut inner, mut passed, mut n) = (Vec::with_capacity(count), 0.0, 0);
        for requested in (1..=count).map(|number| number as f64 * step) {
            while n + 1 < spans.len() && passed + share(n) < requested {
                passed += share(n);
                n += 1;
            }
            inner.push(spans[n].0 + (requested - passed) / density[n]);
        }
        self.evaluate(inner)
    }

    /// Without the knot whose loss costs least.
    fn remove_weakest_knot(&self, from: &PlacedKnots) -> Option<PlacedKnots> {
        let tried = (0..from.inner.len()).filter_map(|n| {
            let mut inner = from.inner.clone();
            inner.remove(n);
            self.evaluate(inner)
        });
        tried.min_by(|a, b| a.sum_of_squares.total_cmp(&b.sum_of_squares))
    }

    /// Puts the knot that is missed least where it gains most, as long as that gains.
    fn relocate_weakest_knot(&self, mut best: PlacedKnots) -> PlacedKnots {
        const MIN_RELATIVE_GAIN: f64 = 1e-3;
        for _ in 0..best.inner.len() {
            let Some(without) = self.remove_weakest_knot(&best) else { break };
            let moved = self
                .find_best_insertions(&without, 2)
                .into_iter()
                .map(|start| self.optimise_knots(start));
            match moved.min_by(|a, b| a.sum_of_squares.total_cmp(&b.sum_of_squares)) {
                Some(moved)
                    if moved.sum_of_squares < (1.0 - MIN_RELATIVE_GAIN) * best.sum_of_squares =>
                {
                    best = moved;
                }
                _ => break,
            }
        }
        best
    }

    /// Slides all knots to the bottom of their valley.
    fn optimise_knots(&self, mut at: PlacedKnots) -> PlacedKnots {
        const MAX_ITERATIONS: usize = 30;
        const MIN_RELATIVE_GAIN: f64 = 1e-4;
        const MAX_DAMPING: f64 = 1e6;
        if at.inner.is_empty() {
            return at;
        }
        let mut damping = 1e-2;
        let mut small_gains = 0;
        for _ in 0..MAX_ITERATIONS {
            let Some((curvature, slope)) = self.normal_equations(&at.inner) else { break };
            let next = loop {
                let next = self.damped_step(&at, &curvature, &slope, damping);
                if let Some(next) = next.filter(|next| next.sum_of_squares < at.sum_of_squares) {
                    damping *= 0.2;
                    break Some(next);
                }
                damping *= 5.0;
                if damping > MAX_DAMPING {
                    break None;
                }
            };
            let Some(next) = next else { break };
            let gain = 1.0 - next.sum_of_squares / at.sum_of_squares;
            at = next;
            small_gains = if gain < MIN_RELATIVE_GAIN { small_gains + 1 } else { 0 };
            if small_gains == 2 {
                break;
            }
        }
        at
    }

    /// `DᵀD` and `DᵀQ₂ᵀy` of the module's text.
    fn normal_equations(&self, inner: &[f64]) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let fit = self.fit(inner)?;
        let (knots, control) = (&fit.spline.knots_mm, &fit.spline.control_um);
        let degree = CUBIC_ORDER - 1;
        // For each inner knot the sites that it moves, and how.
        let moves: Vec<(usize, Vec<f64>)> = (0..inner.len())
            .map(|n| {
                let l = CUBIC_ORDER + n;
                let mut doubled = knots.clone();
                doubled.insert(l, knots[l]);
                let part = |at: f64| self.sites.x.partition_point(|&x| x < at);
                let sites = part(knots[l - degree])..part(knots[l + degree]);
                let rate =
                    |i: usize| (control[i] - control[i - 1]) / (knots[i + degree] - knots[i]);
                let value = |x: f64| {
                    let (first, weights) = evaluate_basis(&doubled, CUBIC_ORDER, x);
                    let near =
                        (l - degree..=l).filter(|&i| (first..first + CUBIC_ORDER).contains(&i));
                    // The first control point has none before it, and its knot is not an inner one.
                    -near.map(|i| rate(i) * weights[i - first]).sum::<f64>()
                };
                (sites.start, self.sites.x[sites].iter().map(|&x| value(x)).collect())
            })
            .collect();

        let sides = inner.len() + 1;
        let mut triangle = BandedLeastSquares::new(CUBIC_ORDER, control.len(), sides);
        let (mut curvature, mut slope) =
            (DMatrix::zeros(inner.len(), inner.len()), DVector::zeros(inner.len()));
        let mut row = vec![0.0; sides];
        for (site, (x, y, weight)) in self.sites.points().enumerate() {
            let root = weight.sqrt();
            for (slot, (start, values)) in row.iter_mut().zip(&moves) {
                let value = site.checked_sub(*start).and_then(|n| values.get(n));
                *slot = value.copied().unwrap_or(0.0) * root;
            }
            row[sides - 1] = y * root;
            let (first, weights) = evaluate_basis(knots, CUBIC_ORDER, x);
            triangle.add_observation(first, weights.map(|w| w * root), &mut row);
            let left = row[sides - 1];
            for j in 0..inner.len() {
                slope[j] += row[j] * left;
                for i in j..inner.len() {
                    curvature[(i, j)] += row[i] * row[j];
                }
            }
        }
        for j in 0..inner.len() {
            for i in 0..j {
                curvature[(i, j)] = curvature[(j, i)];
            }
        }
        Some((curvature, slope))
    }

    /// Returns the knots after a damped step, which takes none of them more than a part of the way to its
    /// neighbour.
    fn damped_step(
        &self,
        at: &PlacedKnots,
        curvature: &DMatrix<f64>,
        slope: &DVector<f64>,
        damping: f64,
    ) -> Option<PlacedKnots> {
        const MAX_STEP_FRACTION: f64 = 0.45;
        let mut damped = curvature.clone();
        let floor = 1e-12 * damped.diagonal().max();
        for n in 0..at.inner.len() {
            damped[(n, n)] += damping * damped[(n, n)] + floor;
        }
        let delta = damped.cholesky()?.solve(slope);
        let [first, last] = self.sites.end_positions_mm();
        let room = |low: f64, high: f64| {
            (MAX_STEP_FRACTION * (high - low)).min(high - low - self.least_gap)
        };
        let inner = (0..at.inner.len())
            .map(|n| {
                let here = at.inner[n];
                let left = if n == 0 { first } else { at.inner[n - 1] };
                let right = at.inner.get(n + 1).copied().unwrap_or(last);
                let (back, forth) = (room(left, here).max(0.0), room(here, right).max(0.0));
                here + delta[n].clamp(-back, forth)
            })
            .collect();
        self.evaluate(inner)
    }
}
