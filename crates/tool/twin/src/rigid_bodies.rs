//! The bodies between the workpiece and the tool: each is moved by one axis, and is a little turned and
//! shifted where it should be straight.
//!
//! ```text
//! workpiece ◄─ body ◄─ body ◄─ bed ─► body ─► body ─► tool
//! ```
//!
//! Where the tip is on the workpiece comes from the whole transforms of both branches, rotation matrices and
//! all, once with the errors and once without; the difference, along the machine's own axes, is the error.
//! A body that carries the workpiece goes the other way than its axis is commanded.

use schemars::JsonSchema;
use serde::Deserialize;

use crate::{cubic_spline::CubicSpline, rotary_head, scenario_error::RuleViolation};

/// The axis that moves a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum MovingAxis {
    /// Along X.
    X,
    /// Along Y.
    Y,
    /// Along Z.
    Z,
    /// About X.
    A,
    /// About Y.
    B,
    /// About Z.
    C,
}

/// A body that an axis moves.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// The axis that moves it.
    pub axis: MovingAxis,
    /// Whether it carries the workpiece, not the tool.
    #[serde(default)]
    pub workpiece: bool,
    /// The point of it that goes as the axis says, and about which it is turned; of a rotary axis a point of
    /// its line. In mm, with all axes at 0: of the tool's rotary axes from the spindle nose, of all others in
    /// machine coordinates.
    #[serde(default)]
    pub at_mm: [f64; 3],
    /// How far it is turned about X in µrad, over the position of its linear axis in mm.
    #[serde(default)]
    pub turn_x: CubicSpline,
    /// About Y.
    #[serde(default)]
    pub turn_y: CubicSpline,
    /// About Z.
    #[serde(default)]
    pub turn_z: CubicSpline,
    /// How far the line of its rotary axis is off, in µm.
    #[serde(default)]
    pub shift_um: [f64; 3],
    /// How far that line is turned about X, Y and Z, in µrad.
    #[serde(default)]
    pub tilt_urad: [f64; 3],
}

/// The first rule that the bodies of a machine break, `head` being its rotary axes that turn the tool.
pub(crate) fn check(
    bodies: &[Body],
    head: &[rotary_head::RotaryAxis],
) -> Result<(), RuleViolation> {
    for (index, body) in bodies.iter().enumerate() {
        let section = format!("body[{index}]");
        if bodies[..index].iter().any(|before| before.axis == body.axis) {
            return Err(RuleViolation::new("axis", "moves two bodies".into()).in_section(&section));
        }
        let turns_tool = !body.workpiece && body.rotation_axis().is_some();
        if turns_tool && !head.iter().any(|axis| Some(*axis as usize) == body.rotation_axis()) {
            return Err(RuleViolation::new("axis", "turns the tool, and is not in head".into())
                .in_section(&section));
        }
    }
    Ok(())
}

/// A rotation, and a translation in mm after it.
#[derive(Clone, Copy)]
struct Transform {
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
}

impl Transform {
    const IDENTITY: Self = Self {
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
    };

    fn from_translation(translation: [f64; 3]) -> Self {
        Self { translation, ..Self::IDENTITY }
    }

    fn from_rotation(about: usize, angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        let (first, second) = ((about + 1) % 3, (about + 2) % 3);
        let mut turn = Self::IDENTITY;
        turn.rotation[first][first] = cos;
        turn.rotation[first][second] = -sin;
        turn.rotation[second][first] = sin;
        turn.rotation[second][second] = cos;
        turn
    }

    fn from_small_rotations(urad: [f64; 3]) -> Self {
        let turns = (0..3).map(|about| Self::from_rotation(about, urad[about] * 1e-6));
        turns.fold(Self::IDENTITY, Self::compose)
    }

    /// First `inner`, then this.
    fn compose(self, inner: Self) -> Self {
        let rotation = std::array::from_fn(|row| {
            std::array::from_fn(|column| {
                (0..3).map(|n| self.rotation[row][n] * inner.rotation[n][column]).sum()
            })
        });
        Self { rotation, translation: self.transform_point(inner.translation) }
    }

    fn transform_point(&self, point: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|row| {
            (0..3).map(|n| self.rotation[row][n] * point[n]).sum::<f64>() + self.translation[row]
        })
    }

    /// Where a point of outside is, seen from what was moved so.
    fn inverse_transform_point(&self, point: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|column| {
            (0..3).map(|n| self.rotation[n][column] * (point[n] - self.translation[n])).sum()
        })
    }
}

