//! `chain` of `[machine]`, `[angular]`, `[rotary]` and `[tool]`: what is known of the whole volume.
//!
//! Angles are those of ISO 230-1: `eax` is the angle about A (X) of the motion along X. Location errors of
//! rotary axes are those of ISO 230-7: `exoc` shifts the line of C along X, `eaoc` turns it about A. The chain
//! is written in the letters of ISO 10791-6 ([`chain`](super::chain)).

use super::{
    axis::{
        LinearAxis::{self, X, Y, Z},
        RotaryAxis::{self, A, B, C},
    },
    chain::Chain,
    key::{
        Form::{Number, Numbers, Vector, Whole},
        Key, key, section,
    },
    read::Section,
    straightness::{KNOTS, SplineKeys, read_spline, write_spline},
    table::{Table, table, value, written},
    write::section::NewSection,
};
use crate::{effect::Angle, location::BadInput};

/// The model of the whole volume. Where the chain is not known, nothing else is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Volume {
    /// Which axis carries what.
    pub chain: Option<Chain>,
    /// The angular errors of the linear axes; no pair of axes twice.
    pub angular: Vec<Angular>,
    /// Where pitch and straightness of X, Y and Z are stated, in mm of machine coordinates: the angles do
    /// nothing there.
    pub point_mm: [[f64; 3]; 3],
    /// The location errors of the rotary axes; no axis twice, each in the chain.
    pub rotary: Vec<RotaryLocation>,
    /// Where the tool tip is.
    pub tool: ToolTip,
}

impl Volume {
    /// Returns whether anything in it makes an error.
    #[must_use]
    pub fn has_errors(&self) -> bool {
        !self.angular.is_empty() || self.rotary.iter().any(|it| !it.is_right())
    }

    /// Returns where the line of a rotary axis should be, in mm.
    #[must_use]
    pub fn line_mm(&self, axis: RotaryAxis) -> [f64; 3] {
        self.rotary.iter().find(|it| it.axis == axis).map_or([0.0; 3], |it| it.point_mm)
    }
}

/// An angular error of a linear axis: EAX has `about` A and `along` X.
#[derive(Clone, Debug, PartialEq)]
pub struct Angular {
    /// The axis that the moving part turns about, right-handed.
    pub about: RotaryAxis,
    /// The axis that moves.
    pub along: LinearAxis,
    /// The angle over its position, in µrad.
    pub angle: Angle,
}

impl Angular {
    /// Returns the nine (about, along), in the order of ISO 230-1.
    #[must_use]
    pub fn all() -> [(RotaryAxis, LinearAxis); 9] {
        [(A, X), (B, X), (C, X), (A, Y), (B, Y), (C, Y), (A, Z), (B, Z), (C, Z)]
    }

    /// Returns its name in ISO 230-1, in lower case, which is its key under `[angular]`: `eax`.
    #[must_use]
    pub fn name(&self) -> String {
        let all = Self::all().into_iter().zip(ANGLES);
        let key = all.filter(|(it, _)| *it == (self.about, self.along)).map(|(_, key)| key.name);
        key.collect()
    }
}

/// How far the line of a rotary axis is from where it should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotaryLocation {
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

impl RotaryLocation {
    /// Returns whether its line is where it should be.
    #[must_use]
    pub fn is_right(&self) -> bool {
        self.shift_um == [0.0; 3] && self.tilt_urad == [0.0; 3]
    }
}

table! {
    /// Where the tool tip is with all angles at 0, in mm: `offset_mm` from the spindle nose, and from there
    /// `length_mm` in the tool direction.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct ToolTip {
        length_mm: f64 = key(NotNegative, "mm", "from where the tool begins to its tip, in `tool_direction`").or("0.0");
        /// In machine coordinates.
        offset_mm: [f64; 3] = key(Vector, "mm", "where the tool begins, from the spindle nose with all angles at 0").or("[0.0, 0.0, 0.0]");
    }
}

impl ToolTip {
    /// Returns the same with this length, where one is given.
    #[must_use]
    pub fn of_length(self, length_mm: Option<f64>) -> Self {
        Self { length_mm: length_mm.unwrap_or(self.length_mm), ..self }
    }

    /// Returns the way from the spindle nose to the tip, with all angles at 0.
    #[must_use]
    pub fn tip_mm(&self, direction: [f64; 3]) -> [f64; 3] {
        // A length that is not known is missing along the tool alone.
        let along =
            |n: usize| if direction[n] == 0.0 { 0.0 } else { self.length_mm * direction[n] };
        [0, 1, 2].map(|n| self.offset_mm[n] + along(n))
    }
}

