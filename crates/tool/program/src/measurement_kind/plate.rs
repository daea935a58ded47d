//! A ball plate: rows and columns of balls, touched one after the other (ISO 10360-2 and ISO 230-1 call it an artefact). In
//! three heights and with two styli it shows all angles of three axes.

use trueup_machine::{Machine, machine_file::LinearAxis};

use super::{
    COMPENSATION_OFF_PRECAUTION, PlansWithNotes,
    ball::{Ball, BallTarget, ball_columns},
    base_plan, head_zero_precaution,
    probing::{LINUXCNC_LOG_NOTE, PROBE_PRECAUTION, ProbeSetup, build_fit_command, require_option},
    unused_clearance_note,
};
use crate::{
    options::MeasurementOptions, plan::MeasurementPlan, program_error::ProgramError,
    travel::round_to_micrometres,
};

/// Rounds over the plate.
const DEFAULT_REPEATS: u32 = 2;
/// Balls along both axes of a usual plate.
const DEFAULT_BALL_COUNTS: [u32; 2] = [5, 5];
/// More balls are another artefact, along one axis.
const MAX_BALLS_PER_AXIS: u32 = 50;

pub(crate) fn create_plans(
    machine: &Machine,
    options: &MeasurementOptions,
) -> Result<PlansWithNotes, ProgramError> {
    let (probing, mut notes) = ProbeSetup::new(machine, options, "a ball plate")?;
    notes.extend(unused_clearance_note(options));
    if machine.volume.chain.is_none() {
        notes.push(super::MISSING_CHAIN_NOTE.into());
    }
    Ok((vec![create_plan(machine, &probing, options)?], notes))
}

fn create_plan(
    machine: &Machine,
    probing: &ProbeSetup,
    options: &MeasurementOptions,
) -> Result<MeasurementPlan, ProgramError> {
    let ball = Ball::new(probing, options)?;
    let pitch_mm = require_option(options.step_mm, "--step-mm", "the distance of the balls")?;
    let [columns_, rows] = options.balls.unwrap_or(DEFAULT_BALL_COUNTS);
    if !(1..=MAX_BALLS_PER_AXIS).contains(&columns_) || !(1..=MAX_BALLS_PER_AXIS).contains(&rows) {
        return Err(ProgramError(format!(
            "--balls {columns_}x{rows}: 1 to {MAX_BALLS_PER_AXIS} each way"
        )));
    }
    let clear = ball.clearance_radius_mm(probing);
    if pitch_mm < 2.0 * clear {
        return Err(ProgramError(format!(
            "--step-mm {pitch_mm}: between two balls the stylus needs {} mm: give a smaller --search or --stylus",
            2.0 * clear
        )));
    }
    let mut sides = probing.sides;
    sides.sort_unstable();
    let mut steps = Vec::new();
    for (n, &length_mm) in probing.tool_lengths_mm.iter().enumerate() {
        if let Some(length_mm) = length_mm.filter(|_| n > 0) {
            steps.push(probing.stylus_change_step(length_mm));
        }
        steps.extend(probing.retract_steps());
        for run in 1..=options.repeats.unwrap_or(DEFAULT_REPEATS) {
            for number in 0..columns_ * rows {
                let row = number / columns_;
                // There and back, so that no way is longer than to the next ball.
                let column = number % columns_;
                let column = if row % 2 == 0 { column } else { columns_ - 1 - column };
                let mut at_mm = probing.adjust_position_for_stylus(probing.at_mm, length_mm);
                for (axis, balls) in sides.into_iter().zip([column, row]) {
                    at_mm[axis] = round_to_micrometres(at_mm[axis] + f64::from(balls) * pitch_mm);
                }
                ball.check(probing, at_mm)?;
                let point = Some(row * columns_ + column + 1);
                let place = BallTarget {
                    run,
                    at_mm,
                    angle_deg: [None; 3],
                    tool_length_mm: length_mm,
                    point,
                };
                steps.extend(ball.probing_steps(probing, &place));
            }
        }
        steps.push(probing.guarded_move(probing.tool, probing.retracted_position_mm()));
    }
    let [u, v] = sides.map(|n| super::uppercase_axis_name(LinearAxis::ALL[n]));
    let mut precautions = head_zero_precaution(machine);
    precautions.extend([
        format!("{columns_} balls along {u}, {rows} along {v}, {pitch_mm} mm apart, level; --at is the first."),
        PROBE_PRECAUTION.into(),
    ]);
    Ok(MeasurementPlan {
        name: "plate-xyz".into(),
        notes: vec![
            COMPENSATION_OFF_PRECAUTION.to_string(),
            LINUXCNC_LOG_NOTE.into(),
            "Readings are the place of a ball minus where it was found. Subtract the values in the certificate of the plate.".into(),
            "Put the plate on spacers and write this program again, with the new height in --at: each height is a run file of its own."
                .into(),
        ],
        precautions,
        columns: ball_columns(probing, &[], true),
        then: build_fit_command("plate-xyz", &steps),
        steps,
        ..base_plan(machine, options)
    })
}
