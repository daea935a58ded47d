//! Student's distribution, for intervals and for the limit beyond which a row is an outlier; and that of the ratio of two
//! mean squares.

use statrs::distribution::{ContinuousCDF, FisherSnedecor, StudentsT};

/// Returns the `probability` quantile of Student's t; infinite without degrees of freedom.
///
/// ```
/// assert!((trueup_numerics::t_quantile(0.975, 10.0) - 2.228_138_9).abs() < 1e-6);
/// ```
#[must_use]
pub fn t_quantile(probability: f64, degrees_of_freedom: f64) -> f64 {
    match StudentsT::new(0.0, 1.0, degrees_of_freedom) {
        Ok(t) if degrees_of_freedom > 0.0 => t.inverse_cdf(probability),
        _ => f64::INFINITY,
    }
}

/// Returns the probability that Student's t is below `t`; NaN without degrees of freedom.
///
/// ```
/// assert!((trueup_numerics::t_cdf(2.228_138_9, 10.0) - 0.975).abs() < 1e-8);
/// ```
#[must_use]
pub fn t_cdf(t: f64, degrees_of_freedom: f64) -> f64 {
    match StudentsT::new(0.0, 1.0, degrees_of_freedom) {
        Ok(student) if degrees_of_freedom > 0.0 => student.cdf(t),
        _ => f64::NAN,
    }
}

/// Returns the `probability` quantile of the ratio of two mean squares with these degrees of freedom, Fisher's F;
/// infinite without degrees of freedom.
///
/// ```
/// // scipy.stats.f.ppf(0.95, 3, 10)
/// assert!((trueup_numerics::f_quantile(0.95, 3.0, 10.0) - 3.708_264_8).abs() < 1e-6);
/// ```
#[must_use]
pub fn f_quantile(probability: f64, numerator: f64, denominator: f64) -> f64 {
    let quantile = FisherSnedecor::new(numerator, denominator).map(|f| f.inverse_cdf(probability));
    quantile.ok().filter(|f| !f.is_nan()).unwrap_or(f64::INFINITY)
}
