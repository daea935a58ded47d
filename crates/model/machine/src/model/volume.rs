//! The errors of the volume in `f64`: angular errors of the linear axes and location errors of the rotary
//! axes, each times its lever to the tool tip.
//!
//! ```text
//! workpiece ◄─ C′ ◄─ A′ ◄─ X′ ◄─ bed ─► Y ─► Z ─► B ─► tool
//!
//! e = Σ ε_i × L_i  +  Σ (δ_r + ε_r × L_r)       − for an axis that moves the workpiece
//! ```
//!
//! | angle | lever X | lever Y | lever Z |
//! |---|---|---|---|
//! | about X (EAX, EAY, EAZ) | | +dz | −dy |
//! | about Y (EBX, EBY, EBZ) | −dz | | +dx |
//! | about Z (ECX, ECY, ECZ) | +dy | −dx | |
//!
//! The lever of a linear axis goes from its `point_mm` to the tool tip: positions of the axes between it and the tool,
//! its own too where it moves the workpiece, and the tool. Of a rotary axis that turns the tool the lever goes from its
//! line to the tip; of one that turns the workpiece from its line to the place where the tip is on it. All errors are
//! along X, Y and Z of the machine, whatever the angles are. First order: the product of two errors is neglected. Against
//! homogeneous transforms it is within 0.01 µm (`host-tests/python/volume.py`).

use super::kinematics::rotate_about_axis;
use crate::{
    machine_file::Machine,
    sections::{
        AngleProfile, AngularErrorMotion, AxisChain, LinearAxis, RotaryAxis, RotaryLocationErrors,
        ToolGeometry,
    },
    spline::spline_value_um,
};

/// Returns the error of the tip of `tool` on X, Y and Z in µm; 0 without angular and location errors. A position, an
/// angle or a length that is missing (NaN) makes what depends on it NaN.
///
/// ```
/// use std::path::Path;
/// use trueup_machine::{MachineFile, model::volumetric_error_um};
/// let text = "machine = { name = 'm', kind = '3-axis', chain = 'w b X Y Z t' }
///             angular.eax.urad_per_m = 10.0";
/// let machine = MachineFile::parse(text, Path::new("m.toml")).expect("right");
/// // At X = 1 m it is rolled by 10 µrad; 0.5 m of Y lift the tip by 5 µm, 0.2 m of Z take it to −Y by 2 µm.
/// let tool = machine.volume.tool;
/// assert_eq!(volumetric_error_um(&machine, tool, [1000.0, 500.0, 200.0], [0.0; 3]), [0.0, -2.0, 5.0]);
/// ```
#[must_use]
pub fn volumetric_error_um(
    machine: &Machine,
    tool: ToolGeometry,
    position_mm: [f64; 3],
    angle_deg: [f64; 3],
) -> [f64; 3] {
    let volume = &machine.volume;
    let Some(chain) = volume.chain.as_ref().filter(|_| volume.has_geometric_errors()) else {
        return [0.0; 3];
    };
    let (tip_mm, mut error_um) = compute_tip_and_head_error(machine, tool, chain, angle_deg);
    for angular in &volume.angular {
        let place_mm = position_mm[angular.along.index()];
        let urad = angle_urad(&angular.angle, place_mm);
        let sign = if chain.moves_workpiece(angular.along) { -1.0 } else { 1.0 };
        for (error, lever, turns) in rotation_levers(angular.about) {
            let from_point =
                tip_mm[lever.index()] - volume.point_mm[angular.along.index()][lever.index()];
            let travelled = chain.lever_axes(angular.along).contains(&lever);
            let travelled_mm = if travelled { position_mm[lever.index()] } else { 0.0 };
            error_um[error.index()] += sign * turns * urad * (from_point + travelled_mm) / 1000.0;
        }
    }
    let on_table = table_axes_error_um(machine, chain, tip_mm, position_mm, angle_deg);
    [0, 1, 2].map(|n| error_um[n] - on_table[n])
}

/// Returns where a turn about an axis moves a point: axis in error, axis of the lever, sign.
fn rotation_levers(about: RotaryAxis) -> [(LinearAxis, LinearAxis, f64); 2] {
    use LinearAxis::{X, Y, Z};
    match about {
        RotaryAxis::A => [(Z, Y, 1.0), (Y, Z, -1.0)],
        RotaryAxis::B => [(X, Z, 1.0), (Z, X, -1.0)],
        RotaryAxis::C => [(Y, X, 1.0), (X, Y, -1.0)],
    }
}

