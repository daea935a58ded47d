//! The growth of an axis that is run warm (paper 2): measured cold, then run to and fro for twenty
//! minutes and measured every 100 mm, round by round.

use trueup_machine::Machine;

use super::{
    PlansWithNotes, base_plan, linear_move, measured_column_name, plan_each_axis,
    temperature_column,
};
use crate::{
    options::MeasurementOptions,
    plan::{Column, MeasurementPlan, Step},
    program_error::ProgramError,
    travel::{AxisTravel, evenly_spaced_positions_mm, round_to_micrometres},
};

/// Where, in mm (paper 2).
const DEFAULT_MEASURED_RANGE_MM: [f64; 2] = [500.0, 1500.0];
/// From target to target, in mm (paper 2).
const MAX_TARGET_STEP_MM: f64 = 100.0;
/// From measurement to measurement, in s (paper 2).
const DEFAULT_HEATING_ROUND_S: f64 = 1200.0;
/// Rounds of heat: two hours.
const DEFAULT_HEATING_ROUNDS: u32 = 6;
/// The most strokes of a round: FANUC repeats no more often.
const MAX_STROKES_PER_ROUND: f64 = 9999.0;

pub(crate) fn create_plans(
    machine: &Machine,
    options: &MeasurementOptions,
) -> Result<PlansWithNotes, ProgramError> {
    plan_each_axis(machine, options, create_plan)
}

fn create_plan(
    machine: &Machine,
    travel: &AxisTravel,
    options: &MeasurementOptions,
) -> Result<MeasurementPlan, ProgramError> {
    let axis = travel.axis;
    let [low, high] = select_measured_range_mm(travel, options);
    let step = options.step_mm.unwrap_or(MAX_TARGET_STEP_MM.min((high - low) / 4.0));
    let targets = evenly_spaced_positions_mm(low, high, step).ok_or_else(|| {
        ProgramError(format!(
            "--step-mm {step} does not fit into {low} to {high} mm of {}",
            axis.name()
        ))
    })?;
    let heat_feed = options.heat_feed_mm_per_min;
    let strokes = (options.heat_s.unwrap_or(DEFAULT_HEATING_ROUND_S) * heat_feed
        / 60.0
        / (2.0 * (high - low)))
        .ceil();
    if strokes > MAX_STROKES_PER_ROUND {
        return Err(ProgramError(format!(
            "{strokes} strokes from {low} to {high} mm in a round: give a longer range or a lower \
             --heat-feed"
        )));
    }
    let [near, far] = travel.arrange_in_approach_order([low, high]);
    let over_mm = travel.over_travel_mm();
    let before = round_to_micrometres(if travel.starts_at_upper_end() {
        near + over_mm
    } else {
        near - over_mm
    });
    let targets = travel.arrange_in_approach_order(targets);
    let feed = options.first_feed_mm_per_min();
    let measure = || {
        let read = |mm: &f64| [linear_move(travel, *mm, feed), Step::Read(options.dwell_s)];
        let approach = [linear_move(travel, before, feed)];
        approach.into_iter().chain(targets.iter().flat_map(read)).collect::<Vec<Step>>()
    };
    let stroke = vec![linear_move(travel, far, heat_feed), linear_move(travel, near, heat_feed)];
    // A number of strokes is whole and in range.
    let heat = Step::Repeat { times: strokes as u32, steps: stroke };
    // Measured first, so that the first round is the cold one; the heat of the last would be wasted.
    let mut round = measure();
    round.extend([linear_move(travel, near, heat_feed), heat]);
    let rounds = options.repeats.unwrap_or(DEFAULT_HEATING_ROUNDS);
    let [start, _] = travel.ends_in_approach_order_mm();
    // A tool axis is retracted before it goes to its first place.
    let mut steps: Vec<Step> =
        travel.retract.map(|_| travel.approach_step(start)).into_iter().collect();
    steps.extend([travel.approach_step(near), Step::Repeat { times: rounds, steps: round }]);
    steps.push(Step::Note("the last measurement".into()));
    steps.extend(measure());
    let mut columns = vec![Column::Empty("time_s".into()), Column::Position(axis.index())];
    columns.push(Column::Direction(axis.index()));
    columns.push(Column::Empty(temperature_column(machine, axis)));
    columns.push(Column::Empty(measured_column_name(axis)));
    let notes = [
        "Begin with a machine that has stood still over night.",
        "Write down the screw's temperature and the time at each reading, or let a logger do it.",
    ];
    Ok(MeasurementPlan {
        name: format!("axis-heat-{}", axis.name()),
        notes: notes.map(String::from).into(),
        steps,
        columns,
        then: vec![format!("trueup fit thermal --run axis-heat-{}.csv", axis.name())],
        ..base_plan(machine, options)
    })
}

/// Returns the range that is requested, else the paper's as far as the travel has it, else all of that.
fn select_measured_range_mm(travel: &AxisTravel, options: &MeasurementOptions) -> [f64; 2] {
    let [inside_low, inside_high] = travel.target_range_mm();
    let (low, high) = (
        inside_low.max(DEFAULT_MEASURED_RANGE_MM[0]),
        inside_high.min(DEFAULT_MEASURED_RANGE_MM[1]),
    );
    let is_requested = options.range_mm[travel.axis.index()].is_some();
    // Half of the paper's metre is worth more than places that it names.
    let is_enough =
        high - low >= 0.5 * (DEFAULT_MEASURED_RANGE_MM[1] - DEFAULT_MEASURED_RANGE_MM[0]);
    if is_enough && !is_requested { [low, high] } else { [inside_low, inside_high] }
}
