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
//! Both products fall out of the row-wise rotations of [`Banded`](crate::bspline::Banded).

use nalgebra::{DMatrix, DVector};

use super::sites::Sites;
use crate::bspline::{Banded, InKnots, basis, clamped, is_determined, least_squares};

/// The order of every curve that has inner knots: cubic.
pub(super) const ORDER: usize = 4;

/// How sure of each coefficient the data must be, as the sine that
/// [`Banded::least_sine`] gives: where points are too few, no knot.
const MIN_SINE: f64 = 0.03;

/// Inner knots, and what they leave.
#[derive(Clone, Debug)]
pub(super) struct Placed {
    pub(super) inner: Vec<f64>,
    pub(super) sum_of_squares: f64,
}

/// Which sites must suffice to determine the coefficients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Support {
    /// Every second, from the first on or from the second: no coefficient follows a single point.
    EverySecond,
    /// All sites together.
    All,
}

/// Looks for knots over given sites.
pub(super) struct Search<'s> {
    sites: &'s Sites,
    support: Support,
    /// Two knots are at least that far apart, in mm.
    least_gap: f64,
}

impl<'s> Search<'s> {
    pub(super) fn new(sites: &'s Sites, support: Support) -> Self {
        let [first, last] = sites.ends();
        // A quarter of the mean spacing: two knots for one kink are possible, and distinguished.
        let least_gap = 0.25 * (last - first) / (sites.len() - 1) as f64;
        Self { sites, support, least_gap }
    }

    fn knots(&self, inner: &[f64]) -> Vec<f64> {
        let [first, last] = self.sites.ends();
        clamped(ORDER, first, inner, last)
    }

    /// Returns the fit in these inner knots; `None` if they may not be.
    fn fit(&self, inner: &[f64]) -> Option<InKnots> {
        let [first, last] = self.sites.ends();
        let before = std::iter::once(first).chain(inner.iter().copied());
        let after = inner.iter().copied().chain(std::iter::once(last));
        if before.zip(after).any(|(low, high)| high - low < self.least_gap) {
            return None;
        }
        let knots = self.knots(inner);
        let is_supported = |(from, step)| {
            is_determined(&knots, ORDER, self.sites.x.iter().skip(from).step_by(step).copied())
        };
        let is_supported = match self.support {
            Support::EverySecond => [(0, 2), (1, 2)].into_iter().all(is_supported),
            Support::All => is_supported((0, 1)),
        };
        is_supported
            .then(|| least_squares(knots.clone(), ORDER, self.sites.points()))?
            .filter(|fit| fit.triangle.least_sine() > MIN_SINE)
    }

    /// These inner knots as they are.
    pub(super) fn place(&self, inner: Vec<f64>) -> Option<Placed> {
        let sum_of_squares = self.fit(&inner)?.sum_of_squares;
        Some(Placed { inner, sum_of_squares })
    }

    /// Returns one knot more than `from` has, all at their best; `None` where the sites allow no further.
    pub(super) fn one_more(&self, from: &Placed) -> Option<Placed> {
        /// Of more knots than that, each gains little: one start is enough.
        const MANY: usize = 32;
        let count = from.inner.len() + 1;
        if count > MANY {
            return self.insertions(from, 1).pop().map(|start| self.slide(start));
        }
        let mut starts = self.insertions(from, 2);
        starts.extend(self.spread(from, count));
        let slid = starts.into_iter().map(|start| self.slide(start));
        let best = slid.min_by(|a, b| a.sum_of_squares.total_cmp(&b.sum_of_squares))?;
        Some(self.relocate(best))
    }

    /// Knots that may leave a smaller largest residual than the least sum of squares does: evenly
    /// spaced ones, and those to which the knots slide when large residuals weigh more and more
    /// (Lawson's way to the smallest maximum).
    pub(super) fn flattened(&self, from: &Placed) -> Vec<Vec<f64>> {
        const ROUNDS: usize = 4;
        let [first, last] = self.sites.ends();
        let count = from.inner.len();
        let share = |n: usize| n as f64 / (count + 1) as f64;
        let even: Vec<f64> = (1..=count).map(|n| first + share(n) * (last - first)).collect();
        let mut tried: Vec<Vec<f64>> = self.place(even).map(|it| it.inner).into_iter().collect();
        let mut weighted = self.sites.clone();
        let mut at = from.inner.clone();
        for _ in 0..ROUNDS {
            let Some(fit) = self.fit(&at) else { break };
            let residuals = self.sites.residuals(&fit.spline);
            let mean = residuals.iter().map(|r| r.abs()).sum::<f64>() / residuals.len() as f64;
            if mean == 0.0 {
                break;
            }
            for (weight, residual) in weighted.weight.iter_mut().zip(&residuals) {
                *weight *= residual.abs() / mean + 0.1;
            }
            let search = Search { sites: &weighted, ..*self };
            let Some(start) = search.place(at) else { break };
            at = search.slide(start).inner;
            tried.push(at.clone());
        }
        tried
    }

