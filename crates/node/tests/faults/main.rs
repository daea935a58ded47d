//! Faults of every input: what a bridge makes of them, and that it never jumps.

mod changes;
mod emergencies;
mod matrix;
mod rig;
