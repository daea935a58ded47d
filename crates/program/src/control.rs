//! A plan as the text that a control runs.
//!
//! | control | machine coordinates | repeats | dwell |
//! |---|---|---|---|
//! | LinuxCNC | `G53` in each block | `o101 repeat [7]` | `G4 P5` |
//! | FANUC | the way from `#5021` to `#5023`, as `G53` moves at rapid only; then increments (`G91`) | `M98 P7101 L7` | `G04 X5.` |
//! | Siemens 840D sl | `SUPA` in each block | `FOR R1=1 TO 7` | `G4 F5` |
//! | HEIDENHAIN | `M91` in each block | `LBL 1` … `CALL LBL 1 REP 6` | cycle 9 |
//!
//! Every program begins with a stop ([`Plan::first_stop`]), then sets the modes that it needs; no block moves at
//! rapid, and none by a way from a place that the program does not know. No form depends on a work offset. Positions are whole micrometres, so that increments add up to
//! exactly where they began.
//!
//! X of a lathe is a diameter in the text (`G7`, `DIAMON`), and a radius everywhere else.

mod dialect;
mod fanuc;
mod heidenhain;
mod linuxcnc;
mod siemens;

use self::dialect::{Dialect, Ends};
use trueup_machine::{Machine, file::Kind};

use crate::{
    plan::{Plan, Step},
    refused::Refused,
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
    pub fn check(self, machine: &Machine) -> Result<(), Refused> {
        let why = match self {
            Self::LinuxCnc | Self::Siemens => return Ok(()),
            Self::Fanuc => {
                "G90 begins a turning cycle in G-code system A, and a parameter says whether X is a diameter"
            }
            Self::Heidenhain => "turning is a mode of its own, which has not been tried",
        };
        match machine.kind {
            Kind::Lathe => Err(Refused(format!(
                "no program of a lathe for this control: {why}. Move by hand to the positions of the program for siemens, \
                 and fill in its run file"
            ))),
            _ => Ok(()),
        }
    }
}

/// Returns the name and text of the program.
#[must_use]
pub fn program(plan: &Plan, control: Control) -> (String, String) {
    let name = plan.name.replace('-', "_");
    let text = |mut dialect: Box<dyn Dialect>| {
        dialect.head(plan);
        dialect.stop(&plan.first_stop());
        dialect.modes(plan.is_lathe);
        let mut at_um = [None; 3];
        write(plan, &plan.steps, dialect.as_mut(), &mut at_um);
        dialect.end()
    };
    match control {
        Control::LinuxCnc => (format!("{name}.ngc"), text(Box::<linuxcnc::Text>::default())),
        Control::Fanuc => (format!("{name}.nc"), text(Box::<fanuc::Text>::default())),
        Control::Siemens => (format!("{name}.mpf"), text(Box::<siemens::Text>::default())),
        Control::Heidenhain => (format!("{name}.h"), text(Box::<heidenhain::Text>::default())),
    }
}

fn write(plan: &Plan, steps: &[Step], dialect: &mut dyn Dialect, at_um: &mut [Option<i64>; 3]) {
    for step in steps {
        match step {
            Step::Note(text) => dialect.note(text),
            Step::Stop(text) => {
                dialect.stop(text);
                // The operator may have jogged.
                *at_um = [None; 3];
            }
            Step::Approach { axis, to_mm } => {
                let mut to = [None; 3];
                to[*axis] = Some(*to_mm);
                dialect.line(&ends(plan, &to, at_um), plan.approach_mm_per_min);
            }
            Step::Move { to_mm, feed_mm_per_min } => {
                dialect.line(&ends(plan, to_mm, at_um), *feed_mm_per_min);
            }
            Step::Spindle(rpm) => dialect.spindle(*rpm),
            Step::Dwell(s) => dialect.dwell(*s, false),
            Step::Read(s) => dialect.dwell(*s, true),
            Step::Repeat { times, steps } => {
                dialect.repeat(*times);
                write(plan, steps, dialect, at_um);
                dialect.repeated();
            }
        }
    }
}

fn ends(plan: &Plan, to_mm: &[Option<f64>; 3], at_um: &mut [Option<i64>; 3]) -> Ends {
    let mut axes = Vec::new();
    for (axis, to_mm) in to_mm.iter().enumerate() {
        let Some(to_mm) = to_mm else { continue };
        // X of a lathe is written as a diameter.
        let times = if plan.is_lathe && axis == 0 { 2 } else { 1 };
        let to = times * micrometres(*to_mm);
        axes.push((axis, at_um[axis].replace(to), to));
    }
    Ends { axes }
}

/// A machine is far shorter than what an i64 holds.
fn micrometres(mm: f64) -> i64 {
    (mm * 1000.0).round() as i64
}
