//! Position errors there and back over uneven targets (ISO 230-2; paper 4).
//!
//! Targets of equal distance may all stand on the same phase of the screw, and its periodic error is
//! then invisible. So each is moved on by a share of the step, r·step with r from 0 to a quarter, in the
//! sequence n·φ mod 1 (φ the golden ratio), which fills any phase evenly and is the same each time.

use trueup_machine::Machine;

use super::{
    COMPENSATION_OFF_PRECAUTION, PlansWithNotes, base_plan, bidirectional_passes,
    evenly_spaced_targets_mm, measured_column_name, plan_each_axis,
};
use crate::{
    options::MeasurementOptions,
    plan::{Column, MeasurementPlan},
    program_error::ProgramError,
    travel::{AxisTravel, round_to_micrometres},
};

/// Runs in each direction (ISO 230-2).
const DEFAULT_REPEATS: u32 = 5;
/// This many steps on an axis, at least (ISO 230-2 has 5 a metre; a table wants more).
const MIN_STEPS: f64 = 20.0;
/// And at most so far from target to target, in mm (ISO 230-2, axes above 2 m).
const MAX_TARGET_STEP_MM: f64 = 250.0;
/// How far a target may be moved on, as a share of the step.
const MAX_TARGET_SHIFT_RATIO: f64 = 0.25;
/// The golden ratio less 1.
const INVERSE_GOLDEN_RATIO: f64 = 0.618_033_988_749_895;

pub(crate) fn create_plans(
    machine: &Machine,
    options: &MeasurementOptions,
) -> Result<PlansWithNotes, ProgramError> {
    let (plans, notes) = plan_each_axis(machine, options, create_plan)?;
    Ok((plans.into_iter().flat_map(|plan| split_plan_by_drive(machine, plan)).collect(), notes))
}

/// Returns the plan, or of an axis with two drives one for each: the beam's axis stands where the other drive does not
/// count. The program does not move it; the operator jogs it there.
fn split_plan_by_drive(machine: &Machine, plan: MeasurementPlan) -> Vec<MeasurementPlan> {
    let moved = plan.columns.iter().find_map(|column| match column {
        Column::Position(axis) => Some(*axis),
        _ => None,
    });
    let Some(dual) = moved.and_then(|axis| machine.axes[axis].dual.as_ref()) else {
        return vec![plan];
    };
    let across = dual.across.index();
    let both = [("drive1", "first", dual.first_mm), ("drive2", "second", dual.second_mm)];
    let names = both.map(|(suffix, ..)| format!("{}-{suffix}", plan.name));
    both.into_iter()
        .zip(&names)
        .map(|((_, which, mm), name)| {
            let mut plan = plan.clone();
            plan.name.clone_from(name);
            let beam = dual.across.name().to_uppercase();
            plan.precautions.insert(0, format!("{beam} stands at {mm} mm, at the {which} drive."));
            let at = plan.columns.len() - 1;
            plan.columns.insert(at, Column::Stands(across, mm));
            plan.then =
                vec![format!("trueup fit pitch --run {}.csv --run {}.csv", names[0], names[1])];
            plan
        })
        .collect()
}

fn create_plan(
    machine: &Machine,
    travel: &AxisTravel,
    options: &MeasurementOptions,
) -> Result<MeasurementPlan, ProgramError> {
    let axis = travel.axis;
    let times = options.repeats.unwrap_or(DEFAULT_REPEATS);
    let steps = bidirectional_passes(travel, compute_targets_mm(travel, options)?, times, options);
    let mut columns = vec![Column::Run, Column::Position(axis.index())];
    columns.extend([Column::Direction(axis.index()), Column::Empty(measured_column_name(axis))]);
    Ok(MeasurementPlan {
        name: format!("pitch-{}", axis.name()),
        notes: vec![COMPENSATION_OFF_PRECAUTION.to_string()],
        steps,
        columns,
        then: vec![format!("trueup fit pitch --run pitch-{}.csv", axis.name())],
        ..base_plan(machine, options)
    })
}

fn compute_targets_mm(
    travel: &AxisTravel,
    options: &MeasurementOptions,
) -> Result<Vec<f64>, ProgramError> {
    let mut targets = evenly_spaced_targets_mm(travel, options, MIN_STEPS, MAX_TARGET_STEP_MM)?;
    let apart = targets[1] - targets[0];
    // The last one stays: beyond it is only the over-travel.
    let last = targets.len() - 1;
    for (n, target) in targets.iter_mut().enumerate().take(last) {
        let share = (n as f64 * INVERSE_GOLDEN_RATIO).fract();
        *target = round_to_micrometres(*target + MAX_TARGET_SHIFT_RATIO * apart * share);
    }
    Ok(targets)
}
