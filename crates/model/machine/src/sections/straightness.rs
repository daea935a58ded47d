//! `[straightness.z_of_x]` and `[squareness]`: the error of one linear axis while another moves.

use super::LinearAxis::{self, X, Y, Z};
use crate::{
    keys::{
        key::{
            Key,
            ValueType::{Number, Numbers, Whole},
            key, section,
        },
        plausible_range::SPLINE_ORDER_RANGE,
        reader::{MAX_ARRAY_LENGTH, Section},
        section::{NewSection, Value},
    },
    location::InputFileError,
    spline::BSpline,
};

/// The error of one axis along another: δz(x) has `error` Z and `along` X.
#[derive(Clone, Debug, PartialEq)]
pub struct Straightness {
    /// The axis that is in error.
    pub error: LinearAxis,
    /// The axis that moves, another one.
    pub along: LinearAxis,
    /// The error over the position of the axis that moves.
    pub spline: BSpline,
}

impl Straightness {
    /// The six pairs (error, along), in the order of the format's description.
    pub const AXIS_PAIRS: [(LinearAxis, LinearAxis); 6] =
        [(Y, X), (Z, X), (Z, Y), (X, Y), (X, Z), (Y, Z)];

    /// Returns the name of its section under `[straightness]`: `z_of_x`.
    #[must_use]
    pub fn name(&self) -> String {
        pair_key(STRAIGHTNESS_KEYS, (self.error, self.along)).map_or("", |key| key.name).to_string()
    }
}

/// The slope of one axis along another: an error of `error` that grows with the position of
/// `along`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Squareness {
    /// The axis that is in error.
    pub error: LinearAxis,
    /// The axis that moves, another one.
    pub along: LinearAxis,
    /// The error in µm for one metre of `along`.
    pub um_per_m: f64,
}

impl Squareness {
    /// Its key under `[squareness]`: `x_of_y_um_per_m`.
    #[must_use]
    pub fn name(&self) -> String {
        pair_key(SQUARENESS_KEYS, (self.error, self.along)).map_or("", |key| key.name).to_string()
    }
}

