//! Constants that follow the machine: from readings of a reference that the machine measures itself (a
//! probe on a ball, a tool setter, a laser barrier), slowly, within bounds, and never by one reading.
//!
//! ```text
//! record with readings ─► Sensitivity   what each constant does in each row, as the model says
//!                              │
//!                              ▼
//!                         Filter ×3      recursive least squares, each forgetting at its own pace;
//!                              │         a reading that stands alone is refused, with the reason
//!                              ▼
//!                         Bank           which of them has predicted the readings best, or the original file
//!                              ▼
//!                         Watch          whether something happened: events, from which on it is done anew
//!                              ▼
//!                         Limits         a bound for each constant, for all together, for one reading
//!                              ▼
//!                         Memory         what was learned, every change, and the way back
//!                              ▼
//!                         Live           what of it may be sent to a bridge while it runs
//! ```
//!
//! The user's own machine file stays unchanged; what was learned is a second file with the same sections and
//! other numbers. It never makes a machine worse by intent: as long as the original file predicts the readings
//! as well as what was learned, the original file stands.
//!
//! [`mod@calibration_monitoring`] answers the other question: whether the calibration still fits at all.
#![forbid(unsafe_code)]

pub mod calibration_monitoring;
mod change_detection;
mod event;
mod event_monitor;
mod file_update;
mod filter_bank;
mod filter_history;
mod learnable_constants;
mod learner;
mod learner_notes;
mod learner_state;
mod learning_limits;
pub mod live_update;
mod probe_checks;
mod readings;
mod rls_filter;
mod section_lookup;
mod state_reconciliation;
mod temperature_rise;
mod wear;
mod wear_regression;

pub use event::{DetectedEvent, EventKind};
pub use learnable_constants::LearnableConstant;
pub use learner::{LearningResult, ReadingOutcome, learn_from_run};
pub use learner_state::{DailyChange, LearnerState, MachineIdentity};
pub use learning_limits::LearningLimits;
pub use live_update::LiveUpdate;
