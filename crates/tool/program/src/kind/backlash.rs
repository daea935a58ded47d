//! Backlash at the middle and near both ends, seven times each (paper 4, N10…N90).
//!
//! At each place the axis goes beyond it and comes back, is read, goes beyond on the other side and
//! comes back, is read again. The largest mean is the backlash.
//!
//! | gauge | the other side | needs |
//! |---|---|---|
//! | laser | the whole over-travel | nothing |
//! | dial with `--clearance` | the whole over-travel, past the dial, which another axis has made room for | the room |
//! | dial alone | half a millimetre into the dial | as much of its stroke |

use trueup_machine::{
    Machine,
    file::{Feedback, Kind, LinearAxis},
};

use super::{Plans, WITHOUT_CORRECTION, capital, go, head_at_zero, measured};
use crate::{
    options::{Gauge, Options},
    plan::{Column, Plan, Step},
    refused::Refused,
    travel::{Travel, micrometres, retract, travel, travels},
};

/// How often at each place: "generally seven" (paper 4).
const REPEATS: u32 = 7;
/// How far an axis reverses into a dial that stays where it is, in mm: many times the play of a worn axis, and
/// within the stroke of a plunger dial.
const PRESS_MM: f64 = 0.5;

pub(crate) fn plans(machine: &Machine, options: &Options) -> Result<Plans, Refused> {
    let (travels, mut notes) = travels(machine, options)?;
    let room = Room::of(machine, options)?;
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
        let room = room.filter(|room| room.axis != travel.axis);
        plans.push(plan(machine, &travel, room, options));
    }
    if plans.is_empty() {
        let why = "no axis with feedback from the screw may move";
        notes.insert(0, format!("no backlash to measure: {why}"));
        return Err(Refused(notes.join("; ")));
    }
    Ok((plans, notes))
}

/// Another axis that makes room for a dial: two places in machine coordinates, so that nothing depends on where the
/// axis stood.
#[derive(Clone, Copy)]
struct Room {
    axis: LinearAxis,
    /// Where the dial touches, in mm.
    at_mm: f64,
    /// Where it is free, in mm.
    clear_mm: f64,
}

impl Room {
    /// Returns the room that `--clearance` asks for: around the middle of the axis's range, or from the retracted
    /// end of a tool axis.
    fn of(machine: &Machine, options: &Options) -> Result<Option<Self>, Refused> {
        let Some((axis, mm)) = options.clearance_mm else { return Ok(None) };
        if gauge(options) != Gauge::Dial {
            return Ok(None);
        }
        let name = axis.name();
        let refused = |why: &str| Refused(format!("--clearance {name}={mm}: {why}"));
        let range = travel(machine, options, axis)?.map_err(|why| refused(&why))?;
        if mm.abs() > range.length_mm() {
            return Err(refused(&format!(
                "{name} may move from {} to {} mm only",
                range.low_mm, range.high_mm
            )));
        }
        let (at_mm, clear_mm) = match retract(machine, axis) {
            Some(way) if way * mm < 0.0 => {
                return Err(refused("the tool would move towards the part; change the sign"));
            }
            Some(_) => {
                let [retracted, _] = range.start_and_far_mm();
                (retracted - mm, retracted)
            }
            None => {
                let middle = (range.low_mm + range.high_mm) / 2.0;
                (middle - mm / 2.0, middle + mm / 2.0)
            }
        };
        Ok(Some(Self { axis, at_mm: micrometres(at_mm), clear_mm: micrometres(clear_mm) }))
    }

    fn clear(&self) -> Step {
        Step::Approach { axis: self.axis.index(), to_mm: self.clear_mm }
    }

    fn back(&self) -> Step {
        Step::Approach { axis: self.axis.index(), to_mm: self.at_mm }
    }
}

fn gauge(options: &Options) -> Gauge {
    options.gauge.unwrap_or_default()
}

