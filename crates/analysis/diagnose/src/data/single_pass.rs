//! Whether the position only grows with the time: then an error over the position and one over the time are one
//! question, whatever the clock says.

use trueup_machine::effect::{Effect, peak_to_peak};
use trueup_numerics::repeats::MIN_TABLE_POSITIONS;

use super::{data_table::DataTable, table_columns::KnownColumn};

/// Returns true where the own axis goes one way through the whole record, and never comes back to a place.
pub(super) fn is_single_pass(data: &DataTable) -> bool {
    let Some(position) = data.own_position_mm() else { return false };
    if data.places.series.last().is_some_and(|last| *last > 0) {
        return false;
    }
    let rows = position.iter().zip(&*data.measured);
    let places: Vec<f64> =
        rows.filter(|(mm, um)| mm.is_finite() && um.is_finite()).map(|(mm, _)| *mm).collect();
    let steps = || places.windows(2).map(|pair| pair[1] - pair[0]);
    let moves = steps().filter(|step| *step != 0.0).count();
    // Fewer places have no form.
    moves + 1 >= MIN_TABLE_POSITIONS
        && (steps().all(|step| step >= 0.0) || steps().all(|step| step <= 0.0))
}

/// Excludes the clock of a pass where only the position is correlated with it: it says the same once more, and
/// noise that is as slow as the pass would be taken for the error.
pub(super) fn exclude_redundant_clock(data: &mut DataTable) {
    let varies = |values: &[f64]| peak_to_peak(values) > 0.0;
    let columns = data.temperatures().iter().chain(data.unknown_columns());
    let has_inputs = columns.map(|(_, values)| values).any(|values| varies(values))
        || [data.spindle_rpm(), data.load_n()].into_iter().flatten().any(varies)
        || data.setting.stated.iter().any(|stated| Effect::depends_on_time(&stated.effect));
    if !has_inputs {
        data.columns[KnownColumn::Time] = None;
        data.columns[KnownColumn::GaugeTime] = None;
    }
}
