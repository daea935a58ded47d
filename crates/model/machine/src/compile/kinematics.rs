//! Where the tool points: a direction, and the rotary axes that turn it.

use trueup_core::{
    kinematics::{self, Kinematics},
    tool_direction::ToolDirection,
};

use crate::{machine_file::MachineKind, sections::RotaryAxis, unit_conversion::round_to_i32};

/// Returns the tool's direction and the axes that turn it, on the board.
pub(super) fn compile(tool_direction: [f64; 3], head_axes: &[RotaryAxis]) -> Kinematics {
    Kinematics {
        zero: compile_tool_direction(tool_direction),
        axes: std::array::from_fn(|n| head_axes.get(n).map(|axis| rotary_axis_to_board(*axis))),
    }
}

/// Returns the axis on the board.
pub(super) fn rotary_axis_to_board(axis: RotaryAxis) -> kinematics::RotaryAxis {
    match axis {
        RotaryAxis::A => kinematics::RotaryAxis::A,
        RotaryAxis::B => kinematics::RotaryAxis::B,
        RotaryAxis::C => kinematics::RotaryAxis::C,
    }
}

/// Returns the board's axis in the machine file.
pub(super) fn rotary_axis_from_board(axis: kinematics::RotaryAxis) -> RotaryAxis {
    match axis {
        kinematics::RotaryAxis::A => RotaryAxis::A,
        kinematics::RotaryAxis::B => RotaryAxis::B,
        kinematics::RotaryAxis::C => RotaryAxis::C,
    }
}

fn compile_tool_direction(tool_direction: [f64; 3]) -> ToolDirection {
    let stored = |component: f64| round_to_i32(component * f64::from(ToolDirection::ONE));
    // A component is at most 1 in magnitude, give or take the last bit of an f64: it always fits.
    ToolDirection(tool_direction.map(|component| stored(component).expect("a length of 1")))
}

/// Returns what a user writes: the kind of machine, its axes and the direction in the fewest decimals,
/// which is not of length 1.
pub(super) fn decompile(
    kinematics: &Kinematics,
    turns_workpiece: bool,
) -> (MachineKind, Vec<RotaryAxis>, [f64; 3]) {
    let axes: Vec<RotaryAxis> =
        kinematics.axes.iter().flatten().map(|axis| rotary_axis_from_board(*axis)).collect();
    let kind = match axes.len() {
        0 if turns_workpiece => MachineKind::TableTable,
        // It may be "table-table" as well: the board runs both alike.
        0 => MachineKind::ThreeAxis,
        1 => MachineKind::HeadTable,
        _ => MachineKind::HeadHead,
    };
    (kind, axes, decompile_tool_direction(kinematics.zero))
}

/// Returns the direction with the fewest decimals that is stored as `stored` again.
fn decompile_tool_direction(stored: ToolDirection) -> [f64; 3] {
    const MAX_DECIMALS: i32 = 12;
    let unit = unit_vector_near(stored);
    (0..=MAX_DECIMALS)
        .map(|decimals| {
            let scale = 10_f64.powi(decimals);
            // + 0.0 turns −0 into 0.
            unit.map(|component| (component * scale).round() / scale + 0.0)
        })
        .find(|&written| compiles_to(written, stored))
        .unwrap_or(unit)
}

/// Returns whether the machine file's reader and the compiler make `stored` of `written`.
fn compiles_to(written: [f64; 3], stored: ToolDirection) -> bool {
    let length = written.iter().map(|component| component * component).sum::<f64>().sqrt();
    let one = f64::from(ToolDirection::ONE);
    // Without a length this is NaN, which is equal to nothing.
    written.map(|component| (component / length * one).round()) == stored.0.map(f64::from)
}

/// Returns a vector of length 1 whose every component rounds to that of `stored`.
///
/// The stored vector is not of length 1, and to scale it can move a component by up to 0.68 of its
/// last place, into the next one. The length added by rounding is therefore taken back in
/// equal steps from all three components, which moves each by half a place at most if there is such
/// a vector at all.
fn unit_vector_near(stored: ToolDirection) -> [f64; 3] {
    let one = f64::from(ToolDirection::ONE);
    let components = stored.0.map(f64::from);
    let length = components.iter().map(|component| component * component).sum::<f64>().sqrt();
    let sum = components.iter().map(|component| component.abs()).sum::<f64>();
    let step = if sum == 0.0 { 0.0 } else { (length - one) * length / sum };
    components.map(|component| {
        let sign = if component == 0.0 { 0.0 } else { component.signum() };
        (component - sign * step) / one
    })
}
