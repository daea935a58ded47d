//! The contents of a run file that was read, and their limits.

use std::sync::Arc;

use super::field_positions::FieldPositions;

/// The longest run file that is read, in bytes: a million rows of fifty numbers of twenty digits.
pub(crate) const MAX_RUN_FILE_BYTES: u64 = 1 << 30;

/// The most columns that a run file may have.
pub const MAX_RUN_FILE_COLUMNS: usize = 4096;

/// The most values that a run file may have, rows times columns: a million rows of fifty columns.
pub(crate) const MAX_RUN_FILE_VALUES: usize = 50_000_000;

/// One column of a run.
#[derive(Clone, Debug)]
pub struct RunColumn {
    /// Its name in the header, without surrounding blanks.
    pub name: String,
    /// Its value in each row; NaN where it is missing. Shared with who goes on with it: a run may be large.
    pub values: Arc<[f64]>,
    /// The character column at which each value stands in its line, from 1; shared too.
    pub(super) starts: Arc<FieldPositions>,
}

/// A column that is not known, and the known one that was probably meant.
#[derive(Clone, Debug)]
pub(super) struct ColumnTypo {
    pub(super) name: String,
    pub(super) meant: String,
    /// The character column of its name in the header, from 1.
    pub(super) column: usize,
}

/// How much a run file may hold.
#[derive(Clone, Copy)]
pub(super) struct RunFileSizeLimits {
    pub(super) bytes: u64,
    pub(super) values: usize,
}

/// A run as it was read.
pub(super) struct RunTable {
    pub(super) columns: Vec<RunColumn>,
    pub(super) header_line: usize,
    /// The line of each row, from 1: empty lines and comments are no rows.
    pub(super) line_of_row: Vec<u32>,
    pub(super) slips: Vec<ColumnTypo>,
    /// The labels of tools, by the number in whose form each is kept.
    pub(super) labels: Vec<(f64, String)>,
    /// The instant from which `time_s` counts, in s from 1970, where it was written as dates.
    pub(super) epoch_s: Option<f64>,
}
