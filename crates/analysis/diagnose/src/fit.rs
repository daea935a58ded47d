//! All terms at once to all rows: least squares by Gauss, Newton, Levenberg and Marquardt.
//!
//! Plain least squares on purpose, also where the noise has a memory: weights that follow the noise
//! trust the quick part of a misfit and predict worse where the model is not quite right (measured on
//! `spindle_sjtu`: a path that halves the error of the hold-out looks worthless to them). The memory
//! is in the intervals instead: the sandwich (XᵀX)⁻¹·Xᵀ·V·X·(XᵀX)⁻¹ with the noise's covariance V.

//!
//! | module | does |
//! |---|---|
//! | `problem` | the data of the fit |
//! | `bounds` | how far each nonlinear value may go |
//! | `cache`, `memo` | columns that were worked out before; what was found for whole models |
//! | `growth` | the machine's own law in groups |
//! | `jacobian` | the change of the prediction with each value |
//! | `undetermined` | values that the data do not determine |
//! | `solve` | the fit |
//! | `spread` | how far the values may be off |

mod column_cache;
mod covariance;
mod growth_cache;
mod jacobian;
mod levenberg_marquardt;
mod memo_table;
mod parameter_bounds;
mod problem;
mod split_half_difference;
mod undetermined_parameters;

pub(crate) use covariance::{ParameterCovariance, estimate_parameter_covariance};
pub(crate) use jacobian::{jacobian, part_derivatives};
pub(crate) use levenberg_marquardt::{FittedModel, fit};
pub(crate) use problem::{FitProblem, settling_time_s};
pub(crate) use split_half_difference::find_largest_half_difference;

/// The level of what is reported: of intervals and regions, of a floor, and the power of what would have been found (fixed
/// form of the answer).
pub(crate) const CONFIDENCE_LEVEL: f64 = 0.95;
/// What differs by no more than this share is equal: what two models leave on held-out blocks or a hold-out (RMS; the
/// fixed form of the answer, `docs/reference.md`, Diagnosis), what a term does and what imitates it, and a value and the
/// end of its search.
pub(crate) const EQUIVALENCE_TOLERANCE: f64 = 0.05;
