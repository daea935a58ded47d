//! A plan as the text that a control runs.
//!
//! | control | machine coordinates | circles, by ways from their start | repeats | dwell |
//! |---|---|---|---|---|
//! | LinuxCNC | `G53` in each block | `G91 G91.1 G3 X0 Y0 I-100 J0` | `o101 repeat [7]` | `G4 P5` |
//! | FANUC | the way from `#5021` to `#5023`, as `G53` moves at rapid only; then increments (`G91`) | `G91 G03 X0. Y0. I-100. J0.` | `M98 P7101 L7` | `G04 X5.` |
//! | Siemens 840D sl | `SUPA` in each block | `G3 X=IC(0) Y=IC(0) I-100 J0` | `FOR R1=1 TO 7` | `G4 F5` |
//! | HEIDENHAIN | `M91` in each block | refused: `M91` does not hold there | `LBL 1` … `CALL LBL 1 REP 6` | cycle 9 |
//!
//! A touch probe is read by LinuxCNC alone (`G38.2`), which writes the run file itself (`LOG`): the words of the others depend on how
//! their builder has wired the probe.
//!
//! A rotation, a mirror or a scale that an earlier program left would turn the way to a centre: it ends the program before
//! anything moves.
//!
//! Every program begins with a stop ([`MeasurementPlan::first_stop_instructions`]), then sets the modes that it needs; no block moves at
//! rapid, and none by a way from a place that the program does not know. No form depends on a work offset. Positions are whole micrometres, so that increments add up to
//! exactly where they began.
//!
//! X of a lathe is a diameter in the text (`G7`, `DIAMON`), and a radius everywhere else.

mod dialect;
mod fanuc;
mod heidenhain;
mod linuxcnc;
mod siemens;

use self::dialect::{ArcBlocks, Cell, Dialect, MoveTargets, ProbeMove};
use trueup_machine::{Machine, machine_file::MachineKind};

use crate::{
    arc::ArcMove,
    plan::{Column, MeasurementPlan, PlannedReading, Step},
    probe::ProbedPoint,
    program_error::ProgramError,
    template,
};

/// Whose program it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// LinuxCNC 2.8 and later.
    LinuxCnc,
    /// FANUC 0i and later: a milling machine in millimetres.
    Fanuc,
    /// Siemens SINUMERIK 840D sl and 828D.
    Siemens,
    /// HEIDENHAIN Klartext, TNC 426 and later.
    Heidenhain,
}

impl Control {
    /// Whether programs for this machine can be written for this control.
    ///
    /// # Errors
    /// A lathe of a control whose words mean something else there.
    pub fn check_machine(self, machine: &Machine) -> Result<(), ProgramError> {
        let why = match self {
            Self::LinuxCnc | Self::Siemens => return Ok(()),
            Self::Fanuc => {
                "G90 begins a turning cycle in G-code system A, and a parameter says whether X is a diameter"
            }
            Self::Heidenhain => "turning is a mode of its own, which has not been tried",
        };
        match machine.kind {
            MachineKind::Lathe => Err(ProgramError(format!(
                "no program of a lathe for this control: {why}. Move by hand to the positions of the program for siemens, \
                 and fill in its run file"
            ))),
            _ => Ok(()),
        }
    }
}

/// Returns the name and text of the program.
///
/// # Errors
/// The control cannot do a step of the plan.
pub fn generate_program(
    plan: &MeasurementPlan,
    control: Control,
) -> Result<(String, String), ProgramError> {
    if control == Control::Heidenhain && plan.steps.iter().any(|step| matches!(step, Step::Arc(_)))
    {
        return Err(ProgramError(format!(
            "no {} for this control: M91 does not hold in the blocks of a circle, and a basic rotation would turn it. Program \
             the circle by hand around a preset, with the positions of the program for siemens, and fill in its run file",
            plan.name
        )));
    }
    let is_probed = plan.steps.iter().any(|step| matches!(step, Step::Touch(_)));
    if is_probed && control != Control::LinuxCnc {
        return Err(ProgramError(format!(
            "no {} for this control: how it reads a probe outside of its own cycles depends on its builder. Touch the places of the \
             program for linuxcnc by the control's own measuring cycles, and fill in its run file",
            plan.name
        )));
    }
    let name = plan.name.replace('-', "_");
    let text = |mut dialect: Box<dyn Dialect>| {
        dialect.write_header(plan);
        dialect.write_stop(&plan.first_stop_instructions());
        dialect.write_modes(plan);
        let mut at_um = [None; 3];
        write_steps(plan, &plan.steps, dialect.as_mut(), &mut at_um);
        dialect.finish()
    };
    Ok(match control {
        Control::LinuxCnc => {
            (format!("{name}.ngc"), text(Box::<linuxcnc::LinuxcncWriter>::default()))
        }
        Control::Fanuc => (format!("{name}.nc"), text(Box::<fanuc::FanucWriter>::default())),
        Control::Siemens => (format!("{name}.mpf"), text(Box::<siemens::SiemensWriter>::default())),
        Control::Heidenhain => {
            (format!("{name}.h"), text(Box::<heidenhain::HeidenhainWriter>::default()))
        }
    })
}