fn angle_urad(angle: &AngleProfile, place_mm: f64) -> f64 {
    match angle {
        AngleProfile::Line(urad_per_m) => urad_per_m * place_mm / 1000.0,
        AngleProfile::Curve(spline) => spline_value_um(spline, place_mm),
    }
}

/// Returns the tip from the spindle nose in mm, and the errors of the axes that turn the tool in µm.
fn compute_tip_and_head_error(
    machine: &Machine,
    tool: ToolGeometry,
    chain: &AxisChain,
    angle_deg: [f64; 3],
) -> ([f64; 3], [f64; 3]) {
    let volume = &machine.volume;
    let mut tip_mm = tool.tip_offset_mm(machine.tool_direction);
    let mut error_um = [0.0; 3];
    for &axis in chain.head.iter().rev() {
        let point_mm = volume.axis_line_point_mm(axis);
        let angle = angle_deg[axis.index()];
        let arm_mm = subtract_vectors(tip_mm, point_mm);
        // An arm of nothing is nothing at any angle.
        let arm_mm =
            if arm_mm == [0.0; 3] { arm_mm } else { rotate_about_axis(arm_mm, axis, angle) };
        if error_um != [0.0; 3] {
            error_um = rotate_about_axis(error_um, axis, angle);
        }
        if let Some(location) = volume.rotary.iter().find(|location| location.axis == axis) {
            error_um = add_vectors(error_um, location_error_um(location, arm_mm));
        }
        tip_mm = add_vectors(point_mm, arm_mm);
    }
    (tip_mm, error_um)
}

/// Returns the errors of the axes that turn the workpiece, in µm: how far it is off at the tip.
fn table_axes_error_um(
    machine: &Machine,
    chain: &AxisChain,
    tip_mm: [f64; 3],
    position_mm: [f64; 3],
    angle_deg: [f64; 3],
) -> [f64; 3] {
    let volume = &machine.volume;
    // Seen from the part that the present axis is on, and how the parts before it are turned.
    let (mut seen_mm, mut before): ([f64; 3], Vec<RotaryAxis>) =
        (add_vectors(position_mm, tip_mm), Vec::new());
    let mut sum_um = [0.0; 3];
    for &axis in &chain.table {
        let point_mm = volume.axis_line_point_mm(axis);
        let location = volume.rotary.iter().find(|location| location.axis == axis);
        if let Some(location) = location.filter(|location| !location.is_error_free()) {
            let own_um = location_error_um(location, subtract_vectors(seen_mm, point_mm));
            let error_um = before.iter().rev().fold(own_um, |um, &turned| {
                rotate_about_axis(um, turned, -angle_deg[turned.index()])
            });
            sum_um = add_vectors(sum_um, error_um);
        }
        // A workpiece that turns by −θ sees the tip turned by +θ.
        seen_mm = add_vectors(
            point_mm,
            rotate_about_axis(subtract_vectors(seen_mm, point_mm), axis, angle_deg[axis.index()]),
        );
        before.push(axis);
    }
    sum_um
}

/// Returns δ + ε × L; a lever that no angle multiplies may be missing.
fn location_error_um(location: &RotaryLocationErrors, lever_mm: [f64; 3]) -> [f64; 3] {
    let mut error_um = location.shift_um;
    for about in RotaryAxis::ALL {
        let urad = location.tilt_urad[about.index()];
        for (error, lever, turns) in rotation_levers(about).into_iter().filter(|_| urad != 0.0) {
            error_um[error.index()] += turns * urad * lever_mm[lever.index()] / 1000.0;
        }
    }
    error_um
}

fn add_vectors(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|n| a[n] + b[n])
}

fn subtract_vectors(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|n| a[n] - b[n])
}

impl Machine {
    /// Returns whether the errors of the volume depend on where `axis` is.
    pub(super) fn volume_needs_position(&self, axis: LinearAxis) -> bool {
        let Some(chain) = &self.volume.chain else { return false };
        let of_angle = |angular: &AngularErrorMotion| {
            let is_lever = chain.lever_axes(angular.along).contains(&axis);
            angular.along == axis || is_lever && angular.about.index() != axis.index()
        };
        let of_table = |location: &RotaryLocationErrors| {
            chain.table.contains(&location.axis) && location.tilt_urad != [0.0; 3]
        };
        self.volume.angular.iter().any(of_angle) || self.volume.rotary.iter().any(of_table)
    }

