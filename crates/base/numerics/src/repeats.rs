//! Readings at places that come again, cycle after cycle: which of them stand alone, whether the places
//! differ by more than their repeats, and which table holds on a cycle that it has not seen.
//!
//! | page | does |
//! |---|---|
//! | `reading` | a reading; which stops are one place, and which cycle they are of |
//! | `gross` | readings that stand alone among the repeats of their place |
//! | `table` | a value for each place, and a step or another value for the second side |
//! | `table_selection` | which table, if any, by an F test and by held-out cycles |
//! | `between` | whether a line between two places predicts the one between them |
//! | `grid` | how well places determine a table of equal steps |
//! | `power` | how many cycles would show an error of a given size |
//!
//! A table that was measured several times is not judged against noise that a model of it leaves: its own
//! repeats say what it is worth. One decision, [`select_table`], for all who ask.

mod grid_determinacy;
mod gross_errors;
mod interpolation_check;
mod power;
mod reading;
mod table_fit;
mod table_selection;
#[cfg(test)]
mod tests;

pub use grid_determinacy::{DETERMINACY_THRESHOLD, max_point_variance};
pub use gross_errors::find_gross_errors;
pub use interpolation_check::{InterpolationCheck, MIN_R_SQUARED, check_interpolation};
pub use power::required_cycles;
pub use reading::{POSITION_TOLERANCE_PER_STEP, RepeatReading, cycle_numbers, group_positions};
pub use table_fit::TableLaw;
pub use table_selection::{
    LawTest, MIN_TABLE_POSITIONS, SIGNIFICANCE_LEVEL, TableRejection, TableSelection, is_worse,
    select_table,
};
