//! Which of the columns that the project does not know are inputs that an error may depend on.
//!
//! Not clocks, which only grow with the rows, nor columns that reproduce what was measured: either would
//! explain an error that it has no part in. Columns that a bridge or a gauge writes about the record are no inputs
//! either.

use super::{data_table::DataTable, table_columns::ColumnGroup};

/// The correlation from which a column is another one in other units: 0.2 % of the squares are its own, the last digits.
const MIN_DUPLICATE_CORRELATION: f64 = 0.999;
/// The share of a column's squares left next to others up to which it is one of them.
pub(crate) const MAX_DUPLICATE_VARIANCE_FRACTION: f64 =
    1.0 - MIN_DUPLICATE_CORRELATION * MIN_DUPLICATE_CORRELATION;

/// Returns whether a column is about the record, not about the machine.
pub(super) fn is_record_metadata_column(name: &str) -> bool {
    let is_offset = name.starts_with("offset_") && name.ends_with("_um");
    is_offset || ["quality", "calibration_crc", "check_um"].contains(&name)
}

/// Keeps the inputs among the other columns, and notes what is none. Columns that a term of the machine file reads
/// stay.
pub(super) fn retain_input_columns(data: &mut DataTable) {
    let needed = trueup_machine::model::required_columns(&data.setting.machine);
    let others = std::mem::take(&mut data.columns[ColumnGroup::Others]);
    for column in others {
        let name = &column.0;
        if needed.contains(name) || is_position_column(name) {
            data.columns[ColumnGroup::Others].push(column);
        } else if is_monotonic_column(data, &column.1) {
            data.notes
                .push(format!("{name} only grows with the rows: it is a clock, and no input"));
        } else if is_linearly_equivalent(&column.1, &data.measured) {
            data.notes.push(format!("{name} reproduces the measured value, and is no input"));
        } else {
            data.columns[ColumnGroup::Others].push(column);
        }
    }
}

/// Returns whether it is a position: an axis may go one way all the time.
pub(crate) fn is_position_column(name: &str) -> bool {
    name.ends_with("_mm") || name.ends_with("_deg")
}

/// Returns whether the values never fall within a series, and grow more than once: a switch that was closed once only
/// grows too.
fn is_monotonic_column(data: &DataTable, values: &[f64]) -> bool {
    let changes = || {
        let is_pair = |row: &usize| data.places.series[*row] == data.places.series[row - 1];
        (1..values.len()).filter(is_pair).map(|row| values[row] - values[row - 1])
    };
    changes().filter(|change| *change > 0.0).nth(1).is_some()
        && !changes().any(|change| change < 0.0)
}

/// Returns whether a column is another one, but for its unit and zero.
pub(crate) fn is_linearly_equivalent(column: &[f64], other: &[f64]) -> bool {
    correlation(column, other).abs() > MIN_DUPLICATE_CORRELATION
}

/// Pearson's coefficient over the rows that have both.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let pairs = || a.iter().zip(b).filter(|(a, b)| a.is_finite() && b.is_finite());
    let count = pairs().count() as f64;
    if count < 3.0 {
        return 0.0;
    }
    let mean = |of: fn((&f64, &f64)) -> f64| pairs().map(of).sum::<f64>() / count;
    let (a0, b0) = (mean(|(a, _)| *a), mean(|(_, b)| *b));
    let sum = |of: &dyn Fn(f64, f64) -> f64| pairs().map(|(a, b)| of(a - a0, b - b0)).sum::<f64>();
    let spread = (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt();
    if spread > 0.0 { sum(&|a, b| a * b) / spread } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_column_that_is_the_reading_in_other_units_is_the_reading() {
        let reading = [1.0, 2.0, f64::NAN, 4.0, 8.0];
        let scaled = [-1e3, -2e3, -3e3, -4e3, -8e3];
        assert!(is_linearly_equivalent(&scaled, &reading));
        let other = [1.0, -2.0, 0.0, 2.0, -1.0];
        assert!(!is_linearly_equivalent(&other, &reading));
    }
}