impl Body {
    /// About which of X, Y and Z its axis turns it; `None` of a linear one.
    fn rotation_axis(&self) -> Option<usize> {
        (self.axis as usize).checked_sub(3)
    }

    /// Returns what the body's axis does to all that is on it.
    fn axis_transform(
        &self,
        position_mm: [f64; 3],
        angle_deg: [f64; 3],
        is_perfect: bool,
    ) -> Transform {
        let way = if self.workpiece { -1.0 } else { 1.0 };
        let to = Transform::from_translation(self.at_mm);
        let back = Transform::from_translation(self.at_mm.map(|mm| -mm));
        match self.rotation_axis() {
            None => {
                let along = self.axis as usize;
                let mm = position_mm[along];
                let mut step = [0.0; 3];
                step[along] = way * mm;
                let step = Transform::from_translation(step);
                if is_perfect {
                    return step;
                }
                let urad = [&self.turn_x, &self.turn_y, &self.turn_z].map(|turn| turn.evaluate(mm));
                step.compose(to).compose(Transform::from_small_rotations(urad)).compose(back)
            }
            Some(about) => {
                let turn = Transform::from_rotation(about, (way * angle_deg[about]).to_radians());
                let off = Transform::from_translation(self.shift_um.map(|um| um / 1000.0))
                    .compose(Transform::from_small_rotations(self.tilt_urad));
                let line = if is_perfect { to } else { to.compose(off) };
                line.compose(turn).compose(back)
            }
        }
    }
}

/// Returns the error of the tip on the workpiece along the machine's axes, in µm: of bodies listed from the
/// workpiece to the tool, with the tip at `tip_mm` from the spindle nose. Angles are of A, B and C.
#[must_use]
pub fn error_um(
    bodies: &[Body],
    tip_mm: [f64; 3],
    position_mm: [f64; 3],
    angle_deg: [f64; 3],
) -> [f64; 3] {
    if bodies.is_empty() {
        return [0.0; 3];
    }
    let branch = |is_perfect: bool, of_workpiece: bool| {
        let own = bodies.iter().filter(|body| body.workpiece == of_workpiece);
        let own = own.map(|body| body.axis_transform(position_mm, angle_deg, is_perfect));
        let mut from_bed: Vec<Transform> = own.collect();
        if of_workpiece {
            from_bed.reverse();
        }
        from_bed.into_iter().fold(Transform::IDENTITY, Transform::compose)
    };
    let on_workpiece = |is_perfect: bool| {
        branch(is_perfect, true)
            .inverse_transform_point(branch(is_perfect, false).transform_point(tip_mm))
    };
    let (actual, right) = (on_workpiece(false), on_workpiece(true));
    let off = std::array::from_fn(|n| (actual[n] - right[n]) * 1000.0);
    // A direction, not a point.
    let table = branch(true, true);
    Transform { translation: [0.0; 3], ..table }.transform_point(off)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body(text: &str) -> Body {
        toml::from_str(text).expect("the test's own")
    }

    #[test]
    fn a_carriage_that_rolls_takes_the_tip_by_its_arm_and_a_table_the_other_way() {
        // 10 µrad about X, with an arm of 200 mm in Y and 400 mm in Z.
        let rolls = "axis = \"x\"\nturn_x = [[0, 10]]\n";
        for (text, sign) in [(rolls.to_string(), 1.0), (format!("{rolls}workpiece = true\n"), -1.0)]
        {
            let bodies = [body(&text), body("axis = \"y\""), body("axis = \"z\"")];
            let [x, y, z] = error_um(&bodies, [0.0; 3], [0.0, 200.0, 400.0], [0.0; 3]);
            assert!(
                x.abs() < 1e-6 && (y + sign * 4.0).abs() < 1e-3 && (z - sign * 2.0).abs() < 1e-3
            );
        }
    }

    #[test]
    fn a_line_that_is_off_shows_in_the_directions_that_its_body_stands_in() {
        // C on A, both under the workpiece: A at 90° takes what was +Y of C to −Z.
        let bodies = [
            body("axis = \"c\"\nworkpiece = true\nshift_um = [0, 5, 0]\n"),
            body("axis = \"a\"\nworkpiece = true\n"),
        ];
        let [_, y, z] = error_um(&bodies, [0.0; 3], [0.0; 3], [90.0, 0.0, 30.0]);
        assert!(y.abs() < 1e-9 && (z - 5.0).abs() < 1e-9, "{y} {z}");
    }
}
