//! What the user writes, built once by the host into what the board runs.

use crate::{limits::Limits, sensor::SensorLaw, tool::Direction};

/// Everything that a tick needs to know about the machine; it never changes while the board runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Calibration {
    /// The displacement sensor.
    pub sensor: SensorLaw,
    /// From the spindle nose to the tool tip.
    pub tool_direction: Direction,
    /// How far and how fast an offset may go, and how long silence is tolerated.
    pub limits: Limits,
}
