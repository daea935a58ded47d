//! Clamp and slew limit: how far and how fast an offset may go.

use crate::units::Nanometres;

/// How far and how fast an offset may go, and how long silence is tolerated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// The largest offset on X, Y and Z, either way; at least 0.
    pub max: [Nanometres; 3],
    /// The fastest change of an offset in nanometres a second, on each axis.
    pub slew_nm_per_s: u32,
    /// Without a valid `Control` for so long the CNC counts as lost.
    pub link_timeout_ms: u32,
    /// How long the last offset is held before it is taken back to 0.
    pub hold_ms: u32,
}
