//! The growth of an axis that is run warm (paper 2): measured cold, then run to and fro for twenty
//! minutes and measured every 100 mm, round by round.

use trueup_machine::Machine;

use super::{Plans, all_that_fit, go, head_at_zero, measured, temperature, without_clearance};
use crate::{
    options::Options,
    plan::{Column, Plan, Step},
    refused::Refused,
    travel::{Travel, even, micrometres, travels},
};

/// Where, in mm (paper 2).
const RANGE_MM: [f64; 2] = [500.0, 1500.0];
/// From target to target, in mm (paper 2).
const STEP_MM: f64 = 100.0;
/// From measurement to measurement, in s (paper 2).
const HEAT_S: f64 = 1200.0;
/// Rounds of heat: two hours.
const ROUNDS: u32 = 6;
/// The most strokes of a round: FANUC repeats no more often.
const MAX_STROKES: f64 = 9999.0;

pub(crate) fn plans(machine: &Machine, options: &Options) -> Result<Plans, Refused> {
    let (travels, mut notes) = travels(machine, options)?;
    notes.extend(without_clearance(options));
    all_that_fit(&travels, notes, |travel| plan(machine, travel, options))
}

fn plan(machine: &Machine, travel: &Travel, options: &Options) -> Result<Plan, Refused> {
    let axis = travel.axis;
    let [low, high] = range(travel, options);
    let step = options.step_mm.unwrap_or(STEP_MM.min((high - low) / 4.0));
    let targets = even(low, high, step).ok_or_else(|| {
        Refused(format!("--step-mm {step} does not fit into {low} to {high} mm of {}", axis.name()))
    })?;
    let heat_feed = options.heat_feed_mm_per_min;
    let strokes =
        (options.heat_s.unwrap_or(HEAT_S) * heat_feed / 60.0 / (2.0 * (high - low))).ceil();
    if strokes > MAX_STROKES {
        return Err(Refused(format!(
            "{strokes} strokes from {low} to {high} mm in a round: give a longer range or a lower \
             --heat-feed"
        )));
    }
    let [near, far] = travel.ordered([low, high]);
    let over_mm = travel.over_travel_mm();
    let before = micrometres(if travel.starts_high() { near + over_mm } else { near - over_mm });
    let targets = travel.ordered(targets);
    let feed = options.feed();
    let measure = || {
        let read = |mm: &f64| [go(travel, *mm, feed), Step::Read(options.dwell_s)];
        let approach = [go(travel, before, feed)];
        approach.into_iter().chain(targets.iter().flat_map(read)).collect::<Vec<Step>>()
    };
    let stroke = vec![go(travel, far, heat_feed), go(travel, near, heat_feed)];
    // A number of strokes is whole and in range.
    let heat = Step::Repeat { times: strokes as u32, steps: stroke };
    // Measured first, so that the first round is the cold one; the heat of the last would be wasted.
    let mut round = measure();
    round.extend([go(travel, near, heat_feed), heat]);
    let rounds = options.repeats.unwrap_or(ROUNDS);
    let [start, _] = travel.start_and_far_mm();
    // A tool axis is retracted before it goes to its first place.
    let mut steps: Vec<Step> = travel.retract.map(|_| travel.approach(start)).into_iter().collect();
    steps.extend([travel.approach(near), Step::Repeat { times: rounds, steps: round }]);
    steps.push(Step::Note("the last measurement".into()));
    steps.extend(measure());
    let mut columns = vec![Column::Empty("time_s".into()), Column::Position(axis.index())];
    columns.push(Column::Direction(axis.index()));
    columns.push(Column::Empty(temperature(machine, axis)));
    columns.push(Column::Empty(measured(axis)));
    let notes = [
        "Begin with a machine that has stood still over night.",
        "Write down the screw's temperature and the time at each reading, or let a logger do it.",
    ];
    Ok(Plan {
        name: format!("axis-heat-{}", axis.name()),
        notes: notes.map(String::from).into(),
        precautions: head_at_zero(machine).into_iter().collect(),
        approach_mm_per_min: options.approach_mm_per_min,
        steps,
        columns,
        then: vec![format!("trueup fit thermal --run axis-heat-{}.csv", axis.name())],
        is_lathe: false,
        records: Vec::new(),
    })
}

/// Returns the range that is asked for, else the paper's as far as the travel has it, else all of that.
fn range(travel: &Travel, options: &Options) -> [f64; 2] {
    let [inside_low, inside_high] = travel.inside_mm();
    let (low, high) = (inside_low.max(RANGE_MM[0]), inside_high.min(RANGE_MM[1]));
    let is_asked_for = options.range_mm[travel.axis.index()].is_some();
    // Half of the paper's metre is worth more than places that it names.
    let is_enough = high - low >= 0.5 * (RANGE_MM[1] - RANGE_MM[0]);
    if is_enough && !is_asked_for { [low, high] } else { [inside_low, inside_high] }
}
