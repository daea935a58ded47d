//! The runs as one table: what was measured, what the model says, and what might explain the rest.
//!
//! | module | does |
//! |---|---|
//! | `quantity` | which error the runs are compared in |
//! | `read` | from runs to the table |
//! | `channels` | thermometers that lie and columns that are copies, excluded |
//! | `inputs` | which of the other columns an error may depend on |
//! | `one_pass` | whether the position only grows with the time |
//! | `prediction`, `reversal` | what the machine file says of each row; what follows from turning |
//! | `stated` | the terms that the machine file has already |
//! | `table` | the columns, by name |
//! | `drawn` | some of the rows, or means of neighbours, as a table |
//! | `row_blocks` | means over rows that follow each other |
//! | `groups` | neighbouring rows put together |
//! | `lag`, `lag_series` | gaps filled, values behind a lag; the same for means of some rows |
//! | `stretches` | the same of a long record |
//! | `stepped` | what was stepped through all rows before |
//! | `lags` | temperatures behind lags, by whichever of these is enough |

mod channels;
mod drawn;
mod groups;
mod inputs;
mod lag;
mod lag_series;
mod lags;
mod one_pass;
mod prediction;
mod quantity;
mod read;
mod reversal;
mod row_blocks;
mod stated;
mod stepped;
mod stretches;
mod table;

pub(crate) use channels::PAUSE_ROWS;
pub(crate) use groups::Groups;
pub(crate) use inputs::is_same;
pub(crate) use lag::{filled, first_of};
pub(crate) use quantity::quantity_of;
pub(crate) use stated::Stated;
pub(crate) use table::{Data, DrawnFrom};
