//! The four body diagonals in steps of one axis at a time, for a laser along each: three readings a step distinguish X,
//! Y and Z, which a diagonal in one move does not.
//!
//! ```text
//!        ┌ Z, read       each step: one axis, read, the next axis, read, the third axis, read
//!   Y ───┘ read          the way back is the way there, without readings
//!   │ read
//!   X
//! ```
//!
//! A beam that is not along the diagonal is seen by the steps to first order: `fit volume` has its direction as an
//! unknown of each set-up, so that four diagonals, or circles next to them, are needed.

use trueup_machine::{
    Machine,
    machine_file::{LinearAxis, MachineKind},
};

use super::{COMPENSATION_OFF_PRECAUTION, PlansWithNotes, base_plan, unused_clearance_note};
use crate::{
    options::MeasurementOptions,
    plan::{Column, MeasurementPlan, Step},
    program_error::ProgramError,
    travel::{AxisTravel, evenly_spaced_positions_mm, resolve_travels, round_to_micrometres},
};

/// Repeats of a diagonal.
const DEFAULT_REPEATS: u32 = 2;
/// Steps of each axis.
const DEFAULT_STEPS_PER_AXIS: f64 = 10.0;

pub(crate) fn create_plans(
    machine: &Machine,
    options: &MeasurementOptions,
) -> Result<PlansWithNotes, ProgramError> {
    if machine.kind == MachineKind::Lathe {
        return Err(ProgramError("a body diagonal needs X, Y and Z, and a lathe has no Y".into()));
    }
    let (travels, mut notes) = resolve_travels(machine, options)?;
    let mut travels = <[AxisTravel; 3]>::try_from(travels).map_err(|travels| {
        let names: Vec<&str> = travels.iter().map(|travel| travel.axis.name()).collect();
        let why = format!(
            "a body diagonal needs three axes, and only {} may move or is asked for",
            names.join(", ")
        );
        ProgramError([vec![why], notes.clone()].concat().join("; "))
    })?;
    // The tool is retracted before other axes move, and comes last.
    travels.sort_by_key(|travel| travel.retract.is_some());
    // Each further axis that begins where it is retracted halves them.
    let count = 4 >> travels[..2].iter().filter(|travel| travel.retract.is_some()).count();
    let all = (0..count).map(|number| create_plan(machine, &travels, options, [number, count]));
    let plans = all.collect::<Result<Vec<_>, _>>()?;
    if count < 4 {
        notes.push(format!(
            "{count} of the four body diagonals: the others do not begin where all vertical axes and the tool are retracted. Measure \
             circles as well: trueup fit volume reports what stays open"
        ));
    }
    notes.extend(unused_clearance_note(options));
    if machine.volume.chain.is_none() {
        notes.push(super::MISSING_CHAIN_NOTE.into());
    }
    Ok((plans, notes))
}

fn create_plan(
    machine: &Machine,
    travels: &[AxisTravel; 3],
    options: &MeasurementOptions,
    [number, count]: [usize; 2],
) -> Result<MeasurementPlan, ProgramError> {
    let feed = options.first_feed_mm_per_min();
    // Each diagonal is one of four corners of the first two axes; the third begins where the tool is retracted.
    let starts_at_upper_end = [number & 1 == 1, number & 2 == 2, false];
    let ordered = |n: usize, ends: [f64; 2]| match (travels[n].retract, starts_at_upper_end[n]) {
        (Some(_), _) => travels[n].arrange_in_approach_order(ends),
        (None, true) => [ends[1], ends[0]],
        (None, false) => ends,
    };
    let near = [0, 1, 2].map(|n| ordered(n, [travels[n].low_mm, travels[n].high_mm])[0]);
    let [from, until] = [0, 1]
        .map(|end: usize| [0, 1, 2].map(|n: usize| ordered(n, travels[n].target_range_mm())[end]));
    let length = (0..3).map(|n| (until[n] - from[n]).powi(2)).sum::<f64>().sqrt();
    let step_mm = options.step_mm.unwrap_or(length / DEFAULT_STEPS_PER_AXIS);
    let shares = evenly_spaced_positions_mm(0.0, length, step_mm).ok_or_else(|| {
        ProgramError(format!("--step-mm {step_mm} does not fit into {length:.0} mm"))
    })?;
    let mm = |n: usize, step: usize| {
        // A length that is rounded to whole micrometres is not 1.
        round_to_micrometres(from[n] + (shares[step] / length).min(1.0) * (until[n] - from[n]))
    };
    let go = |n: usize, mm: f64| Step::Move {
        to_mm: travels[n].target_position_mm(mm),
        feed_mm_per_min: feed,
    };
    let mut run: Vec<Step> = (0..3).map(|n| go(n, mm(n, 0))).collect();
    run.push(Step::Read(options.dwell_s));
    for step in 1..shares.len() {
        for n in 0..3 {
            run.extend([go(n, mm(n, step)), Step::Read(options.dwell_s)]);
        }
    }
    for step in (0..shares.len() - 1).rev() {
        run.extend((0..3).rev().map(|n| go(n, mm(n, step))));
    }
    run.extend((0..3).rev().map(|n| go(n, near[n])));
    let times = options.repeats.unwrap_or(DEFAULT_REPEATS);
    let mut steps: Vec<Step> = (0..3).rev().map(|n| travels[n].approach_step(near[n])).collect();
    steps.push(Step::Repeat { times, steps: run });
    let mut columns = vec![Column::Run];
    columns.extend(LinearAxis::ALL.map(|axis| Column::Position(axis.index())));
    columns.extend(LinearAxis::ALL.map(|axis| Column::Direction(axis.index())));
    columns.push(Column::Empty("measured_diagonal_um".into()));
    let file = |number: usize| format!("--run step-diagonal-{}-xyz.csv", number + 1);
    Ok(MeasurementPlan {
        name: format!("step-diagonal-{}-xyz", number + 1),
        notes: vec![
            COMPENSATION_OFF_PRECAUTION.to_string(),
            "Lay the beam along the line from the first to the last position. A mirror that is \
             wide enough stays in it while one axis steps."
                .into(),
            "The reading is the way along that line, actual minus commanded, plus where it is too long.".into(),
        ],
        steps,
        columns,
        // All are measured first.
        then: (number + 1 == count)
            .then(|| {
                let files: Vec<String> = (0..count).map(file).collect();
                format!("trueup fit volume {}", files.join(" "))
            })
            .into_iter()
            .collect(),
        ..base_plan(machine, options)
    })
}
