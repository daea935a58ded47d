//! `chain` of `[machine]`, `[angular]`, `[rotary]` and `[tool]`: what is known of the whole volume.
//!
//! Angles are those of ISO 230-1: `eax` is the angle about A (X) of the motion along X. Location errors of
//! rotary axes are those of ISO 230-7: `exoc` shifts the line of C along X, `eaoc` turns it about A. The chain
//! is written in the letters of ISO 10791-6 ([`AxisChain`]).

use super::{
    AxisChain,
    LinearAxis::{self, X, Y, Z},
    RotaryAxis::{self, A, B, C},
    straightness::{KNOTS_KEY, SplineKeys, add_spline_keys, read_spline},
};
use crate::{
    keys::{
        key::{
            Key,
            ValueType::{Number, Numbers, Vector, Whole},
            key, section,
        },
        plausible_range::SPLINE_ORDER_RANGE,
        reader::Section,
        section::NewSection,
        table::{Table, add_key, read_or_default, table},
    },
    location::InputFileError,
    spline::BSpline,
};

/// An angle over the position of an axis, in µrad.
#[derive(Clone, Debug, PartialEq)]
pub enum AngleProfile {
    /// c·P/1000, c in µrad/m.
    Line(f64),
    /// A spline, its control points in µrad: µm at a lever of a metre.
    Curve(BSpline),
}

/// The model of the whole volume. Where the chain is not known, nothing else is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VolumetricModel {
    /// Which axis carries what.
    pub chain: Option<AxisChain>,
    /// The angular errors of the linear axes; no pair of axes twice.
    pub angular: Vec<AngularErrorMotion>,
    /// Where pitch and straightness of X, Y and Z are stated, in mm of machine coordinates: the angles do
    /// nothing there.
    pub point_mm: [[f64; 3]; 3],
    /// The location errors of the rotary axes; no axis twice, each in the chain.
    pub rotary: Vec<RotaryLocationErrors>,
    /// Where the tool tip is.
    pub tool: ToolGeometry,
}

impl VolumetricModel {
    /// Returns whether anything in it makes an error.
    #[must_use]
    pub fn has_geometric_errors(&self) -> bool {
        !self.angular.is_empty() || self.rotary.iter().any(|location| !location.is_error_free())
    }

    /// Returns where the line of a rotary axis should be, in mm.
    #[must_use]
    pub fn axis_line_point_mm(&self, axis: RotaryAxis) -> [f64; 3] {
        self.rotary
            .iter()
            .find(|location| location.axis == axis)
            .map_or([0.0; 3], |location| location.point_mm)
    }
}

/// An angular error of a linear axis: EAX has `about` A and `along` X.
#[derive(Clone, Debug, PartialEq)]
pub struct AngularErrorMotion {
    /// The axis that the moving part turns about, right-handed.
    pub about: RotaryAxis,
    /// The axis that moves.
    pub along: LinearAxis,
    /// The angle over its position, in µrad.
    pub angle: AngleProfile,
}

impl AngularErrorMotion {
    /// Returns the nine (about, along), in the order of ISO 230-1.
    #[must_use]
    pub fn all_axis_pairs() -> [(RotaryAxis, LinearAxis); 9] {
        [(A, X), (B, X), (C, X), (A, Y), (B, Y), (C, Y), (A, Z), (B, Z), (C, Z)]
    }

    /// Returns its name in ISO 230-1, in lower case, which is its key under `[angular]`: `eax`.
    #[must_use]
    pub fn name(&self) -> String {
        let all = Self::all_axis_pairs().into_iter().zip(ANGULAR_ERROR_KEYS);
        let key = all
            .filter(|(candidate, _)| *candidate == (self.about, self.along))
            .map(|(_, key)| key.name);
        key.collect()
    }
}

/// How far the line of a rotary axis is from where it should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotaryLocationErrors {
    /// The axis.
    pub axis: RotaryAxis,
    /// A point of the line, with all axes at 0: of an axis that turns the workpiece in machine coordinates, of one
    /// that turns the tool from the spindle nose.
    pub point_mm: [f64; 3],
    /// Along X, Y and Z; along the line itself 0.
    pub shift_um: [f64; 3],
    /// About X, Y and Z; about the line itself the zero of the angle.
    pub tilt_urad: [f64; 3],
}