/// Returns the key of a pair; `None` where it is no pair of two axes.
fn pair_key(keys: &'static [Key], pair: (LinearAxis, LinearAxis)) -> Option<&'static Key> {
    Straightness::AXIS_PAIRS
        .iter()
        .zip(keys)
        .find(|(candidate, _)| **candidate == pair)
        .map(|(_, key)| key)
}

/// Keys of a spline: its order, its knots, its control points.
pub(crate) type SplineKeys = [Key; 3];

const SPLINE_KEYS: SplineKeys = [
    key("order", Whole(2, 4), "", "degree plus one; 4 is cubic")
        .required()
        .with_example_value("4")
        .with_range(SPLINE_ORDER_RANGE),
    KNOTS_KEY.required(),
    key("control_um", Numbers, "µm", "the control points")
        .required()
        .with_example_value("[0.0, 3.0, -2.0, 4.0, 0.0]"),
];

/// The knots of a spline.
pub(crate) const KNOTS_KEY: Key = key("knots_mm", Numbers, "mm", "as many as control points and `order` together, not falling; the first and the last stand there `order` times")
    .with_example_value("[0.0, 0.0, 0.0, 0.0, 500.0, 1000.0, 1000.0, 1000.0, 1000.0]");

/// In the order of [`Straightness::AXIS_PAIRS`].
pub(crate) const STRAIGHTNESS_KEYS: &[Key] = &[
    section("y_of_x", &SPLINE_KEYS, "the B-spline of Y's deviation while X moves"),
    section("z_of_x", &SPLINE_KEYS, "of Z while X moves"),
    section("z_of_y", &SPLINE_KEYS, "of Z while Y moves"),
    section("x_of_y", &SPLINE_KEYS, "of X while Y moves"),
    section("x_of_z", &SPLINE_KEYS, "of X while Z moves"),
    section("y_of_z", &SPLINE_KEYS, "of Y while Z moves"),
];

const fn squareness_key(name: &'static str, meaning: &'static str) -> Key {
    key(name, Number, "µm/m", meaning).with_example_value("3.5")
}

/// In the order of [`Straightness::AXIS_PAIRS`].
pub(crate) const SQUARENESS_KEYS: &[Key] = &[
    squareness_key("y_of_x_um_per_m", "error of Y for each metre of X"),
    squareness_key("z_of_x_um_per_m", "of Z for each metre of X"),
    squareness_key("z_of_y_um_per_m", "of Z for each metre of Y"),
    squareness_key("x_of_y_um_per_m", "of X for each metre of Y"),
    squareness_key("x_of_z_um_per_m", "of X for each metre of Z"),
    squareness_key("y_of_z_um_per_m", "of Y for each metre of Z"),
];

pub(crate) fn read_straightness(
    section: &Section<'_>,
) -> Result<Vec<Straightness>, InputFileError> {
    let mut curves = Vec::new();
    for ((error, along), key) in Straightness::AXIS_PAIRS.into_iter().zip(STRAIGHTNESS_KEYS) {
        if let Some(section) = section.section(key.name)? {
            curves.push(Straightness {
                error,
                along,
                spline: read_spline(&section, &SPLINE_KEYS)?,
            });
        }
    }
    Ok(curves)
}

/// Returns a spline among the keys of `section`, which may have others.
pub(crate) fn read_spline(
    section: &Section<'_>,
    keys: &SplineKeys,
) -> Result<BSpline, InputFileError> {
    let [order, knots, control] = keys.map(|key| key.name);
    let order = section.required(order, section.integer(order, 0, u32::MAX)?)?;
    let knots_mm = section.required(knots, section.numbers(knots)?)?;
    let control_um = section.required(control, section.numbers(control)?)?;
    // An order beyond every array is as wrong as any other that is not 2, 3 or 4.
    let order = usize::try_from(order).unwrap_or(MAX_ARRAY_LENGTH);
    let spline = BSpline { order, knots_mm, control_um };
    spline.validate().map_err(|fault| {
        let named = |text: String| text.replace(SPLINE_KEYS[2].name, control);
        section.key_error(&named(fault.key), named(fault.rule))
    })?;
    Ok(spline)
}

pub(crate) fn read_squareness(section: &Section<'_>) -> Result<Vec<Squareness>, InputFileError> {
    let mut angles = Vec::new();
    for ((error, along), key) in Straightness::AXIS_PAIRS.into_iter().zip(SQUARENESS_KEYS) {
        if let Some(um_per_m) = section.number(key.name)? {
            angles.push(Squareness { error, along, um_per_m });
        }
    }
    Ok(angles)
}

pub(crate) fn write_straightness(curve: &Straightness) -> NewSection {
    let section = NewSection::new(format!("straightness.{}", curve.name()));
    add_spline_keys(section, &curve.spline, &SPLINE_KEYS)
}

/// Returns `section` with a spline after the keys that it has.
pub(crate) fn add_spline_keys(
    section: NewSection,
    spline: &BSpline,
    keys: &SplineKeys,
) -> NewSection {
    let with = |section: NewSection, (key, value)| section.with_value(key, value);
    spline_entries(spline, keys).into_iter().fold(section, with)
}

/// Returns the keys of a spline with their values.
pub(crate) fn spline_entries(spline: &BSpline, keys: &SplineKeys) -> [(&'static str, Value); 3] {
    // What passes `check` is 2, 3 or 4.
    let order = u32::try_from(spline.order).unwrap_or(u32::MAX);
    let [order_key, knots, control] = keys.map(|key| key.name);
    [
        (order_key, Value::Whole(order)),
        (knots, Value::Numbers(spline.knots_mm.clone())),
        (control, Value::Numbers(spline.control_um.clone())),
    ]
}

pub(crate) fn write_squareness(angles: &[Squareness]) -> Option<NewSection> {
    let section = NewSection::new("squareness");
    let with =
        |section: NewSection, angle: &Squareness| section.with_number(angle.name(), angle.um_per_m);
    (!angles.is_empty()).then(|| angles.iter().fold(section, with))
}
