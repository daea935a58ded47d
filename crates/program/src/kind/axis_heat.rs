//! The growth of an axis that is run warm (seed 002): measured cold, then run to and fro for twenty
//! minutes and measured every 100 mm, round by round.

use trueup_machine::Machine;

use super::{Plans, go, measured, temperature};
use crate::{
    options::Options,
    plan::{Column, Plan, Step},
    refused::Refused,
    travel::{Travel, even, micrometres, travels},
};

/// Where, in mm (seed 002).
const RANGE_MM: [f64; 2] = [500.0, 1500.0];
/// From target to target, in mm (seed 002).
const STEP_MM: f64 = 100.0;
/// From measurement to measurement, in s (seed 002).
const HEAT_S: f64 = 1200.0;
/// Rounds of heat: two hours.
const ROUNDS: u32 = 6;
/// The most strokes of a round: FANUC repeats no more often.
const MOST_STROKES: f64 = 9999.0;

pub(crate) fn plans(machine: &Machine, options: &Options) -> Result<Plans, Refused> {
    let (travels, notes) = travels(machine, options)?;
    let plans =
        travels.iter().map(|travel| plan(machine, travel, options)).collect::<Result<_, _>>()?;
    Ok((plans, notes))
}

fn plan(machine: &Machine, travel: &Travel, options: &Options) -> Result<Plan, Refused> {
    let axis = travel.axis;
    let [low, high] = range(travel, options)?;
    let step = options.step_mm.unwrap_or(STEP_MM.min((high - low) / 4.0));
    let targets = even(low, high, step).ok_or_else(|| {
        Refused(format!("--step-mm {step} does not fit into {low} to {high} mm of {}", axis.name()))
    })?;
    let heat_feed = options.heat_feed_mm_per_min;
    let strokes =
        (options.heat_s.unwrap_or(HEAT_S) * heat_feed / 60.0 / (2.0 * (high - low))).ceil();
    if strokes > MOST_STROKES {
        return Err(Refused(format!(
            "{strokes} strokes from {low} to {high} mm in a round: give a longer range or a lower \
             --heat-feed"
        )));
    }
    let before = micrometres(low - travel.over_travel_mm());
    let feed = options.feed();
    let measure = || {
        let read = |mm: &f64| [go(travel, *mm, feed), Step::Read(options.dwell_s)];
        let approach = [go(travel, before, feed)];
        approach.into_iter().chain(targets.iter().flat_map(read)).collect::<Vec<Step>>()
    };
    let stroke = vec![go(travel, high, heat_feed), go(travel, low, heat_feed)];
    // A number of strokes is whole and in range.
    let heat = Step::Repeat { times: strokes as u32, steps: stroke };
    // Measured first, so that the first round is the cold one; the heat of the last would be wasted.
    let mut round = measure();
    round.extend([go(travel, low, heat_feed), heat]);
    let rounds = options.repeats.unwrap_or(ROUNDS);
    let mut steps = vec![Step::Rapid(travel.at(low)), Step::Repeat { times: rounds, steps: round }];
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
        steps,
        columns,
        then: format!("trueup fit thermal --run axis-heat-{}.csv", axis.name()),
        records: Vec::new(),
    })
}

/// The range that is asked for, else the paper's as far as the travel has it, else all of that.
fn range(travel: &Travel, options: &Options) -> Result<[f64; 2], Refused> {
    let [inside_low, inside_high] = travel.inside_mm();
    if let Some([low, high]) = options.heat_range_mm {
        if !(inside_low <= low && low < high && high <= inside_high) {
            return Err(Refused(format!(
                "--range-mm {low}:{high} does not fit: {} may be run warm from {inside_low} to \
                 {inside_high} mm",
                travel.axis.name()
            )));
        }
        return Ok([low, high].map(micrometres));
    }
    let (low, high) = (inside_low.max(RANGE_MM[0]), inside_high.min(RANGE_MM[1]));
    // Half of the paper's metre is worth more than places that it names.
    let is_enough = high - low >= 0.5 * (RANGE_MM[1] - RANGE_MM[0]);
    Ok(if is_enough { [low, high] } else { [inside_low, inside_high] })
}
