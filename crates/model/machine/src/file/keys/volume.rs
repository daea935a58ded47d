//! The keys of `[angular]`, `[rotary]` and `[tool]`.

use super::key::{
    Form::{NotNegative, Number, Numbers, Vector, Whole},
    Key, key, section,
};

const fn point(name: &'static str, meaning: &'static str) -> Key {
    key(name, Vector, "mm", meaning).or("[0.0, 0.0, 0.0]")
}

/// An angle over a position.
const ANGLE: &[Key] = &[
    key("urad_per_m", Number, "µrad/m", "the angle for each metre from machine zero; or a B-spline").as_in("4.0"),
    key("order", Whole(2, 4), "", "of a B-spline: degree plus one; 4 is cubic").as_in("4"),
    key("knots_mm", Numbers, "mm", "as many as control points and `order` together, not falling; the first and the last stand there `order` times")
        .as_in("[0.0, 0.0, 0.0, 0.0, 500.0, 1000.0, 1000.0, 1000.0, 1000.0]"),
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

pub(super) const TOOL_TIP: &[Key] = &[
    key(
        "length_mm",
        NotNegative,
        "mm",
        "from where the tool begins to its tip, in `tool_direction`",
    )
    .or("0.0"),
    point("offset_mm", "where the tool begins, from the spindle nose with all angles at 0"),
];
