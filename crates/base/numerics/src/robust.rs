//! Gross errors: rows that do not belong to the rest, found, listed, and never dropped in silence.
//!
//! Three kinds of data, three ways to say what the rest is:
//!
//! - **A series** ([`find_series_outliers`]): what is warm moves slowly. Each row is compared with a line
//!   through its neighbours in time (the median of the slopes of all pairs, Theil and Sen, and the
//!   median height), without itself. A single row or a short burst that leaves and comes back is a
//!   gross error; a level that stays is a step of the machine, and no row of it is excluded. Which
//!   model explains the series does not matter.
//! - **A relation** ([`find_regression_outliers`]): y against columns x. First the fit of many small random
//!   samples (their seed is fixed: the same data gives the same rows) whose median residual is
//!   smallest, which up to half of the rows cannot spoil; from there least squares with Tukey's
//!   biweight at 4.685 scales, which comes near to plain least squares where nothing is wrong (an
//!   MM estimate).
//! - **A residual** ([`flag_residual_outliers`]): what a model leaves, which may still hold a cause that is not named yet. Each
//!   row is compared with the median of its six neighbours and itself.
//!
//! Neither of the tests in order does for the other (measured, `tests/outliers.rs`; 20 runs of 400 rows
//! with scatter 1, in each 5 gross errors of 40, and what a cause leaves that is not named yet):
//!
//! | left | found as a series | as a residual | sound rows excluded as a series | as a residual |
//! |---|---|---|---|---|
//! | nothing | 100 of 100 | 100 | 0 of 7900 | 0 |
//! | a wave of 10 rows, amplitude 6 | 0 | 100 | 0 | 0 |
//! | a level that changes by 12 every 25 rows | 100 | 0 | 0 | 0 |
//! | 3 rows of 15, every 40 | 100 | 100 | 540 | 360 |
//!
//! A fit sees series that drift and step, a diagnosis residuals that oscillate; and of 20,000 rows a
//! residual takes 48 ms, a series 306 ms.
//!
//! The scale is 1.4826 times the median of the magnitudes of the residuals, never below the step in
//! which the values were written or a series moves. A row of a series or a relation is excluded beyond
//! the quantile of Student's t at which 1 of 100 clean runs would lose a row, but never within [`MIN_CUTOFF_SCALES`]
//! scales; the median knows the scale as well as 0.37·n values would with squares, so short runs need
//! more.

mod outlier_isolation;
mod regression_outliers;
mod residual_outliers;
mod series_outliers;
mod statistics;
mod tail_probability;
#[cfg(test)]
mod tests;

pub use outlier_isolation::retain_isolated_outliers;
pub use regression_outliers::{MIN_ROWS_PER_COLUMN, find_regression_outliers};
pub use residual_outliers::{MAX_OUTLIER_FRACTION, NEIGHBOURS_PER_SIDE, flag_residual_outliers};
pub use series_outliers::{MIN_SERIES_ROWS, find_series_outliers};
pub use statistics::median;
pub(crate) use statistics::outlier_cutoff;
pub use statistics::{MIN_CUTOFF_SCALES, Outlier};
pub use tail_probability::{noise_tail_probability, poisson_tail_probability};
