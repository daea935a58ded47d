//! A head that turns the tool: rotary axes in a row, from the frame to the tool.
//!
//! The tool direction is the product of their turns, V = R₁·R₂·V₀: the axis next to the tool turns
//! it first, the one next to the frame turns what came of that. Turns are right-handed about +X (A),
//! +Y (B), +Z (C).

use schemars::JsonSchema;
use serde::Deserialize;

/// A rotary axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum RotaryAxis {
    /// Turns about X.
    A,
    /// Turns about Y.
    B,
    /// Turns about Z.
    C,
}

/// At most this many of them carry a spindle.
pub(crate) const MAX_HEAD_AXES: usize = 2;

impl RotaryAxis {
    /// Returns the column of its angle.
    #[must_use]
    pub(crate) fn angle_column(self) -> &'static str {
        ["a_deg", "b_deg", "c_deg"][self as usize]
    }

    /// `v` turned by `angle_deg` about this axis.
    fn rotate(self, angle_deg: f64, v: [f64; 3]) -> [f64; 3] {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        // The two components that it turns, in the order in which it turns them.
        let (first, second) = match self {
            Self::A => (1, 2),
            Self::B => (2, 0),
            Self::C => (0, 1),
        };
        let mut turned = v;
        turned[first] = cos * v[first] - sin * v[second];
        turned[second] = sin * v[first] + cos * v[second];
        turned
    }
}

/// `straight` turned by the head's axes, which stand at `angles_deg`.
#[must_use]
pub(crate) fn rotate_tool_direction(
    axes: &[RotaryAxis],
    angles_deg: [f64; MAX_HEAD_AXES],
    straight: [f64; 3],
) -> [f64; 3] {
    let from_the_frame: Vec<_> = axes.iter().zip(angles_deg).collect();
    from_the_frame.iter().rev().fold(straight, |v, (axis, angle_deg)| axis.rotate(*angle_deg, v))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tool_that_points_down_turns_with_a_and_then_with_c() {
        let axes = [RotaryAxis::C, RotaryAxis::A];
        // A at +30° moves a tool that points down to +Y: sin 30° = 0.5.
        let v = rotate_tool_direction(&axes, [0.0, 30.0], [0.0, 0.0, -1.0]);
        assert!((v[1] - 0.5).abs() < 1e-12 && (v[2] + 0.75_f64.sqrt()).abs() < 1e-12);
        // C at 90° then takes +Y to −X.
        let v = rotate_tool_direction(&axes, [90.0, 30.0], [0.0, 0.0, -1.0]);
        assert!((v[0] + 0.5).abs() < 1e-12 && v[1].abs() < 1e-12);
    }
}
