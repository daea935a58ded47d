//! `Diagnosis::next_run`: on machines of the twin, of which one short run leaves causes open, the planned run distinguishes
//! them in a fraction of the machine minutes of the cycles of ISO 230-2 and 230-3.
//!
//! `cargo test -p trueup-diagnose --test next -- --show-output --include-ignored` prints the figures.

mod axis;
mod needed;
mod spindle;
