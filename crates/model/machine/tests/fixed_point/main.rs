//! The board's integers against the reference model in `f64`, with everything switched on.
//!
//! | what | bound |
//! |---|---|
//! | the sum of all parts, on each axis | 10 nm |
//! | angles, levers and rotary axes over ±2 m | 1 nm |
//! | growth by the warm-up model, any speed | 1 nm of 80 µm |
//! | a lagging axis over a two-hour ramp, rows of 60 s | 5 nm on 5 m |
//! | the blob of a whole gantry | 16384 bytes, 24 a segment of a curve with its index |
//!
//! Machines come from a seeded generator as the text that a user would write. Signs are held to
//! what the hand finds from `docs/physics.md`, on three ways: the model, the compiled calibration, and
//! the offset that leaves the bridge.

mod bench;
mod gantry;
mod laws;
mod rig;
mod signs;
mod sum;
mod volume;