    /// Returns the `most` best places for one more knot, each with the knots of `from` where they are.
    fn insertions(&self, from: &Placed, most: usize) -> Vec<Placed> {
        let knots = self.knots(&from.inner);
        let mut found: Vec<Placed> = Vec::new();
        let pairs = knots.windows(2).filter(|pair| pair[1] - pair[0] >= 2.0 * self.least_gap);
        for pair in pairs {
            let tried = [0.25, 0.5, 0.75].into_iter().filter_map(|share| {
                let mut inner = from.inner.clone();
                let place = pair[0] + share * (pair[1] - pair[0]);
                inner.insert(inner.partition_point(|&knot| knot < place), place);
                self.place(inner)
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
    fn spread(&self, from: &Placed, count: usize) -> Option<Placed> {
        let spline = self.fit(&from.inner)?.spline;
        let knots = &spline.knots_mm;
        // Distinct spans and the third derivative in each, from second derivatives at their ends.
        let mut spans: Vec<(f64, f64, f64)> = Vec::new();
        for pair in knots.windows(2).filter(|pair| pair[1] > pair[0]) {
            let width = pair[1] - pair[0];
            let second = |share: f64| crate::bspline::derivatives(&spline, pair[0] + share * width);
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
        for wanted in (1..=count).map(|number| number as f64 * step) {
            while n + 1 < spans.len() && passed + share(n) < wanted {
                passed += share(n);
                n += 1;
            }
            inner.push(spans[n].0 + (wanted - passed) / density[n]);
        }
        self.place(inner)
    }

    /// Without the knot whose loss costs least.
    fn without_least(&self, from: &Placed) -> Option<Placed> {
        let tried = (0..from.inner.len()).filter_map(|n| {
            let mut inner = from.inner.clone();
            inner.remove(n);
            self.place(inner)
        });
        tried.min_by(|a, b| a.sum_of_squares.total_cmp(&b.sum_of_squares))
    }

    /// Puts the knot that is missed least where it gains most, as long as that gains.
    fn relocate(&self, mut best: Placed) -> Placed {
        const MIN_GAIN: f64 = 1e-3;
        for _ in 0..best.inner.len() {
            let Some(without) = self.without_least(&best) else { break };
            let moved = self.insertions(&without, 2).into_iter().map(|start| self.slide(start));
            match moved.min_by(|a, b| a.sum_of_squares.total_cmp(&b.sum_of_squares)) {
                Some(moved) if moved.sum_of_squares < (1.0 - MIN_GAIN) * best.sum_of_squares => {
                    best = moved;
                }
                _ => break,
            }
        }
        best
    }

    /// Slides all knots to the bottom of their valley.
    fn slide(&self, mut at: Placed) -> Placed {
        const MAX_STEPS: usize = 30;
        const MIN_GAIN: f64 = 1e-4;
        const STEEPEST_DESCENT: f64 = 1e6;
        if at.inner.is_empty() {
            return at;
        }
        let mut damping = 1e-2;
        let mut small_gains = 0;
        for _ in 0..MAX_STEPS {
            let Some((curvature, slope)) = self.downhill(&at.inner) else { break };
            let next = loop {
                let next = self.step(&at, &curvature, &slope, damping);
                if let Some(next) = next.filter(|next| next.sum_of_squares < at.sum_of_squares) {
                    damping *= 0.2;
                    break Some(next);
                }
                damping *= 5.0;
                if damping > STEEPEST_DESCENT {
                    break None;
                }
            };
            let Some(next) = next else { break };
            let gain = 1.0 - next.sum_of_squares / at.sum_of_squares;
            at = next;
            small_gains = if gain < MIN_GAIN { small_gains + 1 } else { 0 };
            if small_gains == 2 {
                break;
            }
        }
        at
    }

    /// `DᵀD` and `DᵀQ₂ᵀy` of the module's text.
    fn downhill(&self, inner: &[f64]) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let fit = self.fit(inner)?;
        let (knots, control) = (&fit.spline.knots_mm, &fit.spline.control_um);
        let degree = ORDER - 1;
        // For each inner knot the sites that it moves, and how.
        let moves: Vec<(usize, Vec<f64>)> = (0..inner.len())
            .map(|n| {
                let l = ORDER + n;
                let mut doubled = knots.clone();
                doubled.insert(l, knots[l]);
                let part = |at: f64| self.sites.x.partition_point(|&x| x < at);
                let sites = part(knots[l - degree])..part(knots[l + degree]);
                let rate =
                    |i: usize| (control[i] - control[i - 1]) / (knots[i + degree] - knots[i]);
                let value = |x: f64| {
                    let (first, weights) = basis(&doubled, ORDER, x);
                    let near = (l - degree..=l).filter(|&i| (first..first + ORDER).contains(&i));
                    // The first control point has none before it, and its knot is not an inner one.
                    -near.map(|i| rate(i) * weights[i - first]).sum::<f64>()
                };
                (sites.start, self.sites.x[sites].iter().map(|&x| value(x)).collect())
            })
            .collect();

        let sides = inner.len() + 1;
        let mut triangle = Banded::new(ORDER, control.len(), sides);
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
            let (first, weights) = basis(knots, ORDER, x);
            triangle.add(first, weights.map(|w| w * root), &mut row);
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
    fn step(
        &self,
        at: &Placed,
        curvature: &DMatrix<f64>,
        slope: &DVector<f64>,
        damping: f64,
    ) -> Option<Placed> {
        const PART: f64 = 0.45;
        let mut damped = curvature.clone();
        let floor = 1e-12 * damped.diagonal().max();
        for n in 0..at.inner.len() {
            damped[(n, n)] += damping * damped[(n, n)] + floor;
        }
        let delta = damped.cholesky()?.solve(slope);
        let [first, last] = self.sites.ends();
        let room = |low: f64, high: f64| (PART * (high - low)).min(high - low - self.least_gap);
        let inner = (0..at.inner.len())
            .map(|n| {
                let here = at.inner[n];
                let left = if n == 0 { first } else { at.inner[n - 1] };
                let right = at.inner.get(n + 1).copied().unwrap_or(last);
                let (back, forth) = (room(left, here).max(0.0), room(here, right).max(0.0));
                here + delta[n].clamp(-back, forth)
            })
            .collect();
        self.place(inner)
    }
}
