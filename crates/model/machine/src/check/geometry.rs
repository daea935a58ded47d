//! Where things are: the tool's direction, and tables and curves next to the travel of their axis.

use super::warning::Warning;
use crate::{
    machine_file::{Machine, MachineKind},
    sections::{AngleProfile, LinearAxis},
};

/// How far a curve may reach beyond the travel, as a share of it: ends are rounded up.
pub(super) const OVERTRAVEL_FRACTION: f64 = 0.01;

pub(super) fn warnings(machine: &Machine) -> Vec<Warning> {
    tool_direction_warning(machine)
        .into_iter()
        .chain(table_range_warnings(machine))
        .chain(curve_range_warnings(machine))
        .collect()
}

fn tool_direction_warning(machine: &Machine) -> Option<Warning> {
    let [_, _, z] = machine.tool_direction;
    if z > 0.0 && machine.kind == MachineKind::Lathe {
        return Some(Warning::for_key(
            machine,
            "machine.tool_direction",
            &format!(
                "points away from the chuck (Z {z:+.3}): on a lathe it is the way from the turret to the chuck"
            ),
            "where Z+ leads away from the chuck it is [0.0, 0.0, -1.0]; with the wrong sign the turret is moved \
             into work that grows",
        ));
    }
    (z > 0.0).then(|| {
        Warning::for_key(
            machine,
            "machine.tool_direction",
            &format!("points up (Z {z:+.3}): from the spindle nose to the tip it is down on most machines"),
            "a tool that hangs down is [0.0, 0.0, -1.0]; with the wrong sign a growing spindle is pushed \
             into the part",
        )
    })
}

/// A table may begin or end one step beyond the travel, so that it covers it.
fn table_range_warnings(machine: &Machine) -> Vec<Warning> {
    let mut warnings = Vec::new();
    for axis in LinearAxis::ALL {
        let model = &machine.axes[axis.index()];
        let Some(travel_mm) = model.travel_mm else { continue };
        let drives = [
            (model.pitch.as_ref(), "pitch"),
            (model.dual.as_ref().map(|dual| &dual.pitch), "dual.pitch"),
        ];
        for (pitch, name) in drives {
            let Some(pitch) = pitch else { continue };
            let key = format!("axis.{}.{name}.start_mm", axis.name());
            warnings.extend(outside_travel_warning(
                machine,
                &key,
                pitch.range_mm(),
                travel_mm,
                pitch.step_mm,
                axis,
            ));
        }
    }
    warnings
}

fn curve_range_warnings(machine: &Machine) -> Vec<Warning> {
    let curves = machine.straightness.iter();
    let curves =
        curves.map(|curve| (format!("straightness.{}", curve.name()), curve.along, &curve.spline));
    let angles = machine.volume.angular.iter().filter_map(|motion| match &motion.angle {
        AngleProfile::Curve(spline) => {
            Some((format!("angular.{}", motion.name()), motion.along, spline))
        }
        AngleProfile::Line(_) => None,
    });
    curves
        .chain(angles)
        .filter_map(|(name, along, spline)| {
            let travel_mm = machine.axes[along.index()].travel_mm?;
            let spare_mm = OVERTRAVEL_FRACTION * (travel_mm[1] - travel_mm[0]);
            let key = format!("{name}.knots_mm");
            outside_travel_warning(machine, &key, spline.range_mm()?, travel_mm, spare_mm, along)
        })
        .collect()
}

fn outside_travel_warning(
    machine: &Machine,
    key: &str,
    [first, last]: [f64; 2],
    [low, high]: [f64; 2],
    spare_mm: f64,
    axis: LinearAxis,
) -> Option<Warning> {
    if first >= low - spare_mm && last <= high + spare_mm {
        return None;
    }
    let what = format!(
        "reaches from {first} to {last} mm, outside the travel of {}, {low} to {high} mm",
        axis.name()
    );
    let help = "positions are those of the machine's own coordinates, in mm; are start, step and unit right?";
    Some(Warning::for_key(machine, key, &what, help))
}