    /// Returns the rotary axes on whose angles the errors of the volume depend.
    pub(super) fn volume_rotary_axes(&self) -> Vec<RotaryAxis> {
        let volume = &self.volume;
        let Some(chain) = volume.chain.as_ref().filter(|_| volume.has_geometric_errors()) else {
            return Vec::new();
        };
        let is_wrong = |axis: &RotaryAxis| {
            volume.rotary.iter().any(|location| location.axis == *axis && !location.is_error_free())
        };
        let mut axes = chain.head.clone();
        // What is wrong with the axis next to the workpiece turns with the one under it.
        if let [first, second] = chain.table[..]
            && is_wrong(&second)
        {
            axes.push(first);
        }
        axes
    }
}

#[cfg(test)]
mod tests {
    use super::{volumetric_error_um as tip_error_um, *};
    use crate::machine_file::MachineFile;
    use std::path::Path;

    /// With the tool of the machine file.
    fn volumetric_error_um(
        machine: &Machine,
        position_mm: [f64; 3],
        angle_deg: [f64; 3],
    ) -> [f64; 3] {
        tip_error_um(machine, machine.volume.tool, position_mm, angle_deg)
    }

    fn machine(chain: &str, rest: &str) -> Machine {
        let kind = match chain.chars().filter(|character| "ABC".contains(*character)).count() {
            0 => "kind = \"3-axis\"",
            1 if chain.contains("B t") => "kind = \"head-table\", head_axes = [\"b\"]",
            2 if chain.contains("C A t") => "kind = \"head-head\", head_axes = [\"c\", \"a\"]",
            _ => "kind = \"table-table\"",
        };
        let text = format!("machine = {{ name = \"m\", {kind}, chain = \"{chain}\" }}\n{rest}");
        MachineFile::parse(&text, Path::new("m.toml"))
            .unwrap_or_else(|error| panic!("{error}\n{text}"))
    }