impl RotaryLocationErrors {
    /// Returns whether its line is where it should be.
    #[must_use]
    pub fn is_error_free(&self) -> bool {
        self.shift_um == [0.0; 3] && self.tilt_urad == [0.0; 3]
    }
}

table! {
    /// Where the tool tip is with all angles at 0, in mm: `offset_mm` from the spindle nose, and from there
    /// `length_mm` in the tool direction.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct ToolGeometry {
        length_mm: f64 = key(NotNegative, "mm", "from where the tool begins to its tip, in `tool_direction`").with_default("0.0");
        /// In machine coordinates.
        offset_mm: [f64; 3] = key(Vector, "mm", "where the tool begins, from the spindle nose with all angles at 0").with_default("[0.0, 0.0, 0.0]");
    }
}

impl ToolGeometry {
    /// Returns the same with this length, where one is given.
    #[must_use]
    pub fn with_length(self, length_mm: Option<f64>) -> Self {
        Self { length_mm: length_mm.unwrap_or(self.length_mm), ..self }
    }

    /// Returns the way from the spindle nose to the tip, with all angles at 0.
    #[must_use]
    pub fn tip_offset_mm(&self, direction: [f64; 3]) -> [f64; 3] {
        // A length that is not known is missing along the tool alone.
        let along =
            |n: usize| if direction[n] == 0.0 { 0.0 } else { self.length_mm * direction[n] };
        [0, 1, 2].map(|n| self.offset_mm[n] + along(n))
    }
}

const fn point_key(name: &'static str, meaning: &'static str) -> Key {
    key(name, Vector, "mm", meaning).with_default("[0.0, 0.0, 0.0]")
}

/// An angle for each metre.
const ANGLE_GRADIENT_KEY: Key = key(
    "urad_per_m",
    Number,
    "µrad/m",
    "the angle for each metre from machine zero; or a B-spline",
)
.with_example_value("4.0");
/// An angle as a B-spline.
const SPLINE_KEYS: SplineKeys = [
    key("order", Whole(2, 4), "", "of a B-spline: degree plus one; 4 is cubic")
        .with_example_value("4")
        .with_range(SPLINE_ORDER_RANGE),
    KNOTS_KEY,
    key("control_urad", Numbers, "µrad", "the control points")
        .with_example_value("[0.0, 3.0, -2.0, 4.0, 0.0]"),
];
/// An angle over a position.
const ANGLE_KEYS: &[Key] = &[ANGLE_GRADIENT_KEY, SPLINE_KEYS[0], SPLINE_KEYS[1], SPLINE_KEYS[2]];

/// Of X, Y and Z.
const REFERENCE_POINT_KEYS: [Key; 3] = [
    point_key(
        "point_x_mm",
        "where pitch and straightness of X are stated: its angles do nothing there. Machine coordinates of the tool tip, of an axis that moves the workpiece on that part",
    ),
    point_key("point_y_mm", "the same of Y"),
    point_key("point_z_mm", "the same of Z"),
];

/// In the order of [`AngularErrorMotion::all_axis_pairs`].
const ANGULAR_ERROR_KEYS: [Key; 9] = [
    section("eax", ANGLE_KEYS, "the angle about +X, right-handed, of the part that X moves (roll)"),
    section("ebx", ANGLE_KEYS, "about +Y while X moves"),
    section("ecx", ANGLE_KEYS, "about +Z while X moves"),
    section("eay", ANGLE_KEYS, "about +X while Y moves"),
    section("eby", ANGLE_KEYS, "about +Y while Y moves (roll)"),
    section("ecy", ANGLE_KEYS, "about +Z while Y moves"),
    section("eaz", ANGLE_KEYS, "about +X while Z moves"),
    section("ebz", ANGLE_KEYS, "about +Y while Z moves"),
    section("ecz", ANGLE_KEYS, "about +Z while Z moves (roll)"),
];

