//! Backlash at the middle and near both ends, seven times each (seed 004, N10…N90).
//!
//! At each place the axis goes beyond it and comes back, is read, goes beyond on the other side and
//! comes back, is read again. With an indicator another axis makes room for it in between. The
//! largest mean is the backlash.

use trueup_machine::{
    Machine,
    file::{Feedback, LinearAxis},
};

use super::{Plans, WITHOUT_CORRECTION, capital, go, measured};
use crate::{
    options::{Gauge, Options},
    plan::{Column, Plan, Step},
    refused::Refused,
    travel::{Travel, travels},
};

/// How often at each place: "generally seven" (seed 004).
const REPEATS: u32 = 7;
/// How far the axis that makes room for an indicator goes, in mm (seed 004, N40).
const CLEAR_MM: f64 = 50.0;

pub(crate) fn plans(machine: &Machine, options: &Options) -> Result<Plans, Refused> {
    let (travels, mut notes) = travels(machine, options)?;
    let mut plans = Vec::new();
    for travel in travels {
        let name = travel.axis.name();
        if machine.axes[travel.axis.index()].feedback == Feedback::Scale {
            let why = "its feedback is from a scale, which sees the backlash itself";
            if options.axes.contains(&travel.axis) {
                return Err(Refused(format!("no backlash to measure on {name}: {why}")));
            }
            notes.push(format!("no program for {name}: {why}"));
            continue;
        }
        plans.push(plan(&travel, options));
    }
    if plans.is_empty() {
        let why = "no axis with feedback from the screw has a known travel";
        return Err(Refused(format!("no backlash to measure: {why}")));
    }
    Ok((plans, notes))
}

fn plan(travel: &Travel, options: &Options) -> Plan {
    let axis = travel.axis;
    let [low, high] = travel.inside_mm();
    let places = [("near the lower end", low), ("in the middle", (low + high) / 2.0)];
    let places = places.into_iter().chain([("near the upper end", high)]);
    let is_dial = options.gauge == Gauge::Dial;
    let mut steps = Vec::new();
    let feeds = options.feeds();
    for (where_, at) in places {
        steps.push(Step::Note(format!("{} {where_}", capital(axis))));
        steps.push(Step::Rapid(travel.at(at)));
        if is_dial {
            let text = format!(
                "Set an indicator against the spindle, along {}, and to zero. Keep its holder short.",
                capital(axis)
            );
            steps.push(Step::Stop(text));
        }
        for feed in &feeds {
            let times = options.repeats.unwrap_or(REPEATS);
            steps.push(Step::Repeat { times, steps: cycle(travel, at, *feed, options) });
        }
    }
    let mut notes = vec![WITHOUT_CORRECTION.to_string()];
    if is_dial {
        notes.push(format!(
            "{} goes {CLEAR_MM} mm up and back between the readings: it must have the room.",
            capital(clearing(axis))
        ));
    }
    let mut columns = vec![Column::Run, Column::Position(axis.index())];
    columns.extend([Column::Direction(axis.index()), Column::Feed]);
    columns.push(Column::Empty(measured(axis)));
    Plan {
        name: format!("backlash-{}", axis.name()),
        notes,
        steps,
        columns,
        then: format!("trueup fit backlash --run backlash-{}.csv", axis.name()),
        records: Vec::new(),
    }
}

/// One cycle at a place, N10 to N80.
fn cycle(travel: &Travel, at: f64, feed: f64, options: &Options) -> Vec<Step> {
    let over = travel.over_travel_mm();
    let clear =
        |mm: f64| Step::By { axis: clearing(travel.axis).index(), mm, feed_mm_per_min: feed };
    let mut steps = vec![go(travel, at + over, feed), go(travel, at, feed)];
    steps.push(Step::Read(options.dwell_s));
    let is_dial = options.gauge == Gauge::Dial;
    steps.extend(is_dial.then(|| clear(CLEAR_MM)));
    steps.extend([go(travel, at - over, feed), go(travel, at, feed)]);
    steps.extend(is_dial.then(|| clear(-CLEAR_MM)));
    steps.push(Step::Read(options.dwell_s));
    steps
}

/// The axis that makes room for an indicator.
fn clearing(axis: LinearAxis) -> LinearAxis {
    if axis == LinearAxis::Z { LinearAxis::X } else { LinearAxis::Z }
}
