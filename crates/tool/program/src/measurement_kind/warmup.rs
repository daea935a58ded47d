//! The growth of the spindle from cold, read once a minute (paper 1, S1, S5 and S6).
//!
//! Nothing moves but the spindle: where the gauge stands is the operator's choice. The same program
//! runs twice, from cold each time: without compensation, and with it.
//!
//! A gauge that does not touch reads while the spindle turns. With a dial the spindle stops, and the program waits
//! for the operator at each reading: nothing may touch what turns.

use trueup_machine::{
    Machine,
    machine_file::{ElongationSource, MachineKind},
};

use super::{NON_CONTACT_PRECAUTION, PlansWithNotes, base_plan, unused_clearance_note};
use crate::{
    options::{MeasurementOptions, MeasuringInstrument},
    plan::{Column, MeasurementPlan, Step},
    program_error::ProgramError,
};

/// Two hours at full speed (paper 0).
const DEFAULT_WARMUP_DURATION_S: f64 = 7200.0;
/// From reading to reading, in s.
const DEFAULT_READING_INTERVAL_S: f64 = 60.0;
/// The same where the spindle stops for each, in s: rarely enough that it hardly cools.
const DEFAULT_CONTACT_READING_INTERVAL_S: f64 = 600.0;
/// How long the spindle runs down before the operator is called, in s.
const SPINDLE_RUN_DOWN_S: f64 = 20.0;

pub(crate) fn create_plans(
    machine: &Machine,
    options: &MeasurementOptions,
) -> Result<PlansWithNotes, ProgramError> {
    let rated = machine.spindle.warmup.as_ref().and_then(|warmup| warmup.rated_rpm);
    let rpm = options.spindle_rpm.or(rated).ok_or_else(|| {
        ProgramError(
            "the speed is not known: give --rpm, or rated_rpm under [spindle.warmup]".into(),
        )
    })?;
    let is_touching = options.gauge == Some(MeasuringInstrument::Dial);
    let every_s = options.every_s.unwrap_or(if is_touching {
        DEFAULT_CONTACT_READING_INTERVAL_S
    } else {
        DEFAULT_READING_INTERVAL_S
    });
    if every_s <= options.dwell_s {
        return Err(ProgramError(format!(
            "--every-s {every_s} must be above --dwell-s {}: a reading takes that long",
            options.dwell_s
        )));
    }
    let times = (options.heat_s.unwrap_or(DEFAULT_WARMUP_DURATION_S) / every_s).round();
    if !(1.0..=9999.0).contains(&times) {
        return Err(ProgramError(format!(
            "--heat-s must be 1 to 9999 times --every-s ({every_s}), not {times}"
        )));
    }
    // A number of readings is whole and in range.
    let times = times as u32;
    let mut columns = if is_touching {
        vec![Column::Empty("time_s".into()), Column::SpeedBetween(rpm)]
    } else {
        vec![Column::Time, Column::Speed]
    };
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
    let how = if is_touching {
        "The spindle stops before each reading: touch nothing that turns."
    } else {
        NON_CONTACT_PRECAUTION
    };
    let place = match machine.kind {
        MachineKind::Lathe => {
            "Set the gauge between turret and chuck: in the turret, along Z against the face of a bar in the chuck, to zero."
        }
        _ => {
            "Set the gauge under a test bar that is rated for the speed, near where parts are cut, and to zero."
        }
    };
    let sign = match machine.kind {
        MachineKind::Lathe => {
            "Growth of the bar out of the chuck is positive. Delete columns that you have no values for."
        }
        _ => "Growth out of the spindle is positive. Delete columns that you have no values for.",
    };
    let notes = [
        "Begin with a machine that has stood still over night.",
        place,
        "A gauge that touches: write the program with --gauge dial, which stops the spindle and waits for each reading.",
        sign,
        "First without compensation; then, cold again, the same with it.",
    ];
    let fit = match spindle.source {
        Some(ElongationSource::Sensor | ElongationSource::Temperature) => "elongation",
        Some(ElongationSource::Warmup) | None => "warmup",
    };
    let plan = MeasurementPlan {
        name: "warmup".into(),
        notes: notes.map(String::from).into(),
        precautions: vec![how.into()],
        steps: if is_touching {
            contact_gauge_steps(rpm, every_s, times)
        } else {
            let (wait_s, read_s) = (every_s - options.dwell_s, options.dwell_s);
            let steps = vec![Step::Dwell(wait_s), Step::Read(read_s)];
            vec![Step::Spindle(rpm), Step::Repeat { times, steps }, Step::Spindle(0.0)]
        },
        columns,
        then: vec![
            format!("trueup fit {fit} --run warmup-off.csv"),
            "trueup accept --off warmup-off.csv --on warmup-on.csv".into(),
        ],
        records: vec!["off", "on"],
        ..base_plan(machine, options)
    };
    Ok((vec![plan], unused_clearance_note(options).into_iter().collect()))
}

/// Returns the steps of a gauge that touches: the spindle stands at each reading, and the operator is called.
fn contact_gauge_steps(rpm: f64, every_s: f64, times: u32) -> Vec<Step> {
    let call = [
        "Wait until the spindle stands. Then touch the bar, read, and write down the time.",
        "Take the gauge away: the spindle turns again after this stop.",
    ];
    let steps = vec![
        Step::Spindle(rpm),
        Step::Dwell(every_s),
        Step::Spindle(0.0),
        Step::Read(SPINDLE_RUN_DOWN_S),
        Step::Stop(call.map(String::from).into()),
    ];
    vec![Step::Repeat { times, steps }]
}
