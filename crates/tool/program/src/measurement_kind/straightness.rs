//! How the other two axes err while one moves, there and back (paper 3).

use trueup_machine::{
    Machine,
    machine_file::{LinearAxis, MachineKind},
};

use super::{
    COMPENSATION_OFF_PRECAUTION, PlansWithNotes, base_plan, bidirectional_passes,
    evenly_spaced_targets_mm, measured_column_name, plan_each_axis,
};
use crate::{
    options::MeasurementOptions,
    plan::{Column, MeasurementPlan},
    program_error::ProgramError,
    travel::AxisTravel,
};

/// There and back so often: the scatter of three shows what a curve is worth.
const DEFAULT_REPEATS: u32 = 3;
/// This many steps on an axis, at least: three for each of the paper's first ten control points, less the
/// two ends.
const MIN_STEPS: f64 = 24.0;
/// And at most so far from target to target, in mm: the length of the paper's slide.
const MAX_TARGET_STEP_MM: f64 = 240.0;

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
    let targets = evenly_spaced_targets_mm(travel, options, MIN_STEPS, MAX_TARGET_STEP_MM)?;
    let times = options.repeats.unwrap_or(DEFAULT_REPEATS);
    let steps = bidirectional_passes(travel, targets, times, options);
    let others: Vec<LinearAxis> = LinearAxis::ALL
        .into_iter()
        .filter(|other| {
            *other != axis && (machine.kind != MachineKind::Lathe || *other != LinearAxis::Y)
        })
        .collect();
    let mut columns = vec![Column::Run, Column::Position(axis.index())];
    columns.push(Column::Direction(axis.index()));
    columns.extend(others.iter().map(|other| Column::Empty(measured_column_name(*other))));
    let note = "Read the deviation of both other axes, or run it once for each; a column that you do \
                not fill in, delete.";
    Ok(MeasurementPlan {
        name: format!("straightness-{}", axis.name()),
        notes: vec![COMPENSATION_OFF_PRECAUTION.to_string(), note.to_string()],
        steps,
        columns,
        then: vec![format!(
            "trueup fit straightness --run straightness-{}.csv --axis {}",
            axis.name(),
            others[0].name()
        )],
        ..base_plan(machine, options)
    })
}