    #[track_caller]
    fn assert_near(um: [f64; 3], expected_um: [f64; 3]) {
        let off = um.iter().zip(expected_um).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-9, "{um:?} µm, expected {expected_um:?}");
    }

    /// 100 µrad and levers of 0.1, 0.2 and 0.4 m: by the right hand about X, Y takes the tip up and Z takes it to −Y;
    /// about Y, Z takes it to +X and X down; about Z, X takes it to +Y and Y to −X.
    const BY_HAND: [[f64; 3]; 3] = [[0.0, -40.0, 20.0], [40.0, 0.0, -10.0], [-20.0, 10.0, 0.0]];
    const LEVER_MM: [f64; 3] = [100.0, 200.0, 400.0];

    #[test]
    fn each_of_the_nine_angles_acts_by_the_right_hand() {
        // The tool is the lever, whatever the axes stand at: they are all at 0 but the one that turns.
        let tool = format!("tool.offset_mm = {LEVER_MM:?}\n");
        for (about, along) in AngularErrorMotion::all_axis_pairs() {
            let name = format!("e{}{}", about.name(), along.name());
            let angle = format!("{tool}angular.{name}.urad_per_m = 100.0\n");
            let mut position_mm = [0.0; 3];
            position_mm[along.index()] = 1000.0;
            let of_tool = machine("w b X Y Z t", &angle);
            assert_near(
                volumetric_error_um(&of_tool, position_mm, [0.0; 3]),
                BY_HAND[about.index()],
            );
            // Under the workpiece it is the workpiece that goes that way; and its own metre is a lever too.
            let of_table = machine("w Z' Y' X' b t", &angle);
            position_mm[along.index()] = -1000.0;
            let mut lever_mm = LEVER_MM;
            lever_mm[along.index()] -= 1000.0;
            let turned = [
                [0.0, -lever_mm[2], lever_mm[1]],
                [lever_mm[2], 0.0, -lever_mm[0]],
                [-lever_mm[1], lever_mm[0], 0.0],
            ];
            // −100 µrad, and the opposite sign of the workpiece.
            assert_near(
                volumetric_error_um(&of_table, position_mm, [0.0; 3]),
                turned[about.index()].map(|mm| mm * 100.0 / 1000.0),
            );
        }
    }

    #[test]
    fn the_lever_has_the_axes_between_the_guide_and_the_tool() {
        // 10 µrad about X at 1 m of X.
        let angle = "angular.eax.urad_per_m = 10.0\n";
        for (chain, dy, dz) in [
            ("w b X Y Z t", -4.0, 2.0),
            ("w b X Z Y t", -4.0, 2.0),
            ("w b Y X Z t", -4.0, 0.0),
            ("w b Z X Y t", 0.0, 2.0),
            ("w b Y Z X t", 0.0, 0.0),
            ("w Y' b X Z t", -4.0, 0.0),
            // X moves the workpiece: what is over the bed, and between it and the bed, counts.
            ("w X' b Y Z t", 4.0, -2.0),
            ("w X' Y' Z' b t", 4.0, -2.0),
            ("w Y' X' b Z t", 4.0, 0.0),
            ("w Z' Y' X' b t", 0.0, 0.0),
        ] {
            let um = volumetric_error_um(&machine(chain, angle), [1000.0, 200.0, 400.0], [0.0; 3]);
            assert_near(um, [0.0, dy, dz]);
        }
        // From the point where straightness is stated.
        let point = format!("{angle}angular.point_x_mm = [0.0, 200.0, 300.0]\n");
        let um =
            volumetric_error_um(&machine("w b X Y Z t", &point), [1000.0, 200.0, 400.0], [0.0; 3]);
        assert_near(um, [0.0, -1.0, 0.0]);
    }

    #[test]
    fn a_line_that_is_off_moves_the_tool_one_way_and_the_workpiece_the_other() {
        let shift = "rotary.c.exoc_um = 5.0\nrotary.c.eaoc_urad = 10.0\n";
        let table = machine("w C' b X Y Z t", &format!("{shift}rotary.c.point_mm = [0, 100, 0]\n"));
        // The table's line is 5 µm too far to +X, and its top falls over to −Y by 10 µrad · 0.3 m.
        for c in [0.0, 77.0] {
            let um = volumetric_error_um(&table, [50.0, 300.0, 300.0], [0.0, 0.0, c]);
            assert_near(um, [-5.0, 3.0, -2.0]);
        }
        // A head whose line is 0.2 m above a tool of 0.1 m.
        let head = "rotary.b.exob_um = 5.0\nrotary.b.ecob_urad = 10.0\n\
                    rotary.b.point_mm = [0, 0, 200]\ntool.length_mm = 100.0\n";
        let head = machine("w b X Y Z B t", head);
        assert_near(volumetric_error_um(&head, [7.0, 8.0, 9.0], [0.0; 3]), [5.0, 0.0, 0.0]);
        // At B = 90° the tip is 0.3 m to −X of the line.
        assert_near(
            volumetric_error_um(&head, [7.0, 8.0, 9.0], [0.0, 90.0, 0.0]),
            [5.0, -3.0, 0.0],
        );
    }

    #[test]
    fn the_axis_on_another_one_errs_in_the_directions_that_it_is_turned_to() {
        // C is turned by A. A′ = 90° turns the workpiece by −90°: what was +Y is −Z.
        let table = machine("w C' A' b X Y Z t", "rotary.c.eyoc_um = 5.0\n");
        assert_near(volumetric_error_um(&table, [0.0; 3], [0.0; 3]), [0.0, -5.0, 0.0]);
        assert_near(volumetric_error_um(&table, [0.0; 3], [90.0, 0.0, 0.0]), [0.0, 0.0, 5.0]);
        // A is turned by C: at C = 90° what was +Y is −X.
        let head = machine("w b X Y Z C A t", "rotary.a.eyoa_um = 5.0\n");
        assert_near(volumetric_error_um(&head, [0.0; 3], [0.0; 3]), [0.0, 5.0, 0.0]);
        assert_near(volumetric_error_um(&head, [0.0; 3], [0.0, 0.0, 90.0]), [-5.0, 0.0, 0.0]);
    }

    #[test]
    fn only_what_a_lever_needs_must_be_known() {
        use super::super::required_columns;
        let needed = |chain: &str, rest: &str| required_columns(&machine(chain, rest));
        assert_eq!(needed("w b X Y Z t", "tool.length_mm = 100.0\n"), [""; 0]);
        assert_eq!(needed("w b X Y Z t", "angular.eaz.urad_per_m = 1.0\n"), ["z_mm"]);
        assert_eq!(needed("w b X Y Z t", "angular.eay.urad_per_m = 1.0\n"), ["y_mm", "z_mm"]);
        assert_eq!(needed("w C' b X Y Z t", "rotary.c.exoc_um = 1.0\n"), [""; 0]);
        assert_eq!(needed("w C' A' b X Y Z t", "rotary.c.exoc_um = 1.0\n"), ["a_deg"]);
        assert_eq!(needed("w C' A' b X Y Z t", "rotary.a.eyoa_um = 1.0\n"), [""; 0]);
        let unknown = volumetric_error_um(
            &machine("w b X Y Z t", "angular.eay.urad_per_m = 1.0\n"),
            [f64::NAN, 1000.0, 1000.0],
            [f64::NAN; 3],
        );
        assert_near(unknown, [0.0, -1.0, 0.0]);
    }
}