const fn point(name: &'static str, meaning: &'static str) -> Key {
    key(name, Vector, "mm", meaning).or("[0.0, 0.0, 0.0]")
}

/// An angle for each metre.
const LINE: Key = key(
    "urad_per_m",
    Number,
    "µrad/m",
    "the angle for each metre from machine zero; or a B-spline",
)
.as_in("4.0");
/// An angle as a B-spline.
const CURVE: SplineKeys = [
    key("order", Whole(2, 4), "", "of a B-spline: degree plus one; 4 is cubic").as_in("4"),
    KNOTS,
    key("control_urad", Numbers, "µrad", "the control points").as_in("[0.0, 3.0, -2.0, 4.0, 0.0]"),
];
/// An angle over a position.
const ANGLE: &[Key] = &[LINE, CURVE[0], CURVE[1], CURVE[2]];

/// Of X, Y and Z.
const POINTS: [Key; 3] = [
    point(
        "point_x_mm",
        "where pitch and straightness of X are stated: its angles do nothing there. Machine coordinates of the tool tip, of an axis that moves the workpiece on that part",
    ),
    point("point_y_mm", "the same of Y"),
    point("point_z_mm", "the same of Z"),
];

/// In the order of [`Angular::all`].
const ANGLES: [Key; 9] = [
    section("eax", ANGLE, "the angle about +X, right-handed, of the part that X moves (roll)"),
    section("ebx", ANGLE, "about +Y while X moves"),
    section("ecx", ANGLE, "about +Z while X moves"),
    section("eay", ANGLE, "about +X while Y moves"),
    section("eby", ANGLE, "about +Y while Y moves (roll)"),
    section("ecy", ANGLE, "about +Z while Y moves"),
    section("eaz", ANGLE, "about +X while Z moves"),
    section("ebz", ANGLE, "about +Y while Z moves"),
    section("ecz", ANGLE, "about +Z while Z moves (roll)"),
];

/// The points, then the angles.
pub(super) const ANGULAR: &[Key] = &{
    let mut keys = [POINTS[0]; POINTS.len() + ANGLES.len()];
    let mut n = 0;
    while n < keys.len() {
        keys[n] = if n < POINTS.len() { POINTS[n] } else { ANGLES[n - POINTS.len()] };
        n += 1;
    }
    keys
};

const fn shift(name: &'static str, meaning: &'static str) -> Key {
    key(name, Number, "µm", meaning).or("0.0").quiet()
}

const fn tilt(name: &'static str, meaning: &'static str) -> Key {
    key(name, Number, "µrad", meaning).or("0.0").quiet()
}

const POINT: Key = point(
    "point_mm",
    "a point of its line with all axes at 0: of an axis that turns the workpiece in machine coordinates, of one that turns the tool from the spindle nose",
);

/// Of A, B and C: the point; the shifts along X, Y and Z without that along the line; the tilts about A, B and C.
static LINES: [[Key; 6]; 3] = [
    [
        POINT,
        shift("eyoa_um", "how far the line is off along +Y"),
        shift("ezoa_um", "along +Z"),
        tilt("eaoa_urad", "zero of the angle: about +X, right-handed"),
        tilt("eboa_urad", "how far the line is turned about +Y, right-handed"),
        tilt("ecoa_urad", "about +Z"),
    ],
    [
        POINT,
        shift("exob_um", "how far the line is off along +X"),
        shift("ezob_um", "along +Z"),
        tilt("eaob_urad", "how far the line is turned about +X, right-handed"),
        tilt("ebob_urad", "zero of the angle: about +Y, right-handed"),
        tilt("ecob_urad", "about +Z"),
    ],
    [
        POINT,
        shift("exoc_um", "how far the line is off along +X"),
        shift("eyoc_um", "along +Y"),
        tilt("eaoc_urad", "how far the line is turned about +X, right-handed"),
        tilt("eboc_urad", "about +Y"),
        tilt("ecoc_urad", "zero of the angle: about +Z, right-handed"),
    ],
];

pub(super) const ROTARY: &[Key] = &[
    section(A.name(), &LINES[0], "the line about which A turns"),
    section(B.name(), &LINES[1], "the line about which B turns"),
    section(C.name(), &LINES[2], "the line about which C turns"),
];

pub(super) fn read_angular(
    section: &Section<'_>,
) -> Result<(Vec<Angular>, [[f64; 3]; 3]), BadInput> {
    let mut point_mm = [[0.0; 3]; 3];
    for (point, key) in point_mm.iter_mut().zip(&POINTS) {
        *point = value(section, key)?;
    }
    let mut angular = Vec::new();
    for ((about, along), key) in Angular::all().into_iter().zip(ANGLES) {
        if let Some(section) = section.section(key.name)? {
            angular.push(Angular { about, along, angle: read_angle(&section)? });
        }
    }
    Ok((angular, point_mm))
}

