//! Angular errors of the linear axes and location errors of the rotary axes, carried to the tool tip.
//!
//! ```text
//! workpiece ◄─ C′ ◄─ A′ ◄─ X′ ◄─ bed ─► Y ─► Z ─► B ─► tool        (any order, each axis once)
//!
//! e = Σ ε_i × L_i  +  Σ (δ_r + ε_r × L_r)       − for an axis that moves the workpiece
//! ```
//!
//! ε is an angle, right-handed about +X, +Y, +Z, of the part that the axis moves; δ the shift of the line
//! of a rotary axis. L is the lever, from the point where the errors of the axis are stated to the tool
//! tip, as seen from that part:
//!
//! | axis | lever |
//! |---|---|
//! | linear, moves the tool | positions of the axes between it and the tool, and the tool |
//! | linear, moves the workpiece | positions of all axes but those between it and the workpiece, and the tool |
//! | rotary, moves the tool | from its point to the tip, turned by it and the axes after it |
//! | rotary, moves the workpiece | from its point to the tip, all positions in it, turned back by the axes before it |
//!
//! An axis ′ turns the workpiece by −θ where θ is commanded (ISO 841). All is first order: the product of two
//! errors is neglected, 1 nm for 30 µrad each at 1 m.
//!
//! An angle is stored as the error that it makes at a lever of [`REFERENCE_LEVER`], in 1/256 nm: ±6.25 mrad. Levers are 10 nm, and
//! saturate at ±21 m. Each product is rounded once to 1/256 nm. Measured worst error against `f64` over drawn machines and
//! poses: 0.1 nm (`fixed_point/volume.rs` of `trueup-machine`).

use crate::{
    cnc::LinearAxis,
    curve::Curve,
    fixed_point::{rounding_shift_right, saturate_to_i32, widening_mul},
    gradient::Gradient,
    kinematics::{self, RotaryAxis, round_from_q30},
    machine_position::MachinePosition,
    term::REFERENCE_LEVER,
    trigonometry::sin_cos,
    units::{FineNanometres, Position},
};

/// The largest component of a tool or of a point of a rotary axis, in 10 nm: 5.37 m. A vector of such
/// components turns without leaving an `i32`.
pub const MAX_LEVER_ARM: i32 = 1 << 29;

const REFERENCE_LEVER_BITS: u32 = REFERENCE_LEVER.0.trailing_zeros();

/// A length or an error along X, Y and Z.
type Vector = [i32; 3];

/// The order of the linear axes between the workpiece and the tool, and where the bed is among them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KinematicChain {
    /// The place of X, Y and Z, counted from the workpiece.
    places: [u8; 3],
    on_workpiece: u8,
    /// Of X, Y and Z: a bit for each axis whose position is a part of its lever, and [`MOVES_WORKPIECE_FLAG`].
    levers: [u8; 3],
}

const MOVES_WORKPIECE_FLAG: u8 = 1 << 3;

impl Default for KinematicChain {
    /// X, Y and Z move the tool, in this order.
    fn default() -> Self {
        Self::from_chain_indices([0, 1, 2], 0)
    }
}

impl KinematicChain {
    /// Returns the chain of these axes, from the workpiece to the tool, of which the first
    /// `on_workpiece` move the workpiece; `None` unless each axis stands there once.
    #[must_use]
    pub fn new(order: [LinearAxis; 3], on_workpiece: u8) -> Option<Self> {
        const UNASSIGNED_INDEX: u8 = 3;
        let mut places = [UNASSIGNED_INDEX; 3];
        for (place, axis) in (0..).zip(order) {
            *places.get_mut(axis as usize)? = place;
        }
        (!places.contains(&UNASSIGNED_INDEX) && on_workpiece <= UNASSIGNED_INDEX)
            .then(|| Self::from_chain_indices(places, on_workpiece))
    }

    fn from_chain_indices(places: [u8; 3], on_workpiece: u8) -> Self {
        let levers = places.map(|own| {
            let moves_tool = own >= on_workpiece;
            // The part that moves the workpiece does not move with the tip: its own position counts.
            let first = own.saturating_add(u8::from(moves_tool));
            let bits = [1, 2, 4].into_iter().zip(places);
            let side = if moves_tool { 0 } else { MOVES_WORKPIECE_FLAG };
            bits.filter(|(_, place)| *place >= first).fold(side, |all, (bit, _)| all | bit)
        });
        Self { places, on_workpiece, levers }
    }

