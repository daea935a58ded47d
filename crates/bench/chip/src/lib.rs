//! A strict STM32F405 in software: an image runs on it as it is flashed, and what silicon would not do,
//! ignores or forbids is reported. See `README.md` for what is modelled and what is not, and `CHANGES.md`
//! for what was changed in the model and which section of the manual says so.
//!
//! ```text
//!  processor ──► run ◄── chip ◄── world, script, max31865, frame
//!   (rsemu)       │        └────► report
//!                 └──► summary (what the program prints)
//! ```

pub mod accelerator;
pub mod board;
pub mod chip;
pub mod elf;
pub mod frame;
pub mod handler_timing;
mod link;
pub mod max31865;
mod memory_map;
pub mod processor;
pub mod report;
pub mod script;
pub mod summary;
pub mod time;
pub mod wire;
pub mod world;
