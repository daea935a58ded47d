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
    calibration::{AxisModel, Calibration, STRAIGHTNESS_AXIS_PAIRS},
    cnc::LinearAxis,
    gradient::Gradient,
    index_set::IndexSet,
    machine_position::MachinePosition,
    reversal::backlash_error,
    term,
    thermal_state::MachineThermalState,
    units::{FineNanometres, Position},
    volumetric_error::CachedVolumetricErrors,
};

/// The errors of one axis at a place, part by part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisErrorComponents {
    /// Its expansion, K₀ + tanβ·(P − P₀).
    pub thermal: FineNanometres,
    /// Positioning: pitch table and backlash.
    pub positioning: FineNanometres,
    /// Straightness of the two other axes, squareness to them, and what [`volumetric_error`](crate::volumetric_error) adds.
    pub guides: FineNanometres,
    /// The terms that a diagnosis has added.
    pub terms: FineNanometres,
}

impl AxisErrorComponents {
    /// Returns the sum, each part held to ±`largest` first, which counts as 0 below 0; and whether a part was held.
    #[must_use]
    #[inline]
    pub fn clamped_sum(&self, largest: FineNanometres) -> (FineNanometres, bool) {
        let parts = [self.thermal, self.positioning, self.guides, self.terms];
        let largest = FineNanometres(largest.0.max(0));
        if parts.iter().all(|part| part.is_within(largest)) {
            (sum_components(parts), false)
        } else {
            (sum_clamped_components(parts, largest), true)
        }
    }
}

#[inline]
fn sum_components([thermal, positioning, guides, terms]: [FineNanometres; 4]) -> FineNanometres {
    thermal.saturating_add(positioning).saturating_add(guides).saturating_add(terms)
}

#[cold]
fn sum_clamped_components(parts: [FineNanometres; 4], largest: FineNanometres) -> FineNanometres {
    sum_components(parts.map(|part| part.clamped(largest).0))
}

/// The errors of X, Y and Z.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisErrors {
    /// Of X, Y and Z, part by part; each in 1/256 nm, actual minus commanded.
    pub axes: [AxisErrorComponents; 3],
    /// A position lies outside a table, whose end value is held.
    pub outside: bool,
}

/// The errors of X, Y and Z, each the sum of its parts.
#[derive(Clone, Copy, Debug)]
pub struct ErrorSums {
    /// In 1/256 nm, actual minus commanded.
    pub sums: [FineNanometres; 3],
    /// A part was clamped to its limit.
    pub clamped: bool,
    /// A position lies outside a table, whose end value is held.
    pub outside: bool,
}

impl AxisErrors {
    /// Returns the sums, each part clamped to ±`largest` of its axis first.
    #[must_use]
    pub fn clamped_sums(&self, largest: [FineNanometres; 3]) -> ErrorSums {
        let mut all =
            ErrorSums { sums: [FineNanometres::ZERO; 3], clamped: false, outside: self.outside };
        for ((sum, error), largest) in all.sums.iter_mut().zip(&self.axes).zip(largest) {
            let (clamped_sum, clamped) = error.clamped_sum(largest);
            *sum = clamped_sum;
            all.clamped |= clamped;
        }
        all
    }
}

/// The errors at a place, cached from message to message: what an axis that moves or a thermometer
/// does not change is not computed again. [`Self::sum_guideway_errors`] makes [`Self::errors`] of the parts.
///
/// The parts that depend on one axis cost 497 instructions (median) on the gantry of `data/`, with two or three
/// curves and tables (`cargo measure`).
#[derive(Clone, Debug, Default)]
pub struct CachedErrors {
    errors: AxisErrors,
    /// The tables that a position lies outside of: those of the positioning from [`FIRST_POSITIONING_INDEX`] on, of
    /// the guides from [`FIRST_GUIDEWAY_INDEX`] on, of the angles from [`FIRST_ANGLE_INDEX`] on, and [`TERMS_INDEX`].
    outside: IndexSet,
    /// Straightness and squareness, in the order of [`STRAIGHTNESS_AXIS_PAIRS`].
    guides: [FineNanometres; 6],
    volume: CachedVolumetricErrors,
}