/// The points, then the angles.
pub(crate) const ANGULAR_KEYS: &[Key] = &{
    let mut keys = [REFERENCE_POINT_KEYS[0]; REFERENCE_POINT_KEYS.len() + ANGULAR_ERROR_KEYS.len()];
    let mut n = 0;
    while n < keys.len() {
        keys[n] = if n < REFERENCE_POINT_KEYS.len() {
            REFERENCE_POINT_KEYS[n]
        } else {
            ANGULAR_ERROR_KEYS[n - REFERENCE_POINT_KEYS.len()]
        };
        n += 1;
    }
    keys
};

const fn shift_key(name: &'static str, meaning: &'static str) -> Key {
    key(name, Number, "µm", meaning).with_default("0.0").omit_default()
}

const fn tilt_key(name: &'static str, meaning: &'static str) -> Key {
    key(name, Number, "µrad", meaning).with_default("0.0").omit_default()
}

const AXIS_LINE_POINT_KEY: Key = point_key(
    "point_mm",
    "a point of its line with all axes at 0. Of an axis that turns the workpiece: in machine coordinates. Of one \
     that turns the tool: from the spindle nose",
);

/// Of A, B and C: the point; the shifts along X, Y and Z without that along the line; the tilts about A, B and C.
static AXIS_LINE_KEYS: [[Key; 6]; 3] = [
    [
        AXIS_LINE_POINT_KEY,
        shift_key("eyoa_um", "how far the line is off along +Y"),
        shift_key("ezoa_um", "along +Z"),
        tilt_key("eaoa_urad", "zero of the angle: about +X, right-handed"),
        tilt_key("eboa_urad", "how far the line is turned about +Y, right-handed"),
        tilt_key("ecoa_urad", "about +Z"),
    ],
    [
        AXIS_LINE_POINT_KEY,
        shift_key("exob_um", "how far the line is off along +X"),
        shift_key("ezob_um", "along +Z"),
        tilt_key("eaob_urad", "how far the line is turned about +X, right-handed"),
        tilt_key("ebob_urad", "zero of the angle: about +Y, right-handed"),
        tilt_key("ecob_urad", "about +Z"),
    ],
    [
        AXIS_LINE_POINT_KEY,
        shift_key("exoc_um", "how far the line is off along +X"),
        shift_key("eyoc_um", "along +Y"),
        tilt_key("eaoc_urad", "how far the line is turned about +X, right-handed"),
        tilt_key("eboc_urad", "about +Y"),
        tilt_key("ecoc_urad", "zero of the angle: about +Z, right-handed"),
    ],
];

pub(crate) const ROTARY_KEYS: &[Key] = &[
    section(A.name(), &AXIS_LINE_KEYS[0], "the line about which A turns"),
    section(B.name(), &AXIS_LINE_KEYS[1], "the line about which B turns"),
    section(C.name(), &AXIS_LINE_KEYS[2], "the line about which C turns"),
];

pub(crate) fn read_angular_errors(
    section: &Section<'_>,
) -> Result<(Vec<AngularErrorMotion>, [[f64; 3]; 3]), InputFileError> {
    let mut point_mm = [[0.0; 3]; 3];
    for (point, key) in point_mm.iter_mut().zip(&REFERENCE_POINT_KEYS) {
        *point = read_or_default(section, key)?;
    }
    let mut angular = Vec::new();
    for ((about, along), key) in
        AngularErrorMotion::all_axis_pairs().into_iter().zip(ANGULAR_ERROR_KEYS)
    {
        if let Some(section) = section.section(key.name)? {
            angular.push(AngularErrorMotion { about, along, angle: read_angle(&section)? });
        }
    }
    Ok((angular, point_mm))
}

fn read_angle(section: &Section<'_>) -> Result<AngleProfile, InputFileError> {
    let of_curve = section.first_present_key(&SPLINE_KEYS.map(|key| key.name)).map(str::to_string);
    match (section.number(ANGLE_GRADIENT_KEY.name)?, of_curve) {
        (None, None) => {
            let rule = "is missing: an angle is urad_per_m, or order, knots_mm and control_urad";
            Err(section.key_error(ANGLE_GRADIENT_KEY.name, rule))
        }
        (None, Some(_)) => Ok(AngleProfile::Curve(read_spline(section, &SPLINE_KEYS)?)),
        (Some(_), Some(key)) => {
            let rule = "must not stand next to urad_per_m: an angle is one or the other";
            Err(section.key_error(&key, rule))
        }
        (Some(urad_per_m), None) => Ok(AngleProfile::Line(urad_per_m)),
    }
}

