//! How the other two axes err while one moves, there and back (paper 3).

use trueup_machine::{
    Machine,
    file::{Kind, LinearAxis},
};

use super::{
    Plans, WITHOUT_CORRECTION, all_that_fit, even_targets_mm, head_at_zero, measured,
    there_and_back, without_clearance,
};
use crate::{
    options::Options,
    plan::{Column, Plan},
    refused::Refused,
    travel::{Travel, travels},
};

/// There and back so often: the scatter of three shows what a curve is worth.
const REPEATS: u32 = 3;
/// This many steps on an axis, at least: three for each of the paper's first ten control points, less the
/// two ends.
const STEPS: f64 = 24.0;
/// And at most so far from target to target, in mm: the length of the paper's slide.
const LONGEST_STEP_MM: f64 = 240.0;

pub(crate) fn plans(machine: &Machine, options: &Options) -> Result<Plans, Refused> {
    let (travels, mut notes) = travels(machine, options)?;
    notes.extend(without_clearance(options));
    all_that_fit(&travels, notes, |travel| plan(machine, travel, options))
}

fn plan(machine: &Machine, travel: &Travel, options: &Options) -> Result<Plan, Refused> {
    let axis = travel.axis;
    let targets = even_targets_mm(travel, options, STEPS, LONGEST_STEP_MM)?;
    let times = options.repeats.unwrap_or(REPEATS);
    let steps = there_and_back(travel, targets, times, options);
    let others: Vec<LinearAxis> = LinearAxis::ALL
        .into_iter()
        .filter(|other| *other != axis && (machine.kind != Kind::Lathe || *other != LinearAxis::Y))
        .collect();
    let mut columns = vec![Column::Run, Column::Position(axis.index())];
    columns.push(Column::Direction(axis.index()));
    columns.extend(others.iter().map(|other| Column::Empty(measured(*other))));
    let note = "Read the deviation of both other axes, or run it once for each; a column that you do \
                not fill in, delete.";
    Ok(Plan {
        name: format!("straightness-{}", axis.name()),
        notes: vec![WITHOUT_CORRECTION.to_string(), note.to_string()],
        precautions: head_at_zero(machine).into_iter().collect(),
        approach_mm_per_min: options.approach_mm_per_min,
        steps,
        columns,
        then: vec![format!(
            "trueup fit straightness --run straightness-{}.csv --axis {}",
            axis.name(),
            others[0].name()
        )],
        is_lathe: false,
        records: Vec::new(),
    })
}
