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
    straightness::{KNOTS, read_spline, spline_keys},
    table::{Table, table},
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
        angle_name(self.about, self.along)
    }
}

fn angle_name(about: RotaryAxis, along: LinearAxis) -> String {
    format!("e{}{}", about.name(), along.name())
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

/// An angle over a position.
const ANGLE: &[Key] = &[
    key(
        "urad_per_m",
        Number,
        "µrad/m",
        "the angle for each metre from machine zero; or a B-spline",
    )
    .as_in("4.0"),
    key("order", Whole(2, 4), "", "of a B-spline: degree plus one; 4 is cubic").as_in("4"),
    KNOTS,
    key("control_urad", Numbers, "µrad", "the control points").as_in("[0.0, 3.0, -2.0, 4.0, 0.0]"),
];

pub(super) const ANGULAR: &[Key] = &[
    point(
        "point_x_mm",
        "where pitch and straightness of X are stated: its angles do nothing there. Machine coordinates of the tool tip, of an axis that moves the workpiece on that part",
    ),
    point("point_y_mm", "the same of Y"),
    point("point_z_mm", "the same of Z"),
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

const fn shift(name: &'static str, meaning: &'static str) -> Key {
    key(name, Number, "µm", meaning).or("0.0")
}

const fn tilt(name: &'static str, meaning: &'static str) -> Key {
    key(name, Number, "µrad", meaning).or("0.0")
}

const POINT: Key = point(
    "point_mm",
    "a point of its line with all axes at 0: of an axis that turns the workpiece in machine coordinates, of one that turns the tool from the spindle nose",
);

pub(super) const ROTARY: &[Key] = &[
    section(
        "a",
        &[
            POINT,
            shift("eyoa_um", "how far the line is off along +Y"),
            shift("ezoa_um", "along +Z"),
            tilt("eaoa_urad", "zero of the angle: about +X, right-handed"),
            tilt("eboa_urad", "how far the line is turned about +Y, right-handed"),
            tilt("ecoa_urad", "about +Z"),
        ],
        "the line about which A turns",
    ),
    section(
        "b",
        &[
            POINT,
            shift("exob_um", "how far the line is off along +X"),
            shift("ezob_um", "along +Z"),
            tilt("eaob_urad", "how far the line is turned about +X, right-handed"),
            tilt("ebob_urad", "zero of the angle: about +Y, right-handed"),
            tilt("ecob_urad", "about +Z"),
        ],
        "the line about which B turns",
    ),
    section(
        "c",
        &[
            POINT,
            shift("exoc_um", "how far the line is off along +X"),
            shift("eyoc_um", "along +Y"),
            tilt("eaoc_urad", "how far the line is turned about +X, right-handed"),
            tilt("eboc_urad", "about +Y"),
            tilt("ecoc_urad", "zero of the angle: about +Z, right-handed"),
        ],
        "the line about which C turns",
    ),
];

pub(super) fn read_angular(
    section: &Section<'_>,
) -> Result<(Vec<Angular>, [[f64; 3]; 3]), BadInput> {
    let mut point_mm = [[0.0; 3]; 3];
    for (point, axis) in point_mm.iter_mut().zip(LinearAxis::ALL) {
        *point = section.vector(&point_key(axis))?.unwrap_or_default();
    }
    let mut angular = Vec::new();
    for (about, along) in Angular::all() {
        if let Some(section) = section.section(&angle_name(about, along))? {
            angular.push(Angular { about, along, angle: read_angle(&section)? });
        }
    }
    Ok((angular, point_mm))
}

fn point_key(axis: LinearAxis) -> String {
    format!("point_{}_mm", axis.name())
}

fn read_angle(section: &Section<'_>) -> Result<Angle, BadInput> {
    let has = |key: &str| section.keys().contains(&key);
    match section.number("urad_per_m")? {
        None if !has("order") && !has("knots_mm") && !has("control_urad") => {
            let rule = "is missing: an angle is urad_per_m, or order, knots_mm and control_urad";
            Err(section.bad("urad_per_m", rule))
        }
        None => Ok(Angle::Curve(read_spline(section, "control_urad")?)),
        Some(urad_per_m) => {
            match ["order", "knots_mm", "control_urad"].into_iter().find(|it| has(it)) {
                Some(key) => Err(section
                    .bad(key, "must not stand next to urad_per_m: an angle is one or the other")),
                None => Ok(Angle::Line(urad_per_m)),
            }
        }
    }
}

/// Returns the keys of the shifts and tilts of a rotary axis, each with its place among X, Y and Z; the
/// shift along the line itself has none.
fn location_keys(axis: RotaryAxis) -> ([Option<String>; 3], [String; 3]) {
    let shift = LinearAxis::ALL.map(|along| {
        (along.index() != axis.index()).then(|| format!("e{}o{}_um", along.name(), axis.name()))
    });
    let tilt = RotaryAxis::ALL.map(|about| format!("e{}o{}_urad", about.name(), axis.name()));
    (shift, tilt)
}

pub(super) fn read_rotary(section: &Section<'_>) -> Result<Vec<RotaryLocation>, BadInput> {
    let mut all = Vec::new();
    for axis in RotaryAxis::ALL {
        let Some(section) = section.section(axis.name())? else { continue };
        let (shift, tilt) = location_keys(axis);
        let mut location = RotaryLocation {
            axis,
            point_mm: section.vector("point_mm")?.unwrap_or_default(),
            shift_um: [0.0; 3],
            tilt_urad: [0.0; 3],
        };
        for n in 0..3 {
            if let Some(key) = &shift[n] {
                location.shift_um[n] = section.number(key)?.unwrap_or(0.0);
            }
            location.tilt_urad[n] = section.number(&tilt[n])?.unwrap_or(0.0);
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
    let points = LinearAxis::ALL.into_iter().zip(volume.point_mm);
    let points = points.filter(|(_, point)| *point != [0.0; 3]);
    let points = points.fold(NewSection::new("angular"), |section, (axis, point)| {
        section.numbers(point_key(axis), point)
    });
    if points.values().next().is_some() {
        sections.push(points);
    }
    for angular in &volume.angular {
        let section = NewSection::new(format!("angular.{}", angular.name()));
        sections.push(match &angular.angle {
            Angle::Line(urad_per_m) => section.number("urad_per_m", *urad_per_m),
            Angle::Curve(spline) => spline_keys(section, spline, "control_urad"),
        });
    }
    for it in &volume.rotary {
        let (shift, tilt) = location_keys(it.axis);
        let mut section = NewSection::new(format!("rotary.{}", it.axis.name()));
        section = section.numbers("point_mm", it.point_mm);
        let shifts = shift.into_iter().zip(it.shift_um).filter_map(|(key, um)| Some((key?, um)));
        let all = shifts.chain(tilt.into_iter().zip(it.tilt_urad));
        for (key, value) in all.filter(|(_, value)| *value != 0.0) {
            section = section.number(key, value);
        }
        sections.push(section);
    }
    if volume.tool != ToolTip::default() {
        sections.push(volume.tool.write(NewSection::new("tool")));
    }
    sections
}
