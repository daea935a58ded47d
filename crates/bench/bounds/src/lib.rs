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
//! enters it, and each constant is read from the flash. Left out: an unaligned read that crosses a line of the flash.

pub mod block;
pub mod clock;
pub mod declared;
pub mod decode;
pub mod firmware;
pub mod flow;
pub mod image;
pub mod longest;
pub mod loops;
pub mod path;
pub(crate) mod pieces;
pub mod program;
pub mod report;
pub mod response;
pub mod rounds;
pub mod sections;
pub mod source;
pub mod table;
pub mod tasks;
pub mod values;
pub mod worst;
