//! A sphere, touched with one stylus or several, and where the table turns at many angles: it shows where the lines of rotary
//! axes are, and with two styli at several places the angles of X, Y and Z.
//!
//! The operator turns the axes: a program moves none that cannot be stopped at a glance. Where the ball is at an angle follows
//! from the lines of the machine file.

use trueup_machine::{
    Machine,
    machine_file::{AxisChain, RotaryAxis},
    model::rotate_about_axis,
};

use super::{
    COMPENSATION_OFF_PRECAUTION, PlansWithNotes,
    ball::{Ball, BallTarget, ball_columns},
    base_plan, head_zero_precaution,
    probing::{LINUXCNC_LOG_NOTE, PROBE_PRECAUTION, ProbeSetup, build_fit_command},
    unused_clearance_note,
};
use crate::{
    options::MeasurementOptions,
    plan::{MeasurementPlan, Step},
    program_error::ProgramError,
    travel::round_to_micrometres,
};

/// Touched so often at each place and angle.
const DEFAULT_REPEATS: u32 = 2;
/// The most poses of a program: each needs a hand.
const MAX_POSES: usize = 200;

/// Angles of A, B and C.
type RotaryAngles = [Option<f64>; 3];

pub(crate) fn create_plans(
    machine: &Machine,
    options: &MeasurementOptions,
) -> Result<PlansWithNotes, ProgramError> {
    let (probing, mut notes) = ProbeSetup::new(machine, options, "a sphere")?;
    let ball = Ball::new(&probing, options)?;
    notes.extend(unused_clearance_note(options));
    let poses = enumerate_poses(machine, options)?;
    let mut steps = Vec::new();
    let (mut first_refused, mut skipped, mut written) = (None, 0, 0);
    let mut stands = Some(poses[0]);
    for (n, &length_mm) in probing.tool_lengths_mm.iter().enumerate() {
        if let Some(length_mm) = length_mm.filter(|_| n > 0) {
            steps.push(probing.stylus_change_step(length_mm));
        }
        steps.extend(probing.retract_steps());
        for &angle_deg in &poses {
            let at_mm = axis_position_at_ball_mm(machine, &probing, angle_deg);
            let at_mm = probing.adjust_position_for_stylus(at_mm, length_mm);
            if let Err(why) = ball.check(&probing, at_mm) {
                skipped += 1;
                first_refused.get_or_insert(why);
                continue;
            }
            written += 1;
            if stands != Some(angle_deg) {
                steps.push(table_rotation_step(angle_deg));
                steps.extend(probing.retract_steps());
                stands = Some(angle_deg);
            }
            for run in 1..=options.repeats.unwrap_or(DEFAULT_REPEATS) {
                let place =
                    BallTarget { run, at_mm, angle_deg, tool_length_mm: length_mm, point: None };
                steps.extend(ball.probing_steps(&probing, &place));
            }
            steps.push(probing.guarded_move(probing.tool, probing.retracted_position_mm()));
        }
    }
    if let Some(why) = first_refused {
        if written == 0 {
            return Err(why);
        }
        notes.push(format!(
            "{skipped} of {} poses are skipped; the first: {why}",
            skipped + written
        ));
    }
    if machine.volume.chain.is_none() {
        notes.push(super::MISSING_CHAIN_NOTE.into());
    }
    let rotary: Vec<usize> = (0..3).filter(|n| poses[0][*n].is_some()).collect();
    let mut precautions = head_zero_precaution(machine);
    precautions.extend(describe_angles(poses[0]).map(|description| format!("{description} now.")));
    precautions.push(PROBE_PRECAUTION.into());
    let plan = MeasurementPlan {
        name: "sphere-xyz".into(),
        notes: vec![
            COMPENSATION_OFF_PRECAUTION.to_string(),
            LINUXCNC_LOG_NOTE.into(),
            "Readings are the place of the ball minus where it was found. The same with the ball at other places, each by a program \
             of its own, and all run files together, show most."
                .into(),
        ],
        precautions,
        columns: ball_columns(&probing, &rotary, false),
        then: build_fit_command("sphere-xyz", &steps),
        steps,
        ..base_plan(machine, options)
    };
    Ok((vec![plan], notes))
}

/// Returns all combinations of the angles that are requested; one without an angle where none is.
fn enumerate_poses(
    machine: &Machine,
    options: &MeasurementOptions,
) -> Result<Vec<RotaryAngles>, ProgramError> {
    let table = machine.volume.chain.as_ref().map(|chain: &AxisChain| chain.table.clone());
    let table = table.unwrap_or_default();
    let mut poses = vec![[None; 3]];
    for axis in RotaryAxis::ALL {
        let angles = &options.angles_deg[axis.index()];
        if angles.is_empty() {
            continue;
        }
        if !table.contains(&axis) {
            return Err(ProgramError(format!(
                "--angle {0}: the chain of the machine file has no {1} under the workpiece. A \
                 head that is turned cannot touch a ball from above",
                axis.name(),
                axis.name().to_uppercase()
            )));
        }
        poses = poses
            .into_iter()
            .flat_map(|pose: RotaryAngles| {
                angles.iter().map(move |deg| {
                    let mut pose = pose;
                    pose[axis.index()] = Some(*deg);
                    pose
                })
            })
            .collect();
    }
    if poses.len() > MAX_POSES {
        return Err(ProgramError(format!(
            "--angle: {} poses, and at most {MAX_POSES}",
            poses.len()
        )));
    }
    Ok(poses)
}

/// Returns where the axes stand with the tip in the centre of the ball, whose place is stated with all angles at 0.
fn axis_position_at_ball_mm(
    machine: &Machine,
    probing: &ProbeSetup,
    angle_deg: RotaryAngles,
) -> [f64; 3] {
    let at_mm = probing.at_mm;
    let Some(chain) = &machine.volume.chain else { return at_mm };
    let mut tool = machine.volume.tool;
    tool.length_mm = probing.tool_lengths_mm[0].unwrap_or(tool.length_mm);
    let tip_mm = tool.tip_offset_mm(machine.tool_direction);
    let mut place = [0, 1, 2].map(|n| at_mm[n] + tip_mm[n]);
    // As the workpiece turns: the axis on the bed last.
    for &axis in chain.table.iter().rev() {
        let point = machine.volume.axis_line_point_mm(axis);
        let arm = [0, 1, 2].map(|n| place[n] - point[n]);
        let arm = rotate_about_axis(arm, axis, -angle_deg[axis.index()].unwrap_or(0.0));
        place = [0, 1, 2].map(|n| point[n] + arm[n]);
    }
    [0, 1, 2].map(|n| round_to_micrometres(place[n] - tip_mm[n]))
}

/// Returns `C stands at 30 deg and A stands at 0 deg`; `None` where no angle is requested.
fn describe_angles(angle_deg: RotaryAngles) -> Option<String> {
    let each = RotaryAxis::ALL.into_iter().filter_map(|axis| {
        let name = axis.name().to_uppercase();
        Some(format!("{name} stands at {} deg", angle_deg[axis.index()]?))
    });
    let each: Vec<String> = each.collect();
    (!each.is_empty()).then(|| each.join(" and "))
}

/// The operator turns the table.
fn table_rotation_step(angle_deg: RotaryAngles) -> Step {
    let cnc_data = describe_angles(angle_deg).unwrap_or_default();
    Step::Stop(vec![
        format!("Turn the table so that {cnc_data}, and see that nothing is in its way."),
        "The tool is retracted, and goes over the ball next.".into(),
    ])
}
