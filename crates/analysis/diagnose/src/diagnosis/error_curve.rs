//! The model between the places where the axis was measured: evaluated densely, so that a wave
//! between them shows.

use trueup_machine::{
    Machine,
    machine_file::LinearAxis,
    model::{ReferenceModel, RowInputs},
};
use trueup_numerics::robust::median;

use crate::{
    data::DataTable,
    diagnosis::{Diagnosis, extended_machine_file, value_range::min_max},
};

/// Points drawn between two neighbouring places: a wave of that length still looks like one.
const MAX_POINTS_BETWEEN_POSITIONS: usize = 20;
/// A picture does not show more.
const MAX_CURVE_POINTS: usize = 1500;

/// The errors by a model over an axis, approached from one side.
pub(super) struct ErrorCurve {
    pub at_mm: Vec<f64>,
    pub um: Vec<f64>,
}

/// Returns the axis that the readings are over: the own one if it moves, else the one that moves farthest.
pub(super) fn abscissa_axis(data: &DataTable) -> Option<LinearAxis> {
    let travel_mm = |axis: LinearAxis| {
        let at_mm = data.position_mm(axis).into_iter().flatten();
        let [low, high] = min_max(at_mm.copied());
        high - low
    };
    let own = data.setting.quantity.axis().filter(|&axis| travel_mm(axis) > 0.0);
    own.or_else(|| {
        let all = LinearAxis::ALL.into_iter().filter(|&axis| travel_mm(axis) > 0.0);
        all.max_by(|a, b| travel_mm(*a).total_cmp(&travel_mm(*b)))
    })
}

/// Returns the curves by the current machine file and by the extended one, from each side that was approached
/// from; what else was recorded stands at its median. None where that does not say all that is needed.
pub(super) fn compute_error_curves(
    diagnosis: &Diagnosis,
    axis: LinearAxis,
) -> [Vec<ErrorCurve>; 2] {
    let believed = diagnosis.data.setting.machine.clone();
    [believed, extended_machine_file::build_extended_machine(diagnosis)]
        .map(|machine| compute_machine_error_curves(&diagnosis.data, &machine, axis))
}

fn compute_machine_error_curves(
    data: &DataTable,
    machine: &Machine,
    axis: LinearAxis,
) -> Vec<ErrorCurve> {
    let index = axis.index();
    let places = sample_positions(data.position_mm(axis).unwrap_or(&[]));
    let mut sides: Vec<f64> = data
        .approach_direction(axis)
        .map_or(vec![1.0], |of| [1.0, -1.0].into_iter().filter(|side| of.contains(side)).collect());
    if sides.is_empty() {
        sides.push(1.0);
    }
    let temperatures: Vec<(&str, f64)> =
        data.temperatures().iter().map(|(name, of)| (name.as_str(), finite_median(of))).collect();
    let others: Vec<(&str, f64)> = data
        .unknown_columns()
        .iter()
        .map(|(name, of)| (name.as_str(), finite_median(of)))
        .collect();
    let at = |column: Option<&[f64]>| column.map(finite_median);
    let mut model = ReferenceModel::new(machine);
    let mut all = Vec::new();
    for side in sides {
        let mut at_mm = places.clone();
        if side < 0.0 {
            at_mm.reverse();
        }
        let um: Vec<f64> = at_mm
            .iter()
            .map(|&mm| {
                let mut situation = RowInputs {
                    time_s: data.time_s().map(|_| 0.0),
                    spindle_rpm: at(data.spindle_rpm()),
                    load_n: at(data.load_n()),
                    temperatures_c: &temperatures,
                    others: &others,
                    position_mm: data.positions_mm().map(|of| at(of).unwrap_or(f64::NAN)),
                    direction: [1.0; 3],
                    ..RowInputs::UNKNOWN
                };
                situation.position_mm[index] = mm;
                situation.direction[index] = side;
                let parts = model.step(&situation);
                match data.setting.quantity.axis() {
                    None => parts.elongation_um,
                    Some(error) => parts.error_um()[error.index()],
                }
            })
            .collect();
        if um.iter().all(|um| um.is_finite()) && um.len() > 1 {
            all.push(ErrorCurve { at_mm, um });
        }
    }
    all
}

/// Returns the places of the readings, rising, with points between them.
fn sample_positions(position_mm: &[f64]) -> Vec<f64> {
    let mut places: Vec<f64> = position_mm.iter().copied().filter(|mm| mm.is_finite()).collect();
    places.sort_unstable_by(f64::total_cmp);
    places.dedup_by(|a, b| *a - *b < 1e-3);
    let between = (MAX_CURVE_POINTS / places.len().max(1)).clamp(1, MAX_POINTS_BETWEEN_POSITIONS);
    let mut all: Vec<f64> = places
        .windows(2)
        .flat_map(|pair| {
            let step = (pair[1] - pair[0]) / between as f64;
            (0..between).map(move |n| pair[0] + step * n as f64)
        })
        .collect();
    all.extend(places.last());
    all
}

/// Returns the median of what is there.
fn finite_median(values: &[f64]) -> f64 {
    median(&mut values.iter().copied().filter(|value| value.is_finite()).collect::<Vec<f64>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_two_places_there_are_points_and_the_ends_are_the_places() {
        let all = sample_positions(&[10.0, 0.0, 5.0, f64::NAN, 5.000_01]);
        assert_eq!(all.len(), 41);
        assert_eq!((all[0], all[20], all[40]), (0.0, 5.0, 10.0));
        assert!(sample_positions(&[]).is_empty());
    }
}
