//! Bounds of time of the firmware, from its linked image: the worst case of every task in cycles of the Cortex-M4 with the
//! waits of the STM32F405's flash, and the response times of all tasks under fixed priorities.
//!
//! ```text
//! image ─► decode ─► flow (blocks) ─► values ─► loops ─┐
//!                 firmware (bounds, with reasons) ─────┴► program ─► worst (cycles) ─┬► response ─► report
//!              src/main.rs ─► tasks (priorities, arrivals, deadlines)   sections ────┘
//! ```
//!
//! It shares nothing with the firmware, nor with the model of the chip: the one bounds, the other runs.
//!
//! The accelerator of the flash (RM0090 3.5.2) counts in one way alone: a loop whose instructions are at most 64 lines of 16
//! bytes reads each line once, and each interrupt may take all of them away. Elsewhere each line is read anew wherever a path
//! enters it, and each constant is read from the flash. Not covered: an unaligned read that crosses a line of the flash.

mod basic_block;
pub mod clock_configuration;
pub(crate) mod control_flow;
pub mod critical_sections;
pub(crate) mod declaration_lookup;
pub mod declarations;
pub mod decode;
pub mod flow_facts;
pub mod function_entry;
pub mod image;
pub(crate) mod iteration_bounds;
pub(crate) mod longest_path;
mod loop_analysis;
pub(crate) mod outlined_code;
pub mod path_report;
pub(crate) mod prepared_function;
pub mod program;
pub(crate) mod register_values;
pub mod report;
pub(crate) mod response_time;
pub mod source_code;
pub mod tasks;
pub mod wcet;
