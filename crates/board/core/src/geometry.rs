//! The errors of the axes at a place, where the machine stands, in space.
//!
//! ```text
//! thermal      K₀ + tanβ·(P − P₀)                          along the axis itself
//! positioning  pitch table by direction + backlash      along the axis itself
//! guides       straightness and squareness over the two other axes
//!              Δx = δx(y) + δx(z),  Δy = δy(x) + δy(z),  Δz = δz(x) + δz(y)
//! volume       angles × levers, lines of rotary axes       any of these
//! terms        what a diagnosis has added                  any of these
//! ```
//!
//! An error is actual minus commanded. Everything is added in 1/256 nm and rounded once, by the
//! caller.

use crate::{
    calibration::{AXIS_PAIRS, AxisModel, Calibration},
    cnc::LinearAxis,
    gradient::Gradient,
    heat::Heat,
    place::Place,
    set::IndexSet,
    term,
    travel::backlash,
    units::{Fine, Position},
    volume::CachedVolume,
};

/// The errors of one axis at a place, part by part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisError {
    /// Its expansion, K₀ + tanβ·(P − P₀).
    pub thermal: Fine,
    /// Positioning: pitch table and backlash.
    pub positioning: Fine,
    /// Straightness of the two other axes, squareness to them, and what [`volume`](crate::volume) adds.
    pub guides: Fine,
    /// The terms that a diagnosis has added.
    pub terms: Fine,
}

impl AxisError {
    /// Returns the sum, each part held to ±`largest` first, which counts as 0 below 0; and whether a part was held.
    #[must_use]
    #[inline]
    pub fn sum(&self, largest: Fine) -> (Fine, bool) {
        let parts = [self.thermal, self.positioning, self.guides, self.terms];
        let largest = Fine(largest.0.max(0));
        if parts.iter().all(|part| part.is_within(largest)) {
            (total(parts), false)
        } else {
            (held_total(parts, largest), true)
        }
    }
}

#[inline]
fn total([thermal, positioning, guides, terms]: [Fine; 4]) -> Fine {
    thermal.plus(positioning).plus(guides).plus(terms)
}

#[cold]
fn held_total(parts: [Fine; 4], largest: Fine) -> Fine {
    total(parts.map(|part| part.clamped(largest).0))
}

/// The errors of X, Y and Z.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Errors {
    /// Of X, Y and Z, part by part; each in 1/256 nm, actual minus commanded.
    pub axes: [AxisError; 3],
    /// A position lies outside a table, whose end value is held.
    pub outside: bool,
}

/// The errors of X, Y and Z, each the sum of its parts.
#[derive(Clone, Copy, Debug)]
pub struct ErrorSums {
    /// In 1/256 nm, actual minus commanded.
    pub sums: [Fine; 3],
    /// A part was clamped to its limit.
    pub clamped: bool,
    /// A position lies outside a table, whose end value is held.
    pub outside: bool,
}

impl Errors {
    /// Returns the sums, each part clamped to ±`largest` of its axis first.
    #[must_use]
    pub fn sums(&self, largest: [Fine; 3]) -> ErrorSums {
        let mut all = ErrorSums { sums: [Fine::ZERO; 3], clamped: false, outside: self.outside };
        for ((sum, error), largest) in all.sums.iter_mut().zip(&self.axes).zip(largest) {
            let (clamped_sum, clamped) = error.sum(largest);
            *sum = clamped_sum;
            all.clamped |= clamped;
        }
        all
    }
}

/// The errors at a place, cached from message to message: what an axis that moves or a thermometer
/// does not change is not computed again. [`Self::add_up`] makes [`Self::errors`] of the parts.
///
/// The parts that depend on one axis cost 497 instructions (median) on the gantry of `data/`, with two or three
/// curves and tables (`cargo measure`).
#[derive(Clone, Debug, Default)]
pub struct CachedErrors {
    errors: Errors,
    /// The tables that a position lies outside of: those of the positioning from [`POSITIONING`] on, of
    /// the guides from [`GUIDES`] on, of the angles from [`ANGLES`] on, and [`TERMS`].
    outside: IndexSet,
    /// Straightness and squareness, in the order of [`AXIS_PAIRS`].
    guides: [Fine; 6],
    volume: CachedVolume,
}

const POSITIONING: usize = 0;
const GUIDES: usize = 3;
const ANGLES: usize = 9;
const TERMS: usize = 12;

/// Of X, Y and Z: the two places in [`AXIS_PAIRS`] where the axis is the one that moves.
const GUIDES_OVER: [[usize; 2]; 3] = {
    let mut over = [[0; 2]; 3];
    let (mut axis, mut pair) = (0, 0);
    while axis < over.len() {
        let mut found = 0;
        while pair < AXIS_PAIRS.len() {
            if AXIS_PAIRS[pair].1 as usize == axis {
                over[axis][found] = pair;
                found += 1;
            }
            pair += 1;
        }
        (axis, pair) = (axis + 1, 0);
    }
    over
};

