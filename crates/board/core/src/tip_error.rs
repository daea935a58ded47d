//! The raw error at the tool tip: what the model says of the present place, before the reference,
//! the limits and the slew rate. The tick and the host's prediction both take it from here.
//!
//! ```text
//! e = s·V + E        e on X, Y and Z: actual minus commanded
//! s  elongation by its source, with its terms        V  tool direction
//! E  sums of the errors of the axes (geometry)
//! ```

use crate::{
    calibration::ElongationSource,
    thermal_state::MachineThermalState,
    tool_direction::ToolDirection,
    units::{FineNanometres, Nanometres},
};

/// No part of an error is clamped by these.
pub const UNLIMITED: [FineNanometres; 3] = [FineNanometres(i32::MAX); 3];

/// Returns the elongation by a source, before its terms; 0 without one.
#[must_use]
#[inline]
pub fn source_elongation(
    source: Option<ElongationSource>,
    by_sensor: Nanometres,
    heat: &MachineThermalState,
) -> Nanometres {
    match source {
        Some(ElongationSource::Sensor) => by_sensor,
        Some(ElongationSource::Temperature) => heat.temperature_elongation(),
        Some(ElongationSource::Warmup) => heat.warmup_elongation(),
        None => Nanometres::ZERO,
    }
}

/// Returns the error at the tool tip on X, Y and Z in 1/256 nm, saturating at ±8.388 mm, and whether the
/// elongation along an axis was clamped to ±`largest`.
///
/// `axes` are the sums of the errors of the axes, with their parts clamped already.
///
/// ```
/// use trueup_core::{tip_error::{UNLIMITED, compute_tip_error}, tool_direction::ToolDirection, units::{FineNanometres, Nanometres}};
/// // A spindle that has grown by 20 µm, on a Z axis that goes 5 µm too high.
/// let axes = [FineNanometres(0), FineNanometres(0), FineNanometres(5_000 * 256)];
/// let (error, _) = compute_tip_error(Nanometres(20_000), ToolDirection::DOWN, axes, UNLIMITED);
/// assert_eq!(error.map(|fine| fine.rounded().0), [0, 0, -15_000]);
/// ```
#[must_use]
#[inline]
pub fn compute_tip_error(
    elongation: Nanometres,
    direction: ToolDirection,
    axes: [FineNanometres; 3],
    largest: [FineNanometres; 3],
) -> ([FineNanometres; 3], bool) {
    // Axis by axis and not in a loop: so no part goes through memory.
    let ([along_x, along_y, along_z], [x, y, z]) =
        (direction.project_elongation_fine(elongation), axes);
    let [largest_x, largest_y, largest_z] = largest;
    let x = compute_axis_tip_error(along_x, x, largest_x);
    let y = compute_axis_tip_error(along_y, y, largest_y);
    let z = compute_axis_tip_error(along_z, z, largest_z);
    ([x.0, y.0, z.0], x.1 | y.1 | z.1)
}

/// Returns the elongation along an axis, clamped, and the error of the axis itself.
#[inline]
fn compute_axis_tip_error(
    along: FineNanometres,
    own: FineNanometres,
    largest: FineNanometres,
) -> (FineNanometres, bool) {
    let (along, clamped) = along.clamped(largest);
    (along.saturating_add(own), clamped)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clamp_of_any_axis_and_of_several_at_once_is_reported() {
        // Growth of 100 nm along (0.48, 0.64, −0.6): every part is above 40 nm.
        let share = |share: f64| (share * f64::from(ToolDirection::ONE)) as i32;
        let direction = ToolDirection([0.48, 0.64, -0.6].map(share));
        for bits in 0..8_u8 {
            let largest = [0, 1, 2]
                .map(|axis| FineNanometres(if bits & 1 << axis == 0 { 25_600 } else { 256 }));
            let (error, clamped) =
                compute_tip_error(Nanometres(100), direction, [FineNanometres(0); 3], largest);
            assert_eq!(clamped, bits != 0, "{bits:03b}");
            for (axis, error) in error.into_iter().enumerate() {
                assert_eq!(error.0.abs() == 256, bits & 1 << axis != 0, "{bits:03b}");
            }
        }
    }
}
