//! Where the machine stands.

use crate::{
    cnc::LinearAxis,
    reversal::{Fraction, ReversalTracker},
    units::{MicroDegrees, Position},
};

/// Where the machine stands, and from which side it came there. The default is 0 on all axes, with
/// no direction seen.
#[derive(Clone, Debug, Default)]
pub struct MachinePosition {
    /// The commanded positions of X, Y and Z, without the external offset.
    pub position: [Position; 3],
    /// The direction of approach of X, Y and Z.
    pub travel: [ReversalTracker; 3],
    /// The angles of the rotary axes, in the order of the CNC's.
    pub angles: [MicroDegrees; 2],
}

impl MachinePosition {
    /// Returns the position of an axis.
    #[must_use]
    #[inline]
    pub fn axis_position(&self, axis: LinearAxis) -> Position {
        self.position.get(axis as usize).copied().unwrap_or_default()
    }

    /// β of an axis: 0 approached in the positive direction or unknown, 1 in the negative.
    #[must_use]
    #[inline]
    pub fn reversal(&self, axis: LinearAxis) -> Fraction {
        self.travel.get(axis as usize).map_or(Fraction::ZERO, ReversalTracker::reversal)
    }
}
