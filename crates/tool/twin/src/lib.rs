//! The virtual machine tool: `trueup simulate`, and the truth that the model and the diagnosis are tried on
//! (`trueup-campaigns` draws the cases).
//!
//! It shares no code with `trueup-machine`, `trueup-core`, `trueup-fit` or `trueup-diagnose`, not
//! even the writer of run files: that a diagnosis finds what was hidden here proves something only if
//! the two do not agree by construction.
//!
//! | module | does |
//! |---|---|
//! | [`heat_conduction`] | heat conduction along a rod, by finite volumes |
//! | [`spindle`] | bearings, motor, cooling; growth by heat, speed, holder and force |
//! | [`tool`] | what each tool adds by its speed |
//! | [`ambient`] | the air over the day |
//! | [`axes`] | screws, scales, pitch, backlash, straightness, angles |
//! | [`rigid_bodies`] | what each axis moves, turned and shifted a little, to the tip |
//! | [`cubic_spline`] | smooth curves through points |
//! | [`sensors`] | the displacement sensor and the thermometers, with their faults |
//! | [`instrument`] | the reference instrument, with its own |
//! | `rotary_head` | rotary axes that turn the tool |
//! | [`machine`] | all of it as one machine, stepped by its drives |
//! | [`path`] | speeds, loads, ways, position runs |
//! | [`scenario`] | all of these in one file |
//! | `simulation` | a scenario that is run: `trueup simulate` |
//! | [`noise`] | streams of chance by seed and purpose, correlated noise |
//! | [`run_table`] | columns of numbers, and the run file that they are written to |
#![forbid(unsafe_code)]

pub mod ambient;
pub mod axes;
pub mod cubic_spline;
pub mod heat_conduction;
pub mod instrument;
pub mod machine;
pub mod noise;
pub mod path;
pub mod rigid_bodies;
mod rotary_head;
pub mod run_table;
pub mod scenario;
mod scenario_error;
pub mod schema;
pub mod sensors;
pub(crate) mod simulation;
pub mod spindle;
pub mod tool;

pub use scenario::{Scenario, ScenarioError};
pub use simulation::simulate;
