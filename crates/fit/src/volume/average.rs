//! The constants averaged over what is not known of the smoothness of the errors.
//!
//! How smooth the errors are is a power of the roughness ([`modes`](super::modes)). No power is taken for known: each has its own
//! most likely variances, and counts by the likelihood of the readings with them, where the constants are integrated out:
//!
//! ```text
//! ln L = −½·(Σ n·ln σ² + yᵀy/σ² − bᵀ·mean + ln det(1 + V^½·XᵀX/σ²·V^½))        b = Xᵀy/σ²
//! ```
//!
//! Mean and covariance are those of the mixture: how far the powers differ is in the intervals.

use nalgebra::{DMatrix, DVector};

use super::{
    design::{Design, Normals},
    estimate::{Posterior, Variances, most_likely, system},
    setup::Uncertainty,
};

/// Powers of the roughness; 1 to 2.5 decay as those of smoothing splines of degree 3 to 9.
const POWERS: [f64; 4] = [1.0, 1.5, 2.0, 2.5];

/// Returns the variances that make the readings most likely, begun at the stated noise, and the constants averaged over the powers.
#[must_use]
pub fn estimate(
    design: &Design,
    normals: &Normals,
    uncertainty: &Uncertainty,
    noise_um: f64,
) -> (Variances, Posterior) {
    let each = POWERS.map(|power| {
        let begun = Variances::usual(design, uncertainty, [noise_um; 4], 1.0, power);
        let (variances, found) = most_likely(design, normals, begun, noise_um);
        let log_likelihood = log_likelihood(normals, &variances, &found);
        (log_likelihood, variances, found)
    });
    let best = each.iter().map(|it| it.0).fold(f64::MIN, f64::max);
    let weights = each.each_ref().map(|it| (it.0 - best).exp());
    let found = mixture(each.iter().zip(weights).map(|(it, weight)| (&it.2, weight)));
    let most = each.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).expect("there are powers");
    (most.1, found)
}

/// Returns the logarithm of the likelihood of the readings with these variances, up to a constant.
fn log_likelihood(normals: &Normals, variances: &Variances, found: &Posterior) -> f64 {
    let system = system(normals, variances);
    let of_noise = normals.iter().zip(variances.noise_um).map(|(normal, noise_um)| {
        let variance = noise_um * noise_um;
        normal.count as f64 * variance.ln() + normal.whole / variance
    });
    let root = system.squares.l_dirty().diagonal();
    let determinant: f64 = root.iter().map(|it| 2.0 * it.ln()).sum();
    0.5 * (system.products.dot(&found.mean) - of_noise.sum::<f64>() - determinant)
}

/// Returns mean and covariance of posteriors with these weights.
fn mixture<'a>(each: impl Iterator<Item = (&'a Posterior, f64)> + Clone) -> Posterior {
    let whole: f64 = each.clone().map(|it| it.1).sum();
    let count = each.clone().next().map_or(0, |it| it.0.mean.len());
    let (mut mean, mut covariance) = (DVector::zeros(count), DMatrix::zeros(count, count));
    for (found, weight) in each.clone() {
        mean.axpy(weight / whole, &found.mean, 1.0);
    }
    for (found, weight) in each {
        let off = &found.mean - &mean;
        covariance += (&found.covariance + &off * off.transpose()) * (weight / whole);
    }
    Posterior { mean, covariance }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mixture_is_as_wide_as_its_parts_and_what_they_differ_by() {
        let part = |mean: f64, variance: f64| Posterior {
            mean: DVector::from_element(1, mean),
            covariance: DMatrix::from_element(1, 1, variance),
        };
        let found = mixture([(&part(0.0, 1.0), 3.0), (&part(4.0, 2.0), 1.0)].into_iter());
        // Mean 4/4; variance 5/4 within, ¾·1² + ¼·3² = 3 between.
        assert!((found.mean[0] - 1.0).abs() < 1e-12, "{found:?}");
        assert!((found.covariance[(0, 0)] - 4.25).abs() < 1e-12, "{found:?}");
    }
}
