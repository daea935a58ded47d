//! The boot program, unmodified, on the model of its chip (`crates/bench/chip`), with small images in the slots
//! (`src/bin/slot_test`): which one speaks, and after how long.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

mod application;
mod board;
mod cuts;
mod full_store;
mod hangs;
mod key_change;
mod loads;
mod reasons;
#[path = "../support/sdo_script.rs"]
mod sdo_script;
#[path = "../support/sectors.rs"]
mod sectors;
mod starts;
mod updates;
mod whole;
