//! Cases drawn at random for tests and campaigns: what is hidden is known, so that a diagnosis, a learner or a plan can be
//! scored.
//!
//! As the virtual machine tool (`trueup-twin`), the drawing shares no code with what is tried on it: [`score`] alone knows
//! the diagnosis, and the model of a machine file serves only [`faulty_machine`] and [`run_file`], as its user's belief.
//!
//! | module | does |
//! |---|---|
//! | [`hidden_effects`] | challenges: a believed machine, runs with one hidden effect, the answer |
//! | [`known_term`] | challenges whose machine file has a cause already |
//! | [`physical_faults`] | machines with physical faults, in no terms but those of physics |
//! | [`faulty_machine`] | such machines with faults that their records show, by seed |
//! | [`input_dependence`] | two days with one effect of recorded inputs that is in no list |
//! | [`spindle_trial`] | a spindle that may be run as one likes, with one thing wrong in its file |
//! | [`axis_trial`] | an axis of the same kind |
//! | [`simulated_month`] | a month of a machine that ages, with a probe now and then |
//! | [`simulated_year`] | a year of a spindle or an axis in a small shop, with events and two probings a day |
//! | [`run_file`] | runs with columns or readings changed |
//! | [`score`] | the score of an answer to a drawn case |
//!
//! # A challenge
//! ```
//! use trueup_campaigns::hidden_effects::{ExpectedDiagnosis, HiddenCause, draw_test_case};
//! // Thermal lag, three times as large as the noise, by seed 7.
//! let challenge = draw_test_case(HiddenCause::ThermalLag, 3.0, 7);
//! assert!(challenge.runs[0].starts_with("time_s,")); // run files, to train on
//! assert!(challenge.machine.contains("[machine]"));  // what the user believes
//! let effect = &challenge.truth.effects[0];          // the answer
//! assert_eq!(effect.cause.name(), "thermal-lag");
//! assert!(effect.parameter("time_constant_s").is_some_and(|tau_s| tau_s > 100.0));
//! assert_eq!(challenge.truth.expected, ExpectedDiagnosis::Compensated);
//! // The hold-out, and how much better it can become at best.
//! assert!(challenge.holdout.lines().count() > 150);
//! assert!(challenge.truth.max_holdout_rms_reduction() > 0.3);
//! ```
#![forbid(unsafe_code)]

pub mod axis_trial;
pub mod faulty_machine;
pub mod hidden_effects;
pub mod input_dependence;
pub mod known_term;
mod orthogonal_component;
pub mod physical_faults;
pub mod run_file;
pub mod score;
pub mod simulated_month;
pub mod simulated_year;
pub mod spindle_trial;
