//! The errors of the volume for the board, and back: chain, angles, lines of the rotary axes, tool tip.
//!
//! An angle is stored as the error that it makes at the board's lever of 1.34 m. It is held against the
//! model at a lever of 15 m, a shift as it is.

use trueup_core::{
    gradient::Gradient,
    units::Position,
    volumetric_error::{self, MAX_LEVER_ARM},
};

use super::{
    curve::{self, OwnedCurve, compile_curve},
    kinematics::{rotary_axis_from_board, rotary_axis_to_board},
    part_differences::PartDifferences,
    squareness::{compile_squareness, linear_axis_from_board, linear_axis_to_board},
    term::{MAX_LEVER_RATIO, REFERENCE_LEVER_M, compile_length},
};
use crate::{
    location::InputFileError,
    machine_file::Machine,
    sections::{
        AngleProfile, AngularErrorMotion, AxisChain, LinearAxis, RotaryAxis, RotaryLocationErrors,
        ToolGeometry, VolumetricModel,
    },
    spline::BSpline,
    unit_conversion::{
        FINE_UNITS_PER_UM, GRADIENT_UNITS_PER_UM_PER_M, POSITION_UNITS_PER_MM, round_to_i32,
        to_user_value,
    },
};

/// The errors of the volume whose curves are owned.
pub(super) struct OwnedVolume {
    chain: volumetric_error::KinematicChain,
    points: [[Position; 3]; 3],
    angles: [[(Gradient, OwnedCurve); 3]; 3],
    tool: [Position; 3],
    rotary: [Option<volumetric_error::RotaryAxisLocation>; 2],
}

impl OwnedVolume {
    /// Returns what the calibration holds.
    pub(super) fn view(&self) -> volumetric_error::VolumetricErrorModel<'_> {
        volumetric_error::VolumetricErrorModel {
            chain: self.chain,
            guides: std::array::from_fn(|axis| volumetric_error::AngularErrors {
                point: self.points[axis],
                about: self.angles[axis].each_ref().map(|(slope, curve)| {
                    volumetric_error::AngularErrorCurve { slope: *slope, curve: curve.view() }
                }),
            }),
            tool: self.tool,
            rotary: self.rotary,
        }
    }
}

/// Returns the errors of the volume; `None` where there are none.
pub(super) fn compile(
    machine: &Machine,
    account: &mut PartDifferences<'_>,
) -> Result<Option<OwnedVolume>, InputFileError> {
    let it = &machine.volume;
    let Some(chain) = it.chain.as_ref().filter(|_| it.has_geometric_errors()) else {
        return Ok(None);
    };
    let no_angle = || (Gradient::ZERO, OwnedCurve::EMPTY);
    let mut angles: [[_; 3]; 3] = std::array::from_fn(|_| std::array::from_fn(|_| no_angle()));
    for angular in &it.angular {
        let made = compile_angle(&angular.angle);
        let key = format!("angular.{}", angular.name());
        angles[angular.along.index()][angular.about.index()] =
            account.check_and_record_difference(&key, made)?;
    }
    let mut points = [[Position(0); 3]; 3];
    for (point, axis) in points.iter_mut().zip(LinearAxis::ALL) {
        let key = format!("angular.point_{}_mm", axis.name());
        let made = compile_positions(it.point_mm[axis.index()], i32::MAX);
        *point = made.map_err(|rule| machine.places.key_error(&key, rule))?;
    }
    let made = compile_positions(it.tool.tip_offset_mm(machine.tool_direction), MAX_LEVER_ARM);
    let tool = made.map_err(|rule| machine.places.key_error("tool", rule))?;
    let mut places = [None; 2];
    for (place, axis) in places.iter_mut().zip(chain.rotary_axes()) {
        let moves_workpiece = chain.table.contains(&axis);
        *place = Some(compile_rotary_location(machine, axis, moves_workpiece, account)?);
    }
    let on_workpiece = u8::try_from(chain.on_workpiece).unwrap_or(u8::MAX);
    let chain =
        volumetric_error::KinematicChain::new(chain.linear.map(linear_axis_to_board), on_workpiece);
    let chain = chain.expect("read with each axis once, at most three on the workpiece");
    Ok(Some(OwnedVolume { chain, points, angles, tool, rotary: places }))
}

/// Returns an angle, and its largest difference from the model in nm.
fn compile_angle(angle: &AngleProfile) -> Result<((Gradient, OwnedCurve), f64), String> {
    let (made, nm) = match angle {
        AngleProfile::Line(urad_per_m) => {
            let (slope, nm) = compile_squareness(urad_per_m * REFERENCE_LEVER_M)
                .map_err(|_| format!("{urad_per_m} is beyond the board's ±2328 µrad/m"))?;
            ((slope, OwnedCurve::EMPTY), nm)
        }
        AngleProfile::Curve(spline) => {
            let control_um =
                spline.control_um.iter().map(|urad| urad * REFERENCE_LEVER_M).collect();
            let (made, nm) = compile_curve(&BSpline { control_um, ..spline.clone() })?;
            ((Gradient::ZERO, made), nm)
        }
    };
    Ok((made, nm * MAX_LEVER_RATIO))
}

