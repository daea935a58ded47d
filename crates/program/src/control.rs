//! A plan as the text that a control runs.
//!
//! | control | machine coordinates | repeats | dwell |
//! |---|---|---|---|
//! | LinuxCNC | `G53` in each block | `o101 repeat [7]` | `G4 P5` |
//! | FANUC | `G53` for rapid moves only, so what is measured is in increments (`G91`) from there | `M98 P7101 L7` | `G04 X5.` |
//! | Siemens 840D sl | `SUPA` in each block | `FOR R1=1 TO 7` | `G4 F5` |
//! | HEIDENHAIN | `M91` in each block | `LBL 1` … `CALL LBL 1 REP 6` | cycle 9 |
//!
//! No form depends on a work offset. Positions are whole micrometres, so that increments add up to
//! exactly where they began.

mod dialect;
mod fanuc;
mod heidenhain;
mod linuxcnc;
mod siemens;

use self::dialect::{Dialect, Ends};
use crate::plan::{Plan, Step};

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

/// The name and text of the program.
#[must_use]
pub fn program(plan: &Plan, control: Control) -> (String, String) {
    let name = plan.name.replace('-', "_");
    let text = |mut dialect: Box<dyn Dialect>| {
        dialect.head(plan);
        let mut at_um = [None; 3];
        write(&plan.steps, dialect.as_mut(), &mut at_um);
        dialect.end()
    };
    match control {
        Control::LinuxCnc => (format!("{name}.ngc"), text(Box::<linuxcnc::Text>::default())),
        Control::Fanuc => (format!("{name}.nc"), text(Box::<fanuc::Text>::default())),
        Control::Siemens => (format!("{name}.mpf"), text(Box::<siemens::Text>::default())),
        Control::Heidenhain => (format!("{name}.h"), text(Box::<heidenhain::Text>::default())),
    }
}

fn write(steps: &[Step], dialect: &mut dyn Dialect, at_um: &mut [Option<i64>; 3]) {
    for step in steps {
        match step {
            Step::Note(text) => dialect.note(text),
            Step::Stop(text) => dialect.stop(text),
            Step::Rapid(to_mm) => dialect.rapid(&ends(to_mm, at_um)),
            Step::Move { to_mm, feed_mm_per_min } => {
                dialect.line(&ends(to_mm, at_um), *feed_mm_per_min);
            }
            Step::By { axis, mm, feed_mm_per_min } => {
                let um = micrometres(*mm);
                at_um[*axis] = at_um[*axis].map(|at| at + um);
                dialect.by(*axis, um, *feed_mm_per_min);
            }
            Step::Spindle(rpm) => dialect.spindle(*rpm),
            Step::Dwell(s) => dialect.dwell(*s, false),
            Step::Read(s) => dialect.dwell(*s, true),
            Step::Repeat { times, steps } => {
                dialect.repeat(*times);
                write(steps, dialect, at_um);
                dialect.repeated();
            }
        }
    }
}

fn ends(to_mm: &[Option<f64>; 3], at_um: &mut [Option<i64>; 3]) -> Ends {
    let mut axes = Vec::new();
    for (axis, to_mm) in to_mm.iter().enumerate() {
        let Some(to_mm) = to_mm else { continue };
        let to = micrometres(*to_mm);
        axes.push((axis, at_um[axis].replace(to), to));
    }
    Ends { axes }
}

/// A machine is far shorter than what an i64 holds.
fn micrometres(mm: f64) -> i64 {
    (mm * 1000.0).round() as i64
}
