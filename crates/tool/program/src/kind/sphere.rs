//! A sphere, touched with one stylus or several, and where the table turns at many angles: it shows where the lines of rotary
//! axes are, and with two styli at several places the angles of X, Y and Z.
//!
//! The operator turns the axes: a program moves none that cannot be stopped at a glance. Where the ball is at an angle follows
//! from the lines of the machine file.

use trueup_machine::{
    Machine,
    file::{Chain, RotaryAxis},
    model::rotated,
};

use super::{
    Plans, WITHOUT_CORRECTION,
    ball::{Ball, Place, columns},
    head_at_zero,
    probing::{LOGGED, PROBE, Probing, then},
    without_clearance,
};
use crate::{
    options::Options,
    plan::{Plan, Step},
    refused::Refused,
    travel::micrometres,
};

/// Touched so often at each place and angle.
const REPEATS: u32 = 2;
/// The most poses of a program: each needs a hand.
const MAX_POSES: usize = 200;

/// Angles of A, B and C.
type Angles = [Option<f64>; 3];

pub(crate) fn plans(machine: &Machine, options: &Options) -> Result<Plans, Refused> {
    let (probing, mut notes) = Probing::of(machine, options, "a sphere")?;
    let ball = Ball::of(&probing, options)?;
    notes.extend(without_clearance(options));
    let poses = poses(machine, options)?;
    let mut steps = Vec::new();
    let (mut first_refused, mut left_out, mut written) = (None, 0, 0);
    let mut stands = Some(poses[0]);
    for (n, &length_mm) in probing.tool_lengths_mm.iter().enumerate() {
        if let Some(length_mm) = length_mm.filter(|_| n > 0) {
            steps.push(probing.change(length_mm));
        }
        steps.extend(probing.retract());
        for &angle_deg in &poses {
            let at_mm = turned(machine, &probing, angle_deg);
            let at_mm = probing.with_tool(at_mm, length_mm);
            if let Err(why) = ball.check(&probing, at_mm) {
                left_out += 1;
                first_refused.get_or_insert(why);
                continue;
            }
            written += 1;
            if stands != Some(angle_deg) {
                steps.push(turn(angle_deg));
                steps.extend(probing.retract());
                stands = Some(angle_deg);
            }
            for run in 1..=options.repeats.unwrap_or(REPEATS) {
                let place = Place { run, at_mm, angle_deg, tool_length_mm: length_mm, point: None };
                steps.extend(ball.steps(&probing, &place));
            }
            steps.push(probing.guarded(probing.tool, probing.retracted_mm()));
        }
    }
    if let Some(why) = first_refused {
        if written == 0 {
            return Err(why);
        }
        notes.push(format!(
            "{left_out} of {} poses are left out; the first: {why}",
            left_out + written
        ));
    }
    if machine.volume.chain.is_none() {
        notes.push(super::NO_CHAIN.into());
    }
    let rotary: Vec<usize> = (0..3).filter(|n| poses[0][*n].is_some()).collect();
    let mut precautions: Vec<String> = head_at_zero(machine).into_iter().collect();
    precautions.extend(said(poses[0]).map(|said| format!("{said} now.")));
    precautions.push(PROBE.into());
    let plan = Plan {
        name: "sphere-xyz".into(),
        notes: vec![
            WITHOUT_CORRECTION.to_string(),
            LOGGED.into(),
            "Readings are the place of the ball minus where it was found. The same with the ball at other places, each by a program \
             of its own, and all run files together, say most."
                .into(),
        ],
        precautions,
        approach_mm_per_min: options.approach_mm_per_min,
        columns: columns(&probing, &rotary, false),
        then: then("sphere-xyz", &steps),
        steps,
        is_lathe: false,
        records: Vec::new(),
    };
    Ok((vec![plan], notes))
}

/// Returns all combinations of the angles that are asked for; one without an angle where none is.
fn poses(machine: &Machine, options: &Options) -> Result<Vec<Angles>, Refused> {
    let table = machine.volume.chain.as_ref().map(|chain: &Chain| chain.table.clone());
    let table = table.unwrap_or_default();
    let mut poses = vec![[None; 3]];
    for axis in RotaryAxis::ALL {
        let angles = &options.angles_deg[axis.index()];
        if angles.is_empty() {
            continue;
        }
        if !table.contains(&axis) {
            return Err(Refused(format!(
                "--angle {0}: the chain of the machine file has no {1} under the workpiece, and a head that is turned cannot touch a \
                 ball from above",
                axis.name(),
                axis.name().to_uppercase()
            )));
        }
        poses = poses
            .into_iter()
            .flat_map(|pose: Angles| {
                angles.iter().map(move |deg| {
                    let mut pose = pose;
                    pose[axis.index()] = Some(*deg);
                    pose
                })
            })
            .collect();
    }
    if poses.len() > MAX_POSES {
        return Err(Refused(format!("--angle: {} poses, and at most {MAX_POSES}", poses.len())));
    }
    Ok(poses)
}

/// Returns where the axes stand with the tip in the centre of the ball, whose place is stated with all angles at 0.
fn turned(machine: &Machine, probing: &Probing, angle_deg: Angles) -> [f64; 3] {
    let at_mm = probing.at_mm;
    let Some(chain) = &machine.volume.chain else { return at_mm };
    let mut tool = machine.volume.tool;
    tool.length_mm = probing.tool_lengths_mm[0].unwrap_or(tool.length_mm);
    let tip_mm = tool.tip_mm(machine.tool_direction);
    let mut place = [0, 1, 2].map(|n| at_mm[n] + tip_mm[n]);
    // As the workpiece turns: the axis on the bed last.
    for &axis in chain.table.iter().rev() {
        let point = machine.volume.line_mm(axis);
        let arm = [0, 1, 2].map(|n| place[n] - point[n]);
        let arm = rotated(arm, axis, -angle_deg[axis.index()].unwrap_or(0.0));
        place = [0, 1, 2].map(|n| point[n] + arm[n]);
    }
    [0, 1, 2].map(|n| micrometres(place[n] - tip_mm[n]))
}

/// Returns `C stands at 30 deg and A stands at 0 deg`; `None` where no angle is asked for.
fn said(angle_deg: Angles) -> Option<String> {
    let each = RotaryAxis::ALL.into_iter().filter_map(|axis| {
        let name = axis.name().to_uppercase();
        Some(format!("{name} stands at {} deg", angle_deg[axis.index()]?))
    });
    let each: Vec<String> = each.collect();
    (!each.is_empty()).then(|| each.join(" and "))
}

/// The operator turns the table.
fn turn(angle_deg: Angles) -> Step {
    let said = said(angle_deg).unwrap_or_default();
    Step::Stop(vec![
        format!("Turn the table so that {said}, and see that nothing is in its way."),
        "The tool is retracted, and goes over the ball next.".into(),
    ])
}
