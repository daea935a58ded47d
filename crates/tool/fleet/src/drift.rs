//! A constant of one machine over its days: does it change, and how fast.
//!
//! A line v = a + b·t by weighted least squares; the errors of the fits are known, so two days are enough. Where the
//! values scatter around it more than their errors explain (χ² at 5 %), the interval grows as much (Birge 1932), with
//! Student's t for the days that are left.

use serde::Serialize;
use trueup_compare::dated_constants::EpochDay;
use trueup_numerics::t_quantile;

use crate::{
    outliers::SIGNIFICANCE_LEVEL,
    random_effects::{Estimate, NORMAL_QUANTILE_975},
};

/// Days of a year.
const DAYS_PER_YEAR: f64 = 365.25;

/// A change with time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Drift {
    /// The change in a year.
    pub per_year: f64,
    /// Its interval of 95 %.
    pub ci95: [f64; 2],
    /// True if it is certain: of machines that do not change one in 100 is called so, over all its constants.
    pub is_certain: bool,
}

/// Returns the change over the days; none below two days. `constants`: how many are looked at on the machine.
#[must_use]
pub(crate) fn estimate_drift(days: &[(EpochDay, Estimate)], constants: usize) -> Option<Drift> {
    let first = days.iter().map(|(day, _)| *day).min()?;
    let at = |day: EpochDay| (day - first) as f64 / DAYS_PER_YEAR;
    let weight = |estimate: &Estimate| estimate.se.powi(-2);
    let sum: f64 = days.iter().map(|(_, estimate)| weight(estimate)).sum();
    let mean = |of: &dyn Fn(&(EpochDay, Estimate)) -> f64| {
        days.iter().map(|day| weight(&day.1) * of(day)).sum::<f64>() / sum
    };
    let (mean_t, mean_v) = (mean(&|day| at(day.0)), mean(&|day| day.1.value));
    let spread: f64 =
        days.iter().map(|(day, estimate)| weight(estimate) * (at(*day) - mean_t).powi(2)).sum();
    if spread <= 0.0 {
        return None;
    }
    let products = days
        .iter()
        .map(|(day, estimate)| weight(estimate) * (at(*day) - mean_t) * (estimate.value - mean_v));
    let per_year = products.sum::<f64>() / spread;
    let residual = |(day, estimate): &(EpochDay, Estimate)| {
        estimate.value - mean_v - per_year * (at(*day) - mean_t)
    };
    let squares: f64 = days.iter().map(|day| weight(&day.1) * residual(day).powi(2)).sum();
    let freedom = days.len() as f64 - 2.0;
    let scatters = freedom > 0.0 && squares > chi_squared_quantile_95(freedom);
    let birge = if scatters { squares / freedom } else { 1.0 };
    let se = (birge / spread).sqrt();
    // With known errors the normal distribution.
    let freedom = if scatters { freedom } else { 1e6 };
    let quantile = |two_sided: f64| t_quantile(1.0 - 0.5 * two_sided, freedom);
    let half = quantile(0.05).max(NORMAL_QUANTILE_975) * se;
    let level = SIGNIFICANCE_LEVEL / constants.max(1) as f64;
    Some(Drift {
        per_year,
        ci95: [per_year - half, per_year + half],
        is_certain: per_year.abs() > quantile(level) * se,
    })
}

/// Returns the 95 % quantile of χ² by Wilson and Hilferty (1931), within 3 %.
fn chi_squared_quantile_95(freedom: f64) -> f64 {
    let part = 2.0 / (9.0 * freedom);
    freedom * (1.0 - part + 1.645 * part.sqrt()).powi(3)
}

/// Returns one value for all days: the newest where the constant changes, else the mean, with an error that covers
/// their scatter.
#[must_use]
pub(crate) fn current_estimate(
    days: &[(Option<EpochDay>, Estimate)],
    drift: Option<Drift>,
) -> Option<Estimate> {
    let newest = days.iter().max_by_key(|(day, _)| *day).map(|(_, estimate)| *estimate)?;
    if drift.is_some_and(|drift| drift.is_certain) {
        return Some(newest);
    }
    let sum: f64 = days.iter().map(|(_, estimate)| estimate.se.powi(-2)).sum();
    let value =
        days.iter().map(|(_, estimate)| estimate.value / estimate.se.powi(2)).sum::<f64>() / sum;
    let squares: f64 =
        days.iter().map(|(_, estimate)| ((estimate.value - value) / estimate.se).powi(2)).sum();
    let birge = (squares / (days.len() as f64 - 1.0).max(1.0)).max(1.0);
    Some(Estimate { value, se: (birge / sum).sqrt() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(value: f64) -> Estimate {
        Estimate { value, se: 0.1 }
    }

    #[test]
    fn a_change_beyond_the_errors_is_found_and_one_within_them_is_not() {
        let year = 365;
        let grows = [(0, value(1.0)), (year, value(2.0)), (2 * year, value(3.0))];
        let found = estimate_drift(&grows, 1).expect("three days");
        assert!((found.per_year - 1.0).abs() < 1e-3 && found.is_certain, "{found:?}");
        let stays = [(0, value(1.0)), (year, value(1.15))];
        assert!(!estimate_drift(&stays, 1).expect("two days").is_certain);
        assert_eq!(estimate_drift(&[(7, value(1.0)), (7, value(2.0))], 1), None, "one day");
    }

    #[test]
    fn what_scatters_beyond_its_errors_is_no_drift() {
        let days = [(0, value(1.0)), (100, value(3.0)), (200, value(1.2)), (300, value(3.1))];
        let found = estimate_drift(&days, 1).expect("four days");
        assert!(!found.is_certain && found.ci95[0] < 0.0, "{found:?}");
        for (freedom, exact) in [(1.0, 3.841), (2.0, 5.991), (10.0, 18.307)] {
            assert!((chi_squared_quantile_95(freedom) / exact - 1.0).abs() < 0.03, "{freedom}");
        }
    }

    #[test]
    fn a_machine_that_drifts_is_as_it_was_last_and_another_is_the_mean() {
        let days = [(Some(0), value(1.0)), (Some(365), value(2.0))];
        let drifting = estimate_drift(&[(0, value(1.0)), (365, value(2.0))], 1);
        assert_eq!(current_estimate(&days, drifting), Some(value(2.0)));
        let mean = current_estimate(&days, None).expect("two values");
        assert!((mean.value - 1.5).abs() < 1e-12 && mean.se > 0.3, "{mean:?}");
    }
}