const FIRST_POSITIONING_INDEX: usize = 0;
const FIRST_GUIDEWAY_INDEX: usize = 3;
const FIRST_ANGLE_INDEX: usize = 9;
const TERMS_INDEX: usize = 12;

/// Of X, Y and Z: the two places in [`STRAIGHTNESS_AXIS_PAIRS`] where the axis is the one that moves.
const STRAIGHTNESS_INDICES_BY_AXIS: [[usize; 2]; 3] = {
    let mut over = [[0; 2]; 3];
    let (mut axis, mut pair) = (0, 0);
    while axis < over.len() {
        let mut found = 0;
        while pair < STRAIGHTNESS_AXIS_PAIRS.len() {
            if STRAIGHTNESS_AXIS_PAIRS[pair].1 as usize == axis {
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
    pub fn compute_axis_errors(
        &self,
        heat: &MachineThermalState,
        place: &MachinePosition,
    ) -> AxisErrors {
        *CachedErrors::from_position(self, heat, place).errors()
    }
}

impl CachedErrors {
    /// Returns the errors at a place, added up.
    #[must_use]
    pub fn from_position(
        calibration: &Calibration<'_>,
        heat: &MachineThermalState,
        place: &MachinePosition,
    ) -> Self {
        let mut cached = Self::default();
        cached.update_rotary_angles(calibration, place);
        let mut all = IndexSet::default();
        for axis in LinearAxis::ALL {
            all.insert(axis as usize);
        }
        cached.update_axis_positions(calibration, heat, place, all);
        cached.sum_guideway_errors(calibration, place);
        cached
    }

    /// Returns the errors as they were last added up.
    #[must_use]
    pub fn errors(&self) -> &AxisErrors {
        &self.errors
    }

    /// An axis has moved to where it stands in `place`, or has turned round.
    // A part of its caller: a call costs 20 instructions, three times a millisecond.
    #[inline(always)]
    pub fn update_axis_position(
        &mut self,
        calibration: &Calibration<'_>,
        heat: &MachineThermalState,
        place: &MachinePosition,
        moved: LinearAxis,
    ) {
        for (name, axis) in LinearAxis::ALL.into_iter().zip(&calibration.axes) {
            // A beam's error changes where it is crossed, too.
            if name == moved || axis.dual.is_some_and(|dual| dual.across == moved) {
                self.update_positioning_error(axis, name, place);
            }
        }
        self.update_axis_thermal_error(calibration, heat, place, moved);
        self.update_guideway_errors(calibration, place, moved);
        self.update_terms(calibration, heat, place);
    }

    /// Updates the errors of all axes in `moved`, by their numbers. Each part is computed once, however many axes it depends on.
    pub fn update_axis_positions(
        &mut self,
        calibration: &Calibration<'_>,
        heat: &MachineThermalState,
        place: &MachinePosition,
        moved: IndexSet,
    ) {
        for (name, axis) in LinearAxis::ALL.into_iter().zip(&calibration.axes) {
            let has_moved = moved.contains(name as usize);
            if has_moved || axis.dual.is_some_and(|dual| moved.contains(dual.across as usize)) {
                self.update_positioning_error(axis, name, place);
            }
            if has_moved {
                self.update_axis_thermal_error(calibration, heat, place, name);
                self.update_guideway_errors(calibration, place, name);
            }
        }
        self.update_terms(calibration, heat, place);
    }

    /// Updates pitch and backlash of an axis.
    #[inline(always)]
    fn update_positioning_error(
        &mut self,
        axis: &AxisModel<'_>,
        name: LinearAxis,
        place: &MachinePosition,
    ) {
        let (error, outside) = positioning_error(axis, name, place);
        let number = name as usize;
        if let Some(of_axis) = self.errors.axes.get_mut(number) {
            of_axis.positioning = error;
        }
        self.outside.set(FIRST_POSITIONING_INDEX.wrapping_add(number), outside);
    }

    /// Updates straightness, squareness and angles over the travel of an axis.
    #[inline(always)]
    fn update_guideway_errors(
        &mut self,
        calibration: &Calibration<'_>,
        place: &MachinePosition,
        moved: LinearAxis,
    ) {
        let position = place.axis_position(moved);
        for &number in STRAIGHTNESS_INDICES_BY_AXIS.get(moved as usize).into_iter().flatten() {
            if let (Some(guide), Some(curve), Some(gradient)) = (
                self.guides.get_mut(number),
                calibration.straightness.get(number),
                calibration.squareness.get(number),
            ) {
                let (straightness, outside) = curve.evaluate(position);
                // Most machines are square, or not measured.
                *guide = match *gradient {
                    Gradient::ZERO => straightness,
                    gradient => straightness
                        .saturating_add(gradient.error_over_travel(Position(0), position)),
                };
                self.outside.set(FIRST_GUIDEWAY_INDEX.wrapping_add(number), outside);
            }
        }
        if let Some(volume) = &calibration.volume {
            let outside = self.volume.update_axis_position(volume, position, moved);
            self.outside.set(FIRST_ANGLE_INDEX.wrapping_add(moved as usize), outside);
        }
    }

    /// The rotary axes have turned to where they stand in `place`.
    pub fn update_rotary_angles(&mut self, calibration: &Calibration<'_>, place: &MachinePosition) {
        if let Some(volume) = &calibration.volume {
            self.volume.update_rotary_angles(volume, place);
        }
    }

    /// Adds the parts up after axes have moved, rotary axes turned or terms changed.
    pub fn sum_guideway_errors(&mut self, calibration: &Calibration<'_>, place: &MachinePosition) {
        // Two guides an axis, in the order of `STRAIGHTNESS_AXIS_PAIRS`.
        for (error, [first, second]) in
            self.errors.axes.iter_mut().zip(self.guides.as_chunks::<2>().0)
        {
            error.guides = first.saturating_add(*second);
        }
        if let Some(volume) = &calibration.volume {
            let of_volume = self.volume.compute_errors(volume, place);
            for (error, of_volume) in self.errors.axes.iter_mut().zip(of_volume) {
                error.guides = error.guides.saturating_add(of_volume);
            }
        }
        self.errors.outside = self.outside != IndexSet::default();
    }

    /// An axis has moved, or a thermometer that a term follows has been read.
    pub fn update_terms(
        &mut self,
        calibration: &Calibration<'_>,
        heat: &MachineThermalState,
        place: &MachinePosition,
    ) {
        // Most machines have none.
        if calibration.terms[0].is_some() {
            let (terms, outside) =
                term::compute_axis_errors(&calibration.terms, heat.terms(), place);
            for (error, term) in self.errors.axes.iter_mut().zip(terms) {
                error.terms = term;
            }
            self.outside.set(TERMS_INDEX, outside);
        }
    }

    /// An axis has become warmer or colder.
    pub fn update_axis_thermal_error(
        &mut self,
        calibration: &Calibration<'_>,
        heat: &MachineThermalState,
        place: &MachinePosition,
        warmed: LinearAxis,
    ) {
        let number = warmed as usize;
        if let (Some(error), Some(axis)) =
            (self.errors.axes.get_mut(number), calibration.axes.get(number))
            && let Some(thermal) = &axis.thermal
        {
            let (constant, gradient) = heat.axis_expansion(number);
            let plain = constant.saturating_add(
                gradient.error_over_travel(thermal.origin, place.axis_position(warmed)),
            );
            error.thermal = heat.learned.apply_to_expansion(number, plain);
        }
    }
}

/// Pitch and backlash of one axis; of a gantry, both drives across the beam.
fn positioning_error(
    axis: &AxisModel<'_>,
    name: LinearAxis,
    place: &MachinePosition,
) -> (FineNanometres, bool) {
    let position = place.axis_position(name);
    let reversal = place.reversal(name);
    let (mut error, mut outside) = (FineNanometres::ZERO, false);
    if let Some(pitch) = &axis.pitch {
        (error, outside) = pitch.error_at(position, reversal);
    }
    if let Some(dual) = &axis.dual {
        let (second, beyond) = dual.pitch.error_at(position, reversal);
        error = dual.beam.interpolate(error, second, place.axis_position(dual.across));
        outside |= beyond;
    }
    if axis.backlash != FineNanometres::ZERO {
        error = error.saturating_add(backlash_error(axis.backlash, reversal));
    }
    (error, outside)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        calibration::DualDrive,
        curve::{Curve, CurveSegment},
        pitch_table::{GantryBeam, PitchErrorTable},
        reversal::Interval,
        term::{Effect, Target, Term},
    };

    #[test]
    fn each_part_is_held_to_its_limit_and_any_that_is_held_is_reported() {
        for bits in 0..16_u8 {
            let part = |bit: u8| FineNanometres(if bits & bit == 0 { 10 } else { -300 });
            let error = AxisErrorComponents {
                thermal: part(1),
                positioning: part(2),
                guides: part(4),
                terms: part(8),
            };
            let held = i32::try_from(bits.count_ones()).expect("4 at the most");
            let sum = FineNanometres(10 * (4 - held) - 100 * held);
            assert_eq!(error.clamped_sum(FineNanometres(100)), (sum, held > 0), "{error:?}");
        }
    }

    /// A gantry: X on two drives along Y, Y with backlash, a bent and not square guide, a term on Z.
    fn gantry<'a>(calibration: &mut Calibration<'a>, [first, second]: [&'a [[u8; 4]]; 2]) {
        let pitch = |forward| PitchErrorTable {
            start: Position(0),
            step: Interval::new(100),
            forward,
            reverse: None,
        };
        calibration.axes[0].pitch = Some(pitch(first));
        calibration.axes[0].dual = Some(DualDrive {
            across: LinearAxis::Y,
            beam: GantryBeam::new(Position(0), Position(1_000)),
            pitch: pitch(second),
        });
        calibration.axes[1].backlash = FineNanometres(-500);
    }

    fn at(positions: [i32; 3]) -> MachinePosition {
        MachinePosition { position: positions.map(Position), ..MachinePosition::default() }
    }

    #[test]
    fn a_gantry_errs_by_both_drives_where_it_is_crossed_and_another_axis_by_its_backlash() {
        let [first, second] =
            [[100, 300], [1_100, 1_700]].map(|range: [i32; 2]| range.map(i32::to_le_bytes));
        let mut calibration: Calibration<'_> = crate::testing::minimal_calibration();
        gantry(&mut calibration, [&first, &second]);
        let heat = MachineThermalState::default();
        let mut place = at([0, 0, 0]);
        let mut cached = CachedErrors::from_position(&calibration, &heat, &place);
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
            cached.update_axis_position(&calibration, &heat, &place, moved);
            cached.sum_guideway_errors(&calibration, &place);
            let errors = cached.errors();
            assert!((errors.axes[0].positioning.0 - error).abs() <= 1, "{positions:?}: {errors:?}");
            assert_eq!((errors.outside, errors.axes[1].positioning), (outside, FineNanometres(0)));
            assert_eq!(*errors, calibration.compute_axis_errors(&heat, &place));
        }
        // Y turns round.
        let config = calibration.axes[1].travel;
        place.travel[1].update(&config, place.position[1], -1);
        cached.update_axis_position(&calibration, &heat, &place, y);
        assert_eq!(cached.errors().axes[1].positioning, FineNanometres(-500));
    }

    #[test]
    fn each_table_that_a_position_is_outside_of_is_reported_alone() {
        let point = [256_i32.to_le_bytes(); 2];
        let segments = [CurveSegment::new(Position(100), 16, [256, 0, 0, 0]).to_bytes()];
        let curve = Curve::new(Position(0), &segments, &[[0, 0]], 16);
        let pitch = PitchErrorTable {
            start: Position(0),
            step: Interval::new(100),
            forward: &point,
            reverse: None,
        };
        let mut all: [Calibration<'_>; 4] = [crate::testing::minimal_calibration(); 4];
        all[0].axes[2].pitch = Some(pitch);
        all[1].straightness[1] = curve;
        let beam = GantryBeam::new(Position(0), Position(1_000));
        all[2].axes[2].dual = Some(DualDrive { across: LinearAxis::X, beam, pitch });
        all[3].terms[0] = Some(Term {
            target: Target::Axis(LinearAxis::X),
            constant: FineNanometres(0),
            effect: Effect::Curve { axis: LinearAxis::Z, curve },
        });
        for (number, machine) in all.iter().enumerate() {
            // The second guide is X over Z.
            for (z, outside) in [(0, false), (100, false), (101, true), (-1, true)] {
                let errors =
                    machine.compute_axis_errors(&MachineThermalState::default(), &at([0, 0, z]));
                assert_eq!(errors.outside, outside, "machine {number} at {z}");
            }
        }
    }
}
