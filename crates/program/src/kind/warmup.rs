//! The growth of the spindle from cold, read once a minute (seed 001, S1, S5 and S6).
//!
//! Nothing moves but the spindle: where the gauge stands is the operator's choice. The same program
//! runs twice, from cold each time: without compensation, and with it.

use trueup_machine::{Machine, file::ElongationSource};

use super::Plans;
use crate::{
    options::Options,
    plan::{Column, Plan, Step},
    refused::Refused,
};

/// Two hours at full speed (seed 000).
const HEAT_S: f64 = 7200.0;

pub(crate) fn plans(machine: &Machine, options: &Options) -> Result<Plans, Refused> {
    let rated = machine.spindle.warmup.as_ref().and_then(|warmup| warmup.rated_rpm);
    let rpm = options.spindle_rpm.or(rated).ok_or_else(|| {
        Refused("the speed is not known: give --rpm, or rated_rpm under [spindle.warmup]".into())
    })?;
    let minutes = (options.heat_s.unwrap_or(HEAT_S) / options.every_s).round();
    if !(1.0..=9999.0).contains(&minutes) {
        return Err(Refused(format!(
            "--heat-s must be 1 to 9999 times --every-s ({}), not {minutes}",
            options.every_s
        )));
    }
    let minute = vec![Step::Dwell(options.every_s - options.dwell_s), Step::Read(options.dwell_s)];
    let mut columns = vec![Column::Time, Column::Speed];
    let spindle = &machine.spindle;
    let mut temperatures: Vec<String> =
        spindle.temperature.iter().map(|law| law.sensor.clone()).collect();
    temperatures.extend(spindle.sensor.iter().filter_map(|sensor| sensor.temperature.clone()));
    temperatures.dedup();
    columns.extend(temperatures.into_iter().map(Column::Empty));
    if spindle.sensor.is_some() {
        columns.push(Column::Empty("sensor_counts".into()));
    }
    columns.push(Column::Empty("measured_elongation_um".into()));
    let notes = [
        "Begin with a machine that has stood still over night.",
        "Set a gauge with a ball under a test bar in the spindle, near where parts are cut, and to zero.",
        "Growth out of the spindle is positive. Delete columns that you have no values for.",
        "First without compensation; then, cold again, the same with it.",
    ];
    let fit = match spindle.source {
        Some(ElongationSource::Sensor | ElongationSource::Temperature) => "elongation",
        Some(ElongationSource::Warmup) | None => "warmup",
    };
    let plan = Plan {
        name: "warmup".into(),
        notes: notes.map(String::from).into(),
        steps: vec![
            Step::Spindle(rpm),
            // A number of minutes is whole and in range.
            Step::Repeat { times: minutes as u32, steps: minute },
            Step::Spindle(0.0),
        ],
        columns,
        then: format!(
            "trueup fit {fit} --run warmup-off.csv; then trueup accept --off warmup-off.csv --on warmup-on.csv"
        ),
        records: vec!["off", "on"],
    };
    Ok((vec![plan], Vec::new()))
}
