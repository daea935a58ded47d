//! A square, touched along both faces by the touch probe of the control: the angle between two axes, and their straightness.
//!
//! ```text
//!        Y ▲  ║ face along Y, touched in X
//!          │ ►║
//!          │ ►║══════════ face along X, touched in Y
//!          │  ▲   ▲   ▲
//!          └─────────────► X          --at: the corner, and the height of the touches
//! ```
//!
//! The way is around the corner, at a distance of `--search` from the faces. The angle of the square counts as right: what
//! its certificate says is to be taken off the readings.

use trueup_machine::{Machine, machine_file::LinearAxis};

use super::{
    COMPENSATION_OFF_PRECAUTION, PlansWithNotes, base_plan, head_zero_precaution,
    probing::{LINUXCNC_LOG_NOTE, PROBE_PRECAUTION, ProbeSetup, build_fit_command, require_option},
    unused_clearance_note,
};
use crate::{
    options::MeasurementOptions,
    plan::{Column, MeasurementPlan, Step},
    probe::{ProbedPoint, TouchMean},
    program_error::ProgramError,
    travel::{evenly_spaced_positions_mm, round_to_micrometres},
};

/// Rounds around both faces.
const DEFAULT_REPEATS: u32 = 2;
/// Steps along a face.
const DEFAULT_STEPS_PER_FACE: f64 = 10.0;
/// How far from its ends a face is touched, in styli.
const FACE_INSET_STYLUS_DIAMETERS: f64 = 1.0;

pub(crate) fn create_plans(
    machine: &Machine,
    options: &MeasurementOptions,
) -> Result<PlansWithNotes, ProgramError> {
    let (probing, mut notes) = ProbeSetup::new(machine, options, "a square")?;
    let size_mm =
        require_option(options.size_mm, "--size", "the length of both faces of the square")?;
    notes.extend(unused_clearance_note(options));
    let plan = create_plan(machine, &probing, size_mm, options)?;
    Ok((vec![plan], notes))
}

fn create_plan(
    machine: &Machine,
    probing: &ProbeSetup,
    size_mm: f64,
    options: &MeasurementOptions,
) -> Result<MeasurementPlan, ProgramError> {
    let inset = FACE_INSET_STYLUS_DIAMETERS * probing.stylus_mm;
    let long_mm = size_mm - 2.0 * inset;
    let step_mm = options.step_mm.unwrap_or(long_mm / DEFAULT_STEPS_PER_FACE);
    let along = evenly_spaced_positions_mm(inset, inset + long_mm, step_mm).ok_or_else(|| {
        ProgramError(format!("--step-mm {step_mm} does not fit on faces of {size_mm} mm"))
    })?;
    let [first, second] = probing.sides;
    let radius = probing.stylus_mm / 2.0;
    let mut steps = Vec::new();
    for (n, &length_mm) in probing.tool_lengths_mm.iter().enumerate() {
        let corner = probing.adjust_position_for_stylus(probing.at_mm, length_mm);
        let before = |axis: usize| corner[axis] - radius - probing.search_mm;
        let behind = |axis: usize| corner[axis] - radius + probing.search_mm;
        for (axis, other) in [(first, second), (second, first)] {
            let last = corner[axis] + along[along.len() - 1];
            probing.check_travel(axis, &[before(axis), last])?;
            probing.check_travel(other, &[before(other), behind(other)])?;
        }
        probing.check_travel(probing.tool, &[corner[probing.tool]])?;
        if let Some(length_mm) = length_mm.filter(|_| n > 0) {
            steps.push(probing.stylus_change_step(length_mm));
        }
        steps.extend(probing.retract_steps());
        // Down next to the corner, outside of both faces.
        steps.extend([first, second].map(|axis| probing.guarded_move(axis, before(axis))));
        steps.push(probing.guarded_move(probing.tool, corner[probing.tool]));
        for run in 1..=options.repeats.unwrap_or(DEFAULT_REPEATS) {
            for [moved, touched] in [[first, second], [second, first]] {
                let surface = corner[touched] - radius;
                for (point, mm) in (1..).zip(&along) {
                    let mut at_mm = corner;
                    (at_mm[moved], at_mm[touched]) =
                        (round_to_micrometres(corner[moved] + mm), round_to_micrometres(surface));
                    let mut by = [None; 3];
                    by[touched] = Some(TouchMean { touches: [1, 1], expected_mm: at_mm[touched] });
                    let angle_deg = [None; 3];
                    let point = Some(point);
                    steps.extend([
                        probing.guarded_move(moved, at_mm[moved]),
                        probing.touch_step(touched, surface, 1.0, 1),
                        Step::Found(ProbedPoint {
                            run,
                            at_mm,
                            angle_deg,
                            tool_length_mm: length_mm,
                            point,
                            by,
                        }),
                    ]);
                }
                // Back to the corner, along the face.
                steps.push(probing.guarded_move(moved, before(moved)));
            }
        }
        steps.push(probing.guarded_move(probing.tool, probing.retracted_position_mm()));
    }
    let mut columns =
        vec![Column::Run, Column::Constant("setup", 1.0), Column::Constant("square", 1.0)];
    columns.push(Column::Point);
    columns.extend(LinearAxis::ALL.map(|axis| Column::Position(axis.index())));
    if probing.tool_lengths_mm[0].is_some() {
        columns.push(Column::ToolLength);
    }
    let mut touched = probing.sides;
    touched.sort_unstable();
    columns.extend(touched.map(|n| Column::Empty(super::measured_column_name(LinearAxis::ALL[n]))));
    let mut precautions = head_zero_precaution(machine);
    let [u, v] = touched.map(|n| super::uppercase_axis_name(LinearAxis::ALL[n]));
    precautions.extend([
        format!(
            "The square lies with its corner towards {u}- and {v}-, its faces along {u} and {v}."
        ),
        PROBE_PRECAUTION.into(),
    ]);
    Ok(MeasurementPlan {
        name: "square-xyz".into(),
        notes: vec![
            COMPENSATION_OFF_PRECAUTION.to_string(),
            LINUXCNC_LOG_NOTE.into(),
            "The angle of the square counts as 90 degrees: subtract the value in its certificate from the readings of one face.".into(),
            "A reading is the place of the face minus where it was found; one of both columns in each row.".into(),
        ],
        precautions,
        columns,
        then: build_fit_command("square-xyz", &steps),
        steps,
        ..base_plan(machine, options)
    })
}
