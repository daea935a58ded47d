//! The runs as one table: what was measured, what the model says, and what might explain the rest.
//!
//! | module | does |
//! |---|---|
//! | `quantity` | which error the runs are compared in |
//! | `read` | from runs to the table |
//! | `channels` | thermometers that lie and columns that are copies, excluded |
//! | `columns` | what a column is called, and what drawn rows have of it |
//! | `inputs` | which of the other columns an error may depend on |
//! | `single_pass` | whether the position only grows with the time |
//! | `prediction`, `reversal` | what the machine file says of each row; what follows from turning |
//! | `stated` | the terms that the machine file has already |
//! | `table` | the columns, by name |
//! | `drawn` | some of the rows, or means of neighbours, as a table |
//! | `row_blocks` | means over rows that follow each other |
//! | `groups` | neighbouring rows put together |
//! | `lag`, `lag_power_series` | gaps filled, values behind a lag; the same for means of some rows |
//! | `stretches` | the same of a long record |
//! | `stepped` | what was stepped through all rows before |
//! | `lag_cache` | temperatures behind lags, by whichever of these is enough |

mod channel_faults;
mod data_table;
mod from_runs;
mod input_columns;
mod lag_cache;
mod lag_column_cache;
mod lag_filter;
mod lag_power_series;
mod lag_segments;
mod prediction;
mod quantity;
mod reversal_decay;
mod row_blocks;
mod row_groups;
mod row_selection;
mod single_pass;
mod stated_terms;
mod table_columns;

pub(crate) use channel_faults::MIN_PAUSE_INTERVALS;
pub(crate) use data_table::{DataTable, ParentTable, RowPredictions};
pub(crate) use input_columns::{
    MAX_DUPLICATE_VARIANCE_FRACTION, is_linearly_equivalent, is_position_column,
};
pub(crate) use lag_filter::{first_finite_or_zero, forward_fill};
pub(crate) use quantity::resolve_quantity;
pub(crate) use row_groups::RowGroups;
pub(crate) use stated_terms::StatedTerm;
pub(crate) use table_columns::{ColumnGroup, KnownColumn};
