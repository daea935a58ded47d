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
mod kind;
pub mod options;
pub mod plan;
pub mod probe;
mod refused;
pub mod template;
mod travel;

use trueup_machine::Machine;

pub use control::Control;
pub use kind::speeds::{Stretch, speeds};
pub use kind::targets::{Targets, targets};
pub use options::{Gauge, Options};
pub use plan::Plan;
pub use refused::Refused;

/// The kinds of measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
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
/// The travel is not known, or what is asked for does not fit in it.
pub fn plans(
    kind: Kind,
    machine: &Machine,
    options: &Options,
) -> Result<(Vec<Plan>, Vec<String>), Refused> {
    options.check()?;
    let (mut plans, notes) = match kind {
        Kind::Backlash => kind::backlash::plans(machine, options),
        Kind::Pitch => kind::pitch::plans(machine, options),
        Kind::Straightness => kind::straightness::plans(machine, options),
        Kind::Warmup => kind::warmup::plans(machine, options),
        Kind::AxisHeat => kind::axis_heat::plans(machine, options),
        Kind::Diagonal => kind::diagonal::plans(machine, options),
        Kind::StepDiagonal => kind::step_diagonal::plans(machine, options),
        Kind::Circle => kind::circle::plans(machine, options),
        Kind::Square => kind::square::plans(machine, options),
        Kind::Sphere => kind::sphere::plans(machine, options),
        Kind::Plate => kind::plate::plans(machine, options),
    }?;
    plans
        .iter_mut()
        .for_each(|plan| plan.is_lathe = machine.kind == trueup_machine::file::Kind::Lathe);
    Ok((plans, notes))
}
