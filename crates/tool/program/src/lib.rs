//! Programs that measure: what a control is to do so that a run file can be filled in.
//!
//! ```text
//! machine file (travel) ─► kind ─► Plan (moves, dwells, readings) ─┬─► the text of a control
//!                                                                  └─► the run file to be filled in
//! ```
//!
//! The run file's rows are found by walking through the plan's own moves, so that position,
//! direction and feed of a reading cannot differ from the control's program.
//!
//! | module | does |
//! |---|---|
//! | [`plan`] | moves, dwells and readings, and the walk through them |
//! | [`arc`] | circles |
//! | [`probe`] | the steps of a touch probe |
//! | `travel` | where an axis may move, and from which end |
//! | `first_stop` | what the operator reads before anything moves |
//! | `refused` | what does not fit |
//! | [`options`] | feeds, repeats, places |
//! | `kind` | one page for each kind of measurement |
//! | [`control`] | the text of LinuxCNC, FANUC, Siemens, HEIDENHAIN |
//! | [`template`] | the run file to be filled in |
#![forbid(unsafe_code)]

pub mod arc;
pub mod control;
mod first_stop;
mod measurement_kind;
pub mod options;
pub mod plan;
pub mod probe;
mod program_error;
pub mod template;
mod travel;

use trueup_machine::Machine;

pub use control::Control;
pub use measurement_kind::spindle_speed_run::{SpeedSegment, plan_speed_run};
pub use measurement_kind::target_run::{TargetRun, plan_target_run};
pub use options::{MeasurementOptions, MeasuringInstrument};
pub use plan::MeasurementPlan;
pub use program_error::ProgramError;

/// The kinds of measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeasurementKind {
    /// The lost motion of an axis on a reversal, at three places.
    Backlash,
    /// Position errors there and back.
    Pitch,
    /// How an axis errs across its way.
    Straightness,
    /// The growth of the spindle from cold.
    Warmup,
    /// The growth of an axis that is run warm.
    AxisHeat,
    /// Two axes at once: what all corrections together leave.
    Diagonal,
    /// The four body diagonals, one axis at a time.
    StepDiagonal,
    /// A circle in both directions, in each plane.
    Circle,
    /// A square, by a touch probe.
    Square,
    /// A sphere, by a touch probe.
    Sphere,
    /// A ball plate, by a touch probe.
    Plate,
}

/// Returns the plans of `kind` for this machine, one for each axis, plane or spindle; and notes of what has none.
///
/// # Errors
/// The travel is not known, or what is requested does not fit in it.
pub fn create_plans(
    kind: MeasurementKind,
    machine: &Machine,
    options: &MeasurementOptions,
) -> Result<(Vec<MeasurementPlan>, Vec<String>), ProgramError> {
    options.check()?;
    match kind {
        MeasurementKind::Backlash => measurement_kind::backlash::create_plans(machine, options),
        MeasurementKind::Pitch => measurement_kind::pitch::create_plans(machine, options),
        MeasurementKind::Straightness => {
            measurement_kind::straightness::create_plans(machine, options)
        }
        MeasurementKind::Warmup => measurement_kind::warmup::create_plans(machine, options),
        MeasurementKind::AxisHeat => measurement_kind::axis_heat::create_plans(machine, options),
        MeasurementKind::Diagonal => measurement_kind::diagonal::create_plans(machine, options),
        MeasurementKind::StepDiagonal => {
            measurement_kind::step_diagonal::create_plans(machine, options)
        }
        MeasurementKind::Circle => measurement_kind::circle::create_plans(machine, options),
        MeasurementKind::Square => measurement_kind::square::create_plans(machine, options),
        MeasurementKind::Sphere => measurement_kind::sphere::create_plans(machine, options),
        MeasurementKind::Plate => measurement_kind::plate::create_plans(machine, options),
    }
}
