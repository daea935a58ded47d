//! The tool direction V: from the spindle nose to the tool tip, in machine coordinates.

/// A unit vector in Q30: 2³⁰ is 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Direction(pub [i32; 3]);

impl Direction {
    /// 1 in this format.
    pub const ONE: i32 = 1 << Self::FRACTION_BITS;
    /// Binary places of a component.
    pub const FRACTION_BITS: u32 = 30;
    /// Straight down, the tool of a vertical spindle: (0, 0, −1).
    pub const DOWN: Self = Self([0, 0, -Self::ONE]);
}
