//! The ranges of the inputs of a record: the corners at which a correction is held against what was measured.

use std::collections::BTreeMap;

use trueup_machine::{
    RunFile,
    envelope::{CHANGE_S, InputRanges},
};

use crate::{answer::range::extent, data::Data};

/// Returns what was recorded of each input; of one that was not, 0.
pub(super) fn recorded(data: &Data, runs: &[RunFile]) -> InputRanges {
    let temperatures = data.temperatures.iter().map(|(name, values)| (name.clone(), known(values)));
    let temperatures_c: BTreeMap<String, [f64; 2]> = temperatures.collect();
    let of = |name: &str| {
        let values = runs.iter().filter_map(|run| run.column(name)).flatten().copied();
        let range = extent(values.filter(|value| value.is_finite()));
        if range[0] <= range[1] { range } else { [0.0; 2] }
    };
    let ramps = data.temperatures.iter().filter_map(|(_, values)| ramp_s(data, values));
    InputRanges {
        temperatures_c,
        is_each_alone: true,
        change_s: ramps.fold(f64::INFINITY, f64::min).clamp(CHANGE_S, 1e7),
        speed_rpm: of("spindle_rpm"),
        load_n: of("load_n"),
        sensor_counts: of("sensor_counts"),
        position_mm: ["x_mm", "y_mm", "z_mm"].map(of),
    }
}

fn known(values: &[f64]) -> [f64; 2] {
    let range = extent(values.iter().copied().filter(|value| value.is_finite()));
    if range[0] <= range[1] { range } else { [0.0; 2] }
}

/// Returns how long a temperature takes over its range where it changes fastest, but not faster than
/// [`CHANGE_S`] shows, in s; `None` where nothing is known.
fn ramp_s(data: &Data, values: &[f64]) -> Option<f64> {
    let time_s = data.time_s.as_deref()?;
    let [low, high] = known(values);
    // In K/s.
    let mut fastest: f64 = 0.0;
    let mut start = 0;
    for row in 1..data.rows {
        if data.restart[row] {
            start = row;
            continue;
        }
        while start + 1 < row && time_s[row] - time_s[start + 1] >= CHANGE_S {
            start += 1;
        }
        let elapsed_s = (time_s[row] - time_s[start]).max(CHANGE_S);
        let rate = (values[row] - values[start]).abs() / elapsed_s;
        if rate.is_finite() {
            fastest = fastest.max(rate);
        }
    }
    (fastest > 0.0).then_some((high - low) / fastest)
}
