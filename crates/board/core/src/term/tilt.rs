//! An angle of one axis times a lever along another: what an axis that tilts as it goes does to a tool
//! that is not on its guide.
//!
//! error = θ·(L − L₀). θ is stored as what it does at a lever of [`REFERENCE_LEVER`], in 1/256 nm, so that the
//! product is one multiplication and one shift. Measured worst error against `f64` over ±21 m both
//! ways: that of θ there, times L/1.34 m, and half a 1/256 nm.

use crate::{
    cnc::LinearAxis,
    fixed_point::rounding_shift_right,
    machine_position::MachinePosition,
    units::{FineNanometres, Position},
};

/// The lever at which an angle is stored: 2²⁷ position units, 1342.177 28 mm.
pub const REFERENCE_LEVER: Position = Position(1 << REFERENCE_LEVER_BITS);
const REFERENCE_LEVER_BITS: u32 = 27;

/// An axis that tilts as it goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tilt<A> {
    /// The axis that tilts.
    pub along: LinearAxis,
    /// The axis of L.
    pub lever: LinearAxis,
    /// L₀: where the tilt has no effect.
    pub origin: Position,
    /// θ over the position of the axis that tilts, as an error at a lever of [`REFERENCE_LEVER`].
    pub angle: A,
}

impl<A> Tilt<A> {
    /// Returns the error at a lever of [`REFERENCE_LEVER`] taken to the lever of `place`; saturates at ±8.388 mm.
    pub(super) fn scale_to_lever(
        &self,
        error: FineNanometres,
        place: &MachinePosition,
    ) -> FineNanometres {
        let lever =
            i64::from(place.axis_position(self.lever).0).wrapping_sub(i64::from(self.origin.0));
        // At most 2³¹·(2³² − 1) + 2²⁶, below 2⁶³: neither step can wrap.
        FineNanometres::saturating_from(rounding_shift_right(
            i64::from(error.0).wrapping_mul(lever),
            REFERENCE_LEVER_BITS,
        ))
    }
}