impl Calibration<'_> {
    /// Returns the errors of the axes at a place.
    #[must_use]
    pub fn errors(&self, heat: &Heat, place: &Place) -> Errors {
        *CachedErrors::at(self, heat, place).errors()
    }
}

impl CachedErrors {
    /// Returns the errors at a place, added up.
    // A function of its own in the image: a board calls it once after a start, and its time is bounded by that.
    #[inline(never)]
    #[must_use]
    pub fn at(calibration: &Calibration<'_>, heat: &Heat, place: &Place) -> Self {
        let mut cached = Self::default();
        cached.turned(calibration, place);
        for axis in LinearAxis::ALL {
            cached.moved(calibration, heat, place, axis);
        }
        cached.add_up(calibration, place);
        cached
    }

    /// Returns the errors as they were last added up.
    #[must_use]
    pub fn errors(&self) -> &Errors {
        &self.errors
    }

    /// An axis has moved to where it stands in `place`, or has turned round.
    pub fn moved(
        &mut self,
        calibration: &Calibration<'_>,
        heat: &Heat,
        place: &Place,
        moved: LinearAxis,
    ) {
        self.warmed(calibration, heat, place, moved);
        for (name, axis) in LinearAxis::ALL.into_iter().zip(&calibration.axes) {
            // A beam's error changes where it is crossed, too.
            if name == moved || axis.dual.is_some_and(|dual| dual.across == moved) {
                let (error, outside) = positioning(axis, name, place);
                let number = name as usize;
                if let Some(of_axis) = self.errors.axes.get_mut(number) {
                    of_axis.positioning = error;
                }
                self.outside.set(POSITIONING.wrapping_add(number), outside);
            }
        }
        let position = place.of(moved);
        for &number in GUIDES_OVER.get(moved as usize).into_iter().flatten() {
            if let (Some(guide), Some(curve), Some(gradient)) = (
                self.guides.get_mut(number),
                calibration.straightness.get(number),
                calibration.squareness.get(number),
            ) {
                let (straightness, outside) = curve.at(position);
                // Most machines are square, or not measured.
                *guide = match *gradient {
                    Gradient::ZERO => straightness,
                    gradient => straightness.plus(gradient.over(Position(0), position)),
                };
                self.outside.set(GUIDES.wrapping_add(number), outside);
            }
        }
        if let Some(volume) = &calibration.volume {
            let outside = self.volume.moved(volume, position, moved);
            self.outside.set(ANGLES.wrapping_add(moved as usize), outside);
        }
        self.terms_changed(calibration, heat, place);
    }

    /// The rotary axes have turned to where they stand in `place`.
    pub fn turned(&mut self, calibration: &Calibration<'_>, place: &Place) {
        if let Some(volume) = &calibration.volume {
            self.volume.turned(volume, place);
        }
    }

    /// Adds the parts up after axes have moved, rotary axes turned or terms changed.
    pub fn add_up(&mut self, calibration: &Calibration<'_>, place: &Place) {
        // Two guides an axis, in the order of `AXIS_PAIRS`.
        for (error, [first, second]) in
            self.errors.axes.iter_mut().zip(self.guides.as_chunks::<2>().0)
        {
            error.guides = first.plus(*second);
        }
        if let Some(volume) = &calibration.volume {
            let of_volume = self.volume.errors(volume, place);
            for (error, of_volume) in self.errors.axes.iter_mut().zip(of_volume) {
                error.guides = error.guides.plus(of_volume);
            }
        }
        self.errors.outside = self.outside != IndexSet::default();
    }

    /// An axis has moved, or a thermometer that a term follows has been read.
    pub fn terms_changed(&mut self, calibration: &Calibration<'_>, heat: &Heat, place: &Place) {
        // Most machines have none.
        if calibration.terms[0].is_some() {
            let (terms, outside) = term::axis_errors(&calibration.terms, heat.terms(), place);
            for (error, term) in self.errors.axes.iter_mut().zip(terms) {
                error.terms = term;
            }
            self.outside.set(TERMS, outside);
        }
    }

    /// An axis has become warmer or colder.
    pub fn warmed(
        &mut self,
        calibration: &Calibration<'_>,
        heat: &Heat,
        place: &Place,
        warmed: LinearAxis,
    ) {
        let number = warmed as usize;
        if let (Some(error), Some(axis)) =
            (self.errors.axes.get_mut(number), calibration.axes.get(number))
            && let Some(thermal) = &axis.thermal
        {
            let (constant, gradient) = heat.axis(number);
            let plain = constant.plus(gradient.over(thermal.origin, place.of(warmed)));
            error.thermal = heat.learned.expansion(number, plain);
        }
    }
}

