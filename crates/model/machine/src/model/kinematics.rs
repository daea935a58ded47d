//! Where the tool points, and what its growth does to X, Y and Z, in `f64`.
//!
//! With V₀ the direction at zero (`docs/physics.md` section 2): V = R₁·R₂·V₀ for the rotary axes that
//! carry the spindle, R₁ that of the one next to the frame; V = V₀ where none does. Rotations are
//! right-handed, about +X (A), +Y (B), +Z (C).
//!
//! A growth s is an error of s·V. The CNC adds the offset, the opposite of the error: with the tool
//! pointing down, growth of +60 µm is an error of −60 µm in Z, and the offset lifts by +60 µm.

use crate::sections::RotaryAxis;

/// `vector` turned about the axis of `axis` by `angle_deg`, by the right hand.
///
/// ```
/// use trueup_machine::{machine_file::RotaryAxis, model::rotate_about_axis};
/// // C = +90° takes +X to +Y.
/// let [x, y, z] = rotate_about_axis([1.0, 0.0, 0.0], RotaryAxis::C, 90.0);
/// assert!(x.abs() < 1e-15 && y == 1.0 && z == 0.0);
/// ```
#[must_use]
pub fn rotate_about_axis(vector: [f64; 3], axis: RotaryAxis, angle_deg: f64) -> [f64; 3] {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    let [x, y, z] = vector;
    match axis {
        RotaryAxis::A => [x, y * cos - z * sin, y * sin + z * cos],
        RotaryAxis::B => [x * cos + z * sin, y, z * cos - x * sin],
        RotaryAxis::C => [x * cos - y * sin, x * sin + y * cos, z],
    }
}

/// Returns the tool direction V at the angles `angle_deg` of A, B and C: `at_zero` turned by `head_axes`,
/// which are listed from the frame to the tool.
///
/// ```
/// use trueup_machine::{machine_file::RotaryAxis::{A, C}, model::tool_direction};
/// // A = +30° swings the tool to (0, sin 30°, −cos 30°); C = +90° turns that on to −X.
/// let [x, y, z] = tool_direction([0.0, 0.0, -1.0], &[C, A], [30.0, 0.0, 90.0]);
/// assert!((x + 0.5).abs() < 1e-15 && y.abs() < 1e-15 && (z + 0.75_f64.sqrt()).abs() < 1e-15);
/// ```
#[must_use]
pub fn tool_direction(
    at_zero: [f64; 3],
    head_axes: &[RotaryAxis],
    angle_deg: [f64; 3],
) -> [f64; 3] {
    // The axis next to the tool turns it first, within all the others.
    head_axes
        .iter()
        .rev()
        .fold(at_zero, |vector, &axis| rotate_about_axis(vector, axis, angle_deg[axis.index()]))
}

/// Returns the error on X, Y and Z in µm of a tool that has grown by `elongation_um` along the unit vector
/// `tool_direction`. A component of 0 takes nothing of a growth that is not known (NaN).
#[must_use]
pub fn elongation_error_um(elongation_um: f64, tool_direction: [f64; 3]) -> [f64; 3] {
    // + 0.0 turns −0 into 0, which is what a table should show.
    tool_direction.map(|v| if v == 0.0 { 0.0 } else { elongation_um * v + 0.0 })
}

/// Returns what the CNC must add to its command on X, Y and Z, in µm: the opposite of [`elongation_error_um`].
#[must_use]
pub fn compensation_offset_um(elongation_um: f64, tool_direction: [f64; 3]) -> [f64; 3] {
    elongation_error_um(-elongation_um, tool_direction)
}

#[cfg(test)]
mod tests {
    use super::*;
    use RotaryAxis::{A, B, C};

    const DOWN: [f64; 3] = [0.0, 0.0, -1.0];

    fn assert_near(there: [f64; 3], expected: [f64; 3]) {
        for (there, expected) in there.into_iter().zip(expected) {
            assert!((there - expected).abs() < 1e-12, "{there} is not {expected}");
        }
    }

    #[test]
    fn growth_lifts_the_tool() {
        assert_eq!(elongation_error_um(62.8, DOWN), [0.0, 0.0, -62.8]);
        assert_eq!(compensation_offset_um(62.8, DOWN), [0.0, 0.0, 62.8]);
    }

    #[test]
    fn shrinking_lowers_the_tool() {
        assert_eq!(compensation_offset_um(-5.0, DOWN), [0.0, 0.0, -5.0]);
    }

    #[test]
    fn half_a_millimetre_at_a_30_degrees_is_the_papers_250_and_433_um() {
        let swung = tool_direction(DOWN, &[A], [30.0, 0.0, 0.0]);
        let cos = 0.75_f64.sqrt();
        assert_near(elongation_error_um(500.0, swung), [0.0, 250.0, -500.0 * cos]);
        assert_near(compensation_offset_um(500.0, swung), [0.0, -250.0, 500.0 * cos]);
        assert!((500.0 * cos - 433.0).abs() < 0.02);
    }

    #[test]
    fn every_rotary_axis_turns_by_the_right_hand() {
        let (x, y, z) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        assert_near(rotate_about_axis(y, A, 90.0), z);
        assert_near(rotate_about_axis(z, B, 90.0), x);
        assert_near(rotate_about_axis(x, C, 90.0), y);
        for (axis, own) in [(A, x), (B, y), (C, z)] {
            assert_eq!(rotate_about_axis(own, axis, 33.0), own);
        }
        // B = +90° swings a tool that points down to −X.
        assert_near(tool_direction(DOWN, &[B], [0.0, 90.0, 0.0]), [-1.0, 0.0, 0.0]);
    }

    #[test]
    fn the_axis_next_to_the_frame_turns_what_the_one_next_to_the_tool_has_swung() {
        let angle_deg = [30.0, 0.0, 90.0];
        let cos = 0.75_f64.sqrt();
        assert_near(tool_direction(DOWN, &[C, A], angle_deg), [-0.5, 0.0, -cos]);
        // The other way round C turns the tool about itself, and A then swings it.
        assert_near(tool_direction(DOWN, &[A, C], angle_deg), [0.0, 0.5, -cos]);
    }

    #[test]
    fn without_head_axes_no_angle_counts() {
        assert_eq!(tool_direction(DOWN, &[], [f64::NAN; 3]), DOWN);
        // About its own direction a component stays, whatever the angle.
        assert_eq!(tool_direction(DOWN, &[C], [0.0, 0.0, f64::NAN])[2], -1.0);
    }

    #[test]
    fn a_direction_keeps_its_length() {
        for step in 0..1000 {
            let angle_deg = [f64::from(step) * 0.37, 0.0, f64::from(step) * -1.7];
            let v = tool_direction([0.0, 0.6, -0.8], &[C, A], angle_deg);
            assert!((v.iter().map(|c| c * c).sum::<f64>() - 1.0).abs() < 1e-14);
        }
    }

    #[test]
    fn no_component_is_minus_zero() {
        for component in
            compensation_offset_um(1.0, DOWN).into_iter().chain(elongation_error_um(1.0, DOWN))
        {
            assert!(component != 0.0 || component.is_sign_positive());
        }
    }

    #[test]
    fn an_unknown_growth_is_unknown_only_where_the_tool_points() {
        let [x, y, z] = elongation_error_um(f64::NAN, DOWN);
        assert_eq!((x, y), (0.0, 0.0));
        assert!(z.is_nan());
    }
}
