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
    machine_file::{Feedback, LinearAxis, MachineKind},
};

use super::{
    COMPENSATION_OFF_PRECAUTION, PlansWithNotes, base_plan, head_zero_precaution, linear_move,
    measured_column_name, uppercase_axis_name,
};
use crate::{
    options::{MeasurementOptions, MeasuringInstrument},
    plan::{Column, MeasurementPlan, Step},
    program_error::ProgramError,
    travel::{
        AxisTravel, resolve_travel, resolve_travels, retract_direction, round_to_micrometres,
    },
};

/// How often at each place: "generally seven" (paper 4).
const DEFAULT_REPEATS: u32 = 7;
/// How far an axis reverses into a dial that stays where it is, in mm: many times the play of a worn axis, and
/// within the stroke of a plunger dial.
const MAX_DIAL_REVERSAL_MM: f64 = 0.5;

pub(crate) fn create_plans(
    machine: &Machine,
    options: &MeasurementOptions,
) -> Result<PlansWithNotes, ProgramError> {
    let (travels, mut notes) = resolve_travels(machine, options)?;
    let room = ClearanceMove::from_options(machine, options)?;
    let mut plans = Vec::new();
    for travel in travels {
        let name = travel.axis.name();
        if machine.axes[travel.axis.index()].feedback == Feedback::Scale {
            let why = "its feedback is from a scale, which sees the backlash itself";
            if options.axes.contains(&travel.axis) {
                return Err(ProgramError(format!("no backlash to measure on {name}: {why}")));
            }
            notes.push(format!("no program for {name}: {why}"));
            continue;
        }
        let room = room.filter(|room| room.axis != travel.axis);
        plans.push(create_plan(machine, &travel, room, options));
    }
    if plans.is_empty() {
        let why = "no axis with feedback from the screw may move";
        notes.insert(0, format!("no backlash to measure: {why}"));
        return Err(ProgramError(notes.join("; ")));
    }
    Ok((plans, notes))
}

/// Another axis that makes room for a dial: two places in machine coordinates, so that nothing depends on where the
/// axis stood.
#[derive(Clone, Copy)]
struct ClearanceMove {
    axis: LinearAxis,
    /// Where the dial touches, in mm.
    at_mm: f64,
    /// Where it is free, in mm.
    clear_mm: f64,
}

impl ClearanceMove {
    /// Returns the room that `--clearance` requests: around the middle of the axis's range, or from the retracted
    /// end of a tool axis.
    fn from_options(
        machine: &Machine,
        options: &MeasurementOptions,
    ) -> Result<Option<Self>, ProgramError> {
        let Some((axis, mm)) = options.clearance_mm else { return Ok(None) };
        if selected_instrument(options) != MeasuringInstrument::Dial {
            return Ok(None);
        }
        let name = axis.name();
        let refused = |why: &str| ProgramError(format!("--clearance {name}={mm}: {why}"));
        let range = resolve_travel(machine, options, axis)?.map_err(|why| refused(&why))?;
        if mm.abs() > range.length_mm() {
            return Err(refused(&format!(
                "{name} may move from {} to {} mm only",
                range.low_mm, range.high_mm
            )));
        }
        let (at_mm, clear_mm) = match retract_direction(machine, axis) {
            Some(way) if way * mm < 0.0 => {
                return Err(refused("the tool would move towards the part; change the sign"));
            }
            Some(_) => {
                let [retracted, _] = range.ends_in_approach_order_mm();
                (retracted - mm, retracted)
            }
            None => {
                let middle = (range.low_mm + range.high_mm) / 2.0;
                (middle - mm / 2.0, middle + mm / 2.0)
            }
        };
        Ok(Some(Self {
            axis,
            at_mm: round_to_micrometres(at_mm),
            clear_mm: round_to_micrometres(clear_mm),
        }))
    }

    fn clearance_move(&self) -> Step {
        Step::Approach { axis: self.axis.index(), to_mm: self.clear_mm }
    }

    fn return_move(&self) -> Step {
        Step::Approach { axis: self.axis.index(), to_mm: self.at_mm }
    }
}

fn selected_instrument(options: &MeasurementOptions) -> MeasuringInstrument {
    options.gauge.unwrap_or_default()
}

