//! The whole chain before one's eyes: measured data in, the cause named, the model extended, the gain
//! shown in the offsets that a CNC reads from the board.
//!
//! ```text
//!  run, machine file ─► diagnose ─► extended.toml ─► bench ─► compile ─► boards: play ─► offsets ─► gain
//!  seed ─► hidden: faults in the virtual machine tool ─┘                                   (act two)
//! ```
//!
//! | module | does |
//! |---|---|
//! | [`stepped_board`] | the board in QEMU, and the same application in this process, bit for bit |
//! | [`bench_machine`] | a machine file as the bench needs it: inputs, limits, time constants shortened |
//! | [`playback`] | a run, row by row, through a board |
//! | [`measured_run_demo`] | a measured run: what is wrong, extended, and what is gained on held-out rows |
//! | `calibration_loader` | a calibration over the board's serial line |
//! | [`hidden_fault_demo`], [`campaign`] | a machine with hidden faults, found and mended; many of them |
//! | `console_text`, [`html_report`], [`summary`] | what is printed on the screen, shown on the page, written for scripts |
#![forbid(unsafe_code)]

pub mod bench_machine;
pub(crate) mod calibration_loader;
pub mod campaign;
pub(crate) mod console_text;
pub mod hidden_fault_demo;
pub mod html_report;
pub mod measured_run_demo;
pub mod playback;
pub mod stepped_board;
pub mod summary;

/// Receives what is being done, and how far it is, 0…1 (NaN: as before).
pub type ProgressCallback<'p> = dyn FnMut(&str, f64) + 'p;
