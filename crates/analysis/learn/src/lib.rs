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
//!                         Bank           which of them has foreseen the readings best, or the file as it is
//!                              ▼
//!                         Watch          whether something happened: events, from which on it is done anew
//!                              ▼
//!                         Limits         a bound for each constant, for all together, for one reading
//!                              ▼
//!                         Memory         what was learned, every change, and the way back
//!                              ▼
//!                         Live           what of it a bridge may be told while it runs
//! ```
//!
//! The user's own machine file stays as it is; what was learned is a second file with the same sections and
//! other numbers. It never makes a machine worse by intent: as long as the file as it is foresees the readings
//! as well as what was learned, the file as it is stands.
//!
//! [`mod@trust`] asks the other question: whether the calibration still fits at all.
#![forbid(unsafe_code)]

mod bank;
mod checks;
mod constants;
mod detect;
mod event;
mod filter;
mod learn;
mod limits;
pub mod live;
mod memory;
mod readings;
mod reconcile;
mod replay;
mod rise;
mod sections;
pub mod trust;
mod watch;
mod wear;
mod worn;
mod written;

pub use constants::Constant;
pub use event::{Event, EventKind, clock};
pub use learn::{Learned, ReadingOutcome, learn};
pub use limits::Limits;
pub use live::Live;
pub use memory::{Change, Memory, Owner};
