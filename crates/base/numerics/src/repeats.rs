//! Readings at places that come again, cycle after cycle: which of them stand alone, whether the places
//! differ by more than their repeats, and which table holds on a cycle that it has not seen.
//!
//! | page | does |
//! |---|---|
//! | `reading` | a reading; which stops are one place, and which cycle they are of |
//! | `gross` | readings that stand alone among the repeats of their place |
//! | `table` | a value for each place, and a step or another value for the second side |
//! | `decide` | which table, if any, by an F test and by left-out cycles |
//! | `between` | whether a line between two places foresees the one between them |
//! | `grid` | how well places determine a table of equal steps |
//! | `power` | how many cycles would show an error of a given size |
//!
//! A table that was measured several times is not judged against noise that a model of it leaves: its own
//! repeats say what it is worth. One decision, [`decide`], for all who ask.

mod between;
mod decide;
mod grid;
mod gross;
mod power;
mod reading;
mod table;
#[cfg(test)]
mod tests;

pub use between::{Between, MIN_R_SQUARED, between};
pub use decide::{Decision, MIN_PLACES, Refusal, SIGNIFICANCE, Trial, decide, is_worse};
pub use grid::{HARDLY, largest_variance};
pub use gross::gross;
pub use power::cycles_for;
pub use reading::{Reading, SAME_PLACE, arrivals, places};
pub use table::{Law, Table};