/// Returns the keys of the line of a rotary axis: of its point, of its shifts along X, Y and Z, of its tilts about A, B and
/// C. The shift along the line itself has none.
fn axis_line_keys(
    axis: RotaryAxis,
) -> (&'static Key, [Option<&'static Key>; 3], [&'static Key; 3]) {
    let [point, first, second, tilts @ ..] = &AXIS_LINE_KEYS[axis.index()];
    let shifts = match axis {
        A => [None, Some(first), Some(second)],
        B => [Some(first), None, Some(second)],
        C => [Some(first), Some(second), None],
    };
    (point, shifts, tilts.each_ref())
}

pub(crate) fn read_rotary_locations(
    section: &Section<'_>,
) -> Result<Vec<RotaryLocationErrors>, InputFileError> {
    let mut all = Vec::new();
    for axis in RotaryAxis::ALL {
        let Some(section) = section.section(axis.name())? else { continue };
        let (point, shifts, tilts) = axis_line_keys(axis);
        let mut location = RotaryLocationErrors {
            axis,
            point_mm: read_or_default(&section, point)?,
            shift_um: [0.0; 3],
            tilt_urad: [0.0; 3],
        };
        for n in 0..3 {
            if let Some(key) = shifts[n] {
                location.shift_um[n] = read_or_default(&section, key)?;
            }
            location.tilt_urad[n] = read_or_default(&section, tilts[n])?;
        }
        all.push(location);
    }
    Ok(all)
}

/// Refuses angular and location errors that the chain does not place.
pub(crate) fn check(root: &Section<'_>, volume: &VolumetricModel) -> Result<(), InputFileError> {
    let first = ["angular", "rotary"].into_iter().find(|name| root.keys().contains(name));
    let (Some(first), chain) = (first, &volume.chain) else { return Ok(()) };
    let Some(chain) = chain else {
        let rule = "needs machine.chain, which states what each axis carries: the sign and the lever of an error \
                    depend on it";
        let help = "write the axes into [machine] from the workpiece over the bed to the tool. \
            Mark those that move the workpiece with ': chain = \"w X' b Y Z t\"";
        return Err(root.key_error(first, rule).with_help(help));
    };
    let rotary = chain.rotary_axes();
    let outside = volume.rotary.iter().find(|location| !rotary.contains(&location.axis));
    outside.map_or(Ok(()), |location| {
        let rule =
            format!("is not in machine.chain, \"{chain}\": write where it stands, or take it out");
        Err(root.key_error(&format!("rotary.{}", location.axis.name()), rule))
    })
}

/// Returns the sections of the file.
pub(crate) fn write(volume: &VolumetricModel) -> Vec<NewSection> {
    let mut sections = Vec::new();
    let points =
        REFERENCE_POINT_KEYS.iter().zip(&volume.point_mm).filter(|(_, point)| **point != [0.0; 3]);
    let points = points
        .fold(NewSection::new("angular"), |section, (key, point)| add_key(section, key, point));
    if points.key_values().next().is_some() {
        sections.push(points);
    }
    for angular in &volume.angular {
        let section = NewSection::new(format!("angular.{}", angular.name()));
        sections.push(match &angular.angle {
            AngleProfile::Line(urad_per_m) => add_key(section, &ANGLE_GRADIENT_KEY, urad_per_m),
            AngleProfile::Curve(spline) => add_spline_keys(section, spline, &SPLINE_KEYS),
        });
    }
    for it in &volume.rotary {
        let (point, shifts, tilts) = axis_line_keys(it.axis);
        let section = NewSection::new(format!("rotary.{}", it.axis.name()));
        let section = add_key(section, point, &it.point_mm);
        let shifts = shifts.into_iter().zip(&it.shift_um).filter_map(|(key, um)| Some((key?, um)));
        let all = shifts.chain(tilts.into_iter().zip(&it.tilt_urad));
        sections.push(all.fold(section, |section, (key, value)| add_key(section, key, value)));
    }
    if volume.tool != ToolGeometry::default() {
        sections.push(volume.tool.write(NewSection::new("tool")));
    }
    sections
}
