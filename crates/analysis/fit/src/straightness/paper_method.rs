//! The paper's way (`docs/physics.md` section 4): data points as control points.
//!
//! The two ends and the eight points of largest local curvature (a point whose curvature is above
//! both neighbours') are the control points b_j; while a residual is above ε, the point of the
//! largest residual joins them. The parameter is the accumulated chord length, which for microns
//! over metres is the position itself (to 10⁻⁸). Inner knots are the running means of the control
//! points' positions, t_{j+p} = (x_{j+1} + … + x_{j+p−1})/(p − 1) for order p, so that a control
//! point pulls about where it stands; near the ends it does not quite, so that even a line that is
//! not level is bent there: take its reference line away first.
//!
//! A curve does not pass through its control points, so the last error need not be small even with
//! all points taken: then the way has failed, and says so. With the control values by least squares
//! in the same knots it does much better; that is in the comparison too.

use trueup_machine::machine_file::BSpline;

use super::{knot_placement::CUBIC_ORDER, sites::Sites};
use crate::bspline::{clamped_knots, fit_least_squares_spline};

/// Points of largest curvature to begin with.
const MAX_INITIAL_CURVATURE_POINTS: usize = 8;

/// The choice of the control values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ControlValueRule {
    /// The readings at the chosen points: the paper's.
    Readings,
    /// Those of the least sum of squares in the same knots.
    LeastSquares,
}

/// The result of the paper's rule.
#[derive(Clone, Debug)]
pub(super) struct PaperFit {
    /// The curve.
    pub(super) spline: BSpline,
    /// Whether all residuals are within the tolerance.
    pub(super) is_within: bool,
    /// On the way there: how many control points, and the largest residual with them in µm.
    pub(super) steps: Vec<(usize, f64)>,
}

/// Returns the fit.
pub(super) fn fit(sites: &Sites, tolerance_um: f64, control: ControlValueRule) -> PaperFit {
    let last = sites.len() - 1;
    let mut is_chosen = vec![false; sites.len()];
    (is_chosen[0], is_chosen[last]) = (true, true);
    for site in find_curvature_maxima(sites) {
        is_chosen[site] = true;
    }
    // A cubic has four control points at least.
    let mut most_even = (1..last).step_by((last / 3).max(1));
    while is_chosen.iter().filter(|&&chosen| chosen).count() < CUBIC_ORDER {
        let free = (1..last).find(|&site| !is_chosen[site]);
        let Some(site) = most_even.next().or(free) else { break };
        is_chosen[site] = true;
    }
    let mut reached: Option<BSpline> = None;
    let mut steps = Vec::new();
    loop {
        let chosen: Vec<usize> = (0..=last).filter(|&site| is_chosen[site]).collect();
        let Some(spline) = spline_from_control_sites(sites, &chosen, control) else {
            // Least squares in knots that the points do not determine: the fit before stands.
            let fallback = || {
                spline_from_control_sites(sites, &chosen, ControlValueRule::Readings)
                    .expect("needs no solution")
            };
            let spline = reached.unwrap_or_else(fallback);
            return PaperFit { spline, is_within: false, steps };
        };
        let residuals = sites.residuals(&spline);
        let largest_um = residuals.iter().fold(0.0, |most: f64, residual| most.max(residual.abs()));
        steps.push((chosen.len(), largest_um));
        if largest_um <= tolerance_um {
            return PaperFit { spline, is_within: true, steps };
        }
        let worst = (0..=last)
            .filter(|&site| !is_chosen[site])
            .max_by(|&a, &b| residuals[a].abs().total_cmp(&residuals[b].abs()));
        let Some(worst) = worst else { return PaperFit { spline, is_within: false, steps } };
        is_chosen[worst] = true;
        reached = Some(spline);
    }
}

