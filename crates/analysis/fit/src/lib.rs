//! From measured runs to the sections of a machine file.
//!
//! Each fit takes [runs without what a bridge applied](trueup_machine::applied_offsets::UncompensatedRun) and gives a [`FitReport`]: the constants with their
//! intervals, the residuals on the rows that were fitted and on rows that were held out, the rows
//! that were excluded and why, and the [`Edit`](trueup_machine::machine_file::writer::MachineFileEdit) that takes the constants into a machine file. A
//! run that no correction makes better is answered with [`FitVerdict::DoNotCompensate`] and the
//! figures that say so.
//!
//! | module | does |
//! |---|---|
//! | [`straightness`] | a B-spline with few coefficients; [next to other ways](straightness::method_table) |
//! | [`pitch`] | position errors of an axis and its backlash |
//! | `iso230_2` | the figures of ISO 230-2 |
//! | [`bspline`] | the basis, and least squares in it |
//! | [`elongation`] | fits `[spindle.sensor]` and `[spindle.temperature]` |
//! | [`warmup`] | fits `[spindle.warmup]` |
//! | [`thermal`] | fits `[axis.x.thermal]` |
//! | [`circle`] | radial deviations of a circle as causes, ISO 230-4 |
//! | [`volume`] | the 21 errors of three axes, and lines of rotary axes |
//! | [`straightness_report`] | a straightness run as a report and a section |
//! | [`partial_prediction`] | what the rest of the machine file says of a run, to be taken off |
//! | [`report`] | the shape that every fit's outcome has |
#![forbid(unsafe_code)]

pub mod bspline;
pub mod circle;
pub mod elongation;
mod iso230_2;
mod lagged_regression;
pub mod partial_prediction;
pub mod pitch;
mod pooled_rows;
pub mod report;
pub mod straightness;
pub mod straightness_report;
pub mod thermal;
pub mod volume;
pub mod warmup;

pub use report::{ExcludedRow, FitDetail, FitParameter, FitReport, FitVerdict, ResidualStatistics};
