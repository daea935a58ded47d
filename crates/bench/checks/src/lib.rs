//! Checks of the project: its tests in tiers, the structure of its source, what it is built from.
//!
//! ```text
//!  verify ─► structure, supply_chain, test_run ─► tally
//!  campaign: soak      book: the manual, and the links of all documents      debian, release: what is handed out
//!  api_docs: the crates' documentation with a front page
//! ```
#![forbid(unsafe_code)]

pub mod api_docs;
pub mod book;
pub mod campaign;
mod cargo;
pub mod debian_package;
pub mod release;
pub mod structure;
mod supply_chain;
mod test_results;
mod test_run;
pub mod timing_bounds;
pub mod verify;
