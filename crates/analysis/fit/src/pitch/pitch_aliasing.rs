//! Which screw pitches a set of test points cannot see.
//!
//! An error that repeats with the pitch p of the screw has the same value at all positions of equal
//! phase x/p. Targets that all have about one phase show it as a constant, and no table made from
//! them takes it away. How much of its amplitude they show follows from how their phases are
//! spread over the turn, with the length of their mean vector:
//!
//! ```text
//! ρ = |1/m · Σ e^(2πi·xᵢ/p)|,   share shown = √(1 − ρ²)
//! ```

use std::f64::consts::TAU;

/// Usual pitches of ball screws, and travels of a motor's turn behind a gear or a belt, in mm.
const COMMON_PITCHES_MM: [f64; 17] =
    [1.0, 2.0, 2.5, 4.0, 5.0, 5.08, 6.0, 8.0, 10.0, 12.0, 12.7, 16.0, 20.0, 25.0, 32.0, 40.0, 50.0];

/// Below this share of its amplitude an error counts as hidden.
const MIN_VISIBLE_AMPLITUDE_RATIO: f64 = 0.1;

/// Fewer targets have one phase by chance.
const MIN_ALIASING_TARGETS: usize = 3;

/// Returns the likely pitches, in mm, of which `targets_mm` show next to nothing.
///
/// ```
/// use trueup_fit::pitch::find_aliased_pitches;
/// assert_eq!(find_aliased_pitches(&[0.0, 5.0, 10.0, 15.0]), [1.0, 2.5, 5.0]);
/// assert!(find_aliased_pitches(&[0.0, 5.3, 10.7, 14.6]).is_empty());
/// ```
#[must_use]
pub fn find_aliased_pitches(targets_mm: &[f64]) -> Vec<f64> {
    if targets_mm.len() < MIN_ALIASING_TARGETS {
        return Vec::new();
    }
    let span = targets_mm.iter().fold(f64::NEG_INFINITY, |a, &b| a.max(b))
        - targets_mm.iter().fold(f64::INFINITY, |a, &b| a.min(b));
    // A pitch longer than the travel is part of the shape that the targets do show.
    let is_hidden = |pitch: &f64| {
        *pitch < span && visible_amplitude_ratio(targets_mm, *pitch) < MIN_VISIBLE_AMPLITUDE_RATIO
    };
    COMMON_PITCHES_MM.into_iter().filter(is_hidden).collect()
}

fn visible_amplitude_ratio(targets_mm: &[f64], pitch_mm: f64) -> f64 {
    let count = targets_mm.len() as f64;
    let (sin, cos) = targets_mm
        .iter()
        .map(|x| (TAU * (x / pitch_mm).fract()).sin_cos())
        .fold((0.0, 0.0), |sum, sin_cos| (sum.0 + sin_cos.0, sum.1 + sin_cos.1));
    let mean = sin.hypot(cos) / count;
    (1.0 - mean * mean).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn multiples_of_a_pitch_hide_it_wherever_they_start() {
        let targets: Vec<f64> = (0..9).map(|n| 3.7 + 20.0 * f64::from(n)).collect();
        assert_eq!(find_aliased_pitches(&targets), [1.0, 2.0, 2.5, 4.0, 5.0, 10.0, 20.0]);
    }

    #[test]
    fn uneven_steps_show_every_pitch() {
        let targets = [0.0, 23.1, 38.7, 62.9, 79.2, 103.6, 117.9, 142.3];
        assert!(find_aliased_pitches(&targets).is_empty());
    }

    #[test]
    fn a_hundredth_of_a_turn_of_scatter_does_not_show_a_pitch_and_a_tenth_does() {
        let jitter = [0.0, 1.0, -1.0, 0.5, -0.5, 0.8, -0.8];
        let targets = |scatter: f64| -> Vec<f64> {
            (0..7).map(|n| 10.0 * n as f64 + scatter * 10.0 * jitter[n]).collect()
        };
        assert!(find_aliased_pitches(&targets(0.01)).contains(&10.0));
        assert!(!find_aliased_pitches(&targets(0.1)).contains(&10.0));
    }

    #[test]
    fn the_share_shown_is_the_standard_deviation_of_small_phases() {
        let spread = [-0.01, 0.01, -0.01, 0.01];
        let targets: Vec<f64> = spread.iter().enumerate().map(|(n, s)| n as f64 + s).collect();
        let share = visible_amplitude_ratio(&targets, 1.0);
        assert!((share - TAU * 0.01).abs() < 1e-4, "{share}");
    }
}
