//! A factor with its interval, and what it says of a CNC.

/// A factor within this of 1 is no fault of the CNC: the scale of a gauge, the slew limit and the days of two runs
/// do as much.
pub(super) const UNIT_FACTOR_TOLERANCE: f64 = 0.1;
/// An interval of the factor that lies within these excludes the faults that there are: 0, 0.5 and 2.
const UNIT_FACTOR_BOUNDS: [f64; 2] = [0.5, 2.0];

/// A factor with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FactorEstimate {
    /// The movement of the machine for 1 µm of offset, in µm.
    pub value: f64,
    /// Its 95 % interval.
    pub ci95: [f64; 2],
}

impl FactorEstimate {
    /// Returns whether the interval is clear of 1: the CNC applies the offset otherwise than once.
    #[must_use]
    pub(crate) fn excludes_one(&self) -> bool {
        self.ci95[1] < 1.0 - UNIT_FACTOR_TOLERANCE || self.ci95[0] > 1.0 + UNIT_FACTOR_TOLERANCE
    }

    /// Returns whether the interval is narrow enough to exclude 0, 0.5 and 2.
    #[must_use]
    pub(crate) fn confirms_one(&self) -> bool {
        !self.excludes_one()
            && self.ci95[0] > UNIT_FACTOR_BOUNDS[0]
            && self.ci95[1] < UNIT_FACTOR_BOUNDS[1]
    }
}
