//! The noncentral F distribution: how likely a test finds an effect of a given size.
//!
//! With k constants, ν degrees of freedom left and the noncentrality λ (the sum of the squares of the
//! effect over the variance of one reading) the statistic F exceeds f with the probability
//!
//! ```text
//! P(F > f) = Σ_j e^(−λ/2)·(λ/2)^j/j! · (1 − I_x(k/2 + j, ν/2))      x = k·f/(k·f + ν)
//! ```
//!
//! I is the regularised incomplete beta function (Johnson, Kotz and Balakrishnan 1995, chapter 30). The
//! sum begins at its largest weight and goes both ways until the weights no longer count.

use statrs::{
    distribution::{ContinuousCDF, FisherSnedecor},
    function::{beta::beta_reg, gamma::ln_gamma},
};

/// No test needs more than that; beyond it the sum would only be longer.
const MAX_NONCENTRALITY: f64 = 2e5;
/// Weights of the sum below this are left out.
const MIN_POISSON_WEIGHT: f64 = 1e-17;

/// Returns the chance, 0…1, that an F test at the level `significance` with `constants` and `freedom` degrees of
/// freedom finds an effect of this `noncentrality`; 0 where nothing is left to test with.
///
/// ```
/// use trueup_numerics::noncentral_f::f_test_power;
/// // scipy.stats.ncf.sf(f.isf(0.01, 2, 20), 2, 20, 15)
/// assert!((f_test_power(0.01, 2.0, 20.0, 15.0) - 0.712_219_807).abs() < 1e-9);
/// ```
#[must_use]
pub fn f_test_power(significance: f64, constants: f64, freedom: f64, noncentrality: f64) -> f64 {
    let Ok(central) = FisherSnedecor::new(constants, freedom) else { return 0.0 };
    if noncentrality.is_nan() || noncentrality <= 0.0 {
        // Without an effect it is found by chance alone.
        return significance;
    }
    let limit = central.inverse_cdf(1.0 - significance);
    // Of a small part of a degree of freedom the limit is beyond all numbers, and x is 1.
    let x = 1.0 / (1.0 + freedom / (constants * limit));
    let half = 0.5 * noncentrality.min(MAX_NONCENTRALITY);
    let weight = |j: f64| (j * half.ln() - half - ln_gamma(j + 1.0)).exp();
    let missed = |j: f64| beta_reg(0.5 * constants + j, 0.5 * freedom, x);
    let largest = half.floor();
    let mut sum = 0.0;
    let mut j = largest;
    while j >= 0.0 && weight(j) > MIN_POISSON_WEIGHT {
        sum += weight(j) * missed(j);
        j -= 1.0;
    }
    j = largest + 1.0;
    while weight(j) > MIN_POISSON_WEIGHT {
        sum += weight(j) * missed(j);
        j += 1.0;
    }
    (1.0 - sum).clamp(0.0, 1.0)
}

/// Returns the noncentrality that such a test finds with the chance `requested`; infinite where none does.
#[must_use]
pub fn required_noncentrality(
    requested: f64,
    significance: f64,
    constants: f64,
    freedom: f64,
) -> f64 {
    let finds = |lambda: f64| f_test_power(significance, constants, freedom, lambda) >= requested;
    let (mut low, mut high) = (0.0, 1.0);
    while !finds(high) {
        (low, high) = (high, 2.0 * high);
        if high > MAX_NONCENTRALITY {
            return f64::INFINITY;
        }
    }
    // To a thousandth: a size is proportional to its root.
    while high - low > 1e-3 * high {
        let middle = 0.5 * (low + high);
        if finds(middle) { high = middle } else { low = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_power_is_that_of_scipy() {
        // scipy 1.17: ncf.sf(f.isf(significance, k, ν), k, ν, λ)
        for (k, freedom, lambda, significance, scipy) in [
            (1.0, 10.0, 12.0, 0.01, 0.622_611_486_294_519_6),
            (2.0, 20.0, 15.0, 0.01, 0.712_219_807_168_759_7),
            (10.0, 44.0, 30.0, 0.01, 0.828_779_327_165_337_6),
            (1.0, 600.0, 17.8, 0.001, 0.818_439_617_007_799_3),
            (5.0, 3.0, 200.0, 0.05, 0.995_069_487_385_805_1),
            (3.0, 97.0, 0.0, 0.01, 0.01),
        ] {
            let here = f_test_power(significance, k, freedom, lambda);
            assert!((here - scipy).abs() < 1e-9, "{k} {freedom} {lambda}: {here} and {scipy}");
        }
        assert_eq!(f_test_power(0.01, 1.0, 0.0, 100.0), 0.0);
    }

    #[test]
    fn a_part_of_a_degree_of_freedom_finds_next_to_nothing() {
        for constants in [1.0, 2.0, 2.4] {
            for freedom in [1e-9, 1e-3, 0.01, 0.02, 0.05, 0.1, 0.3] {
                let found = f_test_power(1e-5, constants, freedom, 1e4);
                assert!((0.0..0.2).contains(&found), "{constants} {freedom}: {found}");
                let lambda = required_noncentrality(0.95, 1e-5, constants, freedom);
                assert_eq!(lambda, f64::INFINITY, "{constants} {freedom}");
            }
        }
    }

    #[test]
    fn the_noncentrality_is_the_one_that_has_the_power() {
        for (constants, freedom) in [(1.0, 10.0), (2.0, 598.0), (21.0, 44.0)] {
            let lambda = required_noncentrality(0.95, 0.01, constants, freedom);
            assert!((f_test_power(0.01, constants, freedom, lambda) - 0.95).abs() < 1e-3);
        }
        assert_eq!(required_noncentrality(0.95, 0.01, 1.0, 0.0), f64::INFINITY);
    }
}