/// Returns places in the board's unit, none beyond `most` of it.
fn compile_positions(mm: [f64; 3], most: i32) -> Result<[Position; 3], String> {
    let mut stored = [Position(0); 3];
    for (stored, mm) in stored.iter_mut().zip(mm) {
        let units = round_to_i32(mm * POSITION_UNITS_PER_MM)
            .filter(|units| units.unsigned_abs() <= most.unsigned_abs());
        *stored = Position(units.ok_or_else(|| {
            format!(
                "reaches {mm} mm, beyond the board's ±{:.0} mm",
                f64::from(most) / POSITION_UNITS_PER_MM
            )
        })?);
    }
    Ok(stored)
}

fn compile_rotary_location(
    machine: &Machine,
    axis: RotaryAxis,
    moves_workpiece: bool,
    account: &mut PartDifferences<'_>,
) -> Result<volumetric_error::RotaryAxisLocation, InputFileError> {
    let key = format!("rotary.{}", axis.name());
    let known = machine.volume.rotary.iter().find(|location| location.axis == axis);
    let zero = [0.0; 3];
    let (point_mm, shift_um, tilt_urad) = known.map_or((zero, zero, zero), |location| {
        (location.point_mm, location.shift_um, location.tilt_urad)
    });
    let made = compile_positions(point_mm, MAX_LEVER_ARM);
    let point = made.map_err(|rule| machine.places.key_error(&format!("{key}.point_mm"), rule))?;
    let mut along = |um: f64, levers: f64| {
        account.check_and_record_difference(
            &key,
            compile_length(um).map(|(stored, nm)| (stored, nm * levers)),
        )
    };
    let [x, y, z] = shift_um;
    let shift = [along(x, 1.0)?, along(y, 1.0)?, along(z, 1.0)?];
    let [a, b, c] = tilt_urad.map(|urad| urad * REFERENCE_LEVER_M);
    let tilt = [along(a, MAX_LEVER_RATIO)?, along(b, MAX_LEVER_RATIO)?, along(c, MAX_LEVER_RATIO)?];
    Ok(volumetric_error::RotaryAxisLocation {
        axis: rotary_axis_to_board(axis),
        moves_workpiece,
        point,
        shift,
        tilt,
    })
}

/// Returns the errors of the volume as a user writes them, with the tool in its `direction`.
pub(super) fn decompile(
    volume: Option<&volumetric_error::VolumetricErrorModel<'_>>,
    direction: [f64; 3],
) -> VolumetricModel {
    let Some(it) = volume else { return VolumetricModel::default() };
    let turning = |is_table: bool| {
        let all =
            it.rotary.iter().flatten().filter(move |location| location.moves_workpiece == is_table);
        all.map(|location| rotary_axis_from_board(location.axis)).collect::<Vec<_>>()
    };
    let chain = AxisChain {
        linear: it.chain.order().map(linear_axis_from_board),
        on_workpiece: it.chain.workpiece_axis_count().into(),
        head: turning(false),
        table: turning(true),
    };
    let angular = AngularErrorMotion::all_axis_pairs().into_iter().filter_map(|(about, along)| {
        let angle = &it.guides[along.index()].about[about.index()];
        let angle = if !angle.curve.is_empty() {
            AngleProfile::Curve(curve::decompile_angle(&angle.curve, REFERENCE_LEVER_M))
        } else if angle.slope != Gradient::ZERO {
            AngleProfile::Line(to_user_value(
                angle.slope.0,
                GRADIENT_UNITS_PER_UM_PER_M * REFERENCE_LEVER_M,
            ))
        } else {
            return None;
        };
        Some(AngularErrorMotion { about, along, angle })
    });
    let rotary = it.rotary.iter().flatten().map(|location| RotaryLocationErrors {
        axis: rotary_axis_from_board(location.axis),
        point_mm: positions_to_mm(location.point),
        shift_um: location.shift.map(|um| to_user_value(um.0, FINE_UNITS_PER_UM)),
        tilt_urad: location
            .tilt
            .map(|um| to_user_value(um.0, FINE_UNITS_PER_UM * REFERENCE_LEVER_M)),
    });
    VolumetricModel {
        chain: Some(chain),
        angular: angular.collect(),
        point_mm: it.guides.each_ref().map(|guide| positions_to_mm(guide.point)),
        rotary: rotary
            .filter(|location| !location.is_error_free() || location.point_mm != [0.0; 3])
            .collect(),
        tool: decompile_tool_tip(positions_to_mm(it.tool), direction),
    }
}

fn positions_to_mm(places: [Position; 3]) -> [f64; 3] {
    places.map(|place| to_user_value(place.0, POSITION_UNITS_PER_MM))
}

/// Returns the tool of this tip: its length where it lies along an axis of the machine, else an offset alone.
fn decompile_tool_tip(tip_mm: [f64; 3], direction: [f64; 3]) -> ToolGeometry {
    let along = (0..3).find(|&n| direction[n].abs() == 1.0);
    let length_mm = along.map_or(0.0, |n| (tip_mm[n] * direction[n]).max(0.0));
    let offset_mm = [0, 1, 2].map(
        |n| if Some(n) == along { tip_mm[n] - length_mm * direction[n] } else { tip_mm[n] } + 0.0,
    );
    ToolGeometry { length_mm, offset_mm }
}
