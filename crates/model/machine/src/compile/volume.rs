//! The errors of the volume for the board, and back: chain, angles, lines of the rotary axes, tool tip.
//!
//! An angle is stored as the error that it makes at the board's lever of 1.34 m. It is held against the
//! model at a lever of 15 m, a shift as it is.

use trueup_core::{
    gradient::Gradient,
    units::Position,
    volume::{self, MAX_ARM},
};

use super::{
    account::Account,
    curve::{self, OwnedCurve, compile_curve},
    kinematics::{rotary, rotary_inverse},
    squareness::{compile_squareness, linear, linear_inverse},
    term::{LEVER_M, MAX_LEVERS, fine},
};
use crate::{
    effect::Angle,
    file::{
        Angular, BSpline, Chain, LinearAxis, Machine, RotaryAxis, RotaryLocation, ToolTip, Volume,
    },
    location::BadInput,
    stored::{FINE_PER_UM, GRADIENT_PER_UM_PER_M, UNITS_PER_MM, rounded, written},
};

/// The errors of the volume whose curves are owned.
pub(super) struct OwnedVolume {
    chain: volume::Chain,
    points: [[Position; 3]; 3],
    angles: [[(Gradient, OwnedCurve); 3]; 3],
    tool: [Position; 3],
    rotary: [Option<volume::RotaryLocation>; 2],
}

impl OwnedVolume {
    /// Returns what the calibration holds.
    pub(super) fn view(&self) -> volume::Volume<'_> {
        volume::Volume {
            chain: self.chain,
            guides: std::array::from_fn(|axis| volume::AngularErrors {
                point: self.points[axis],
                about: self.angles[axis]
                    .each_ref()
                    .map(|(slope, curve)| volume::Angle { slope: *slope, curve: curve.view() }),
            }),
            tool: self.tool,
            rotary: self.rotary,
        }
    }
}

/// Returns the errors of the volume; `None` where there are none.
pub(super) fn compile(
    machine: &Machine,
    account: &mut Account<'_>,
) -> Result<Option<OwnedVolume>, BadInput> {
    let it = &machine.volume;
    let Some(chain) = it.chain.as_ref().filter(|_| it.has_errors()) else { return Ok(None) };
    let no_angle = || (Gradient::ZERO, OwnedCurve::NONE);
    let mut angles: [[_; 3]; 3] = std::array::from_fn(|_| std::array::from_fn(|_| no_angle()));
    for angular in &it.angular {
        let made = compile_angle(&angular.angle);
        let key = format!("angular.{}", angular.name());
        angles[angular.along.index()][angular.about.index()] = account.take(&key, made)?;
    }
    let mut points = [[Position(0); 3]; 3];
    for (point, axis) in points.iter_mut().zip(LinearAxis::ALL) {
        let key = format!("angular.point_{}_mm", axis.name());
        let made = positions(it.point_mm[axis.index()], i32::MAX);
        *point = made.map_err(|rule| machine.places.bad(&key, rule))?;
    }
    let made = positions(it.tool.tip_mm(machine.tool_direction), MAX_ARM);
    let tool = made.map_err(|rule| machine.places.bad("tool", rule))?;
    let mut places = [None; 2];
    for (place, axis) in places.iter_mut().zip(chain.rotary()) {
        let moves_workpiece = chain.table.contains(&axis);
        *place = Some(compile_rotary(machine, axis, moves_workpiece, account)?);
    }
    let on_workpiece = u8::try_from(chain.on_workpiece).unwrap_or(u8::MAX);
    let chain = volume::Chain::new(chain.linear.map(linear), on_workpiece);
    let chain = chain.expect("read with each axis once, at most three on the workpiece");
    Ok(Some(OwnedVolume { chain, points, angles, tool, rotary: places }))
}

/// Returns an angle, and its largest difference from the model in nm.
fn compile_angle(angle: &Angle) -> Result<((Gradient, OwnedCurve), f64), String> {
    let (made, nm) = match angle {
        Angle::Line(urad_per_m) => {
            let (slope, nm) = compile_squareness(urad_per_m * LEVER_M)
                .map_err(|_| format!("{urad_per_m} is beyond the board's ±2328 µrad/m"))?;
            ((slope, OwnedCurve::NONE), nm)
        }
        Angle::Curve(spline) => {
            let control_um = spline.control_um.iter().map(|urad| urad * LEVER_M).collect();
            let (made, nm) = compile_curve(&BSpline { control_um, ..spline.clone() })?;
            ((Gradient::ZERO, made), nm)
        }
    };
    Ok((made, nm * MAX_LEVERS))
}

