//! The kinds of measurement, a page each.

pub(crate) mod axis_heat;
pub(crate) mod backlash;
mod ball;
pub(crate) mod circle;
pub(crate) mod diagonal;
pub(crate) mod pitch;
pub(crate) mod plate;
mod probing;
pub(crate) mod sphere;
pub(crate) mod spindle_speed_run;
pub(crate) mod square;
pub(crate) mod step_diagonal;
pub(crate) mod straightness;
pub(crate) mod target_run;
pub(crate) mod warmup;

use trueup_machine::{
    Machine,
    machine_file::{LinearAxis, MachineKind},
};

use crate::{
    options::MeasurementOptions,
    plan::{MeasurementPlan, Step},
    program_error::ProgramError,
    travel::{AxisTravel, resolve_travels},
};

/// The plans of a kind, and notes of what has none.
type PlansWithNotes = (Vec<MeasurementPlan>, Vec<String>);

/// Returns the plan of each axis that may move, and a note for one that does not fit.
///
/// # Errors
/// None fits.
fn plan_each_axis(
    machine: &Machine,
    options: &MeasurementOptions,
    create_plan: impl Fn(
        &Machine,
        &AxisTravel,
        &MeasurementOptions,
    ) -> Result<MeasurementPlan, ProgramError>,
) -> Result<PlansWithNotes, ProgramError> {
    let (travels, mut notes) = resolve_travels(machine, options)?;
    notes.extend(unused_clearance_note(options));
    let mut plans = Vec::new();
    for travel in &travels {
        match create_plan(machine, travel, options) {
            Ok(plan) => plans.push(plan),
            Err(why) => notes.push(format!("no program for {}: {why}", travel.axis.name())),
        }
    }
    if plans.is_empty() { Err(ProgramError(notes.join("; "))) } else { Ok((plans, notes)) }
}

/// Returns the plan of each pair of axes, and a note for one that does not fit, or that there is no pair for the `name`.
///
/// # Errors
/// None fits.
fn plan_each_pair(
    travels: &[AxisTravel],
    mut notes: Vec<String>,
    name: &str,
    plan: impl Fn([&AxisTravel; 2]) -> Result<MeasurementPlan, ProgramError>,
) -> Result<PlansWithNotes, ProgramError> {
    let mut plans = Vec::new();
    for (n, first) in travels.iter().enumerate() {
        for second in &travels[n + 1..] {
            match plan([first, second]) {
                Ok(plan) => plans.push(plan),
                Err(why) => notes.push(why.0),
            }
        }
    }
    if let [one] = travels {
        let only = one.axis.name();
        let note = format!("a {name} needs two axes, and only {only} may move or is asked for");
        notes.insert(0, note);
    }
    if plans.is_empty() { Err(ProgramError(notes.join("; "))) } else { Ok((plans, notes)) }
}

/// Returns a move of one axis at a feed.
fn linear_move(travel: &AxisTravel, mm: f64, feed_mm_per_min: f64) -> Step {
    Step::Move { to_mm: travel.target_position_mm(mm), feed_mm_per_min }
}

/// Returns the steps from one end of the range to the other and back, `times` times, with a reading at each of the
/// rising `targets` from either side; the over-travels lie beyond the last ones. The retracted end comes first.
fn bidirectional_passes(
    travel: &AxisTravel,
    targets: Vec<f64>,
    times: u32,
    options: &MeasurementOptions,
) -> Vec<Step> {
    let feed = options.first_feed_mm_per_min();
    let targets = travel.arrange_in_approach_order(targets);
    let [start, far] = travel.ends_in_approach_order_mm();
    let read = |mm: &f64| [linear_move(travel, *mm, feed), Step::Read(options.dwell_s)];
    let mut run: Vec<Step> = targets.iter().flat_map(read).collect();
    run.push(linear_move(travel, far, feed));
    run.extend(targets.iter().rev().flat_map(read));
    run.push(linear_move(travel, start, feed));
    vec![travel.approach_step(start), Step::Repeat { times, steps: run }]
}

/// Returns the note that a clearance was given in vain.
fn unused_clearance_note(options: &MeasurementOptions) -> Option<String> {
    let (axis, _) = options.clearance_mm?;
    Some(format!("--clearance {}: only backlash with a dial makes room; not used", axis.name()))
}

/// Returns the parts of a plan that all kinds share; the rest is empty.
fn base_plan(machine: &Machine, options: &MeasurementOptions) -> MeasurementPlan {
    MeasurementPlan {
        precautions: head_zero_precaution(machine),
        approach_mm_per_min: options.approach_mm_per_min,
        is_lathe: machine.kind == MachineKind::Lathe,
        ..MeasurementPlan::default()
    }
}

/// Returns the precaution of a machine whose head turns: the directions hold with all angles at zero.
fn head_zero_precaution(machine: &Machine) -> Vec<String> {
    let axes: Vec<String> =
        machine.head_axes.iter().map(|axis| axis.name().to_uppercase()).collect();
    let precaution = format!("Head axes {} must stand at 0.", axes.join(", "));
    if axes.is_empty() { Vec::new() } else { vec![precaution] }
}

/// Targets as far apart as requested, else this many steps, but none longer than `longest_mm`.
fn evenly_spaced_targets_mm(
    travel: &AxisTravel,
    options: &MeasurementOptions,
    steps: f64,
    longest_mm: f64,
) -> Result<Vec<f64>, ProgramError> {
    let [low, high] = travel.target_range_mm();
    travel
        .evenly_spaced_targets_mm(options.step_mm.unwrap_or(((high - low) / steps).min(longest_mm)))
}

/// `x` of the axis as the operator calls it: `X`.
fn uppercase_axis_name(axis: LinearAxis) -> String {
    axis.name().to_uppercase()
}

/// Returns the column of the measured error of an axis.
fn measured_column_name(axis: LinearAxis) -> String {
    format!("measured_d{}_um", axis.name())
}

/// Returns the column of the temperature that an axis's law goes by.
fn temperature_column(machine: &Machine, axis: LinearAxis) -> String {
    let thermal = machine.axes[axis.index()].thermal.as_ref();
    thermal
        .map_or_else(|| format!("temp_screw_{}_c", axis.name()), |thermal| thermal.sensor.clone())
}

/// How a spindle is read while it turns.
const NON_CONTACT_PRECAUTION: &str =
    "Non-contact gauge only, eddy current, capacitive or laser: nothing may touch what turns.";

/// That all corrections of the control must be off.
const COMPENSATION_OFF_PRECAUTION: &str =
    "Switch the control's own compensation off first: what is measured is the bare machine.";
/// That `fit volume` needs the chain.
const MISSING_CHAIN_NOTE: &str = "machine.chain is missing: trueup fit volume needs it, for example chain = \"w X' b Y Z t\"; measuring does not";
