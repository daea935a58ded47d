//! The live screen of a bridge: what its sensor reads, which offset it gives and from which causes, how
//! it went in the last minutes, what is wrong, and what to do about it.
//!
//! ```text
//!  line, keys, indicator ─► live ─► state (pure) ─► view ─► terminal
//!                             │        ▲
//!                             └► recording   laws: what the machine file makes of it
//! ```
//!
//! | module | does |
//! |---|---|
//! | [`event_loop`] | the loop: what comes from outside goes into the state, the state is drawn |
//! | [`state`] | all that the screen knows, and what a key does; no terminal, no clock |
//! | [`view`] | the state as lines of a terminal of any size |
//! | `compensation_model` | volts, codes and the shares of the causes, by the machine file or the board's own calibration |
//! | [`trend`] | the last minutes |
//! | [`indicator`] | a gauge that sends its readings over a serial line |
#![forbid(unsafe_code)]

pub(crate) mod compensation_model;
pub mod event_loop;
pub mod indicator;
pub mod state;
pub mod trend;
pub mod view;
