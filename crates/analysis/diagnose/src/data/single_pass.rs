//! Whether the position only grows with the time: then an error over the position and one over the time are one
//! question, whatever the clock says. And whether nothing but the position changes.

use trueup_machine::{
    effect::{Effect, peak_to_peak},
    machine_file::LinearAxis,
};
use trueup_numerics::repeats::MIN_TABLE_POSITIONS;

use super::{data_table::DataTable, input_columns::is_position_column, table_columns::KnownColumn};

/// Returns the columns of positions that go one way through the whole record, and never come back to a place.
pub(super) fn passed_columns(data: &DataTable) -> Vec<String> {
    if data.places.series.last().is_some_and(|last| *last > 0) {
        return Vec::new();
    }
    let of_axis = |axis: LinearAxis| Some((axis.column_name(), data.position_mm(axis)?));
    let others = data.unknown_columns().iter().filter(|(name, _)| is_position_column(name));
    let others = others.map(|(name, values)| (name.clone(), &values[..]));
    let all = LinearAxis::ALL.into_iter().filter_map(of_axis).chain(others);
    all.filter(|(_, position)| goes_one_way(data, position)).map(|(name, _)| name).collect()
}

fn goes_one_way(data: &DataTable, position: &[f64]) -> bool {
    let rows = position.iter().zip(&*data.measured);
    let places: Vec<f64> =
        rows.filter(|(mm, um)| mm.is_finite() && um.is_finite()).map(|(mm, _)| *mm).collect();
    let steps = || places.windows(2).map(|pair| pair[1] - pair[0]);
    let moves = steps().filter(|step| *step != 0.0).count();
    // Fewer places have no form.
    moves + 1 >= MIN_TABLE_POSITIONS
        && (steps().all(|step| step >= 0.0) || steps().all(|step| step <= 0.0))
}

/// Returns whether the axis whose error it is goes one way; or where that one rests another does, as the lines of a map follow
/// each other.
pub(super) fn is_pass(data: &DataTable, passed: &[String]) -> bool {
    let is_own = |axis: &LinearAxis| data.setting.quantity.axis() == Some(*axis);
    let is_passed = |axis: &LinearAxis| passed.contains(&axis.column_name());
    let moved = moved_axes(data);
    match moved.iter().find(|axis| is_own(axis)) {
        Some(own) => is_passed(own),
        None => moved.iter().any(is_passed),
    }
}

/// Returns whether the axes that have moved are others than the own one.
pub(super) fn is_guide_map(data: &DataTable) -> bool {
    let moved = moved_axes(data);
    let is_own = |axis: &LinearAxis| data.setting.quantity.axis() == Some(*axis);
    !moved.is_empty() && !moved.iter().any(is_own)
}

fn moved_axes(data: &DataTable) -> Vec<LinearAxis> {
    let has_moved = |axis: &LinearAxis| data.position_mm(*axis).is_some_and(varies);
    LinearAxis::ALL.into_iter().filter(has_moved).collect()
}

/// Returns whether anything changes that an error may depend on next to positions and the time.
pub(super) fn has_other_inputs(data: &DataTable) -> bool {
    let columns = data.temperatures().iter().chain(data.unknown_columns());
    columns.map(|(_, values)| values).any(|values| varies(values))
        || [data.spindle_rpm(), data.load_n()].into_iter().flatten().any(varies)
        || data.setting.stated.iter().any(|stated| Effect::depends_on_time(&stated.effect))
}

fn varies(values: &[f64]) -> bool {
    peak_to_peak(values) > 0.0
}

/// Excludes the clock of a pass: it says the same as the position once more, and noise that is as slow as the pass would
/// be taken for the error.
pub(super) fn exclude_redundant_clock(data: &mut DataTable) {
    data.columns[KnownColumn::Time] = None;
    data.columns[KnownColumn::GaugeTime] = None;
}
