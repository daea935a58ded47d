//! How many cycles would show that places differ.
//!
//! With p places, n cycles and an error of the size b (root mean square) next to a scatter s, F has the
//! noncentral distribution with (p − 1, p·(n − 1)) degrees of freedom and λ = n·p·(b/s)².

use super::table_selection::SIGNIFICANCE_LEVEL;
use crate::noncentral_f;

/// The chance with which the error is to be found.
const TARGET_POWER: f64 = 0.95;
/// No more cycles are considered.
const MAX_CYCLES: usize = 100;

/// Returns the fewest cycles, at least 2, over `places` places after which an error of the root mean square `size`
/// is found with 95 %, where one reading scatters by `scatter` (in the same unit). None: not within 100.
///
/// ```
/// use trueup_numerics::repeats::required_cycles;
/// assert_eq!(required_cycles(10.0, 1.0, 10), Some(2));
/// assert_eq!(required_cycles(0.01, 1.0, 10), None);
/// ```
#[must_use]
pub fn required_cycles(size: f64, scatter: f64, places: usize) -> Option<usize> {
    (2..=MAX_CYCLES).find(|&cycles| power(size, scatter, places, cycles) >= TARGET_POWER)
}

/// Returns the chance that this many cycles show the error, 0…1.
pub(super) fn power(size: f64, scatter: f64, places: usize, cycles: usize) -> f64 {
    let more = places.saturating_sub(1) as f64;
    let freedom = (places * cycles.saturating_sub(1)) as f64;
    let lambda = (places * cycles) as f64 * (size / scatter).powi(2);
    noncentral_f::f_test_power(SIGNIFICANCE_LEVEL, more, freedom, lambda)
}