/// Returns the points whose curvature is above both neighbours', the largest first.
fn find_curvature_maxima(sites: &Sites) -> Vec<usize> {
    let (x, y) = (&sites.x, &sites.y);
    let curvature = |n: usize| {
        let slope = |a: usize, b: usize| (y[b] - y[a]) / (x[b] - x[a]);
        ((slope(n, n + 1) - slope(n - 1, n)) / (0.5 * (x[n + 1] - x[n - 1]))).abs()
    };
    let curvatures: Vec<f64> = (1..sites.len() - 1).map(curvature).collect();
    let is_peak =
        |n: &usize| curvatures[*n] > curvatures[*n - 1] && curvatures[*n] > curvatures[*n + 1];
    let mut peaks: Vec<usize> = (1..curvatures.len().saturating_sub(1)).filter(is_peak).collect();
    peaks.sort_by(|&a, &b| curvatures[b].total_cmp(&curvatures[a]));
    peaks.truncate(MAX_INITIAL_CURVATURE_POINTS);
    // curvatures[0] is that of the second site.
    peaks.iter().map(|n| n + 1).collect()
}

/// Returns the spline whose control points stand at the chosen sites (in order).
fn spline_from_control_sites(
    sites: &Sites,
    chosen: &[usize],
    control: ControlValueRule,
) -> Option<BSpline> {
    let x = |n: usize| sites.x[chosen[n]];
    let inner: Vec<f64> =
        (1..=chosen.len() - CUBIC_ORDER).map(|j| (x(j) + x(j + 1) + x(j + 2)) / 3.0).collect();
    let [first, last] = sites.end_positions_mm();
    let knots_mm = clamped_knots(CUBIC_ORDER, first, &inner, last);
    match control {
        ControlValueRule::Readings => {
            let control_um = chosen.iter().map(|&site| sites.y[site]).collect();
            Some(BSpline { order: CUBIC_ORDER, knots_mm, control_um })
        }
        ControlValueRule::LeastSquares => {
            fit_least_squares_spline(knots_mm, CUBIC_ORDER, sites.points()).map(|fit| fit.spline)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::straightness::sites::every_10_mm;

    #[test]
    fn a_level_line_needs_only_the_points_to_begin_with() {
        let PaperFit { spline, is_within, .. } =
            fit(&every_10_mm(40, |_| -3.0), 1e-9, ControlValueRule::Readings);
        assert!(is_within && spline.control_um.len() < 11, "{spline:?}");
        // Rising by 1 µm from point to point, it is bent by no more than that at the ends.
        let PaperFit { is_within, .. } =
            fit(&every_10_mm(40, |x| 0.1 * x - 3.0), 1.0, ControlValueRule::Readings);
        assert!(is_within);
    }

    #[test]
    fn points_join_until_all_residuals_are_within() {
        let sites = every_10_mm(200, |x| 50.0 * (x / 150.0).sin());
        let mut counts = Vec::new();
        for tolerance_um in [10.0, 3.0, 1.0] {
            let PaperFit { spline, is_within, .. } =
                fit(&sites, tolerance_um, ControlValueRule::Readings);
            assert!(is_within);
            assert_eq!(spline.validate(), Ok(()));
            let residuals = sites.residuals(&spline);
            assert!(residuals.iter().all(|residual| residual.abs() <= tolerance_um));
            counts.push(spline.control_um.len());
        }
        assert!(counts.is_sorted() && counts[0] < counts[2], "{counts:?}");
    }

    #[test]
    fn readings_that_alternate_are_never_within() {
        let sites = every_10_mm(30, |x| if (x / 10.0) % 2.0 == 0.0 { 5.0 } else { -5.0 });
        let PaperFit { spline, is_within, .. } = fit(&sites, 1.0, ControlValueRule::Readings);
        assert!(!is_within);
        assert_eq!(spline.control_um.len(), 30);
    }

    #[test]
    fn four_points_are_enough() {
        for count in 4..9 {
            let PaperFit { spline, .. } =
                fit(&every_10_mm(count, |x| x * x), 1e-3, ControlValueRule::Readings);
            assert_eq!(spline.validate(), Ok(()));
        }
    }
}
