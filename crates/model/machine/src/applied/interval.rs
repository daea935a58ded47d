//! A factor with its interval, and what it says of a CNC.

/// A factor within this of 1 is no fault of the CNC: the scale of a gauge, the slew limit and the days of two runs
/// do as much.
pub(super) const MARGIN: f64 = 0.1;
/// An interval of the factor that lies within these excludes the faults that there are: 0, 0.5 and 2.
const RIGHT: [f64; 2] = [0.5, 2.0];

/// A factor with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Factor {
    /// The movement of the machine for 1 µm of offset, in µm.
    pub value: f64,
    /// Its 95 % interval.
    pub ci95: [f64; 2],
}

impl Factor {
    /// Returns whether the interval is clear of 1: the CNC applies the offset otherwise than once.
    #[must_use]
    pub fn is_wrong(&self) -> bool {
        self.ci95[1] < 1.0 - MARGIN || self.ci95[0] > 1.0 + MARGIN
    }

    /// Returns whether the interval is narrow enough to exclude 0, 0.5 and 2.
    #[must_use]
    pub fn is_right(&self) -> bool {
        !self.is_wrong() && self.ci95[0] > RIGHT[0] && self.ci95[1] < RIGHT[1]
    }
}