fn write_steps(
    plan: &MeasurementPlan,
    steps: &[Step],
    dialect: &mut dyn Dialect,
    at_um: &mut [Option<i64>; 3],
) {
    for step in steps {
        match step {
            Step::Note(text) => dialect.write_comment(text),
            Step::Stop(text) => {
                dialect.write_stop(text);
                // The operator may have jogged.
                *at_um = [None; 3];
            }
            Step::Approach { axis, to_mm } => {
                let mut to = [None; 3];
                to[*axis] = Some(*to_mm);
                dialect.write_linear_move(
                    &advance_to_targets(plan, &to, at_um),
                    plan.approach_mm_per_min,
                );
            }
            Step::Move { to_mm, feed_mm_per_min } => {
                dialect
                    .write_linear_move(&advance_to_targets(plan, to_mm, at_um), *feed_mm_per_min);
            }
            Step::Arc(arc) => {
                if let Some(around) = advance_along_arc(arc, at_um) {
                    dialect.write_arc(&around);
                }
            }
            Step::Guarded { axis, to_mm } => {
                let to = to_micrometres(*to_mm);
                at_um[*axis] = Some(to);
                dialect.write_guarded_move(*axis, to, plan.approach_mm_per_min);
            }
            Step::Touch(touch) => {
                let (axis, number, feed) = (touch.axis, touch.number, touch.feed_mm_per_min);
                let to = to_micrometres(touch.to_mm);
                if let Some(from) = at_um[axis] {
                    let touching = ProbeMove { axis, from, to, feed, number };
                    dialect.write_probe_move(&touching, plan.approach_mm_per_min);
                }
            }
            Step::Found(found) => dialect.write_result_row(&build_result_row(plan, found)),
            Step::Spindle(rpm) => dialect.write_spindle_command(*rpm),
            Step::Dwell(s) => dialect.write_dwell(*s, false),
            Step::Read(s) => dialect.write_dwell(*s, true),
            Step::Repeat { times, steps } => {
                dialect.begin_repeat(*times);
                write_steps(plan, steps, dialect, at_um);
                dialect.end_repeat();
            }
        }
    }
}

fn advance_to_targets(
    plan: &MeasurementPlan,
    to_mm: &[Option<f64>; 3],
    at_um: &mut [Option<i64>; 3],
) -> MoveTargets {
    let mut axes = Vec::new();
    for (axis, to_mm) in to_mm.iter().enumerate() {
        let Some(to_mm) = to_mm else { continue };
        // X of a lathe is written as a diameter.
        let times = if plan.is_lathe && axis == 0 { 2 } else { 1 };
        let to = times * to_micrometres(*to_mm);
        axes.push((axis, at_um[axis].replace(to), to));
    }
    MoveTargets { axes }
}

/// Returns the row of what touches have found.
fn build_result_row(plan: &MeasurementPlan, found: &ProbedPoint) -> Vec<Cell> {
    let reading = PlannedReading::from_probed_point(found);
    let cell = |column: &Column| {
        let name = template::column_name(column);
        let measured = ["measured_dx_um", "measured_dy_um", "measured_dz_um"];
        let mean = measured
            .iter()
            .position(|candidate| *candidate == name)
            .and_then(|axis| found.by[axis]);
        mean.map_or_else(|| Cell::Text(template::cell_text(column, &reading)), Cell::Found)
    };
    plan.columns.iter().map(cell).collect()
}

/// Returns the blocks of an arc, and puts the axes to its end; `None` where it is not known from where it goes.
fn advance_along_arc(arc: &ArcMove, at_um: &mut [Option<i64>; 3]) -> Option<ArcBlocks> {
    let mut from = [at_um[arc.axes[0]]?, at_um[arc.axes[1]]?];
    let centre = arc.centre_mm.map(to_micrometres);
    let mut blocks = Vec::new();
    for turn_deg in arc.block_angles_deg() {
        let block = ArcMove { turn_deg, ..*arc };
        let end = block.end_mm(from.map(|um| um as f64 / 1000.0)).map(to_micrometres);
        let way = |to: [i64; 2]| [0, 1].map(|n| to[n] - from[n]);
        blocks.push((turn_deg > 0.0, way(end), way(centre)));
        from = end;
    }
    for (axis, um) in arc.axes.into_iter().zip(from) {
        at_um[axis] = Some(um);
    }
    Some(ArcBlocks { axes: arc.axes, blocks, feed: arc.feed_mm_per_min })
}

/// A machine is far shorter than what an i64 holds.
fn to_micrometres(mm: f64) -> i64 {
    (mm * 1000.0).round() as i64
}
