//! The measurement to make next, if the runs do not have it already.
//!
//! A cause's page says which measurement would settle what is open about it. Where the runs are such a
//! measurement, it is not recommended again.

use std::collections::BTreeMap;

use crate::{
    data::{DataTable, forward_fill},
    diagnosis::{
        held_out_errors::EXTRAPOLATION_MARGIN_FRACTION,
        value_range::{largest_rise, min_max},
    },
    fit::{FitProblem, settling_time_s},
    term_kind::ModelPart,
};

/// The pages require temperatures so far apart, in K.
const MIN_TEMPERATURE_DIFFERENCE_K: f64 = 5.0;
/// The page of backlash requires this many readings from each side,
const MIN_READINGS_PER_SIDE: usize = 7;
/// at mid-travel and both ends.
const MIN_APPROACH_POSITIONS: usize = 3;

/// `asked`, or what remains where `problem` has that already.
pub(super) fn next_measurement(problem: &FitProblem, part: &ModelPart, asked: String) -> String {
    if !satisfies_request(problem, part, &asked) {
        return asked;
    }
    "These runs have what would be asked for. Repeat them on another day, and diagnose with that record \
     as the hold-out."
        .into()
}

/// Returns whether the runs are what `asked` requires, by the words of the pages.
fn satisfies_request(problem: &FitProblem, part: &ModelPart, asked: &str) -> bool {
    let data = &problem.data;
    let column = part.kind.column();
    if asked.contains("seven times from each side") {
        has_enough_approaches(data)
    } else if asked.contains("with a cool-down") {
        // The pages require a record of three time constants: in that 95 % of a change come.
        let is_long = part.kind.has_time_constant()
            && settling_time_s(part.values[0]) <= problem.bounds.longest_s;
        is_long && has_heating_and_cooling(data, column.as_deref()) && data.setting.files.len() > 1
    } else if asked.contains("a start from cold and a stop from warm") {
        has_heating_and_cooling(data, column.as_deref())
    } else if asked.contains("at both ends") {
        has_axis_ends_at_two_temperatures(data, column.as_deref())
    } else if asked.contains("Change the speed quickly") {
        data.spindle_rpm().is_some_and(has_speed_steps)
    } else {
        false
    }
}

/// Three places at least, each read seven times from each side.
fn has_enough_approaches(data: &DataTable) -> bool {
    let (Some(own), Some(direction)) = (data.own_position_mm(), data.own_approach_direction())
    else {
        return false;
    };
    let mut read: BTreeMap<i64, [usize; 2]> = BTreeMap::new();
    for row in (0..data.rows).filter(|&row| data.used[row] && own[row].is_finite()) {
        // Positions to a micrometre.
        let at = (own[row] * 1000.0).round() as i64;
        read.entry(at).or_default()[usize::from(direction[row] < 0.0)] += 1;
    }
    let often = |sides: &&[usize; 2]| sides.iter().all(|&times| times >= MIN_READINGS_PER_SIDE);
    read.values().filter(often).count() >= MIN_APPROACH_POSITIONS
}

/// Returns the temperatures that matter: that of the term, else all.
fn relevant_temperatures<'d>(
    data: &'d DataTable,
    column: Option<&'d str>,
) -> impl Iterator<Item = Vec<f64>> + use<'d> {
    let is_asked = move |name: &str| column.is_none_or(|column| column == name);
    let all = data.temperatures().iter().filter(move |(name, _)| is_asked(name));
    all.map(|(_, values)| forward_fill(values))
}

/// Returns whether a temperature rises, and falls, by more than half of its range of at least 5 K.
fn has_heating_and_cooling(data: &DataTable, column: Option<&str>) -> bool {
    relevant_temperatures(data, column).any(|values| {
        let rise = largest_rise(values.iter().copied());
        let fall = largest_rise(values.iter().map(|value| -value));
        let range = rise.max(fall);
        range >= MIN_TEMPERATURE_DIFFERENCE_K && rise.min(fall) > 0.5 * range
    })
}

/// Returns whether the axis was at both ends, each at temperatures at least 5 K apart.
fn has_axis_ends_at_two_temperatures(data: &DataTable, column: Option<&str>) -> bool {
    let Some(own) = data.own_position_mm() else { return false };
    let [low, high] = min_max(own.iter().copied());
    // What was read so near to an end may be continued to it.
    let margin = EXTRAPOLATION_MARGIN_FRACTION * (high - low);
    relevant_temperatures(data, column).any(|values| {
        let spread = |is_there: &dyn Fn(f64) -> bool| {
            let there = (0..data.rows).filter(|&row| data.used[row] && is_there(own[row]));
            let [cold, warm] = min_max(there.map(|row| values[row]));
            warm - cold
        };
        high > low
            && spread(&|mm| mm <= low + margin) >= MIN_TEMPERATURE_DIFFERENCE_K
            && spread(&|mm| mm >= high - margin) >= MIN_TEMPERATURE_DIFFERENCE_K
    })
}

/// Returns whether a speed goes up, and down, by more than half of its range from one row to the next, twice at
/// least.
fn has_speed_steps(speed_rpm: &[f64]) -> bool {
    let speed_rpm = forward_fill(speed_rpm);
    let [low, high] = min_max(speed_rpm.iter().copied());
    let changes = |sign: f64| {
        let quick = |pair: &&[f64]| sign * (pair[1] - pair[0]) > 0.5 * (high - low);
        speed_rpm.windows(2).filter(quick).count()
    };
    high > low && changes(1.0) >= 2 && changes(-1.0) >= 2
}

#[cfg(test)]
mod tests {
    use std::{fmt::Write as _, path::Path};

    use trueup_machine::{MachineFile, RunFile, machine_file::Quantity};

    use super::*;

    fn data(text: &str, quantity: Quantity) -> DataTable {
        let file = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";
        let machine = MachineFile::parse(file, Path::new("m.toml")).expect("a machine file");
        let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
        DataTable::new(&machine, &[run], quantity).expect("comparable")
    }

    #[test]
    fn seven_readings_from_each_side_at_three_places_are_not_asked_for_again() {
        let with = |times: usize| {
            let mut text = String::from("x_mm,dir_x,measured_dx_um\n");
            for _ in 0..times {
                for x_mm in [0, 50, 100] {
                    let _ = write!(text, "{x_mm},1,0\n{x_mm},-1,4\n");
                }
            }
            has_enough_approaches(&data(&text, Quantity::Dx))
        };
        assert!(with(7) && !with(6));
    }

    #[test]
    fn a_start_and_a_stop_are_seen_and_a_start_alone_is_not() {
        let with = |rows: i32| {
            let mut text = String::from("time_s,temp_a_c,measured_elongation_um\n");
            for row in 0..rows {
                let _ =
                    writeln!(text, "{},{},1", 10 * row, 20.0 + 0.2 * f64::from(row.min(100 - row)));
            }
            has_heating_and_cooling(&data(&text, Quantity::Elongation), Some("temp_a_c"))
        };
        assert!(with(100) && !with(50));
    }

    #[test]
    fn a_speed_that_jumps_up_and_down_changes_quickly() {
        assert!(has_speed_steps(&[0.0, 8e3, 8e3, 0.0, 8e3, 0.0]));
        assert!(!has_speed_steps(&[0.0, 8e3, 8e3, 8e3]));
        assert!(!has_speed_steps(&[0.0, 1e3, 2e3, 3e3, 2e3, 1e3, 0.0]));
    }
}