/// Pitch and backlash of one axis; of a gantry, both drives across the beam.
fn positioning(axis: &AxisModel<'_>, name: LinearAxis, place: &Place) -> (Fine, bool) {
    let position = place.of(name);
    let reversal = place.reversal(name);
    let (mut error, mut outside) = (Fine::ZERO, false);
    if let Some(pitch) = &axis.pitch {
        (error, outside) = pitch.at(position, reversal);
    }
    if let Some(dual) = &axis.dual {
        let (second, beyond) = dual.pitch.at(position, reversal);
        error = dual.beam.across(error, second, place.of(dual.across));
        outside |= beyond;
    }
    if axis.backlash != Fine::ZERO {
        error = error.plus(backlash(axis.backlash, reversal));
    }
    (error, outside)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        calibration::Dual,
        curve::{Curve, Segment},
        pitch::{Beam, Pitch},
        term::{Effect, Target, Term},
        travel::Interval,
    };

    #[test]
    fn each_part_is_held_to_its_limit_and_any_that_is_held_is_told() {
        for bits in 0..16_u8 {
            let part = |bit: u8| Fine(if bits & bit == 0 { 10 } else { -300 });
            let error = AxisError {
                thermal: part(1),
                positioning: part(2),
                guides: part(4),
                terms: part(8),
            };
            let held = i32::try_from(bits.count_ones()).expect("4 at the most");
            let sum = Fine(10 * (4 - held) - 100 * held);
            assert_eq!(error.sum(Fine(100)), (sum, held > 0), "{error:?}");
        }
    }

    /// A gantry: X on two drives along Y, Y with backlash, a bent and not square guide, a term on Z.
    fn gantry<'a>(calibration: &mut Calibration<'a>, [first, second]: [&'a [[u8; 4]]; 2]) {
        let pitch = |forward| Pitch {
            start: Position(0),
            step: Interval::new(100),
            forward,
            reverse: None,
        };
        calibration.axes[0].pitch = Some(pitch(first));
        calibration.axes[0].dual = Some(Dual {
            across: LinearAxis::Y,
            beam: Beam::new(Position(0), Position(1_000)),
            pitch: pitch(second),
        });
        calibration.axes[1].backlash = Fine(-500);
    }

    fn at(positions: [i32; 3]) -> Place {
        Place { position: positions.map(Position), ..Place::default() }
    }

    #[test]
    fn a_gantry_errs_by_both_drives_where_it_is_crossed_and_another_axis_by_its_backlash() {
        let [first, second] =
            [[100, 300], [1_100, 1_700]].map(|it: [i32; 2]| it.map(i32::to_le_bytes));
        let mut calibration: Calibration<'_> = crate::testing::plain();
        gantry(&mut calibration, [&first, &second]);
        let heat = Heat::default();
        let mut place = at([0, 0, 0]);
        let mut cached = CachedErrors::at(&calibration, &heat, &place);
        let (x, y) = (LinearAxis::X, LinearAxis::Y);
        // To where, which axis, and the error of X in 1/256 nm, whether it is outside.
        for (positions, moved, error, outside) in [
            ([100, 0, 0], x, 300, false),
            ([100, 1_000, 0], y, 1_700, false),
            ([100, 500, 0], y, 1_000, false),
            ([0, 500, 0], x, 600, false),
            ([101, 500, 0], x, 1_000, true),
            ([101, 500, 7], LinearAxis::Z, 1_000, true),
            ([50, 500, 7], x, 800, false),
        ] {
            place.position = positions.map(Position);
            cached.moved(&calibration, &heat, &place, moved);
            cached.add_up(&calibration, &place);
            let errors = cached.errors();
            assert!((errors.axes[0].positioning.0 - error).abs() <= 1, "{positions:?}: {errors:?}");
            assert_eq!((errors.outside, errors.axes[1].positioning), (outside, Fine(0)));
            assert_eq!(*errors, calibration.errors(&heat, &place));
        }
        // Y turns round.
        let config = calibration.axes[1].travel;
        place.travel[1].update(&config, place.position[1], -1);
        cached.moved(&calibration, &heat, &place, y);
        assert_eq!(cached.errors().axes[1].positioning, Fine(-500));
    }

    #[test]
    fn each_table_that_a_position_is_outside_of_is_told_alone() {
        let point = [256_i32.to_le_bytes(); 2];
        let segments = [Segment::new(Position(100), 16, [256, 0, 0, 0]).to_bytes()];
        let curve = Curve::new(Position(0), &segments, &[[0, 0]], 16);
        let pitch =
            Pitch { start: Position(0), step: Interval::new(100), forward: &point, reverse: None };
        let mut all: [Calibration<'_>; 4] = [crate::testing::plain(); 4];
        all[0].axes[2].pitch = Some(pitch);
        all[1].straightness[1] = curve;
        let beam = Beam::new(Position(0), Position(1_000));
        all[2].axes[2].dual = Some(Dual { across: LinearAxis::X, beam, pitch });
        all[3].terms[0] = Some(Term {
            target: Target::Axis(LinearAxis::X),
            constant: Fine(0),
            effect: Effect::Curve { axis: LinearAxis::Z, curve },
        });
        for (number, machine) in all.iter().enumerate() {
            // The second guide is X over Z.
            for (z, outside) in [(0, false), (100, false), (101, true), (-1, true)] {
                let errors = machine.errors(&Heat::default(), &at([0, 0, z]));
                assert_eq!(errors.outside, outside, "machine {number} at {z}");
            }
        }
    }
}