fn create_plan(
    machine: &Machine,
    travel: &AxisTravel,
    room: Option<ClearanceMove>,
    options: &MeasurementOptions,
) -> MeasurementPlan {
    let axis = travel.axis;
    let [low, high] = travel.target_range_mm();
    let places = travel.arrange_in_approach_order([low, (low + high) / 2.0, high]);
    let is_dial = selected_instrument(options) == MeasuringInstrument::Dial;
    let [start, _] = travel.ends_in_approach_order_mm();
    // A tool axis is retracted before it goes to its first place.
    let mut steps: Vec<Step> =
        travel.retract.map(|_| travel.approach_step(start)).into_iter().collect();
    let feeds = options.feeds_mm_per_min();
    for (n, at) in places.into_iter().enumerate() {
        let at = round_to_micrometres(at);
        if is_dial && n > 0 {
            steps.push(Step::Stop(vec![
                "Take the dial away.".into(),
                format!(
                    "{} goes to {at} mm next: its way must be clear.",
                    uppercase_axis_name(axis)
                ),
            ]));
        }
        let room = room.filter(|_| is_dial);
        steps.extend(room.as_ref().map(ClearanceMove::clearance_move));
        steps.push(travel.approach_step(at));
        steps.extend(room.as_ref().map(ClearanceMove::return_move));
        if is_dial {
            steps.push(Step::Stop(dial_setup_instructions(machine, travel, room, options)));
            // If the axis was jogged, increments begin at the right place all the same.
            steps.extend(room.as_ref().map(ClearanceMove::return_move));
            steps.push(travel.approach_step(at));
        }
        for feed in &feeds {
            let times = options.repeats.unwrap_or(DEFAULT_REPEATS);
            steps
                .push(Step::Repeat { times, steps: cycle_steps(travel, at, *feed, room, options) });
        }
    }
    let mut columns = vec![Column::Run, Column::Position(axis.index())];
    columns.extend([Column::Direction(axis.index()), Column::Feed]);
    columns.push(Column::Empty(measured_column_name(axis)));
    let mut precautions = head_zero_precaution(machine);
    if is_dial {
        precautions.push("No dial yet: the program stops for it.".into());
    }
    MeasurementPlan {
        name: format!("backlash-{}", axis.name()),
        notes: vec![COMPENSATION_OFF_PRECAUTION.to_string()],
        precautions,
        steps,
        columns,
        then: vec![format!("trueup fit backlash --run backlash-{}.csv", axis.name())],
        ..base_plan(machine, options)
    }
}

/// Returns which way the axis leaves the dial: +1, −1. The tool axis leaves it by retracting.
fn dial_exit_direction(travel: &AxisTravel) -> f64 {
    travel.retract.unwrap_or(1.0)
}

/// Returns how far the axis goes on the side of the dial, in mm.
fn dial_side_travel_mm(
    travel: &AxisTravel,
    room: Option<ClearanceMove>,
    options: &MeasurementOptions,
) -> f64 {
    let over_mm = travel.over_travel_mm();
    let is_pressed = selected_instrument(options) == MeasuringInstrument::Dial && room.is_none();
    if is_pressed { over_mm.min(MAX_DIAL_REVERSAL_MM) } else { over_mm }
}

/// Where the dial stands, and what moves next.
fn dial_setup_instructions(
    machine: &Machine,
    travel: &AxisTravel,
    room: Option<ClearanceMove>,
    options: &MeasurementOptions,
) -> Vec<String> {
    let (name, over_mm) = (uppercase_axis_name(travel.axis), travel.over_travel_mm());
    let sign = if dial_exit_direction(travel) > 0.0 { '+' } else { '-' };
    let beyond_mm = dial_side_travel_mm(travel, room, options);
    let place = if machine.kind == MachineKind::Lathe { " between turret and chuck," } else { "" };
    let mut text = vec![
        format!(
            "Set a dial{place} along {name}, on a short holder, so that {name}{sign} leaves it; zero it."
        ),
        format!(
            "{name} moves {over_mm} mm to {sign} and back, then {beyond_mm} mm to the other side."
        ),
    ];
    text.push(match room {
        Some(ClearanceMove { axis, at_mm, clear_mm }) => format!(
            "In between {} goes from {at_mm} to {clear_mm} mm and back: both ways must be clear.",
            uppercase_axis_name(axis)
        ),
        None => format!(
            "The dial is pressed by {beyond_mm} mm: leave it twice that stroke. All else must be clear."
        ),
    });
    text
}

/// Returns one cycle at a place, N10 to N80.
fn cycle_steps(
    travel: &AxisTravel,
    at: f64,
    feed: f64,
    room: Option<ClearanceMove>,
    options: &MeasurementOptions,
) -> Vec<Step> {
    let (away, over) = (dial_exit_direction(travel), travel.over_travel_mm());
    let beyond = dial_side_travel_mm(travel, room, options);
    let mut steps =
        vec![linear_move(travel, at + away * over, feed), linear_move(travel, at, feed)];
    steps.push(Step::Read(options.dwell_s));
    steps.extend(room.as_ref().map(ClearanceMove::clearance_move));
    steps.extend([linear_move(travel, at - away * beyond, feed), linear_move(travel, at, feed)]);
    steps.extend(room.as_ref().map(ClearanceMove::return_move));
    steps.push(Step::Read(options.dwell_s));
    steps
}
