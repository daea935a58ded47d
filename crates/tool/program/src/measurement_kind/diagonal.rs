//! Two axes at once, and the error of the third across them (paper 3): what the whole model leaves,
//! which no measurement of one axis shows.

use trueup_machine::{
    Machine,
    machine_file::{LinearAxis, MachineKind},
};

use super::{
    PlansWithNotes, base_plan, measured_column_name, plan_each_pair, unused_clearance_note,
    uppercase_axis_name,
};
use crate::{
    options::MeasurementOptions,
    plan::{Column, MeasurementPlan, Step},
    program_error::ProgramError,
    travel::{AxisTravel, evenly_spaced_positions_mm, resolve_travels, round_to_micrometres},
};

/// There and back so often.
const DEFAULT_REPEATS: u32 = 3;
/// From target to target along the diagonal, in mm: the length of the paper's slide.
const MAX_TARGET_STEP_MM: f64 = 240.0;
/// This many steps on a short one, at least.
const MIN_STEPS: f64 = 12.0;

pub(crate) fn create_plans(
    machine: &Machine,
    options: &MeasurementOptions,
) -> Result<PlansWithNotes, ProgramError> {
    if machine.kind == MachineKind::Lathe {
        return Err(ProgramError(
            "a diagonal is measured across a third axis, which a lathe has not".into(),
        ));
    }
    let (travels, notes) = resolve_travels(machine, options)?;
    let (plans, mut notes) =
        plan_each_pair(&travels, notes, "diagonal", |pair| create_plan(machine, pair, options))?;
    if travels.len() == 2 {
        notes.push("one plane only: the third axis may not move or is not asked for".into());
    }
    notes.extend(unused_clearance_note(options));
    Ok((plans, notes))
}

/// Returns the ends of both axes, where the diagonal begins and where it ends. A tool axis begins where it is
/// retracted; an axis that may begin at either end begins at the same one as the other, so that both rise.
fn diagonal_ends_mm(
    pair: [&AxisTravel; 2],
    ends_mm: impl Fn(&AxisTravel) -> [f64; 2],
) -> [[f64; 2]; 2] {
    let starts_at_upper_end = |n: usize| match pair[n].retract {
        Some(_) => pair[n].starts_at_upper_end(),
        None => pair[1 - n].starts_at_upper_end(),
    };
    let [first, second] = [0, 1].map(|n| {
        let [low, high] = ends_mm(pair[n]);
        if starts_at_upper_end(n) { [high, low] } else { [low, high] }
    });
    [[first[0], second[0]], [first[1], second[1]]]
}

fn create_plan(
    machine: &Machine,
    pair: [&AxisTravel; 2],
    options: &MeasurementOptions,
) -> Result<MeasurementPlan, ProgramError> {
    let [first, second] = pair;
    let feed = options.first_feed_mm_per_min();
    let to = |mm: [f64; 2]| {
        let mut to = [None; 3];
        for (travel, mm) in pair.into_iter().zip(mm) {
            to[travel.axis.index()] = Some(round_to_micrometres(mm));
        }
        to
    };
    let [near, far] = diagonal_ends_mm(pair, |travel| [travel.low_mm, travel.high_mm]);
    let [from, until] = diagonal_ends_mm(pair, AxisTravel::target_range_mm);
    let at = |share: f64| [0, 1].map(|n| from[n] + share * (until[n] - from[n]));
    let length = (until[0] - from[0]).hypot(until[1] - from[1]);
    let step = options.step_mm.unwrap_or(MAX_TARGET_STEP_MM.min(length / MIN_STEPS));
    let shares: Vec<f64> = evenly_spaced_positions_mm(0.0, length, step)
        .ok_or_else(|| ProgramError(format!("--step-mm {step} does not fit into {length:.0} mm")))?
        .into_iter()
        // A length that is rounded to whole micrometres is not 1.
        .map(|mm| (mm / length).min(1.0))
        .collect();
    let go = |mm| Step::Move { to_mm: to(mm), feed_mm_per_min: feed };
    let read = |share: &f64| [go(at(*share)), Step::Read(options.dwell_s)];
    let mut run: Vec<Step> = shares.iter().flat_map(read).collect();
    run.push(go(far));
    run.extend(shares.iter().rev().flat_map(read));
    run.push(go(near));
    let times = options.repeats.unwrap_or(DEFAULT_REPEATS);
    // The tool is retracted before the other axis moves.
    let mut order = [0, 1];
    order.sort_by_key(|n| pair[*n].retract.is_none());
    let mut steps = order.map(|n| pair[n].approach_step(near[n])).to_vec();
    steps.push(Step::Repeat { times, steps: run });
    let across = LinearAxis::ALL
        .into_iter()
        .find(|axis| *axis != first.axis && *axis != second.axis)
        .expect("two of three axes are taken");
    let mut columns = vec![Column::Run];
    columns.extend([first, second].map(|travel| Column::Position(travel.axis.index())));
    columns.extend([first, second].map(|travel| Column::Direction(travel.axis.index())));
    columns.push(Column::Empty(measured_column_name(across)));
    let name = format!("diagonal-{}{}", first.axis.name(), second.axis.name());
    Ok(MeasurementPlan {
        notes: vec![format!(
            "{} and {} go together across the plane; {} is measured. Run it without compensation and with.",
            uppercase_axis_name(first.axis),
            uppercase_axis_name(second.axis),
            uppercase_axis_name(across)
        )],
        steps,
        columns,
        then: vec![format!("trueup accept --off {name}-off.csv --on {name}-on.csv")],
        records: vec!["off", "on"],
        name,
        ..base_plan(machine, options)
    })
}
