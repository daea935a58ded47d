//! The ranges of the inputs of a record: the corners at which a correction is held against what was measured.

use std::collections::BTreeMap;

use trueup_machine::{
    RunFile,
    envelope::{InputRanges, TEMPERATURE_RAMP_DURATION_S},
};

use crate::{data::DataTable, diagnosis::value_range::min_max};

/// Returns what was recorded of each input; of one that was not, 0.
pub(super) fn recorded_input_ranges(data: &DataTable, runs: &[RunFile]) -> InputRanges {
    let temperatures =
        data.temperatures().iter().map(|(name, values)| (name.clone(), finite_range(values)));
    let temperatures_c: BTreeMap<String, [f64; 2]> = temperatures.collect();
    let of = |name: &str| {
        let values = runs.iter().filter_map(|run| run.column(name)).flatten().copied();
        let range = min_max(values.filter(|value| value.is_finite()));
        if range[0] <= range[1] { range } else { [0.0; 2] }
    };
    let ramps =
        data.temperatures().iter().filter_map(|(_, values)| min_ramp_duration_s(data, values));
    InputRanges {
        temperatures_c,
        is_each_alone: true,
        change_s: ramps.fold(f64::INFINITY, f64::min).clamp(TEMPERATURE_RAMP_DURATION_S, 1e7),
        speed_rpm: of("spindle_rpm"),
        load_n: of("load_n"),
        sensor_counts: of("sensor_counts"),
        position_mm: ["x_mm", "y_mm", "z_mm"].map(of),
    }
}

fn finite_range(values: &[f64]) -> [f64; 2] {
    let range = min_max(values.iter().copied().filter(|value| value.is_finite()));
    if range[0] <= range[1] { range } else { [0.0; 2] }
}

/// Returns how long a temperature takes over its range where it changes fastest, but not faster than
/// [`TEMPERATURE_RAMP_DURATION_S`] shows, in s; `None` where nothing is known.
fn min_ramp_duration_s(data: &DataTable, values: &[f64]) -> Option<f64> {
    let time_s = data.time_s()?;
    let [low, high] = finite_range(values);
    // In K/s.
    let mut fastest: f64 = 0.0;
    let mut start = 0;
    for row in 1..data.rows {
        if data.places.restart[row] {
            start = row;
            continue;
        }
        while start + 1 < row && time_s[row] - time_s[start + 1] >= TEMPERATURE_RAMP_DURATION_S {
            start += 1;
        }
        let elapsed_s = (time_s[row] - time_s[start]).max(TEMPERATURE_RAMP_DURATION_S);
        let rate = (values[row] - values[start]).abs() / elapsed_s;
        if rate.is_finite() {
            fastest = fastest.max(rate);
        }
    }
    (fastest > 0.0).then_some((high - low) / fastest)
}