/// Returns places in the board's unit, none beyond `most` of it.
fn positions(mm: [f64; 3], most: i32) -> Result<[Position; 3], String> {
    let mut stored = [Position(0); 3];
    for (stored, mm) in stored.iter_mut().zip(mm) {
        let units =
            rounded(mm * UNITS_PER_MM).filter(|units| units.unsigned_abs() <= most.unsigned_abs());
        *stored = Position(units.ok_or_else(|| {
            format!("reaches {mm} mm, beyond the board's ±{:.0} mm", f64::from(most) / UNITS_PER_MM)
        })?);
    }
    Ok(stored)
}

fn compile_rotary(
    machine: &Machine,
    axis: RotaryAxis,
    moves_workpiece: bool,
    account: &mut Account<'_>,
) -> Result<volume::RotaryLocation, BadInput> {
    let key = format!("rotary.{}", axis.name());
    let known = machine.volume.rotary.iter().find(|it| it.axis == axis);
    let zero = [0.0; 3];
    let (point_mm, shift_um, tilt_urad) =
        known.map_or((zero, zero, zero), |it| (it.point_mm, it.shift_um, it.tilt_urad));
    let made = positions(point_mm, MAX_ARM);
    let point = made.map_err(|rule| machine.places.bad(&format!("{key}.point_mm"), rule))?;
    let mut along = |um: f64, levers: f64| {
        account.take(&key, fine(um).map(|(stored, nm)| (stored, nm * levers)))
    };
    let [x, y, z] = shift_um;
    let shift = [along(x, 1.0)?, along(y, 1.0)?, along(z, 1.0)?];
    let [a, b, c] = tilt_urad.map(|urad| urad * LEVER_M);
    let tilt = [along(a, MAX_LEVERS)?, along(b, MAX_LEVERS)?, along(c, MAX_LEVERS)?];
    Ok(volume::RotaryLocation { axis: rotary(axis), moves_workpiece, point, shift, tilt })
}

/// Returns the errors of the volume as a user writes them, with the tool in its `direction`.
pub(super) fn inverse(volume: Option<&volume::Volume<'_>>, direction: [f64; 3]) -> Volume {
    let Some(it) = volume else { return Volume::default() };
    let turning = |is_table: bool| {
        let all = it.rotary.iter().flatten().filter(move |it| it.moves_workpiece == is_table);
        all.map(|it| rotary_inverse(it.axis)).collect::<Vec<_>>()
    };
    let chain = Chain {
        linear: it.chain.order().map(linear_inverse),
        on_workpiece: it.chain.on_workpiece().into(),
        head: turning(false),
        table: turning(true),
    };
    let angular = Angular::all().into_iter().filter_map(|(about, along)| {
        let angle = &it.guides[along.index()].about[about.index()];
        let angle = if !angle.curve.is_empty() {
            Angle::Curve(curve::inverse_angle(&angle.curve, LEVER_M))
        } else if angle.slope != Gradient::ZERO {
            Angle::Line(written(angle.slope.0, GRADIENT_PER_UM_PER_M * LEVER_M))
        } else {
            return None;
        };
        Some(Angular { about, along, angle })
    });
    let rotary = it.rotary.iter().flatten().map(|it| RotaryLocation {
        axis: rotary_inverse(it.axis),
        point_mm: millimetres(it.point),
        shift_um: it.shift.map(|um| written(um.0, FINE_PER_UM)),
        tilt_urad: it.tilt.map(|um| written(um.0, FINE_PER_UM * LEVER_M)),
    });
    Volume {
        chain: Some(chain),
        angular: angular.collect(),
        point_mm: it.guides.each_ref().map(|guide| millimetres(guide.point)),
        rotary: rotary.filter(|it| !it.is_right() || it.point_mm != [0.0; 3]).collect(),
        tool: tool_inverse(millimetres(it.tool), direction),
    }
}

fn millimetres(places: [Position; 3]) -> [f64; 3] {
    places.map(|it| written(it.0, UNITS_PER_MM))
}

/// Returns the tool of this tip: its length where it lies along an axis of the machine, else an offset alone.
fn tool_inverse(tip_mm: [f64; 3], direction: [f64; 3]) -> ToolTip {
    let along = (0..3).find(|&n| direction[n].abs() == 1.0);
    let length_mm = along.map_or(0.0, |n| (tip_mm[n] * direction[n]).max(0.0));
    let offset_mm = [0, 1, 2].map(
        |n| if Some(n) == along { tip_mm[n] - length_mm * direction[n] } else { tip_mm[n] } + 0.0,
    );
    ToolTip { length_mm, offset_mm }
}
