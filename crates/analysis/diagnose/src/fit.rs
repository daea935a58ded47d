//! All terms at once to all rows: least squares by Gauss, Newton, Levenberg and Marquardt.
//!
//! Plain least squares on purpose, also where the noise has a memory: weights that follow the noise
//! trust the quick part of a misfit and predict worse where the model is not quite right (measured on
//! `spindle_sjtu`: a path that halves the error of the hold-out looks worthless to them). The memory
//! is in the intervals instead: the sandwich (XᵀX)⁻¹·Xᵀ·V·X·(XᵀX)⁻¹ with the noise's covariance V.

//!
//! | module | does |
//! |---|---|
//! | `problem` | what is fitted to |
//! | `cache`, `memo` | columns that were worked out before; what was found for whole models |
//! | `growth` | the machine's own law in groups |
//! | `jacobian` | the change of the prediction with each value |
//! | `undetermined` | values that the data do not determine |
//! | `solve` | the fit |
//! | `spread` | how far the values may be off |

mod cache;
mod growth;
mod halves;
mod jacobian;
mod memo;
mod problem;
mod solve;
mod spread;
mod undetermined;

pub(crate) use halves::differs_between_halves;
pub(crate) use jacobian::{jacobian, of_part};
pub(crate) use problem::Problem;
pub(crate) use solve::{Fitted, fit};
pub(crate) use spread::{Spread, spread};

/// The level of what is said: of intervals and regions, of a floor, and the power of what would have been found (fixed
/// form of the answer).
pub(crate) const LEVEL: f64 = 0.95;
