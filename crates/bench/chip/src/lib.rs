//! A strict STM32F405 in software: an image runs on it as it is flashed, and what silicon would not do,
//! ignores or forbids is reported. See `README.md` for what is modelled and what is not, and `CHANGES.md`
//! for what was changed in the model and which section of the manual says so.
//!
//! ```text
//!  processor ──► run ◄── chip ◄── world, script, max31865, frame
//!   (rsemu)       │        └────► report
//!                 └──► summary (what the program prints)
//! ```

pub mod board;
mod can_ids;
pub mod chip;
pub mod elf;
pub mod flash_accelerator;
pub mod frame;
pub mod handler_timing;
pub mod max31865;
mod memory_map;
pub mod processor;
pub mod report;
pub mod script;
pub mod serial_line;
pub mod simulation_time;
pub mod summary;
pub mod world;