fn plan(machine: &Machine, travel: &Travel, room: Option<Room>, options: &Options) -> Plan {
    let axis = travel.axis;
    let [low, high] = travel.inside_mm();
    let places = travel.ordered([low, (low + high) / 2.0, high]);
    let is_dial = gauge(options) == Gauge::Dial;
    let [start, _] = travel.start_and_far_mm();
    // A tool axis is retracted before it goes to its first place.
    let mut steps: Vec<Step> = travel.retract.map(|_| travel.approach(start)).into_iter().collect();
    let feeds = options.feeds();
    for (n, at) in places.into_iter().enumerate() {
        let at = micrometres(at);
        if is_dial && n > 0 {
            steps.push(Step::Stop(vec![
                "Take the dial away.".into(),
                format!("{} goes to {at} mm next: its way must be clear.", capital(axis)),
            ]));
        }
        let room = room.filter(|_| is_dial);
        steps.extend(room.as_ref().map(Room::clear));
        steps.push(travel.approach(at));
        steps.extend(room.as_ref().map(Room::back));
        if is_dial {
            steps.push(Step::Stop(set_dial(machine, travel, room, options)));
            // Should somebody have jogged, increments begin at the right place all the same.
            steps.extend(room.as_ref().map(Room::back));
            steps.push(travel.approach(at));
        }
        for feed in &feeds {
            let times = options.repeats.unwrap_or(REPEATS);
            steps.push(Step::Repeat { times, steps: cycle(travel, at, *feed, room, options) });
        }
    }
    let mut columns = vec![Column::Run, Column::Position(axis.index())];
    columns.extend([Column::Direction(axis.index()), Column::Feed]);
    columns.push(Column::Empty(measured(axis)));
    let mut precautions: Vec<String> = head_at_zero(machine).into_iter().collect();
    if is_dial {
        precautions.push("No dial yet: the program stops for it.".into());
    }
    Plan {
        name: format!("backlash-{}", axis.name()),
        notes: vec![WITHOUT_CORRECTION.to_string()],
        precautions,
        approach_mm_per_min: options.approach_mm_per_min,
        steps,
        columns,
        then: vec![format!("trueup fit backlash --run backlash-{}.csv", axis.name())],
        is_lathe: false,
        records: Vec::new(),
    }
}

/// Returns which way the axis leaves the dial: +1, −1. The tool axis leaves it by retracting.
fn away(travel: &Travel) -> f64 {
    travel.retract.unwrap_or(1.0)
}

/// Returns how far the axis goes on the side of the dial, in mm.
fn beyond_mm(travel: &Travel, room: Option<Room>, options: &Options) -> f64 {
    let over_mm = travel.over_travel_mm();
    let is_pressed = gauge(options) == Gauge::Dial && room.is_none();
    if is_pressed { over_mm.min(PRESS_MM) } else { over_mm }
}

/// Where the dial stands, and what moves next.
fn set_dial(
    machine: &Machine,
    travel: &Travel,
    room: Option<Room>,
    options: &Options,
) -> Vec<String> {
    let (name, over_mm) = (capital(travel.axis), travel.over_travel_mm());
    let sign = if away(travel) > 0.0 { '+' } else { '-' };
    let beyond_mm = beyond_mm(travel, room, options);
    let place = if machine.kind == Kind::Lathe { " between turret and chuck," } else { "" };
    let mut text = vec![
        format!(
            "Set a dial{place} along {name}, on a short holder, so that {name}{sign} leaves it; zero it."
        ),
        format!(
            "{name} moves {over_mm} mm to {sign} and back, then {beyond_mm} mm to the other side."
        ),
    ];
    text.push(match room {
        Some(Room { axis, at_mm, clear_mm }) => format!(
            "In between {} goes from {at_mm} to {clear_mm} mm and back: both ways must be clear.",
            capital(axis)
        ),
        None => format!(
            "The dial is pressed by {beyond_mm} mm: leave it twice that stroke. All else must be clear."
        ),
    });
    text
}

/// Returns one cycle at a place, N10 to N80.
fn cycle(travel: &Travel, at: f64, feed: f64, room: Option<Room>, options: &Options) -> Vec<Step> {
    let (away, over) = (away(travel), travel.over_travel_mm());
    let beyond = beyond_mm(travel, room, options);
    let mut steps = vec![go(travel, at + away * over, feed), go(travel, at, feed)];
    steps.push(Step::Read(options.dwell_s));
    steps.extend(room.as_ref().map(Room::clear));
    steps.extend([go(travel, at - away * beyond, feed), go(travel, at, feed)]);
    steps.extend(room.as_ref().map(Room::back));
    steps.push(Step::Read(options.dwell_s));
    steps
}