    /// Returns the axes from the workpiece to the tool.
    #[must_use]
    pub fn order(&self) -> [LinearAxis; 3] {
        let mut order = LinearAxis::ALL;
        for (axis, place) in LinearAxis::ALL.into_iter().zip(self.places) {
            if let Some(slot) = order.get_mut(usize::from(place)) {
                *slot = axis;
            }
        }
        order
    }

    /// Returns how many of the axes move the workpiece.
    #[must_use]
    pub fn workpiece_axis_count(&self) -> u8 {
        self.on_workpiece
    }

    /// Returns whether an axis moves the workpiece.
    #[must_use]
    #[inline]
    pub fn moves_workpiece(&self, axis: LinearAxis) -> bool {
        self.chain_index(axis) < self.on_workpiece
    }

    /// Returns whether the position of `other` is a part of the lever of `axis`.
    #[must_use]
    #[inline]
    pub fn is_in_lever(&self, axis: LinearAxis, other: LinearAxis) -> bool {
        self.levers.get(axis as usize).is_some_and(|bits| bits >> (other as u8) & 1 != 0)
    }

    #[inline]
    fn chain_index(&self, axis: LinearAxis) -> u8 {
        self.places.get(axis as usize).copied().unwrap_or_default()
    }
}

/// An angle over the position of the axis that turns: a slope from machine zero on, and a curve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AngularErrorCurve<'a> {
    /// Error at [`REFERENCE_LEVER`] by position.
    pub slope: Gradient,
    /// Error at [`REFERENCE_LEVER`] over the position.
    pub curve: Curve<'a>,
}

impl AngularErrorCurve<'_> {
    /// Returns whether it is 0 everywhere.
    #[must_use]
    pub fn is_zero(&self) -> bool {
        self.slope == Gradient::ZERO && self.curve.is_empty()
    }

    /// Returns the error at [`REFERENCE_LEVER`], and whether it is the held end of the curve.
    fn evaluate(&self, position: Position) -> (FineNanometres, bool) {
        let (on_curve, outside) = self.curve.evaluate(position);
        let sloped = match self.slope {
            Gradient::ZERO => FineNanometres::ZERO,
            slope => slope.error_over_travel(Position(0), position),
        };
        (on_curve.saturating_add(sloped), outside)
    }
}

/// The angular errors of one linear axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AngularErrors<'a> {
    /// Where the pitch and the straightness of the axis are stated: the angles do nothing there.
    pub point: [Position; 3],
    /// About X, Y and Z: of the X axis EAX, EBX and ECX.
    pub about: [AngularErrorCurve<'a>; 3],
}

/// A rotary axis, with the errors of where its line is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RotaryAxisLocation {
    /// The axis that it turns about: A, B or C.
    pub axis: RotaryAxis,
    /// Whether it turns the workpiece.
    pub moves_workpiece: bool,
    /// A point of its line with all angles at 0: of the tool's from the spindle nose, of the workpiece's in
    /// machine coordinates. No component beyond [`MAX_LEVER_ARM`].
    pub point: [Position; 3],
    /// How far the line is off along X, Y and Z.
    pub shift: [FineNanometres; 3],
    /// How far it is turned about X, Y and Z, as errors at [`REFERENCE_LEVER`].
    pub tilt: [FineNanometres; 3],
}

impl RotaryAxisLocation {
    /// Returns whether its line is where it should be.
    #[must_use]
    pub fn is_nominal(&self) -> bool {
        self.shift == [FineNanometres::ZERO; 3] && self.tilt == [FineNanometres::ZERO; 3]
    }

    fn location_error(&self, lever: Vector) -> Vector {
        add_vectors(self.shift.map(|shift| shift.0), cross(self.tilt, lever))
    }
}

/// The model of the whole volume: the chain of the axes, their angular and location errors, the tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VolumetricErrorModel<'a> {
    /// The linear axes.
    pub chain: KinematicChain,
    /// Of X, Y and Z.
    pub guides: [AngularErrors<'a>; 3],
    /// From the spindle nose to the tool tip with all angles at 0; no component beyond [`MAX_LEVER_ARM`].
    pub tool: [Position; 3],
    /// The rotary axes in the order of the CNC's angles: those of the tool from the frame to the tool, then
    /// those of the workpiece from the bed to the workpiece.
    pub rotary: [Option<RotaryAxisLocation>; 2],
}

