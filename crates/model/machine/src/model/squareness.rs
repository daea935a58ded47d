//! The error of one linear axis along another, in `f64`.
//!
//! A straightness is a [spline](crate::spline) over the position of the axis that moves. In space the curves add up:
//! Δx = δx(y) + δx(z), Δy = δy(x) + δy(z), Δz = δz(x) + δz(y). Squareness is a slope: the error of the first axis for one
//! metre of the second.

use crate::sections::Squareness;

/// Returns the error in µm of an angle between two axes, at `along_mm` on the second one.
///
/// ```
/// use trueup_machine::{machine_file::{LinearAxis, Squareness}, model::squareness_error_um};
/// let angle = Squareness { error: LinearAxis::X, along: LinearAxis::Y, um_per_m: 12.0 };
/// assert_eq!(squareness_error_um(&angle, -500.0), -6.0);
/// ```
#[must_use]
pub fn squareness_error_um(squareness: &Squareness, along_mm: f64) -> f64 {
    squareness.um_per_m * along_mm / 1000.0
}
