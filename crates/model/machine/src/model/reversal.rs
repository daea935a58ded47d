//! The effect of a reversal on an axis's offset, and whether that goes against the reversal.
//!
//! A reversal into the negative direction changes an axis's error by B, and its offset by −B. With
//! B > 0, lost motion, the offset goes the way that the axis has just turned to. With B < 0, a CNC
//! that over-compensates, it goes back against it: who takes the direction of an axis from command and
//! offset together must not take that for another reversal, or the two would chase each other.

use crate::{
    Machine,
    effect::BoardTerm,
    sections::{LinearAxis, PitchErrorTable},
};

/// Travel that a backlash which grows with the position is reckoned for, in m: the wire's.
const MAX_TRAVEL_M: f64 = 21.5;

/// Returns the most by which the offset of `axis` goes against a reversal, in µm, 0 where it never does: the
/// sum of the largest of each part, so that the truth is at most as much.
///
/// ```
/// use std::path::Path;
/// use trueup_machine::{MachineFile, machine_file::LinearAxis, model::max_over_compensation_um};
/// let text = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[axis.x.backlash]\nwidth_um = -25.0\n\
///             [axis.y.backlash]\nwidth_um = 6.0\n";
/// let machine = MachineFile::parse(text, Path::new("m.toml")).unwrap();
/// assert_eq!(max_over_compensation_um(&machine, LinearAxis::X), 25.0);
/// assert_eq!(max_over_compensation_um(&machine, LinearAxis::Y), 0.0);
/// ```
#[must_use]
pub fn max_over_compensation_um(machine: &Machine, axis: LinearAxis) -> f64 {
    let own = &machine.axes[axis.index()];
    let pitches = own.pitch.iter().chain(own.dual.as_ref().map(|dual| &dual.pitch));
    let tables = pitches.map(max_table_reversal_um).fold(0.0, f64::max);
    let backlash = own.backlash.as_ref().map_or(0.0, |backlash| -backlash.width_um).max(0.0);
    let of_axis = machine.terms.iter().filter(|term| term.quantity.axis() == Some(axis));
    let forms = of_axis.flat_map(|term| term.effect.board_terms());
    let terms: f64 = forms
        .map(|form| match form {
            BoardTerm::Table(pitch) => max_table_reversal_um(&pitch),
            BoardTerm::Reversed { width_um, um_per_m } => {
                (-width_um).max(0.0) + um_per_m.abs() * MAX_TRAVEL_M
            }
            _ => 0.0,
        })
        .sum();
    tables + backlash + terms
}

/// Returns the most by which the reverse table is below the forward one.
fn max_table_reversal_um(pitch: &PitchErrorTable) -> f64 {
    let Some(reverse_um) = &pitch.reverse_um else { return 0.0 };
    let steps = pitch.forward_um.iter().zip(reverse_um);
    steps.map(|(forward, reverse)| forward - reverse).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::MachineFile;

    #[test]
    fn tables_backlash_and_terms_add_up() {
        let text = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[axis.x.pitch]\nstart_mm = 0.0\n\
                    step_mm = 100.0\nforward_um = [0.0, 3.0, 5.0]\nreverse_um = [4.0, 1.0, 5.0]\n\
                    [[term]]\ncause = \"backlash\"\nquantity = \"dx\"\nwidth_um = -7.0\n";
        let machine = MachineFile::parse(text, Path::new("m.toml")).expect("a machine file");
        assert_eq!(max_over_compensation_um(&machine, LinearAxis::X), 9.0);
        assert_eq!(max_over_compensation_um(&machine, LinearAxis::Z), 0.0);
    }
}