impl VolumetricErrorModel<'_> {
    /// Returns whether the angles of the rotary axes change anything.
    #[must_use]
    pub fn depends_on_rotary_angles(&self) -> bool {
        let [first, second] = self.rotary;
        let turns_tool = first.is_some_and(|first| !first.moves_workpiece);
        let has_errors = self.rotary.iter().flatten().any(|location| !location.is_nominal())
            || self.guides.iter().flat_map(|guide| &guide.about).any(|angle| !angle.is_zero());
        // The first axis under the workpiece turns what is wrong with the second.
        let turns_table = !turns_tool
            && second.is_some_and(|second| second.moves_workpiece && !second.is_nominal());
        turns_tool && has_errors || turns_table
    }

    /// Returns whether the position of `axis` changes anything.
    #[must_use]
    pub fn depends_on_position(&self, axis: LinearAxis) -> bool {
        let of_guide = |guide: LinearAxis| {
            let Some(errors) = self.guides.get(guide as usize) else { return false };
            let is_lever = self.chain.is_in_lever(guide, axis);
            errors.about.iter().enumerate().any(|(about, angle)| {
                !angle.is_zero() && (guide == axis || is_lever && about != axis as usize)
            })
        };
        let of_table = |location: &RotaryAxisLocation| {
            let tilted = location.tilt.iter().filter(|tilt| **tilt != FineNanometres::ZERO).count();
            location.moves_workpiece && tilted > 0
        };
        LinearAxis::ALL.into_iter().any(of_guide) || self.rotary.iter().flatten().any(of_table)
    }

    /// Returns the tip from the spindle nose, and the errors of the axes that turn the tool.
    fn compute_tip_and_tool_error(&self, place: &MachinePosition) -> (Vector, Vector) {
        let (mut tip, mut error) = (to_vector(self.tool), [0; 3]);
        let ([first, second], [of_first, of_second]) = (&self.rotary, place.angles);
        // From the tool to the frame. A `zip` that is reversed could panic, for all that the compiler knows.
        for (rotary, angle) in [(second, of_second), (first, of_first)] {
            let Some(rotary) = rotary.as_ref().filter(|location| !location.moves_workpiece) else {
                continue;
            };
            let turn = sin_cos(angle);
            let lever =
                rotate_vector(rotary.axis, turn, subtract_vectors(tip, to_vector(rotary.point)));
            if !is_zero(error) {
                error = rotate_vector(rotary.axis, turn, error);
            }
            error = add_vectors(error, rotary.location_error(lever));
            tip = add_vectors(to_vector(rotary.point), lever);
        }
        (tip, error)
    }

    /// Returns what the axes that turn the workpiece do to it at the angles of `place`: its shift where the tip is
    /// at machine zero, and its tilt.
    ///
    /// Both axes together are δ₁ + ε₁ × (q − c₁) + R·(δ₂ + ε₂ × (R⁻¹·(q − c₁) + c₁ − c₂)), with R the turn of the first one
    /// and q the tip. As R·(a × b) is (R·a) × (R·b), the tilts add up to ε = ε₁ + R·ε₂, and q is multiplied once.
    fn compute_workpiece_error(&self, place: &MachinePosition) -> (Vector, [FineNanometres; 3]) {
        let mut of_workpiece =
            self.rotary.iter().flatten().filter(|location| location.moves_workpiece);
        let Some(first) = of_workpiece.next() else { return Default::default() };
        let (mut shift, mut tilt) = (first.shift.map(|shift| shift.0), first.tilt);
        if let Some(second) = of_workpiece.next().filter(|location| !location.is_nominal()) {
            let [angle, _] = place.angles;
            let (sine, cosine) = sin_cos(angle);
            let back = |vector| rotate_vector(first.axis, (sine.saturating_neg(), cosine), vector);
            let between = subtract_vectors(to_vector(first.point), to_vector(second.point));
            shift = add_vectors(shift, back(second.location_error(between)));
            let of_second = back(second.tilt.map(|tilt| tilt.0));
            tilt = add_vectors(tilt.map(|tilt| tilt.0), of_second).map(FineNanometres);
        }
        (subtract_vectors(shift, cross(tilt, to_vector(first.point))), tilt)
    }
}

/// The parts of the errors of a volume at a place, kept from message to message. They are multiplied by their levers
/// when they are requested, however many axes have moved since.
#[derive(Clone, Debug, Default)]
pub struct CachedVolumetricErrors {
    guides: [CachedAngularErrors; 3],
    tip: Vector,
    of_tool: Vector,
    /// Shift at machine zero, and tilt.
    of_table: (Vector, [FineNanometres; 3]),
}

