//! The virtual machine tool: the truth that the model and the diagnosis are tried on.
//!
//! It shares no code with `trueup-machine`, `trueup-core`, `trueup-fit` or `trueup-diagnose`, not
//! even the writer of run files: that a diagnosis finds what was hidden here proves something only if
//! the two do not agree by construction.
//!
//! | module | does |
//! |---|---|
//! | [`heat`] | heat conduction along a rod, by finite volumes |
//! | [`spindle`] | bearings, motor, cooling; growth by heat, speed, holder and force |
//! | [`tool`] | what each tool adds by its speed |
//! | [`ambient`] | the air over the day |
//! | [`axes`] | screws, scales, pitch, backlash, straightness, angles |
//! | [`bodies`] | what each axis moves, turned and shifted a little, to the tip |
//! | [`cubic_spline`] | smooth curves through points |
//! | [`sensors`] | the displacement sensor and the thermometers, with their faults |
//! | [`instrument`] | the reference instrument, with its own |
//! | [`head`] | rotary axes that turn the tool |
//! | [`machine`] | all of it as one machine, stepped by its drives |
//! | [`month`] | a month of a machine that ages, with a probe now and then |
//! | [`year`] | a year of a spindle or an axis in a small shop, with events and two probings a day |
//! | [`trial`] | a spindle that may be run as one likes, with one thing wrong in its file |
//! | [`trial_axis`] | an axis of the same kind |
//! | [`path`] | speeds, loads, ways, position runs |
//! | [`scenario`] | all of these in one file |
//! | [`run`] | a scenario that is run: `trueup simulate` |
//! | [`noise`] | streams of chance by seed and purpose, correlated noise |
//! | [`table`] | columns of numbers, and the run file that they are written to |
//! | [`hidden`] | challenges: a believed machine, runs with one hidden effect, the answer |
//! | [`inputs`] | two days with one effect of recorded inputs that is in no list |
//! | [`physical`] | machines with physical faults, in no terms but those of physics |
//!
//! # A challenge
//! ```
//! use trueup_twin::hidden::{Expected, Hidden, draw};
//! // Thermal lag, three times as large as the noise, by seed 7.
//! let challenge = draw(Hidden::ThermalLag, 3.0, 7);
//! assert!(challenge.runs[0].starts_with("time_s,")); // run files, to train on
//! assert!(challenge.machine.contains("[machine]"));  // what the user believes
//! let effect = &challenge.truth.effects[0];          // the answer
//! assert_eq!(effect.cause.name(), "thermal-lag");
//! assert!(effect.parameter("time_constant_s").is_some_and(|tau_s| tau_s > 100.0));
//! assert_eq!(challenge.truth.expected, Expected::Compensated);
//! // The hold-out, and how much better it can become at best.
//! assert!(challenge.holdout.lines().count() > 150);
//! assert!(challenge.truth.possible_reduction() > 0.3);
//! ```
#![forbid(unsafe_code)]

pub mod ambient;
pub mod axes;
pub mod bodies;
mod broken;
pub mod cubic_spline;
pub mod head;
pub mod heat;
pub mod hidden;
pub mod inputs;
pub mod instrument;
pub mod machine;
pub mod month;
pub mod noise;
pub mod path;
pub mod physical;
pub mod run;
pub mod scenario;
pub mod schema;
pub mod sensors;
pub mod spindle;
pub mod table;
pub mod tool;
pub mod trial;
pub mod trial_axis;
pub mod year;

pub use run::simulate;
pub use scenario::{BadScenario, Scenario};
