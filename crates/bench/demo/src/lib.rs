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
//! | [`boards`] | the board in QEMU, and the same application in this process, bit for bit |
//! | [`mod@bench`] | a machine file as the bench needs it: inputs, limits, time constants shortened |
//! | [`playback`] | a run, row by row, through a board |
//! | [`act_one`] | a measured run: what is wrong, extended, and what is gained on held-out rows |
//! | `calibration_loader` | a calibration over the board's serial line |
//! | [`act_two`], [`campaign`] | a machine with hidden faults, found and mended; many of them |
//! | `console_text`, [`page`], [`summary`] | what is printed on the screen, shown on the page, written for scripts |
#![forbid(unsafe_code)]

pub mod act_one;
pub mod act_two;
pub mod bench;
pub mod boards;
pub(crate) mod calibration_loader;
pub mod campaign;
pub(crate) mod console_text;
pub mod page;
pub mod playback;
pub mod summary;

/// Receives what is being done, and how far it is, 0…1 (NaN: as before).
pub type ProgressCallback<'p> = dyn FnMut(&str, f64) + 'p;