fn read_angle(section: &Section<'_>) -> Result<Angle, BadInput> {
    let of_curve = section.first_of(&CURVE.map(|key| key.name)).map(str::to_string);
    match (section.number(LINE.name)?, of_curve) {
        (None, None) => {
            let rule = "is missing: an angle is urad_per_m, or order, knots_mm and control_urad";
            Err(section.bad(LINE.name, rule))
        }
        (None, Some(_)) => Ok(Angle::Curve(read_spline(section, &CURVE)?)),
        (Some(_), Some(key)) => {
            let rule = "must not stand next to urad_per_m: an angle is one or the other";
            Err(section.bad(&key, rule))
        }
        (Some(urad_per_m), None) => Ok(Angle::Line(urad_per_m)),
    }
}

/// Returns the keys of the line of a rotary axis: of its point, of its shifts along X, Y and Z, of its tilts about A, B and
/// C. The shift along the line itself has none.
fn line_keys(axis: RotaryAxis) -> (&'static Key, [Option<&'static Key>; 3], [&'static Key; 3]) {
    let [point, first, second, tilts @ ..] = &LINES[axis.index()];
    let shifts = match axis {
        A => [None, Some(first), Some(second)],
        B => [Some(first), None, Some(second)],
        C => [Some(first), Some(second), None],
    };
    (point, shifts, tilts.each_ref())
}

pub(super) fn read_rotary(section: &Section<'_>) -> Result<Vec<RotaryLocation>, BadInput> {
    let mut all = Vec::new();
    for axis in RotaryAxis::ALL {
        let Some(section) = section.section(axis.name())? else { continue };
        let (point, shifts, tilts) = line_keys(axis);
        let mut location = RotaryLocation {
            axis,
            point_mm: value(&section, point)?,
            shift_um: [0.0; 3],
            tilt_urad: [0.0; 3],
        };
        for n in 0..3 {
            if let Some(key) = shifts[n] {
                location.shift_um[n] = value(&section, key)?;
            }
            location.tilt_urad[n] = value(&section, tilts[n])?;
        }
        all.push(location);
    }
    Ok(all)
}

/// Refuses angular and location errors that the chain does not place.
pub(super) fn check(root: &Section<'_>, volume: &Volume) -> Result<(), BadInput> {
    let first = ["angular", "rotary"].into_iter().find(|name| root.keys().contains(name));
    let (Some(first), chain) = (first, &volume.chain) else { return Ok(()) };
    let Some(chain) = chain else {
        let rule = "needs machine.chain, which says what each axis carries: the sign and the lever of an error \
                    depend on it";
        let help = "write the axes into [machine] from the workpiece over the bed to the tool, those that move \
                    the workpiece with ': chain = \"w X' b Y Z t\"";
        return Err(root.bad(first, rule).with_help(help));
    };
    let rotary = chain.rotary();
    let outside = volume.rotary.iter().find(|it| !rotary.contains(&it.axis));
    outside.map_or(Ok(()), |it| {
        let rule =
            format!("is not in machine.chain, \"{chain}\": write where it stands, or take it out");
        Err(root.bad(&format!("rotary.{}", it.axis.name()), rule))
    })
}

/// Returns the sections of the file.
pub(super) fn write(volume: &Volume) -> Vec<NewSection> {
    let mut sections = Vec::new();
    let points = POINTS.iter().zip(&volume.point_mm).filter(|(_, point)| **point != [0.0; 3]);
    let points = points
        .fold(NewSection::new("angular"), |section, (key, point)| written(section, key, point));
    if points.values().next().is_some() {
        sections.push(points);
    }
    for angular in &volume.angular {
        let section = NewSection::new(format!("angular.{}", angular.name()));
        sections.push(match &angular.angle {
            Angle::Line(urad_per_m) => written(section, &LINE, urad_per_m),
            Angle::Curve(spline) => write_spline(section, spline, &CURVE),
        });
    }
    for it in &volume.rotary {
        let (point, shifts, tilts) = line_keys(it.axis);
        let section = NewSection::new(format!("rotary.{}", it.axis.name()));
        let section = written(section, point, &it.point_mm);
        let shifts = shifts.into_iter().zip(&it.shift_um).filter_map(|(key, um)| Some((key?, um)));
        let all = shifts.chain(tilts.into_iter().zip(&it.tilt_urad));
        sections.push(all.fold(section, |section, (key, value)| written(section, key, value)));
    }
    if volume.tool != ToolTip::default() {
        sections.push(volume.tool.write(NewSection::new("tool")));
    }
    sections
}
