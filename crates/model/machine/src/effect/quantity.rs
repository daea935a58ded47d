//! The quantities that are measured, predicted or corrected.

use crate::sections::LinearAxis;

/// The quantity that a term, a prediction or a measurement is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Quantity {
    /// How far the tool has grown out of the spindle.
    Elongation,
    /// The error of the tool tip on X.
    Dx,
    /// On Y.
    Dy,
    /// On Z.
    Dz,
}

impl Quantity {
    /// All of them, in the order of [`ErrorValues::to_array`](crate::model::ErrorValues::to_array).
    pub const ALL: [Self; 4] = [Self::Elongation, Self::Dx, Self::Dy, Self::Dz];

    /// Its name: `elongation`, `dx`, `dy`, `dz`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Elongation => "elongation",
            Self::Dx => "dx",
            Self::Dy => "dy",
            Self::Dz => "dz",
        }
    }

    /// Returns the axis whose error it is; `None` for the elongation.
    #[must_use]
    pub fn axis(self) -> Option<LinearAxis> {
        match self {
            Self::Elongation => None,
            Self::Dx => Some(LinearAxis::X),
            Self::Dy => Some(LinearAxis::Y),
            Self::Dz => Some(LinearAxis::Z),
        }
    }

    /// Returns the error of this axis.
    #[must_use]
    pub fn from_axis(axis: LinearAxis) -> Self {
        [Self::Dx, Self::Dy, Self::Dz][axis.index()]
    }
}
