//! Position errors of an axis and its backlash, in `f64` (`docs/physics.md` section 5).
//!
//! A table holds errors, actual minus commanded, at points of equal distance: linear between them,
//! the end values held outside. The direction of approach chooses the table where there are two.
//! A gantry that is driven at both ends has a table for each drive, and in between, at the share
//! w = (y − y₁)/(y₂ − y₁) of the way from the first to the second, held to 0…1:
//!
//! ```text
//! error = (1 − w)·e₁ + w·e₂
//! ```
//!
//! Backlash is an error of the approach in the negative direction only, which leaves the table
//! behind: B there, 0 in the positive direction.

use crate::sections::{Backlash, PitchErrorTable, SecondDrive, axis::is_negative_direction};

/// Returns the position error in µm at `position_mm`, approached in `direction` (+1 or −1); NaN for a
/// missing position.
///
/// ```
/// use trueup_machine::{machine_file::PitchErrorTable, model::pitch_error_um};
/// // 10 mm commanded, 9 mm moved: the error is −1 mm, and compensation adds +1 mm.
/// let pitch = PitchErrorTable {
///     start_mm: 0.0, step_mm: 10.0, forward_um: vec![0.0, -1000.0], reverse_um: None,
/// };
/// assert_eq!(pitch_error_um(&pitch, 10.0, 1.0), -1000.0);
/// assert_eq!(pitch_error_um(&pitch, 2.5, -1.0), -250.0);
/// ```
#[must_use]
pub fn pitch_error_um(pitch: &PitchErrorTable, position_mm: f64, direction: f64) -> f64 {
    let table = match &pitch.reverse_um {
        Some(reverse_um) if is_negative_direction(direction) => reverse_um,
        _ => &pitch.forward_um,
    };
    let (Some(&first), Some(&last)) = (table.first(), table.last()) else { return f64::NAN };
    let at = (position_mm - pitch.start_mm) / pitch.step_mm;
    if at.is_nan() {
        return f64::NAN;
    }
    if at < 0.0 {
        return first;
    }
    // A cast from f64 saturates, so that what is far outside has no next point either.
    let index = at as usize;
    match (table.get(index), index.checked_add(1).and_then(|next| table.get(next))) {
        (Some(low), Some(high)) => low + (high - low) * at.fract(),
        _ => last,
    }
}

/// Returns the position error in µm of a gantry with two drives: between the first one's `pitch` and the
/// second one's by where `across_mm` is on the beam.
///
/// ```
/// use trueup_machine::{machine_file::{SecondDrive, LinearAxis, PitchErrorTable}, model::dual_pitch_error_um};
/// let table = |um| PitchErrorTable { start_mm: 0.0, step_mm: 1.0, forward_um: vec![um], reverse_um: None };
/// let dual = SecondDrive {
///     across: LinearAxis::Y, first_mm: 0.0, second_mm: 3000.0, pitch: table(8.0),
/// };
/// // A quarter of the way: 3/4 · 4 + 1/4 · 8
/// assert_eq!(dual_pitch_error_um(&table(4.0), &dual, 500.0, 750.0, 1.0), 5.0);
/// ```
#[must_use]
pub fn dual_pitch_error_um(
    pitch: &PitchErrorTable,
    dual: &SecondDrive,
    position_mm: f64,
    across_mm: f64,
    direction: f64,
) -> f64 {
    let share = (across_mm - dual.first_mm) / (dual.second_mm - dual.first_mm);
    let share = share.clamp(0.0, 1.0);
    let first_um = pitch_error_um(pitch, position_mm, direction);
    let second_um = pitch_error_um(&dual.pitch, position_mm, direction);
    (1.0 - share) * first_um + share * second_um
}

/// Returns the error of backlash in µm after an approach in `direction` (+1 or −1).
///
/// ```
/// use trueup_machine::{machine_file::Backlash, model::backlash_um};
/// let backlash = Backlash { width_um: 4.0, ramp_mm: 0.0, hysteresis_um: 0.0 };
/// assert_eq!((backlash_um(&backlash, 1.0), backlash_um(&backlash, -1.0)), (0.0, 4.0));
/// ```
#[must_use]
pub fn backlash_um(backlash: &Backlash, direction: f64) -> f64 {
    if is_negative_direction(direction) { backlash.width_um } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sections::LinearAxis;

    fn both_ways() -> PitchErrorTable {
        PitchErrorTable {
            start_mm: -100.0,
            step_mm: 100.0,
            forward_um: vec![0.0, 1.5, 2.0],
            reverse_um: Some(vec![0.5, 2.0, 2.5]),
        }
    }

    #[test]
    fn a_table_is_linear_between_its_points_and_held_outside() {
        for (position_mm, um) in [
            (-1e9, 0.0),
            (-100.0, 0.0),
            (-50.0, 0.75),
            (0.0, 1.5),
            (20.0, 1.6),
            (100.0, 2.0),
            (100.1, 2.0),
            (1e300, 2.0),
            (f64::INFINITY, 2.0),
        ] {
            let there = pitch_error_um(&both_ways(), position_mm, 1.0);
            assert!((there - um).abs() < 1e-12, "{position_mm} mm: {there}");
        }
        assert!(pitch_error_um(&both_ways(), f64::NAN, 1.0).is_nan());
    }

    #[test]
    fn the_direction_of_approach_chooses_the_table_and_a_missing_one_is_forward() {
        assert_eq!(pitch_error_um(&both_ways(), 0.0, -1.0), 2.0);
        assert_eq!(pitch_error_um(&both_ways(), 0.0, f64::NAN), 1.5);
    }

    #[test]
    fn a_single_point_holds_everywhere() {
        let one = PitchErrorTable { forward_um: vec![7.0], reverse_um: None, ..both_ways() };
        for position_mm in [-1e6, -100.0, 0.0, 1e6] {
            assert_eq!(pitch_error_um(&one, position_mm, -1.0), 7.0);
        }
    }

    #[test]
    fn ten_millimetres_commanded_and_eleven_moved_are_an_error_of_plus_one() {
        let far = PitchErrorTable {
            start_mm: 0.0,
            step_mm: 10.0,
            forward_um: vec![0.0, 1000.0],
            ..both_ways()
        };
        assert_eq!(pitch_error_um(&far, 10.0, 1.0), 1000.0);
    }

    #[test]
    fn beyond_the_drives_the_nearer_one_holds() {
        let table = |um| PitchErrorTable { forward_um: vec![um], reverse_um: None, ..both_ways() };
        let dual = SecondDrive {
            across: LinearAxis::Y,
            first_mm: 3000.0,
            second_mm: 0.0,
            pitch: table(8.0),
        };
        let at = |across_mm| dual_pitch_error_um(&table(4.0), &dual, 0.0, across_mm, 1.0);
        assert_eq!((at(4000.0), at(3000.0)), (4.0, 4.0));
        assert_eq!((at(0.0), at(-1.0)), (8.0, 8.0));
        assert_eq!(at(1500.0), 6.0);
        assert!(at(f64::NAN).is_nan());
    }

    #[test]
    fn backlash_is_an_error_of_the_negative_approach_and_its_width_may_be_negative() {
        let lash = |width_um| Backlash { width_um, ramp_mm: 0.05, hysteresis_um: 1.0 };
        assert_eq!(backlash_um(&lash(4.0), -1.0), 4.0);
        assert_eq!(backlash_um(&lash(4.0), 1.0), 0.0);
        assert_eq!(backlash_um(&lash(4.0), f64::NAN), 0.0);
        assert_eq!(backlash_um(&lash(-2.5), -1.0), -2.5);
    }
}
