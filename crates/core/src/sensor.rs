//! Spindle elongation from the displacement sensor (seed 000).
//!
//! ΔK = K₀ + (V − V₀)·tanβ, with V and V₀ as [`Reading`]s, so that one law serves any divider
//! and any sensor range. The slope is Q28 nanometres per reading unit: 1.6·10⁻⁸ of its value for
//! the paper's sensor, up to ±8 nm a unit (67 times that sensor).

use crate::units::{Nanometres, Reading};

/// tanβ in nanometres per reading unit, Q28: ±8 nm a unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Slope(pub i32);

impl Slope {
    /// Binary places of a slope.
    pub const FRACTION_BITS: u32 = 28;
}

/// The linear law of the sensor. Its output is positive when the tool grows out of the spindle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SensorLaw {
    /// K₀, the elongation at the zero reading.
    pub k0: Nanometres,
    /// V₀, the reading with the machine cold.
    pub zero: Reading,
    /// tanβ.
    pub slope: Slope,
}
