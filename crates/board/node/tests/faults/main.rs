//! Faults of every input: what a bridge makes of them, and that it never jumps.

// A test may count and round as it likes: what overflows panics.
#![allow(clippy::arithmetic_side_effects, clippy::cast_possible_truncation, clippy::cast_sign_loss)]

mod changes;
mod emergencies;
mod flooded;
mod matrix;
mod rig;
#[path = "../spindle_model/mod.rs"]
mod spindle_model;
