//! How well places determine a table of equal steps that they do not stand on.

/// The share of the squares of the value with most below which another one is not determined: a hundredth of a reading
/// next to one says nothing.
pub const DETERMINACY_THRESHOLD: f64 = 1e-4;

/// Returns the variance of the point of a table that is known least, in those of one reading, if each place of
/// `at` (in the unit of `start` and `step`, any order) was read once and lines join the points. Points on
/// which no place has a say are left out: infinite where what is left is not determined.
///
/// The normal equations of hats are tridiagonal; of their inverse the diagonal is 1/(δ + φ − d), δ and φ the
/// pivots from either end and d the diagonal (Meurant, 1992).
///
/// ```
/// use trueup_numerics::repeats::max_point_variance;
/// // A place on each point; and two places that leave three points open.
/// assert_eq!(max_point_variance(&[0.0, 1.0, 2.0], 0.0, 1.0, 3), 1.0);
/// assert_eq!(max_point_variance(&[0.5, 1.5], 0.0, 1.0, 3), f64::INFINITY);
/// ```
#[must_use]
pub fn max_point_variance(at: &[f64], start: f64, step: f64, points: usize) -> f64 {
    let mut diagonal = vec![0.0; points];
    let mut adjacent = vec![0.0; points];
    for value in at {
        let place = ((value - start) / step).clamp(0.0, (points - 1) as f64);
        let low = (place as usize).min(points.saturating_sub(2));
        let share = place - low as f64;
        diagonal[low] += (1.0 - share).powi(2);
        if low + 1 < points {
            diagonal[low + 1] += share.powi(2);
            adjacent[low] += share * (1.0 - share);
        }
    }
    let most = diagonal.iter().copied().fold(0.0, f64::max);
    let is_open = |n: usize| diagonal[n] <= DETERMINACY_THRESHOLD * most;
    let coupling = |n: usize| if is_open(n) || is_open(n + 1) { 0.0 } else { adjacent[n] };
    let pivot = |n: usize, before: Option<(f64, f64)>| {
        let taken = before.map_or(0.0, |(pivot, adjacent)| adjacent * adjacent / pivot);
        // What is left by rounding is nothing.
        let left = diagonal[n] - taken;
        if left > 1e-12 * diagonal[n] { left } else { 0.0 }
    };
    let mut forward = vec![0.0; points];
    for n in 0..points {
        forward[n] = pivot(
            n,
            n.checked_sub(1).map(|m| (forward[m], coupling(m))).filter(|pair| pair.1 > 0.0),
        );
    }
    let mut backward = vec![0.0; points];
    for n in (0..points).rev() {
        let after = (n + 1 < points).then(|| (backward[n + 1], coupling(n)));
        backward[n] = pivot(n, after.filter(|after| after.1 > 0.0));
    }
    (0..points)
        .filter(|&n| !is_open(n))
        .map(|n| {
            let left = forward[n] + backward[n] - diagonal[n];
            if forward[n] > 0.0 && backward[n] > 0.0 && left > 0.0 {
                1.0 / left
            } else {
                f64::INFINITY
            }
        })
        .fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_variance_is_that_of_the_inverse_of_the_normal_equations() {
        // By hand: hats at 0, 0.25, 0.75, 1, 2 on three points: G = [[1.625, 0.375, 0], [0.375, 1.625, 0],
        // [0, 0, 1]]; its inverse has 1.625/(1.625² − 0.375²) twice, and 1.
        let exact = 1.625 / (1.625_f64.powi(2) - 0.375_f64.powi(2));
        let found = max_point_variance(&[0.0, 0.25, 0.75, 1.0, 2.0], 0.0, 1.0, 3);
        assert!((found - exact.max(1.0)).abs() < 1e-12, "{found}");
    }

    #[test]
    fn places_beyond_the_middle_of_all_gaps_hardly_determine_the_points() {
        let at: Vec<f64> = (0..15).map(|n| f64::from(n) + 0.6).chain([15.0]).collect();
        assert!(max_point_variance(&at, 0.0, 1.0, 16) > 100.0);
    }
}