#[derive(Clone, Copy, Debug, Default)]
struct CachedAngularErrors {
    /// About X, Y and Z.
    angles: [FineNanometres; 3],
    /// From its point to the tip, with all positions at 0.
    arm: Vector,
}

impl CachedVolumetricErrors {
    /// The rotary axes have turned to where they stand in `place`.
    pub fn update_rotary_angles(
        &mut self,
        volume: &VolumetricErrorModel<'_>,
        place: &MachinePosition,
    ) {
        (self.tip, self.of_tool) = volume.compute_tip_and_tool_error(place);
        self.of_table = volume.compute_workpiece_error(place);
        for (cached, guide) in self.guides.iter_mut().zip(&volume.guides) {
            cached.arm = subtract_vectors(self.tip, to_vector(guide.point));
        }
    }

    /// An axis has moved. Returns whether it stands outside a curve, whose end value is held.
    pub fn update_axis_position(
        &mut self,
        volume: &VolumetricErrorModel<'_>,
        position: Position,
        moved: LinearAxis,
    ) -> bool {
        let number = moved as usize;
        let (Some(guide), Some(cached)) = (volume.guides.get(number), self.guides.get_mut(number))
        else {
            return false;
        };
        let mut outside = false;
        for (angle, about) in cached.angles.iter_mut().zip(&guide.about) {
            let (at, is_held) = about.evaluate(position);
            *angle = at;
            outside |= is_held;
        }
        outside
    }

    /// Returns the errors along X, Y and Z.
    #[must_use]
    pub fn compute_errors(
        &self,
        volume: &VolumetricErrorModel<'_>,
        place: &MachinePosition,
    ) -> [FineNanometres; 3] {
        let mut errors = self.of_tool;
        let [at_x, at_y, at_z] = place.position;
        for (guide, levers) in self.guides.iter().zip(&volume.chain.levers) {
            let CachedAngularErrors { angles, arm: [x, y, z] } = *guide;
            if angles == [FineNanometres::ZERO; 3] {
                continue;
            }
            let travelled = |bit: u8, arm: i32, position: Position| {
                if levers & bit == 0 { arm } else { arm.saturating_add(position.0) }
            };
            let lever = [travelled(1, x, at_x), travelled(2, y, at_y), travelled(4, z, at_z)];
            let made = cross(angles, lever);
            let moves_tool = levers & MOVES_WORKPIECE_FLAG == 0;
            errors =
                if moves_tool { add_vectors(errors, made) } else { subtract_vectors(errors, made) };
        }
        let (shift, tilt) = self.of_table;
        errors = subtract_vectors(errors, shift);
        if tilt != [FineNanometres::ZERO; 3] {
            let tip = add_vectors(to_vector(place.position), self.tip);
            errors = subtract_vectors(errors, cross(tilt, tip));
        }
        errors.map(FineNanometres)
    }
}

/// Returns R·v, by sine and cosine of the angle; saturates.
fn rotate_vector(axis: RotaryAxis, turn: (i32, i32), vector: Vector) -> Vector {
    kinematics::rotate(axis, turn, vector, round_from_q30)
}

/// Returns ε × L, of angles as errors at [`REFERENCE_LEVER`]; saturates.
fn cross([a, b, c]: [FineNanometres; 3], [x, y, z]: Vector) -> Vector {
    let part = |first: FineNanometres, along: i32, second: FineNanometres, across: i32| {
        // Of two products the difference is at most 2⁶³ − 2³¹: neither this nor its rounding can wrap.
        let exact = widening_mul(first.0, along).wrapping_sub(widening_mul(second.0, across));
        saturate_to_i32(rounding_shift_right(exact, REFERENCE_LEVER_BITS))
    };
    [part(b, z, c, y), part(c, x, a, z), part(a, y, b, x)]
}

fn to_vector(positions: [Position; 3]) -> Vector {
    positions.map(|position| position.0)
}

fn add_vectors(a: Vector, b: Vector) -> Vector {
    let ([ax, ay, az], [bx, by, bz]) = (a, b);
    [ax.saturating_add(bx), ay.saturating_add(by), az.saturating_add(bz)]
}

/// Returns whether all components are 0. As arrays they are compared by a call.
const fn is_zero([x, y, z]: Vector) -> bool {
    x | y | z == 0
}

fn subtract_vectors(a: Vector, b: Vector) -> Vector {
    let ([ax, ay, az], [bx, by, bz]) = (a, b);
    [ax.saturating_sub(bx), ay.saturating_sub(by), az.saturating_sub(bz)]
}

#[cfg(test)]
mod tests;
