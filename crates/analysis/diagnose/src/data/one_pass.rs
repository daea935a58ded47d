//! Whether the position only grows with the time: then an error over the position and one over the time are one
//! question, whatever the clock says.

use trueup_machine::effect::{Effect, spread};

use super::table::Data;

/// Places that make a pass: two always lie on a line.
const MIN_PLACES: usize = 3;

/// Returns true where the own axis goes one way through the whole record, and never comes back to a place.
pub(super) fn is_one_pass(data: &Data) -> bool {
    let Some(position) = data.own_position() else { return false };
    if data.series.last().is_some_and(|last| *last > 0) {
        return false;
    }
    let rows = position.iter().zip(&*data.measured);
    let places: Vec<f64> =
        rows.filter(|(mm, um)| mm.is_finite() && um.is_finite()).map(|(mm, _)| *mm).collect();
    let steps = || places.windows(2).map(|pair| pair[1] - pair[0]);
    let moves = steps().filter(|step| *step != 0.0).count();
    moves + 1 >= MIN_PLACES && (steps().all(|it| it >= 0.0) || steps().all(|it| it <= 0.0))
}

/// Leaves the clock of a pass out where nothing but the position goes with it: it says the same once more, and
/// noise that is as slow as the pass would be taken for the error.
pub(super) fn leave_the_clock(data: &mut Data) {
    let varies = |values: &[f64]| spread(values) > 0.0;
    let columns = data.temperatures.iter().chain(&data.others);
    let has_inputs = columns.map(|(_, values)| values).any(|values| varies(values))
        || data.spindle_rpm.iter().chain(&data.load_n).any(|values| varies(values))
        || data.stated.iter().any(|stated| Effect::is_in_time(&stated.effect));
    if !has_inputs {
        data.time_s = None;
        data.gauge_time_s = None;
    }
}
