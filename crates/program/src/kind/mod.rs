//! The kinds of measurement, a page each.

pub(crate) mod axis_heat;
pub(crate) mod backlash;
pub(crate) mod diagonal;
pub(crate) mod pitch;
pub(crate) mod speeds;
pub(crate) mod straightness;
pub(crate) mod targets;
pub(crate) mod warmup;

use trueup_machine::{Machine, file::LinearAxis};

use crate::{
    options::Options,
    plan::{Plan, Step},
    refused::Refused,
    travel::Travel,
};

/// What a kind gives: its plans, and notes of what has none.
type Plans = (Vec<Plan>, Vec<String>);

/// A move of one axis at a feed.
fn go(travel: &Travel, mm: f64, feed_mm_per_min: f64) -> Step {
    Step::Move { to_mm: travel.at(mm), feed_mm_per_min }
}

/// From one end of the travel to the other and back, so often, with a reading at each target: each is come to
/// from either side, and both over-travels lie beyond the last ones.
fn there_and_back(travel: &Travel, targets: &[f64], times: u32, options: &Options) -> Vec<Step> {
    let feed = options.feed();
    let read = |mm: &f64| [go(travel, *mm, feed), Step::Read(options.dwell_s)];
    let mut run: Vec<Step> = targets.iter().flat_map(read).collect();
    run.push(go(travel, travel.high_mm, feed));
    run.extend(targets.iter().rev().flat_map(read));
    run.push(go(travel, travel.low_mm, feed));
    vec![Step::Rapid(travel.at(travel.low_mm)), Step::Repeat { times, steps: run }]
}

/// Targets as far apart as asked for, else so many steps, but none longer than `longest_mm`.
fn even_targets_mm(
    travel: &Travel,
    options: &Options,
    steps: f64,
    longest_mm: f64,
) -> Result<Vec<f64>, Refused> {
    let [low, high] = travel.inside_mm();
    travel.even_targets_mm(options.step_mm.unwrap_or(((high - low) / steps).min(longest_mm)))
}

/// `x` of the axis as the operator calls it: `X`.
fn capital(axis: LinearAxis) -> String {
    axis.name().to_uppercase()
}

/// The column of the measured error of an axis.
fn measured(axis: LinearAxis) -> String {
    format!("measured_d{}_um", axis.name())
}

/// The column of the temperature that an axis's law goes by.
fn temperature(machine: &Machine, axis: LinearAxis) -> String {
    let thermal = machine.axes[axis.index()].thermal.as_ref();
    thermal
        .map_or_else(|| format!("temp_screw_{}_c", axis.name()), |thermal| thermal.sensor.clone())
}

/// That all corrections of the control must be off.
const WITHOUT_CORRECTION: &str =
    "Switch the control's own compensation off first: what is measured is the bare machine.";
