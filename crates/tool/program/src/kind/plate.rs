//! A ball plate: rows and columns of balls, touched one after the other (ISO 10360-2 and ISO 230-1 call it an artefact). In
//! three heights and with two styli it shows all angles of three axes.

use trueup_machine::{Machine, file::LinearAxis};

use super::{
    Plans, WITHOUT_CORRECTION,
    ball::{Ball, Place, columns},
    head_at_zero,
    probing::{LOGGED, PROBE, Probing, needed, then},
    without_clearance,
};
use crate::{options::Options, plan::Plan, refused::Refused, travel::micrometres};

/// Rounds over the plate.
const REPEATS: u32 = 2;
/// Balls along both axes of a usual plate.
const BALLS: [u32; 2] = [5, 5];
/// More balls are another artefact, along one axis.
const MAX_BALLS: u32 = 50;

pub(crate) fn plans(machine: &Machine, options: &Options) -> Result<Plans, Refused> {
    let (probing, mut notes) = Probing::of(machine, options, "a ball plate")?;
    notes.extend(without_clearance(options));
    if machine.volume.chain.is_none() {
        notes.push(super::NO_CHAIN.into());
    }
    Ok((vec![plan(machine, &probing, options)?], notes))
}

fn plan(machine: &Machine, probing: &Probing, options: &Options) -> Result<Plan, Refused> {
    let ball = Ball::of(probing, options)?;
    let pitch_mm = needed(options.step_mm, "--step-mm", "the distance of the balls")?;
    let [columns_, rows] = options.balls.unwrap_or(BALLS);
    if !(1..=MAX_BALLS).contains(&columns_) || !(1..=MAX_BALLS).contains(&rows) {
        return Err(Refused(format!("--balls {columns_}x{rows}: 1 to {MAX_BALLS} each way")));
    }
    let clear = ball.clear_mm(probing);
    if pitch_mm < 2.0 * clear {
        return Err(Refused(format!(
            "--step-mm {pitch_mm}: between two balls the stylus needs {} mm: give a smaller --search or --stylus",
            2.0 * clear
        )));
    }
    let mut sides = probing.sides;
    sides.sort_unstable();
    let mut steps = Vec::new();
    for (n, &length_mm) in probing.tool_lengths_mm.iter().enumerate() {
        if let Some(length_mm) = length_mm.filter(|_| n > 0) {
            steps.push(probing.change(length_mm));
        }
        steps.extend(probing.retract());
        for run in 1..=options.repeats.unwrap_or(REPEATS) {
            for number in 0..columns_ * rows {
                let row = number / columns_;
                // There and back, so that no way is longer than to the next ball.
                let column = number % columns_;
                let column = if row % 2 == 0 { column } else { columns_ - 1 - column };
                let mut at_mm = probing.with_tool(probing.at_mm, length_mm);
                for (axis, balls) in sides.into_iter().zip([column, row]) {
                    at_mm[axis] = micrometres(at_mm[axis] + f64::from(balls) * pitch_mm);
                }
                ball.check(probing, at_mm)?;
                let point = Some(row * columns_ + column + 1);
                let place =
                    Place { run, at_mm, angle_deg: [None; 3], tool_length_mm: length_mm, point };
                steps.extend(ball.steps(probing, &place));
            }
        }
        steps.push(probing.guarded(probing.tool, probing.retracted_mm()));
    }
    let [u, v] = sides.map(|n| super::capital(LinearAxis::ALL[n]));
    let mut precautions: Vec<String> = head_at_zero(machine).into_iter().collect();
    precautions.extend([
        format!("{columns_} balls along {u}, {rows} along {v}, {pitch_mm} mm apart, level; --at is the first."),
        PROBE.into(),
    ]);
    Ok(Plan {
        name: "plate-xyz".into(),
        notes: vec![
            WITHOUT_CORRECTION.to_string(),
            LOGGED.into(),
            "Readings are the place of a ball minus where it was found. Take off them what the certificate of the plate says.".into(),
            "Put the plate on spacers and write this program again, with the new height in --at: each height is a run file of its own."
                .into(),
        ],
        precautions,
        approach_mm_per_min: options.approach_mm_per_min,
        columns: columns(probing, &[], true),
        then: then("plate-xyz", &steps),
        steps,
        is_lathe: false,
        records: Vec::new(),
    })
}
