//! What is wrong at a place: the errors of the axes where the machine stands, in space.
//!
//! ```text
//! thermal   K₀ + tanβ·(P − P₀)                          along the axis itself
//! screw     pitch table by direction + backlash         along the axis itself
//! guides    straightness and squareness over the two other axes
//!           Δx = δx(y) + δx(z),  Δy = δy(x) + δy(z),  Δz = δz(x) + δz(y)
//! terms     what a diagnosis has added                  any of these
//! ```
//!
//! An error is actual minus commanded. Everything is added in 1/256 nm and rounded once, by the
//! caller.

use crate::{
    calibration::{Axis, CROSSED, Calibration},
    cnc::LinearAxis,
    heat::Heat,
    travel::{Travel, backlash},
    units::{Fine, Position},
};

/// Where the machine stands, and from which side it came there.
#[derive(Clone, Debug, Default)]
pub struct Place {
    /// X, Y and Z.
    pub position: [Position; 3],
    /// The direction of approach of X, Y and Z.
    pub travel: [Travel; 3],
}

/// The errors of one axis at a place, part by part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisError {
    /// Its expansion.
    pub thermal: Fine,
    /// Pitch and backlash.
    pub screw: Fine,
    /// Straightness of the two other axes, and squareness to them.
    pub guides: Fine,
    /// What a diagnosis has added.
    pub terms: Fine,
}

impl AxisError {
    /// The sum, each part held to ±`largest` first; and whether a part was held.
    #[must_use]
    pub fn sum(&self, largest: Fine) -> (Fine, bool) {
        let largest = largest.0.max(0);
        let mut clamped = false;
        let sum = [self.thermal, self.screw, self.guides, self.terms].into_iter().fold(
            Fine::ZERO,
            |sum, part| {
                let held = part.0.clamp(largest.saturating_neg(), largest);
                clamped |= held != part.0;
                sum.plus(Fine(held))
            },
        );
        (sum, clamped)
    }
}

/// The errors of X, Y and Z.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Errors {
    /// One an axis.
    pub axes: [AxisError; 3],
    /// A position lies outside a table, whose end value is held.
    pub outside: bool,
}

impl Calibration<'_> {
    /// The errors of the axes at a place.
    #[must_use]
    pub fn errors(&self, heat: &Heat, place: &Place) -> Errors {
        let mut errors = Errors::default();
        for (number, (error, axis)) in errors.axes.iter_mut().zip(&self.axes).enumerate() {
            let (Some(&position), Some(travel)) =
                (place.position.get(number), place.travel.get(number))
            else {
                continue;
            };
            if let Some(thermal) = &axis.thermal {
                let (constant, gradient) = heat.axis(number);
                error.thermal = constant.plus(gradient.over(thermal.origin, position));
            }
            let (screw, outside) = screw(axis, position, travel, place);
            error.screw = screw;
            errors.outside |= outside;
        }
        for (((along, over), curve), gradient) in
            CROSSED.into_iter().zip(&self.straightness).zip(self.squareness)
        {
            let Some(error) = errors.axes.get_mut(along as usize) else { continue };
            let position = place.at(over);
            let (bow, outside) = curve.at(position);
            let tilt = gradient.over(Position(0), position);
            error.guides = error.guides.plus(bow).plus(tilt);
            errors.outside |= outside;
        }
        if self.terms[0].is_some() {
            let (terms, outside) = self.axis_terms(heat.terms(), place);
            for (error, term) in errors.axes.iter_mut().zip(terms) {
                error.terms = term;
            }
            errors.outside |= outside;
        }
        errors
    }
}

impl Place {
    fn at(&self, axis: LinearAxis) -> Position {
        self.position.get(axis as usize).copied().unwrap_or_default()
    }
}

/// Pitch and backlash of one axis; of a gantry, both drives across the beam.
fn screw(axis: &Axis<'_>, position: Position, travel: &Travel, place: &Place) -> (Fine, bool) {
    let blend = travel.blend();
    let (mut error, mut outside) = (Fine::ZERO, false);
    if let Some(pitch) = &axis.pitch {
        (error, outside) = pitch.at(position, blend);
    }
    if let Some(dual) = &axis.dual {
        let (second, beyond) = dual.pitch.at(position, blend);
        error = dual.beam.across(error, second, place.at(dual.across));
        outside |= beyond;
    }
    if axis.backlash != Fine::ZERO {
        error = error.plus(backlash(axis.backlash, blend));
    }
    (error, outside)
}
